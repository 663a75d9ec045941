//! The placed scans of a component, as trajectory files state them.

use super::poses::Document;
use crate::error::Result;
use crate::io::trajectories::PlacedScan;
use crate::scan::ScanId;

/// Placed scans of `component`, in the order of the input.
///
/// # Errors
/// [`Error::Input`](crate::Error::Input) when a pose of the document is no rigid motion.
pub fn placed_scans(document: &Document, component: usize) -> Result<Vec<PlacedScan>> {
    let reconstruction = document.reconstruction()?;
    let scans = document.scans.iter().zip(&reconstruction.outcomes).enumerate();
    let placed = scans.filter_map(|(id, (entry, outcome))| {
        let placement = outcome.placement().filter(|p| p.component == component)?;
        // A pivot's pose is what the component's frame is: its deviation of zero is exact.
        let deviation = placement.pose_uncertainty.as_ref().and_then(|u| u.deviation());
        Some(PlacedScan {
            id: ScanId(id),
            name: entry.name.clone(),
            file: entry.file.clone(),
            component,
            world_from_scan: placement.world_from_scan,
            probability: placement.evidence.and_then(|e| e.probability),
            sigma_t_m: deviation.map(|d| d.1),
            sigma_r_deg: deviation.map(|d| d.0),
        })
    });
    Ok(placed.collect())
}

/// Names of all scans, placed or not.
pub fn scan_names(document: &Document) -> Vec<&str> {
    document.scans.iter().map(|entry| entry.name.as_str()).collect()
}
