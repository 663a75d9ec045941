//! Every placed scan as a file of its own, whole and moved into the frame of its component.

use super::poses::{Document, Entry};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::geometry::rigid::PointMover;
use crate::io::{self, E57Scan, ReadOptions};
use crate::monitor::Monitor;
use crate::scan::assemble::{Attributes, assemble_with};
use crate::scan::{PointCloud, Reconstruction, ScanId};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const STAGE: &str = "exporting scans";

/// Formats that scans are exported in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScanFormat {
    /// Binary PLY, one file a scan.
    Ply,
    /// Binary PCD, one file a scan.
    Pcd,
    /// LAS 1.2, one file a scan; without normals.
    Las,
    /// LAZ, one file a scan; without normals.
    Laz,
    /// One E57 file a component: every scan in its own coordinates, with its pose.
    E57,
}

impl ScanFormat {
    fn extension(self) -> &'static str {
        match self {
            ScanFormat::Ply => "ply",
            ScanFormat::Pcd => "pcd",
            ScanFormat::Las => "las",
            ScanFormat::Laz => "laz",
            ScanFormat::E57 => "e57",
        }
    }
}

/// Writes all placed scans of a result into `folder`, with every point and its colour, intensity and
/// normal: `<scan>.ply` (or as the format is called), those of further components in `component_1/`, …;
/// or `scans.e57`, `scans_1.e57`, …. One file of scans is held in memory at a time. `options` are those
/// that the scans were registered with.
///
/// Returns the files.
///
/// # Errors
/// [`Error::OutputExists`] when one of the files exists and `replace` is not given; files of scans that
/// cannot be read any more or hold something else now; [`Error::Write`], [`Error::Interrupted`].
pub fn export_scans(
    document: &Document,
    options: &ReadOptions,
    folder: &Path,
    format: ScanFormat,
    replace: bool,
    monitor: &dyn Monitor,
) -> Result<Vec<PathBuf>> {
    let reconstruction = document.reconstruction()?;
    let exports = exports(document, &reconstruction, folder, format)?;
    let mut files: Vec<PathBuf> = exports.iter().map(|e| e.file.clone()).collect();
    files.dedup();
    if !replace && files.iter().any(|f| f.exists()) {
        return Err(Error::OutputExists { path: folder.to_path_buf() });
    }
    for parent in files.iter().filter_map(|f| f.parent()) {
        std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
    }
    let mut source = Source { options: ReadOptions { attributes: true, ..options.clone() }, current: None };
    monitor.begin(STAGE, exports.len());
    let mut next = |export: &Export<'_>| {
        monitor.check(STAGE)?;
        let cloud = source.take(export.entry)?;
        monitor.advance(1);
        Ok(cloud)
    };
    if format == ScanFormat::E57 {
        for file in &files {
            let members = exports.iter().filter(|e| e.file == *file);
            let scans = members.map(|export| {
                let (name, world_from_scan) = (export.entry.name.clone(), export.world_from_scan);
                Ok(E57Scan { name, world_from_scan, cloud: next(export)? })
            });
            io::write_e57(file, scans)?;
        }
    } else {
        for export in &exports {
            write_one(&export.file, &moved(&next(export)?, &export.world_from_scan), format)?;
        }
    }
    monitor.end();
    Ok(files)
}

/// A scan, its pose, and the file that it goes into.
struct Export<'a> {
    entry: &'a Entry,
    world_from_scan: RigidMotion,
    file: PathBuf,
}

/// What is to be written, file by file.
fn exports<'a>(
    document: &'a Document,
    reconstruction: &Reconstruction,
    folder: &Path,
    format: ScanFormat,
) -> Result<Vec<Export<'a>>> {
    let extension = format.extension();
    let mut exports = Vec::new();
    for entry in &document.scans {
        let outcome = reconstruction.outcomes.get(entry.id);
        let Some(placement) = outcome.and_then(|o| o.placement()) else { continue };
        let file = match (format, placement.component) {
            (ScanFormat::E57, 0) => folder.join("scans.e57"),
            (ScanFormat::E57, c) => folder.join(format!("scans_{c}.e57")),
            (_, 0) => folder.join(format!("{}.{extension}", entry.name)),
            (_, c) => folder.join(format!("component_{c}")).join(format!("{}.{extension}", entry.name)),
        };
        exports
            .push((placement.component, Export { entry, world_from_scan: placement.world_from_scan, file }));
    }
    if exports.is_empty() {
        let expected = "at least one scan with a pose";
        return Err(Error::input("result", "no placed scan", expected, "register the scans again"));
    }
    // Components one after the other; within each the order of the input.
    exports.sort_by_key(|(component, export)| (*component, ScanId(export.entry.id)));
    Ok(exports.into_iter().map(|(_, export)| export).collect())
}

