//! Scans that are read block by block: memory does not grow with their points.
//!
//! Binary PLY and PCD, LAS, LAZ and E57 are read so. Other formats, and odd files of these, are held whole.

use super::cloud::{Format, HEAD_BYTES, format_of};
use super::scan_file::ReadOptions;
use super::{e57, las, pcd, ply};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::{Direction, RigidMotion};
use crate::scan::PointCloud;
use crate::scan::assemble::{NO_COLORS, assemble, choose_origin};
use nalgebra::{Point3, Vector3};
use std::io::{self, Read};
use std::path::Path;

/// Points of a block: few beside what a program needs anyway, and enough that a block costs little by itself.
pub const BLOCK_POINTS: usize = 1 << 16;
/// Points that an origin and a viewpoint are chosen from, at least, where there are as many.
const SAMPLES: usize = 1001;

/// What takes the blocks of a scan.
pub type TakeBlock<'a> = dyn FnMut(PointCloud) -> Result<()> + 'a;

/// A scan that hands out its points block by block.
pub trait PointBlocks {
    /// Rows that there may be, for progress only; 0 where nothing tells.
    fn rows(&self) -> usize;

    /// Hands every block to `take`, in the order of the file and in its coordinates; each block may have
    /// an origin of its own. May be called again, and then gives the same.
    ///
    /// # Errors
    /// Those of reading the file, or the first of `take`.
    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()>;

    /// Puts the sensor into a cloud of points of all over the scan, where the file says where it stood.
    fn place_sensor(&self, _sample: &mut PointCloud) {}
}

/// A scan that is held whole.
pub struct Held(pub PointCloud);

impl PointBlocks for Held {
    fn rows(&self) -> usize {
        self.0.len()
    }

    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()> {
        let Held(cloud) = self;
        for start in (0..cloud.len()).step_by(BLOCK_POINTS) {
            let rows = start..cloud.len().min(start + BLOCK_POINTS);
            take(PointCloud {
                points: cloud.points[rows.clone()].to_vec(),
                colors: cloud.colors.as_ref().map(|all| all[rows.clone()].to_vec()),
                intensities: cloud.intensities.as_ref().map(|all| all[rows.clone()].to_vec()),
                normals: cloud.normals.as_ref().map(|all| all[rows.clone()].to_vec()),
                origin_m: cloud.origin_m,
                viewpoint: None,
                ..PointCloud::default()
            })?;
        }
        Ok(())
    }

    fn place_sensor(&self, sample: &mut PointCloud) {
        let Self(cloud) = self;
        if let Some(viewpoint) = cloud.viewpoint {
            sample.set_viewpoint(viewpoint.coords.cast::<f64>() + cloud.origin_m);
        }
    }
}

/// A scan whose unit is not the metre.
struct InUnit {
    blocks: Box<dyn PointBlocks>,
    unit_m: f64,
}

impl PointBlocks for InUnit {
    fn rows(&self) -> usize {
        self.blocks.rows()
    }

    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()> {
        let unit_m = self.unit_m;
        self.blocks.for_each(&mut |mut block| {
            block.scale(unit_m);
            take(block)
        })
    }

    fn place_sensor(&self, sample: &mut PointCloud) {
        sample.scale(self.unit_m.recip());
        self.blocks.place_sensor(sample);
        sample.scale(self.unit_m);
    }
}

/// Scan `part` of a file, to be read block by block; `None` where the file must be held whole, or cannot be
/// read, which reading it whole then says.
///
/// # Errors
/// [`Error::Read`] when the system refuses; those of a damaged file.
pub fn open_blocks(path: &Path, part: usize, options: &ReadOptions) -> Result<Option<Box<dyn PointBlocks>>> {
    let refused = |e| Error::read(path, e);
    let mut head = Vec::new();
    files::open(path)?.take(HEAD_BYTES).read_to_end(&mut head).map_err(refused)?;
    let Ok(format) = format_of(path, path, &head) else { return Ok(None) };
    let blocks = match format {
        Format::E57 => e57::blocks::open(path, part, options)?,
        // The others have one scan a file.
        _ if part > 0 => None,
        Format::Las => Some(las::blocks::open(path, options)?),
        Format::Ply => ply::blocks::open(path, options)?,
        Format::Pcd => pcd::blocks::open(path, options)?,
        _ => None,
    };
    Ok(match options.unit_m {
        Some(unit_m) => blocks.map(|blocks| Box::new(InUnit { blocks, unit_m }) as Box<dyn PointBlocks>),
        None => blocks,
    })
}

