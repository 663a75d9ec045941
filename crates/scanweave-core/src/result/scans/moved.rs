//! A scan on its way into a file: moved, with progress, and stopped when the user asks for it.

use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::io::{PointBlocks, Summary, TakeBlock, move_block};
use crate::monitor::Monitor;

const STAGE: &str = "exporting scans";

/// The points of a scan in the frame that they are written in.
pub(super) struct Moved<'a> {
    blocks: Box<dyn PointBlocks>,
    name: String,
    /// "scan 1 of 2".
    numbered: String,
    world_from_scan: RigidMotion,
    /// Points that the header of what is written promises.
    points: usize,
    monitor: &'a dyn Monitor,
}

impl<'a> Moved<'a> {
    pub(super) fn new(
        blocks: Box<dyn PointBlocks>,
        name: &str,
        numbered: &str,
        monitor: &'a dyn Monitor,
    ) -> Self {
        let (name, numbered) = (name.to_owned(), numbered.to_owned());
        Self { blocks, name, numbered, world_from_scan: RigidMotion::identity(), points: 0, monitor }
    }

    /// Says where the points go, and what the header of a file is to say of them there.
    ///
    /// # Errors
    /// Those of reading; [`Error::Interrupted`].
    pub(super) fn move_by(&mut self, world_from_scan: RigidMotion) -> Result<Summary> {
        let monitor = self.monitor;
        monitor.begin(&format!("reading {}", self.numbered), self.blocks.rows());
        monitor.note(&self.name);
        let summary = Summary::of(&mut *self.blocks, &world_from_scan, &mut |points| {
            monitor.advance(points);
            monitor.check(STAGE)
        })?;
        monitor.end();
        (self.world_from_scan, self.points) = (world_from_scan, summary.points);
        Ok(summary)
    }
}

impl PointBlocks for Moved<'_> {
    fn rows(&self) -> usize {
        self.points
    }

    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()> {
        let Self { blocks, name, numbered, world_from_scan, points, monitor } = self;
        monitor.begin(&format!("writing {numbered}"), *points);
        monitor.note(name);
        let mut moved = 0;
        blocks.for_each(&mut |mut block| {
            monitor.check(STAGE)?;
            let n = block.len();
            moved += n;
            move_block(&mut block, world_from_scan);
            take(block)?;
            monitor.advance(n);
            Ok(())
        })?;
        monitor.end();
        if moved != *points {
            let expected = format!("{points}, as at first");
            let remedy = "let nothing write the scan's file, and export again";
            return Err(Error::input(&*name, format!("{moved} points"), expected, remedy));
        }
        Ok(())
    }
}
