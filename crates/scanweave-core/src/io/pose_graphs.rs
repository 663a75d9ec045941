//! Pose graphs for other programs: g2o and Open3D.
//!
//! Both state the error of an edge as the motion `E` by which the relative pose differs from the
//! measured one, `i_from_j = measured · E`: a small motion in the frame of `j`, about the zero of its
//! coordinates. Open3D writes its rotation vector before its translation, g2o its translation before
//! the vector part of its quaternion.

use super::trajectories::{joined, translation_and_xyzw};
use crate::atomic;
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::scan::ScanId;
use nalgebra::Matrix6;
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

/// A scan with a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct GraphNode {
    /// Place in the input.
    pub id: ScanId,
    /// Unique name.
    pub name: String,
    /// Pose.
    pub world_from_scan: RigidMotion,
}

/// Two scans and what is known of their relative pose.
#[derive(Debug, Clone, PartialEq)]
pub struct GraphEdge {
    /// Index of the node whose frame is the target.
    pub i: usize,
    /// Index of the node whose frame is the source.
    pub j: usize,
    /// Takes coordinates of `j` to those of `i`.
    pub i_from_j: RigidMotion,
    /// Inverse covariance of the error: of a rotation vector (radians), then of a translation (metres),
    /// in the frame of `j` about its zero.
    pub information: Matrix6<f64>,
    /// Whether a solver may drop the edge.
    pub uncertain: bool,
}

/// A component as a graph.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseGraphFile {
    /// Its scans.
    pub nodes: Vec<GraphNode>,
    /// Index of the node whose frame is the component's.
    pub pivot: usize,
    /// Its edges.
    pub edges: Vec<GraphEdge>,
}

/// Writes `VERTEX_SE3:QUAT` lines, `FIX` of the pivot, and `EDGE_SE3:QUAT` lines (g2o). Vertices are
/// numbered by the places of the scans in the input.
///
/// The information is over `[t; q_xyz]`: a quaternion's vector is half the rotation vector, so that
/// the block of the rotation is four times that of the rotation vector, and that between both twice.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub fn write_g2o(path: impl AsRef<Path>, graph: &PoseGraphFile) -> Result<()> {
    atomic::write(path.as_ref(), |w| {
        for node in &graph.nodes {
            let pose = joined(&translation_and_xyzw(&node.world_from_scan), " ");
            writeln!(w, "VERTEX_SE3:QUAT {} {pose}", node.id)?;
        }
        if let Some(pivot) = graph.nodes.get(graph.pivot) {
            writeln!(w, "FIX {}", pivot.id)?;
        }
        for edge in &graph.edges {
            let (Some(i), Some(j)) = (graph.nodes.get(edge.i), graph.nodes.get(edge.j)) else { continue };
            let pose = joined(&translation_and_xyzw(&edge.i_from_j), " ");
            let information = g2o_information(&edge.information);
            let upper: Vec<f64> = (0..6).flat_map(|r| (r..6).map(move |c| information[(r, c)])).collect();
            writeln!(w, "EDGE_SE3:QUAT {} {} {pose} {}", i.id, j.id, joined(&upper, " "))?;
        }
        Ok(())
    })
}

/// From an information matrix over `[rotation vector; t]` to one over `[t; q_xyz]`.
fn g2o_information(information: &Matrix6<f64>) -> Matrix6<f64> {
    let place = |k: usize| (k + 3) % 6;
    // The rotation vector is twice the quaternion's vector.
    let scale = |k: usize| if k < 3 { 1.0 } else { 2.0 };
    Matrix6::from_fn(|r, c| information[(place(r), place(c))] * scale(r) * scale(c))
}

