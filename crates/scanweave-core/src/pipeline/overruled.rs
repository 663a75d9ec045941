//! Rough poses that the scans contradict.

use super::Described;
use crate::scan::{Reconstruction, Scan, ScanId};

/// A rough pose that the scans contradict: it is off by more than three stated deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overruled {
    /// The scan.
    pub scan: ScanId,
    /// How far the centre of the scan is from where the rough pose has it, metres.
    pub moved_m: f64,
    /// By how much it is turned against the rough pose, degrees.
    pub turned_deg: f64,
}

impl Overruled {
    pub(super) fn all(scans: &[Scan], described: &Described, reconstruction: &Reconstruction) -> Vec<Self> {
        /// Deviations beyond which a rough pose and a final one contradict each other.
        const BEYOND: f64 = 3.0;
        let of = |(i, scan): (usize, &Scan)| {
            let (rough, stated) = (described.priors[i].rough?, scan.initial_pose?);
            let placed = reconstruction.world_from_scan(ScanId(i))?;
            let centre = described.frames[i] * nalgebra::Point3::origin();
            let moved_m = (placed * centre - stated * centre).norm();
            let turned = placed.rotation.angle_to(&stated.rotation);
            let off = moved_m > BEYOND * rough.position_deviation_m
                || turned > BEYOND * rough.rotation_deviation_rad;
            off.then_some(Self { scan: ScanId(i), moved_m, turned_deg: turned.to_degrees() })
        };
        scans.iter().enumerate().filter_map(of).collect()
    }
}
