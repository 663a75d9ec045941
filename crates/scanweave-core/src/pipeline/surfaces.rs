//! Thinned scans: computed, or from the folder where another stage or shard kept them.

use super::features::hash_cloud;
use crate::error::Result;
use crate::geometry::{Direction, Point, RigidMotion};
use crate::io::features::CacheKey;
use crate::io::kept_surfaces::{KeptSurface, read_surface, write_surface};
use crate::monitor::Monitor;
use crate::preprocessing::{Thinned, ViewpointStudy, local_frame};
use crate::scan::{Scan, Surface, WorkingScale};
use rayon::prelude::*;
use std::ops::Range;
use std::path::Path;

/// Raised when kept surfaces of an older version must not be used any more.
const VERSION: u32 = 1;
const STAGE: &str = "surfaces";

/// Where thinned scans are kept.
#[derive(Debug, Clone, Copy)]
pub(super) enum Store<'a> {
    /// Nowhere.
    None,
    /// Read from this folder where it has them.
    Read(&'a Path),
    /// Also written into it, where shards of one stage find what each of them has done.
    ReadAndWrite(&'a Path),
}

/// All scans, in their own frames, thinned; those of `own` first, so that shards that begin together do
/// each other's work as little as possible.
pub(super) fn thinned(
    scans: &[Scan],
    scan_from_local: &[RigidMotion],
    scale: &WorkingScale,
    (store, own): (Store<'_>, Range<usize>),
    monitor: &dyn Monitor,
) -> Result<Vec<Surface>> {
    monitor.begin(STAGE, scans.len());
    let one = |i: usize| {
        monitor.check(STAGE)?;
        let thinned = through(store, &scans[i], &local_frame::file_zero(&scan_from_local[i]), scale)?;
        monitor.advance(1);
        Ok(thinned)
    };
    let n = scans.len();
    let (start, others) = (own.start, n - own.len());
    let mine = own.clone().into_par_iter().map(one).collect::<Result<Vec<_>>>()?;
    // From the next scan on and round: the shards after this one have done theirs meanwhile.
    let rest = (0..others).into_par_iter().map(|k| one((own.end + k) % n)).collect::<Result<Vec<_>>>()?;
    monitor.end();
    let mut all: Vec<Thinned> = mine.into_iter().chain(rest).collect();
    all.rotate_right(start);
    let studies: Vec<ViewpointStudy> = all.iter().map(|t| t.study).collect();
    let places = ViewpointStudy::decide(&studies);
    Ok(all.into_par_iter().zip(places).map(|(thinned, place)| thinned.seen_from(&place)).collect())
}

fn through(store: Store<'_>, scan: &Scan, file_zero: &Point, scale: &WorkingScale) -> Result<Thinned> {
    let compute = || Thinned::new(&scan.cloud, file_zero, scale);
    let (folder, write) = match store {
        Store::None => return Ok(compute()),
        Store::Read(folder) => (folder, false),
        Store::ReadAndWrite(folder) => (folder, true),
    };
    let key = key(scan, file_zero, scale);
    let path = folder.join(format!("surface-{}.npz", &blake3::Hash::from(key).to_hex()[..32]));
    if path.exists() {
        match read_surface(&path, &key).map(|kept| of_kept(&kept)) {
            Ok(Some(thinned)) => return Ok(thinned),
            Ok(None) => tracing::warn!("thinning again what {} should hold", path.display()),
            Err(error) => tracing::warn!("thinning again what the cache should hold: {error}"),
        }
    }
    let thinned = compute();
    if write {
        write_surface(&path, &to_kept(&thinned), &key)?;
    }
    Ok(thinned)
}

/// Digest of everything that a thinned scan depends on.
fn key(scan: &Scan, file_zero: &Point, scale: &WorkingScale) -> CacheKey {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"surface").update(&VERSION.to_le_bytes());
    for length in [scale.voxel_m, scale.normal_radius_m] {
        hasher.update(&length.to_le_bytes());
    }
    file_zero.coords.iter().for_each(|v| {
        hasher.update(&v.to_le_bytes());
    });
    hash_cloud(&mut hasher, &scan.cloud);
    if let Some(colors) = &scan.cloud.colors {
        hasher.update(colors.as_flattened());
    }
    hasher.finalize().into()
}

fn to_kept(thinned: &Thinned) -> KeptSurface {
    let Surface { points, normals, intensities, .. } = thinned.surface();
    let rows = points.iter().zip(normals).map(|(p, n)| [p.x, p.y, p.z, n.x, n.y, n.z]);
    let study = thinned.study.to_numbers();
    KeptSurface { rows: rows.collect(), intensities: intensities.clone(), study }
}

fn of_kept(kept: &KeptSurface) -> Option<Thinned> {
    let study = ViewpointStudy::of_numbers(&kept.study)?;
    let surface = Surface {
        points: kept.rows.iter().map(|r| Point::new(r[0], r[1], r[2])).collect(),
        normals: kept.rows.iter().map(|r| Direction::new(r[3], r[4], r[5])).collect(),
        intensities: kept.intensities.clone(),
        ..Surface::default()
    };
    Some(Thinned::of_parts(surface, study))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::Silent;
    use crate::pipeline::Shard;
    use crate::scan::PointCloud;

    /// Corners of boxes of different sizes, some of which state where they were seen from, with colours.
    fn scans() -> Vec<Scan> {
        let scan = |k: usize| {
            let at = |i: usize| i as f32 * 0.05 * (1.0 + 0.1 * k as f32);
            let sides = (0..900).flat_map(|i| {
                let (u, v) = (at(i % 30), at(i / 30));
                [Point::new(u, v, 0.0), Point::new(0.0, u, v), Point::new(u, 0.0, v)]
            });
            let points: Vec<Point> = sides.collect();
            let colors = (0..points.len()).map(|i| [i as u8, k as u8, 7]).collect();
            let mut cloud = PointCloud::from_points(points);
            cloud.colors = k.is_multiple_of(2).then_some(colors);
            cloud.viewpoint = (k == 1).then(|| Point::new(1.0, 1.0, 1.0));
            Scan { cloud, ..Scan::from_points(format!("s{k}"), &[]) }
        };
        (0..5).map(scan).collect()
    }

    #[test]
    fn shards_find_each_other_s_surfaces_and_nothing_changes() {
        let (scans, frames) = (scans(), vec![RigidMotion::identity(); 5]);
        let scale = WorkingScale::from_voxel(0.1);
        let make = |store: Store<'_>, own: Range<usize>| {
            thinned(&scans, &frames, &scale, (store, own), &Silent).unwrap()
        };
        let expected = make(Store::None, 0..5);
        assert!(expected.iter().all(|s| s.len() > 100) && !expected[0].intensities.is_empty());
        let place = tempfile::tempdir().unwrap();
        let files =
            || std::fs::read_dir(place.path()).unwrap().map(|e| e.unwrap().path()).collect::<Vec<_>>();
        assert_eq!(make(Store::Read(place.path()), 0..5), expected);
        assert!(files().is_empty());
        for index in 0..7 {
            let own = Shard { index, count: 7 }.range(5);
            assert_eq!(make(Store::ReadAndWrite(place.path()), own), expected);
            assert_eq!(files().len(), 5);
        }
        assert_eq!(make(Store::Read(place.path()), 0..5), expected);
        // They are read: another one under the name of the first is refused, another content is taken.
        let key = key(&scans[0], &Point::origin(), &scale);
        let path = place.path().join(format!("surface-{}.npz", &blake3::Hash::from(key).to_hex()[..32]));
        let mut kept = read_surface(&path, &key).unwrap();
        kept.rows.truncate(50);
        kept.intensities.truncate(50);
        write_surface(&path, &kept, &key).unwrap();
        assert_eq!(make(Store::Read(place.path()), 0..5)[0].len(), 50);
        write_surface(&path, &kept, &[0; 32]).unwrap();
        assert_eq!(make(Store::Read(place.path()), 0..5), expected);
        std::fs::write(&path, "cut").unwrap();
        assert_eq!(make(Store::ReadAndWrite(place.path()), 2..3), expected);
        assert_eq!(make(Store::Read(place.path()), 0..5), expected);
        assert!(read_surface(&path, &key).is_ok());
    }
}
