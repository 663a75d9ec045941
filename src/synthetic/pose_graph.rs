//! Pose graphs whose poses are known, with noisy and with plainly wrong edges.

use crate::geometry::RigidMotion;
use crate::scan::{DeclineReason, PairRegistration, PoseEdge, PoseGraph, ScanId};
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Settings of a pose graph.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseGraphConfig {
    /// Number of scans, scattered over a cube.
    pub scans: usize,
    /// Edge of the cube, metres.
    pub size_m: f64,
    /// Share of all pairs that are edges, in `[0, 1]`; a ring through all scans is always there.
    pub density: f64,
    /// Standard deviation of an edge's rotation vector per axis, radians.
    pub rotation_noise_rad: f64,
    /// Standard deviation of an edge's translation per axis, metres.
    pub translation_noise_m: f64,
    /// Share of the edges that are replaced by random motions, in `[0, 1]`.
    pub outliers: f64,
    /// Seed.
    pub seed: u64,
}

impl Default for PoseGraphConfig {
    fn default() -> Self {
        Self {
            scans: 30,
            size_m: 6.0,
            density: 0.5,
            rotation_noise_rad: 0.0,
            translation_noise_m: 0.0,
            outliers: 0.0,
            seed: 0,
        }
    }
}

/// A pose graph and the truth about it.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownPoseGraph {
    /// The graph.
    pub graph: PoseGraph,
    /// True pose of every scan.
    pub world_from_scan: Vec<RigidMotion>,
    /// Whether an edge was replaced, edge by edge.
    pub outlier: Vec<bool>,
}

impl PoseGraphConfig {
    /// Makes the graph.
    ///
    /// Right edges show 30 to 200 inliers and wrong ones 10 to 60, similarities 0.4 to 0.9 and
    /// 0.3 to 0.7: as with real pairs, neither number alone tells them apart.
    pub fn generate(&self) -> KnownPoseGraph {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let world_from_scan: Vec<RigidMotion> =
            (0..self.scans).map(|_| any_pose(&mut rng, self.size_m)).collect();
        let (mut edges, mut outlier) = (Vec::new(), Vec::new());
        for i in 0..self.scans {
            for j in i + 1..self.scans {
                let ring = j == i + 1 || (i == 0 && j + 1 == self.scans);
                if !(rng.random_bool(self.density) || ring) {
                    continue;
                }
                let wrong = rng.random_bool(self.outliers);
                let truth = world_from_scan[i].inverse() * world_from_scan[j];
                let i_from_j =
                    if wrong { any_pose(&mut rng, self.size_m) } else { self.noisy(&truth, &mut rng) };
                let inliers = if wrong { rng.random_range(10..60) } else { rng.random_range(30..200) };
                let similarity = if wrong { rng.random_range(0.3..0.7) } else { rng.random_range(0.4..0.9) };
                let pair = PairRegistration {
                    target_from_source: i_from_j,
                    matches: 1000,
                    inliers,
                    residual_m: 0.03,
                    overlap: similarity,
                    median_distance_m: 0.03,
                };
                edges.push(PoseEdge { i: ScanId(i), j: ScanId(j), pair, similarity });
                outlier.push(wrong);
            }
        }
        let reason = DeclineReason::TooFewInliers { inliers: 0, needed: 3, matches: 0 };
        let registered_pairs = edges.len();
        let graph = PoseGraph {
            scans: self.scans,
            inlier_radius_m: 0.07,
            edges,
            without_edges: vec![reason; self.scans],
            registered_pairs,
            registration_seconds: 0.0,
            reused_seconds: 0.0,
        };
        KnownPoseGraph { graph, world_from_scan, outlier }
    }

    /// A motion as a registration would measure it: turned and shifted a little, the rotation
    /// without a lever on the translation.
    fn noisy(&self, truth: &RigidMotion, rng: &mut ChaCha8Rng) -> RigidMotion {
        let mut vector = |sigma: f64| Vector3::from_fn(|_, _| sigma * gaussian(rng));
        let turn = UnitQuaternion::from_scaled_axis(vector(self.rotation_noise_rad));
        let shift = vector(self.translation_noise_m);
        RigidMotion::from_parts(Translation3::from(truth.translation.vector + shift), turn * truth.rotation)
    }
}

/// A uniformly distributed rotation (Shoemake 1992) about a place in the cube.
fn any_pose(rng: &mut ChaCha8Rng, size_m: f64) -> RigidMotion {
    let q = Quaternion::new(gaussian(rng), gaussian(rng), gaussian(rng), gaussian(rng));
    let place = Vector3::from_fn(|_, _| rng.random_range(-0.5..0.5) * size_m);
    RigidMotion::from_parts(Translation3::from(place), UnitQuaternion::from_quaternion(q))
}

/// Standard normal, by Box and Muller.
fn gaussian(rng: &mut impl Rng) -> f64 {
    let (u, v) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}
