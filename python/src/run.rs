//! A finished registration.

use crate::calls::{Said, said};
use crate::errors::{OrRaise, exception};
use crate::evaluation;
use crate::matrix;
use crate::scan::points;
use crate::watched::watched;
use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use scanweave::geometry::{Point, RigidMotion};
use scanweave::pipeline::{Run, Stopwatch};
use scanweave::report::remarks;
use scanweave::result::MergedCloud;
use scanweave::result::{self, Document};
use scanweave::result_folder::{self, Exports, GraphFormat, ResultFolder, TrajectoryFormat};
use scanweave::{Config, Error, Result, Scan};
use std::path::PathBuf;

/// What a registration was of, how it was made, and what came out.
#[pyclass(frozen, name = "Run", module = "scanweave._scanweave")]
pub struct PyRun {
    pub scans: Vec<Scan>,
    pub config: Config,
    pub run: Run,
    pub threads: Option<usize>,
}

/// Points `[n,3]`, colours and numbers of the scans that they are from.
type Cloud = (Py<PyArray2<f64>>, Option<Py<PyArray2<u8>>>, Py<PyArray1<u32>>);
/// Points `[n,3]` and colours.
type Placed = (Py<PyArray2<f64>>, Option<Py<PyArray2<u8>>>);
/// Target and source as indices of nodes; target_from_source, information, whether it is uncertain.
type Edge = (usize, usize, (Py<PyArray2<f64>>, Py<PyArray2<f64>>, bool));

impl PyRun {
    pub fn document(&self) -> Document {
        Document::new(&self.scans, &self.run.reconstruction, self.run.scale.inlier_radius_m)
    }

    fn check_component(&self, component: usize) -> Result<()> {
        let components = self.run.reconstruction.components();
        if component < components {
            return Ok(());
        }
        let expected = format!("a number below {components}, of the components there are");
        Err(Error::input("component", component.to_string(), expected, "see result.components"))
    }
}

#[pymethods]
impl PyRun {
    /// `poses.json` without the identity of the run.
    fn poses_json(&self) -> String {
        self.document().to_json()
    }

    /// The effective settings, as TOML.
    fn config_toml(&self, py: Python<'_>) -> PyResult<String> {
        self.config.to_toml().or_raise(py)
    }

    /// Working voxel and inlier radius, metres.
    #[getter]
    fn lengths_m(&self) -> (f64, f64) {
        (self.run.scale.voxel_m, self.run.scale.inlier_radius_m)
    }

    /// Seconds of every stage.
    #[getter]
    fn timings(&self) -> Vec<(String, f64)> {
        self.run.timings.iter().map(|t| (t.stage.clone(), t.seconds)).collect()
    }

    #[getter]
    fn remarks(&self) -> Vec<Said> {
        said(remarks::of_run(&self.run, &self.scans))
    }

    /// Predicted overlap `[N,N]`.
    #[getter]
    fn predicted_overlap(&self, py: Python<'_>) -> Py<PyArray2<f32>> {
        let similarity = &self.run.similarity;
        matrix::rows(py, similarity.len(), similarity.len(), |i, j| similarity.get(i, j))
    }

    /// The placed scans of a component in one thinned cloud, in the frame of the component.
    fn merged(&self, py: Python<'_>, component: usize, voxel_m: Option<f64>) -> PyResult<Cloud> {
        self.check_component(component).or_raise(py)?;
        let usual = self.config.output.merged_voxel_m.unwrap_or(0.5 * self.run.scale.voxel_m);
        let voxel_m = voxel_m.unwrap_or(usual);
        if !(voxel_m > 0.0 && voxel_m.is_finite()) {
            let expected = "a positive length in metres";
            let error = Error::input("voxel", voxel_m.to_string(), expected, "pass another one, or None");
            return Err(exception(py, &error));
        }
        let Self { scans, run, .. } = self;
        let cloud = watched(py, None, self.threads, |_| {
            Ok(MergedCloud::new(scans, &run.reconstruction, component, voxel_m as f32))
        })?;
        let colors = cloud.colors.as_ref().map(|c| matrix::rows(py, c.len(), 3, |i, k| c[i][k]));
        let scan = PyArray1::from_vec(py, cloud.scan).unbind();
        Ok((points(py, &cloud.points, &cloud.origin_m), colors, scan))
    }

