//! The true poses that a result is compared with.

use scanweave::evaluation::pose_error::{PoseReport, evaluate_against_truth, stated_centre};
use scanweave::geometry::{Point, RigidMotion};
use scanweave::result::Document;
use scanweave::scan::{PointCloud, Reconstruction};
use scanweave::{Error, io};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is known for true of the scans of a result, in their order.
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
