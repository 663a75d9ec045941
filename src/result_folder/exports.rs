//! The files of a result for other programs.

use super::numbered;
use crate::Result;
use crate::io;
use crate::result;
use crate::result::Document;
use crate::scan::PoseGraph;
use serde::Deserialize;
use std::path::Path;

/// A format of trajectories.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrajectoryFormat {
    /// TUM: `trajectory.tum`.
    Tum,
    /// KITTI: `trajectory_kitti.txt`, and the names of the scans beside it.
    Kitti,
    /// A table: `trajectory.csv`.
    Csv,
    /// COLMAP: `images.txt`.
    Colmap,
}

/// A format of pose graphs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GraphFormat {
    /// g2o: `pose_graph.g2o`.
    G2o,
    /// Open3D: `pose_graph.json`.
    Open3d,
}

impl TrajectoryFormat {
    const ALL: [Self; 4] = [Self::Tum, Self::Kitti, Self::Csv, Self::Colmap];

    fn file(self, component: usize) -> String {
        match self {
            Self::Tum => numbered("trajectory", component, "tum"),
            Self::Kitti => numbered("trajectory_kitti", component, "txt"),
            Self::Csv => numbered("trajectory", component, "csv"),
            Self::Colmap => numbered("images", component, "txt"),
        }
    }
}

impl GraphFormat {
    const ALL: [Self; 2] = [Self::G2o, Self::Open3d];

    fn file(self, component: usize) -> String {
        match self {
            Self::G2o => numbered("pose_graph", component, "g2o"),
            Self::Open3d => numbered("pose_graph", component, "json"),
        }
    }
}

/// Names of all files that may be written for a component.
pub(super) fn files(component: usize) -> Vec<String> {
    let trajectories = TrajectoryFormat::ALL.into_iter().map(|f| f.file(component));
    let graphs = GraphFormat::ALL.into_iter().map(|f| f.file(component));
    let names = io::trajectory_names_file(Path::new(&TrajectoryFormat::Kitti.file(component)));
    trajectories.chain(graphs).chain([names.to_string_lossy().into_owned()]).collect()
}

/// What pose graphs need to know beside the poses.
#[derive(Debug)]
pub struct Registration<'a> {
    /// τ, metres.
    pub inlier_radius_m: f64,
    /// The pairs of a global method.
    pub pose_graph: Option<&'a PoseGraph>,
}

/// What is written for other programs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Exports {
    /// Trajectories.
    pub trajectory: Vec<TrajectoryFormat>,
    /// Pose graphs.
    pub pose_graph: Vec<GraphFormat>,
}

impl Exports {
    /// Whether nothing is asked for.
    pub fn is_empty(&self) -> bool {
        self.trajectory.is_empty() && self.pose_graph.is_empty()
    }

    /// Writes what is asked for into `folder`; returns the names of the files.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write), or a document with a pose that is no rigid motion.
    pub fn write(
        &self,
        folder: &Path,
        document: &Document,
        registration: &Registration<'_>,
    ) -> Result<Vec<String>> {
        let names = result::scan_names(document);
        let reconstruction = document.reconstruction()?;
        let mut written = Vec::new();
        for component in 0..document.components.len().max(1) {
            let scans = result::placed_scans(document, component)?;
            for format in &self.trajectory {
                let file = format.file(component);
                let path = folder.join(&file);
                match format {
                    TrajectoryFormat::Tum => io::write_tum_trajectory(path, &scans, &names)?,
                    TrajectoryFormat::Kitti => io::write_kitti_trajectory(path, &scans)?,
                    TrajectoryFormat::Csv => io::write_csv_trajectory(path, &scans)?,
                    TrajectoryFormat::Colmap => io::write_images_trajectory(path, &scans)?,
                }
                written.push(file);
            }
            for format in &self.pose_graph {
                let radius_m = registration.inlier_radius_m;
                let pairs = registration.pose_graph;
                let graph =
                    result::pose_graph_of_component(&names, &reconstruction, pairs, component, radius_m);
                let file = format.file(component);
                match format {
                    GraphFormat::G2o => io::write_g2o(folder.join(&file), &graph)?,
                    GraphFormat::Open3d => io::write_open3d_pose_graph(folder.join(&file), &graph)?,
                }
                written.push(file);
            }
        }
        Ok(written)
    }
}