    /// All points of a placed scan in the frame of its component, and its colours.
    fn placed_points(&self, py: Python<'_>, scan: usize) -> PyResult<Option<Placed>> {
        let Some(outcome) = self.run.reconstruction.outcomes.get(scan) else { return Ok(None) };
        let Some(placement) = outcome.placement() else { return Ok(None) };
        let cloud = &self.scans[scan].cloud;
        let world_from_points = placement.world_from_scan * cloud.file_from_points();
        let moved = |p: &Point| (world_from_points * p.cast::<f64>()).coords;
        let moved: Vec<_> = cloud.points.iter().map(moved).collect();
        let colors = cloud.colors.as_ref().map(|c| matrix::rows(py, c.len(), 3, |i, k| c[i][k]));
        Ok(Some((matrix::rows(py, moved.len(), 3, |i, k| moved[i][k]), colors)))
    }

    /// A component as a pose graph: numbers of its scans, and edges between them.
    fn pose_graph(&self, py: Python<'_>, component: usize) -> PyResult<(Vec<usize>, Vec<Edge>)> {
        self.check_component(component).or_raise(py)?;
        let Self { scans, run, .. } = self;
        let names: Vec<&str> = scans.iter().map(|s| s.name.as_str()).collect();
        let (registered, radius_m) = (run.pose_graph.as_ref(), run.scale.inlier_radius_m);
        let graph =
            result::pose_graph_of_component(&names, &run.reconstruction, registered, component, radius_m);
        let edges = graph.edges.iter().map(|e| {
            let information = matrix::rows(py, 6, 6, |r, c| e.information[(r, c)]);
            (e.i, e.j, (matrix::array(py, &e.i_from_j), information, e.uncertain))
        });
        Ok((graph.nodes.iter().map(|node| node.id.0).collect(), edges.collect()))
    }

    /// Writes the folder that the command writes.
    fn save(
        &self,
        py: Python<'_>,
        folder: PathBuf,
        force: bool,
        trajectory: Vec<String>,
        pose_graph: Vec<String>,
    ) -> PyResult<()> {
        let word = "one of tum, kitti, csv, colmap";
        let trajectory = formats::<TrajectoryFormat>("trajectory", &trajectory, word).or_raise(py)?;
        let pose_graph =
            formats::<GraphFormat>("pose_graph", &pose_graph, "one of g2o, open3d").or_raise(py)?;
        let exports = Exports { trajectory, pose_graph };
        let Self { scans, run, config, .. } = self;
        watched(py, None, self.threads, |monitor| {
            let folder = ResultFolder::open(&folder, force)?;
            folder.refuse_inputs(scans)?;
            folder.write(scans, run, config, &exports, Stopwatch::default(), monitor).map(|_| ())
        })
    }

    /// The result as a page.
    fn html(&self, py: Python<'_>) -> PyResult<String> {
        let Self { scans, run, config, .. } = self;
        watched(py, None, self.threads, |_| result_folder::page(scans, run, config))
    }

    /// Errors against true poses, as JSON: of the scans in their order, or of files in a folder.
    #[pyo3(signature = (truth, folder, limits, benchmark))]
    fn evaluate(
        &self,
        py: Python<'_>,
        truth: Option<Vec<PyReadonlyArray2<'_, f64>>>,
        folder: Option<PathBuf>,
        limits: (Option<f64>, f64),
        benchmark: Option<(PathBuf, f64)>,
    ) -> PyResult<String> {
        let truth = truth.map(|all| evaluation::motions("truth", &all)).transpose().or_raise(py)?;
        let truth: Option<Vec<RigidMotion>> = truth;
        evaluation::of_run(self, truth, folder, limits, benchmark).or_raise(py)
    }
}

/// Formats by their names.
fn formats<T: for<'a> serde::Deserialize<'a>>(
    argument: &str,
    names: &[String],
    expected: &str,
) -> Result<Vec<T>> {
    let one = |name: &String| {
        serde_json::from_value(serde_json::Value::String(name.clone()))
            .map_err(|_| Error::input(argument, format!("`{name}`"), expected, "name another format"))
    };
    names.iter().map(one).collect()
}
