//! Synthetic buildings to train on, made once and kept.

use super::{PosedScans, SynthEntry};
use crate::Monitor;
use crate::Result;
use crate::io::PlyCloud;
use crate::io::SceneWriter;
use crate::synthetic::{self, SynthConfig};
use std::path::{Path, PathBuf};

/// Raised when the generator makes other scans of the same settings.
const GENERATOR_VERSION: u32 = 1;

/// The building of one seed: from `cache` if it was made before, made and kept there otherwise.
///
/// # Errors
/// An unusable setting, a cache that cannot be written, or the user asked to stop.
pub(super) fn building(
    entry: &SynthEntry,
    seed: u64,
    cache: Option<&Path>,
    monitor: &dyn Monitor,
) -> Result<PosedScans> {
    let config = entry.config(seed);
    let name = format!("synthetic seed {seed}, {} rooms, {} scans", entry.rooms, entry.scans);
    let Some(place) = cache.map(|folder| place_of(folder, &config)) else {
        let set = synthetic::generate(&config, monitor)?;
        return Ok(PosedScans { name, scans: set.scans, world_from_scan: set.world_from_scan });
    };
    if place.join("PointCloud").is_dir() {
        match read(&place, monitor) {
            Ok(posed) => return Ok(PosedScans { name, ..posed }),
            Err(error) if monitor.cancelled() => return Err(error),
            Err(error) => tracing::warn!("making again what the cache should hold: {error}"),
        }
    }
    write(&place, &config, monitor)?;
    // Poses lose a last bit in a file: only what was read back is the same in this run and the next.
    Ok(PosedScans { name, ..read(&place, monitor)? })
}

/// Folder of a set, named by everything it depends on.
fn place_of(cache: &Path, config: &SynthConfig) -> PathBuf {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&GENERATOR_VERSION.to_le_bytes());
    // A config of plain numbers always has a JSON form.
    hasher.update(serde_json::to_string(config).unwrap_or_default().as_bytes());
    cache.join(format!("synth-{}", &hasher.finalize().to_hex()[..32]))
}

fn write(place: &Path, config: &SynthConfig, monitor: &dyn Monitor) -> Result<()> {
    let set = synthetic::generate(config, monitor)?;
    let writer = SceneWriter::begin(place, true)?;
    for (scan, pose) in set.scans.iter().zip(&set.world_from_scan) {
        let cloud = PlyCloud { points: &scan.cloud.points, ..PlyCloud::default() };
        writer.add(scan.id.0, &cloud, pose, &scan.name)?;
    }
    writer.finish()
}

fn read(place: &Path, monitor: &dyn Monitor) -> Result<PosedScans> {
    super::entries::read_posed(place, monitor)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Silent;

    #[test]
    fn a_building_is_the_same_from_the_generator_and_from_the_cache() {
        let folder = tempfile::tempdir().unwrap();
        let entry = SynthEntry { rooms: 1, scans: 3, frames_per_scan: 1, ..SynthEntry::default() };
        let made = building(&entry, 4, None, &Silent).unwrap();
        let same = |a: &PosedScans, b: &PosedScans| {
            let points = a.scans.iter().zip(&b.scans).all(|(a, b)| a.cloud.points == b.cloud.points);
            let off = a.world_from_scan.iter().zip(&b.world_from_scan);
            let off = off.map(|(a, b)| (a.to_homogeneous() - b.to_homogeneous()).abs().max());
            a.scans.len() == b.scans.len() && points && off.fold(0.0, f64::max) < 1e-12
        };
        let first = building(&entry, 4, Some(folder.path()), &Silent).unwrap();
        let kept = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
        let cloud = kept.join("PointCloud/cloud_bin_1.ply");
        let before = std::fs::metadata(&cloud).unwrap().modified().unwrap();
        let second = building(&entry, 4, Some(folder.path()), &Silent).unwrap();
        assert!(same(&made, &first) && first.world_from_scan == second.world_from_scan);
        assert!(same(&first, &second) && first.name == second.name && made.name == first.name);
        // Read, not made: the file is the old one.
        assert_eq!(std::fs::metadata(&cloud).unwrap().modified().unwrap(), before);
        // Another seed or setting has a place of its own; a damaged one is made again.
        building(&entry, 5, Some(folder.path()), &Silent).unwrap();
        let noisy = SynthEntry { noise: 0.5, ..entry.clone() };
        building(&noisy, 4, Some(folder.path()), &Silent).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
        std::fs::write(&cloud, b"ply\nformat ascii 1.0\n").unwrap();
        assert!(same(&made, &building(&entry, 4, Some(folder.path()), &Silent).unwrap()));
    }
}