/// The files of the scans, the last of which is kept: it may hold the next scan too.
struct Source {
    options: ReadOptions,
    current: Option<(PathBuf, Vec<Option<PointCloud>>)>,
}

impl Source {
    fn take(&mut self, entry: &Entry) -> Result<PointCloud> {
        let Some(path) = entry.file.as_ref().map(PathBuf::from) else {
            let expected = "the file that it came from";
            return Err(Error::input(&entry.name, "a scan without a file", expected, "register files"));
        };
        if self.current.as_ref().is_none_or(|(read, _)| *read != path) {
            // Before the next is read, so that two are never held.
            self.current = None;
            io::check_named_scan(&path)?;
            let scans = io::read_file(&path, &self.options)?.scans;
            self.current = Some((path.clone(), scans.into_iter().map(|s| Some(s.cloud)).collect()));
        }
        let part = entry.part.unwrap_or(0);
        let scans = self.current.as_mut().map(|(_, scans)| scans);
        scans.and_then(|scans| scans.get_mut(part)?.take()).ok_or_else(|| {
            let found = format!("no scan {} in it", part + 1);
            Error::file(&path, found, "the file that was registered", "register it again")
        })
    }
}

fn write_one(path: &Path, cloud: &PointCloud, format: ScanFormat) -> Result<()> {
    match format {
        ScanFormat::Pcd => io::write_pcd(path, cloud),
        ScanFormat::Las | ScanFormat::Laz => io::write_las(path, cloud, format == ScanFormat::Laz),
        ScanFormat::Ply | ScanFormat::E57 => {
            let PointCloud { points, origin_m, normals, colors, intensities, .. } = cloud;
            let (normals, colors) = (normals.as_deref(), colors.as_deref());
            let intensities = intensities.as_deref();
            let cloud =
                io::PlyCloud { points, origin_m: *origin_m, normals, colors, intensities, scans: None };
            io::write_ply(path, &cloud)
        }
    }
}