/// What the headers of formats say of a scan's points.
#[derive(Debug, Clone)]
pub struct Summary {
    /// How many there are.
    pub points: usize,
    /// Coordinates that the others are large beside, or zero: see [`PointCloud::origin_m`].
    pub origin_m: Vector3<f64>,
    /// Least coordinates.
    pub low_m: Vector3<f64>,
    /// Largest coordinates.
    pub high_m: Vector3<f64>,
    /// Whether they have colours.
    pub colors: bool,
    /// Whether they have normals.
    pub normals: bool,
    /// Whether they have intensities.
    pub intensities: bool,
    /// Least and largest finite intensity.
    pub intensity_range: Option<[f32; 2]>,
    /// Where the sensor stood.
    pub viewpoint_m: Option<Vector3<f64>>,
}

impl Summary {
    /// Goes once over the points of a scan, moved by `world_from_scan`; `seen` hears of every block.
    ///
    /// # Errors
    /// Those of reading, or the first of `seen`.
    pub fn of(
        blocks: &mut dyn PointBlocks,
        world_from_scan: &RigidMotion,
        seen: &mut dyn FnMut(usize) -> Result<()>,
    ) -> Result<Self> {
        let mut summary = Self {
            points: 0,
            origin_m: Vector3::zeros(),
            low_m: Vector3::repeat(f64::INFINITY),
            high_m: Vector3::repeat(f64::NEG_INFINITY),
            colors: false,
            normals: false,
            intensities: false,
            intensity_range: None,
            viewpoint_m: None,
        };
        let mut sample = Sample::default();
        blocks.for_each(&mut |block| {
            summary.add(&block, world_from_scan, &mut sample);
            seen(block.len())
        })?;
        let world: Vec<[f64; 3]> =
            sample.points.iter().map(|p| (world_from_scan * Point3::from(*p)).coords.into()).collect();
        summary.origin_m = choose_origin(world.len(), &|i| world[i]);
        let mut cloud = assemble(sample.points.len(), |i| sample.points[i].into(), NO_COLORS, None);
        blocks.place_sensor(&mut cloud);
        let file_from_sample = cloud.file_from_points();
        let viewpoint = cloud.viewpoint.map(|v| file_from_sample * v.cast::<f64>());
        summary.viewpoint_m = viewpoint.map(|v| (world_from_scan * v).coords);
        Ok(summary)
    }

    fn add(&mut self, block: &PointCloud, world_from_scan: &RigidMotion, sample: &mut Sample) {
        self.points += block.len();
        self.colors |= block.colors.is_some();
        self.normals |= block.normals.is_some();
        self.intensities |= block.intensities.is_some();
        for i in 0..block.len() {
            let point = coordinates_m(block, i);
            sample.add(point);
            let moved = (world_from_scan * Point3::from(point)).coords;
            self.low_m = self.low_m.inf(&moved);
            self.high_m = self.high_m.sup(&moved);
        }
        for &v in block.intensities.iter().flatten().filter(|v| v.is_finite()) {
            let [low, high] = self.intensity_range.unwrap_or([v, v]);
            self.intensity_range = Some([low.min(v), high.max(v)]);
        }
    }
}

/// Points of all over a scan, evenly spread over its rows however many these are.
#[derive(Default)]
struct Sample {
    points: Vec<Vector3<f64>>,
    rows: usize,
    /// Every so many rows one is taken, less one.
    passed_over: usize,
}

impl Sample {
    fn add(&mut self, point: Vector3<f64>) {
        if self.rows.is_multiple_of(self.passed_over + 1) {
            self.points.push(point);
        }
        self.rows += 1;
        if self.points.len() > 2 * SAMPLES {
            let mut row = 0;
            self.points.retain(|_| {
                row += 1;
                row % 2 == 1
            });
            self.passed_over = 2 * self.passed_over + 1;
        }
    }
}

/// Coordinates of point `i` of a block, without the block's origin.
#[inline]
pub(super) fn coordinates_m(block: &PointCloud, i: usize) -> Vector3<f64> {
    block.points[i].coords.cast::<f64>() + block.origin_m
}

/// A block in the frame that `world_from_scan` takes it to. Its points keep their size beside its origin,
/// so that they lose nothing far from zero.
pub fn move_block(block: &mut PointCloud, world_from_scan: &RigidMotion) {
    let rotation = world_from_scan.rotation.to_rotation_matrix();
    let turned = |v: &Vector3<f32>| (rotation * v.cast::<f64>()).cast::<f32>();
    block.points.iter_mut().for_each(|p| p.coords = turned(&p.coords));
    block.normals.iter_mut().flatten().for_each(|n: &mut Direction| *n = turned(n));
    block.origin_m = (world_from_scan * Point3::from(block.origin_m)).coords;
}

/// An error on its way through a writer that knows only those of the system; [`unwrapped`] takes it out.
pub(super) fn wrapped(error: Error) -> io::Error {
    io::Error::other(error)
}

/// The error of a scan that could not be read while a file was written, instead of one of writing.
pub(super) fn unwrapped(error: Error) -> Error {
    match error {
        Error::Write { path, source } => match source.downcast::<Error>() {
            Ok(inner) => inner,
            Err(source) => Error::Write { path, source },
        },
        other => other,
    }
}

#[cfg(test)]
mod tests;
