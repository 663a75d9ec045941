//! The true poses that a result is compared with.

use super::pose_error::{PoseReport, evaluate_against_truth, stated_centre};
use super::recall::{RecallConfig, RecallReport, registration_recall};
use crate::geometry::{Point, RigidMotion};
use crate::result::Document;
use crate::scan::{PointCloud, Reconstruction, ScanId};
use crate::{Error, io};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is known for true of the scans of a result, in their order.
#[derive(Debug)]
pub struct Truth {
    /// True `world_from_scan`.
    pub world_from_scan: Vec<RigidMotion>,
    /// How far the worst rotation was from orthonormal before it was replaced by the nearest rotation.
    pub deviation: f64,
    /// Files of the scans.
    files: Vec<PathBuf>,
}

impl Truth {
    /// The truth in `folder` on the scans of `document`, found by the names of their files.
    ///
    /// # Errors
    /// A folder that cannot be read, or a scan without a true pose.
    pub fn read(document: &Document, folder: &Path) -> Result<Self, Error> {
        let scene = io::read_scene(folder)?;
        let by_stem = true_poses(&scene, folder)?;
        let known = |name: &String| {
            let stem = name.rsplit('/').next().unwrap_or(name);
            by_stem.get(stem).cloned().ok_or_else(|| {
                let remedy = "name the folder that these scans came from with --truth";
                let found = format!("no true pose for the scan {name}");
                Error::file(folder, found, "the scans of the result", remedy)
            })
        };
        let found = document.scans.iter().map(|s| known(&s.name)).collect::<Result<Vec<_>, Error>>()?;
        let (world_from_scan, files) = found.into_iter().unzip();
        Ok(Self { world_from_scan, deviation: scene.world_from_scan.map_or(0.0, |t| t.deviation), files })
    }

    /// Centres of all scans in the frame of the truth, metres: those that the result states, else
    /// those of the boxes around the points of the files.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn centres(&self, reconstruction: &Reconstruction) -> Result<Vec<nalgebra::Point3<f64>>, Error> {
        let scans = self.world_from_scan.iter().zip(&self.files).zip(&reconstruction.outcomes);
        scans
            .map(|((world_from_scan, file), outcome)| {
                let centre = match outcome.placement().and_then(stated_centre) {
                    Some(centre) => centre,
                    None => box_centre(&io::read_cloud(file)?),
                };
                Ok(world_from_scan * centre)
            })
            .collect()
    }
}

/// True pose and file by the name of the scan.
fn true_poses(scene: &io::Scene, folder: &Path) -> Result<BTreeMap<String, (RigidMotion, PathBuf)>, Error> {
    let Some(truth) = &scene.world_from_scan else {
        return Err(Error::file(
            folder,
            "scans without true poses",
            "truth.json, a pose file beside each scan, poses/, poses.txt or one .conf",
            "see `scanweave evaluate --help` for the layouts",
        ));
    };
    let names = io::unique_names(&scene.scans);
    let stems = names.into_iter().map(|n| n.rsplit('/').next().unwrap_or(&n).to_owned());
    Ok(stems.zip(truth.value.iter().copied().zip(scene.scans.iter().cloned())).collect())
}

/// Centre of the box around a cloud's points, in the coordinates of its file, metres.
fn box_centre(cloud: &PointCloud) -> nalgebra::Point3<f64> {
    let low = cloud.points.iter().fold(Point::from([f32::INFINITY; 3]), |c, p| c.inf(p));
    let high = cloud.points.iter().fold(Point::from([f32::NEG_INFINITY; 3]), |c, p| c.sup(p));
    let centre = if cloud.is_empty() { Point::origin() } else { nalgebra::center(&low, &high) };
    cloud.file_from_points() * centre.cast::<f64>()
}

/// The errors of a result against the true poses in `truth_folder`.
///
/// # Errors
/// As [`Truth::read`].
pub fn against_truth(
    document: &Document,
    reconstruction: &Reconstruction,
    truth_folder: &Path,
) -> Result<PoseReport, Error> {
    evaluate_against_truth(reconstruction, &Truth::read(document, truth_folder)?.world_from_scan)
}

/// Recall on one benchmark (a folder with gt.log and gt.info), whose ids are the numbers at the end of the scans' names.
///
/// # Errors
/// A folder that cannot be read, or a pair of other scans than the result has.
pub fn benchmark_recall(
    folder: &Path,
    document: &Document,
    reconstruction: &Reconstruction,
    config: &RecallConfig,
) -> Result<RecallReport, Error> {
    let benchmark = io::read_benchmark(folder)?;
    let numbered: BTreeMap<usize, ScanId> = document
        .scans
        .iter()
        .filter_map(|entry| Some((trailing_number(&entry.name)?, ScanId(entry.id))))
        .collect();
    if let Some(pair) =
        benchmark.pairs.iter().find(|p| !numbered.contains_key(&p.i.0) || !numbered.contains_key(&p.j.0))
    {
        return Err(Error::file(
            folder.join("gt.log"),
            format!("the pair {} {}", pair.i, pair.j),
            format!("numbers of the {} scans of the result", document.scans.len()),
            "register all scans of the scene, or name the benchmark of this scene",
        ));
    }
    let relative =
        |i: ScanId, j: ScanId| reconstruction.relative_in_component(numbered[&i.0], numbered[&j.0]);
    registration_recall(&benchmark.pairs, relative, config)
}

fn trailing_number(name: &str) -> Option<usize> {
    let digits = name.bytes().rev().take_while(u8::is_ascii_digit).count();
    name[name.len() - digits..].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_of_a_cloud_is_that_of_its_box_in_file_coordinates() {
        // Most points lie at one corner: it is not their mean.
        let points = [[0.0; 3], [0.0; 3], [0.0, 0.1, 0.0], [2.0, 4.0, -6.0]].map(Point::from).to_vec();
        let origin_m = nalgebra::Vector3::new(500_000.0, 10.0, 0.0);
        let cloud = PointCloud { origin_m, ..PointCloud::from_points(points) };
        assert_eq!(box_centre(&cloud), nalgebra::Point3::new(500_001.0, 12.0, -3.0));
        assert_eq!(box_centre(&PointCloud::default()), nalgebra::Point3::origin());
    }
}