/// A cloud in the frame of its component.
fn moved(cloud: &PointCloud, world_from_scan: &RigidMotion) -> PointCloud {
    let world_from_points = world_from_scan * cloud.file_from_points();
    let mover = PointMover::new(world_from_scan);
    let world = |i: usize| (world_from_points * cloud.points[i].cast::<f64>()).coords.into();
    let rgb = cloud.colors.as_ref().map(|colors| |i: usize| colors[i]);
    let intensity = cloud.intensities.as_ref().map(|intensities| |i: usize| intensities[i]);
    let normal = cloud.normals.as_ref().map(|normals| {
        let mover = &mover;
        move |i: usize| mover.direction(&normals[i]).into()
    });
    let attributes = Attributes {
        rgb: rgb.as_ref().map(|f| f as &dyn Fn(usize) -> [u8; 3]),
        intensity: intensity.as_ref().map(|f| f as &dyn Fn(usize) -> f32),
        normal: normal.as_ref().map(|f| f as &dyn Fn(usize) -> [f32; 3]),
    };
    let viewpoint = cloud.viewpoint.map(|v| (world_from_points * v.cast::<f64>()).coords.into());
    assemble_with(cloud.len(), world, &attributes, viewpoint)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Direction, Point};
    use crate::monitor::Silent;
    use crate::scan::{Outcome, Placement, Scan};
    use nalgebra::Vector3;

    /// A component that the scan is placed in.
    fn placed(world_from_scan: RigidMotion, component: usize) -> Outcome {
        Outcome::Placed(Placement {
            world_from_scan,
            component,
            step: 0,
            parent: None,
            matches: 0,
            inliers: 0,
            residual_m: 0.0,
            evidence: None,
            neighbours: Vec::new(),
            pose_uncertainty: None,
        })
    }

    /// Writes two scans with all attributes; the first is turned by a quarter turn about z and moved far
    /// away: (x, y, z) → (4e5 − y, 2 + x, 3 + z). The second has a component of its own.
    fn result(folder: &Path) -> Document {
        let points: Vec<Point> = (0..12).map(|k| Point::new(k as f32, 2.0, 0.25 * k as f32)).collect();
        let cloud = io::PlyCloud {
            points: &points,
            normals: Some(&[Direction::x(); 12]),
            colors: Some(&[[10, 20, 30]; 12]),
            intensities: Some(&[0.5; 12]),
            ..io::PlyCloud::default()
        };
        let scan = |k: usize| {
            let path = folder.join(format!("s{k}.ply"));
            io::write_ply(&path, &cloud).unwrap();
            Scan { id: ScanId(k), name: format!("s{k}"), path: Some(path), ..Scan::default() }
        };
        let turn = Vector3::z() * std::f64::consts::FRAC_PI_2;
        let moved = RigidMotion::new(Vector3::new(4e5, 2.0, 3.0), turn);
        let outcomes = vec![placed(moved, 0), placed(RigidMotion::identity(), 1)];
        Document::new(&[scan(0), scan(1)], &Reconstruction { outcomes }, 0.07)
    }

    #[test]
    fn scans_are_written_whole_and_moved_with_what_the_format_has_room_for() {
        let folder = tempfile::tempdir().unwrap();
        let document = result(folder.path());
        let attributes = ReadOptions { attributes: true, ..ReadOptions::default() };
        for format in [ScanFormat::Ply, ScanFormat::Pcd, ScanFormat::Las, ScanFormat::Laz, ScanFormat::E57] {
            let out = folder.path().join(format.extension());
            let export =
                |replace| export_scans(&document, &ReadOptions::default(), &out, format, replace, &Silent);
            let files = export(false).unwrap();
            let names = match format {
                ScanFormat::E57 => ["scans.e57".to_owned(), "scans_1.e57".to_owned()],
                _ => ["s0", "component_1/s1"].map(|n| format!("{n}.{}", format.extension())),
            };
            assert_eq!(files, names.map(|n| out.join(n)));
            assert!(matches!(export(false), Err(Error::OutputExists { .. })));
            export(true).unwrap();

            let stored = io::read_file(&files[0], &attributes).unwrap().scans.remove(0);
            // An E57 file has the pose beside the points.
            let world_from_file = match format {
                ScanFormat::E57 => stored.pose.unwrap(),
                _ => RigidMotion::identity(),
            };
            let world_from_points = world_from_file * stored.cloud.file_from_points();
            assert_eq!(stored.cloud.len(), 12);
            for (k, point) in stored.cloud.points.iter().enumerate() {
                let k = k as f64;
                let expected = nalgebra::Point3::new(4e5 - 2.0, 2.0 + k, 3.0 + 0.25 * k);
                let found = world_from_points * point.cast::<f64>();
                assert!((found - expected).norm() < 1e-5, "{format:?}: {found}, not {expected}");
            }
            assert_eq!(stored.cloud.colors, Some(vec![[10, 20, 30]; 12]), "{format:?}");
            let intensities = stored.cloud.intensities.unwrap();
            let las = matches!(format, ScanFormat::Las | ScanFormat::Laz);
            // Half of the 65535 of LAS, whatever a reader makes of it.
            let expected = if las && intensities[0] > 1.0 { 32768.0 } else { 0.5 };
            assert!(intensities.iter().all(|v| (v - expected).abs() < 1e-4), "{format:?}: {intensities:?}");
            if matches!(format, ScanFormat::Ply | ScanFormat::Pcd) {
                let normals = stored.cloud.normals.unwrap();
                assert!(
                    normals.iter().all(|n| (n - Direction::y()).norm() < 1e-6),
                    "{format:?}: {normals:?}"
                );
            }
        }
    }

    #[test]
    fn a_scan_whose_file_is_gone_is_an_error_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let document = result(folder.path());
        std::fs::remove_file(folder.path().join("s1.ply")).unwrap();
        let out = folder.path().join("out");
        let format = ScanFormat::E57;
        let error = export_scans(&document, &ReadOptions::default(), &out, format, false, &Silent);
        assert!(error.unwrap_err().to_string().contains("s1.ply"));
        assert!(!out.join("scans_1.e57").exists());
    }
}