/// Writes the JSON of Open3D's `PoseGraph`; node `k` is `graph.nodes[k]`, whose name and place in the
/// input stand with it in fields that Open3D passes over.
///
/// Open3D weighs an edge by its confidence and sets that of uncertain edges itself: it is 1 here. Its
/// reader refuses graphs without an edge.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub fn write_open3d_pose_graph(path: impl AsRef<Path>, graph: &PoseGraphFile) -> Result<()> {
    let class = |name: &str, mut value: Value| {
        value["class_name"] = json!(name);
        value["version_major"] = json!(1);
        value["version_minor"] = json!(0);
        value
    };
    let motion = |pose: &RigidMotion| -> Vec<f64> { pose.to_homogeneous().iter().copied().collect() };
    let node = |n: &GraphNode| {
        let value = json!({"pose": motion(&n.world_from_scan), "name": n.name, "scan": n.id.0});
        class("PoseGraphNode", value)
    };
    let edge = |e: &GraphEdge| {
        let value = json!({
            "source_node_id": e.j,
            "target_node_id": e.i,
            "transformation": motion(&e.i_from_j),
            "information": e.information.iter().copied().collect::<Vec<f64>>(),
            "uncertain": e.uncertain,
            "confidence": 1.0,
        });
        class("PoseGraphEdge", value)
    };
    let nodes: Vec<Value> = graph.nodes.iter().map(node).collect();
    let edges: Vec<Value> = graph.edges.iter().map(edge).collect();
    let document = class("PoseGraph", json!({"nodes": nodes, "edges": edges}));
    atomic::write(path.as_ref(), |w| writeln!(w, "{document:#}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector3, Vector6};

    fn graph() -> PoseGraphFile {
        let node = |id: usize, x: f64| GraphNode {
            id: ScanId(id),
            name: format!("s{id}"),
            world_from_scan: RigidMotion::translation(x, 0.0, 0.0),
        };
        // Symmetric, every entry of the upper triangle different.
        let information = Matrix6::from_fn(|r, c| (10 * r.min(c) + r.max(c)) as f64 + 1.0);
        let turn = Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let i_from_j = RigidMotion::new(Vector3::new(1.0, 2.0, 3.0), turn);
        let edge = GraphEdge { i: 1, j: 0, i_from_j, information, uncertain: true };
        PoseGraphFile { nodes: vec![node(2, 0.5), node(7, 0.0)], pivot: 1, edges: vec![edge] }
    }

    #[test]
    fn g2o_has_translation_first_and_half_the_rotation_vector() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("g.g2o");
        write_g2o(&path, &graph()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "VERTEX_SE3:QUAT 2 0.5 0.0 0.0 0.0 0.0 0.0 1.0");
        assert_eq!(lines[2], "FIX 7");
        let words: Vec<&str> = lines[3].split(' ').collect();
        assert_eq!(words[..6], ["EDGE_SE3:QUAT", "7", "2", "1.0", "2.0", "3.0"]);
        let numbers: Vec<f64> = words[3..].iter().map(|v| v.parse().unwrap()).collect();
        assert!(numbers[5..7].iter().all(|q| (q - 0.5f64.sqrt()).abs() < 1e-15), "{numbers:?}");
        // With Ω_tt and Ω_tθ of rows 34 45 56 / 35 46 / 36 and so on: entry (r, c) of the rotation-first
        // matrix is 10 r + c + 1 for r ≤ c.
        let expected = [
            34.0,
            35.0,
            36.0,
            2.0 * 4.0,
            2.0 * 14.0,
            2.0 * 24.0, //
            45.0,
            46.0,
            2.0 * 5.0,
            2.0 * 15.0,
            2.0 * 25.0, //
            56.0,
            2.0 * 6.0,
            2.0 * 16.0,
            2.0 * 26.0, //
            4.0 * 1.0,
            4.0 * 2.0,
            4.0 * 3.0, //
            4.0 * 12.0,
            4.0 * 13.0, //
            4.0 * 23.0,
        ];
        assert_eq!(numbers[7..], expected);
    }

    #[test]
    fn a_turn_weighs_the_same_as_rotation_vector_and_as_quaternion() {
        // eᵀΩe of a turn by 0.02 rad about y and a shift of 1 cm along x, in both parametrisations.
        let information = Matrix6::from_fn(|r, c| if r == c { 40.0 + r as f64 } else { 1.0 });
        let vector = Vector6::new(0.0, 0.02, 0.0, 0.01, 0.0, 0.0);
        let quaternion = Vector6::new(0.01, 0.0, 0.0, 0.0, 0.01f64.sin(), 0.0);
        let g2o = quaternion.dot(&(g2o_information(&information) * quaternion));
        let expected = vector.dot(&(information * vector));
        // sin(0.01) is 0.01 to within 2e-5 of it.
        assert!((g2o - expected).abs() < 1e-4 * expected, "{g2o} {expected}");
    }

    #[test]
    fn open3d_has_columns_and_rotation_first() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("g.json");
        write_open3d_pose_graph(&path, &graph()).unwrap();
        let value: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        assert_eq!(value["class_name"], "PoseGraph");
        assert_eq!((&value["version_major"], &value["version_minor"]), (&json!(1), &json!(0)));
        let (node, edge) = (&value["nodes"][0], &value["edges"][0]);
        assert_eq!(node["class_name"], "PoseGraphNode");
        let pose = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 1.0];
        assert_eq!(node["pose"], json!(pose));
        assert_eq!(edge["class_name"], "PoseGraphEdge");
        assert_eq!((&edge["source_node_id"], &edge["target_node_id"]), (&json!(0), &json!(1)));
        // Columns of a quarter turn about z: (0,1,0), (−1,0,0), (0,0,1), then the translation.
        let columns = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 2.0, 3.0, 1.0];
        let found: Vec<f64> =
            edge["transformation"].as_array().unwrap().iter().filter_map(Value::as_f64).collect();
        assert!(found.iter().zip(columns).all(|(a, b)| (a - b).abs() < 1e-15), "{found:?}");
        let information = edge["information"].as_array().unwrap();
        assert_eq!(information.len(), 36);
        assert_eq!((information[0].as_f64(), information[21].as_f64()), (Some(1.0), Some(34.0)));
        assert_eq!((&edge["uncertain"], &edge["confidence"]), (&json!(true), &json!(1.0)));
    }
}
