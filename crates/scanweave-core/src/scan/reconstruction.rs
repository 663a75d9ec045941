//! What a registration concludes about every scan.

use super::ScanId;
use crate::geometry::RigidMotion;
use nalgebra::{Matrix6, Point3};
use serde::{Deserialize, Serialize};

/// Agreement of a placed scan with one other placed scan, measured at the final poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct NeighbourEvidence {
    /// The other scan.
    pub scan: ScanId,
    /// Two-way share of keypoints with a counterpart within τ, in `[0, 1]`.
    pub overlap: f64,
    /// Root mean square distance of those keypoints, metres: as coarse as keypoints are sparse.
    pub residual_m: f64,
    /// Median distance of the points of each surface from the tangent planes of the other where they touch
    /// and face the same way, metres; `None` where it was not measured or too few touch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane_distance_m: Option<f64>,
}

impl NeighbourEvidence {
    /// What keypoints tell; the distance of the surfaces was not measured.
    pub fn new(scan: ScanId, overlap: f64, residual_m: f64) -> Self {
        Self { scan, overlap, residual_m, plane_distance_m: None }
    }
}

/// What speaks for the pose at which a scan was registered against the meta-shape.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Evidence {
    /// Mutual descriptor matches.
    pub matches: usize,
    /// Matches within τ under the pose.
    pub inliers: usize,
    /// Inliers of the next distinct hypothesis, in the same component or, where they leave the pose
    /// undecided, in another.
    pub second_best_inliers: usize,
    /// Matches that the pose would bring within τ if they were paired at random.
    #[serde(default)]
    pub chance_inliers: f64,
    /// Share of the scan's surface within τ of the model, in `[0, 1]`.
    pub overlap: f64,
    /// Share of that whose normals agree, in `[0, 1]`.
    pub normal_agreement: f64,
    /// Root mean square distance to the model's tangent planes, in units of τ.
    pub plane_residual: f64,
    /// Share of what either side could judge that lies in space the other saw to be empty, in `[0, 1]`.
    #[serde(default)]
    pub free_space_violation: f64,
    /// How firmly the touching surface fixes the pose: smallest eigenvalue of the normalised
    /// information matrix, 0 where some motion is free.
    #[serde(default)]
    pub localizability: f64,
    /// By how much what was known before (rough poses, which way is up) lowers the log odds, 0 where it
    /// agrees or nothing was known.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub prior_penalty: f64,
    /// Probability that the pose is right; `None` where it was not measured.
    pub probability: Option<f64>,
    /// The pose relative to the parent when the scan joined, before any later refinement; `None`
    /// until it joins.
    #[serde(default)]
    pub parent_from_scan: Option<RigidMotion>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// How firmly a placed scan is held in its component.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PoseUncertainty {
    /// The least certain link of the most certain chain of links between the scan and the pivot;
    /// `None` for the pivot.
    pub weakest_edge: Option<ScanEdge>,
    /// Covariance of the pose relative to the pivot's: of a rotation vector (radians) and of the
    /// displacement of the scan's centre (metres), both in the component's frame. `None` where no
    /// surfaces were compared.
    pub covariance: Option<Matrix6<f64>>,
    /// The scan's centre that the covariance refers to: that of the box around its surface along the
    /// axes of its own frame, in the coordinates of its file, metres. `None` in files of an earlier version.
    #[serde(default)]
    pub centre: Option<Point3<f64>>,
}

/// Two scans that hold each other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScanEdge {
    /// The scans.
    pub scans: (ScanId, ScanId),
    /// Probability that their relative pose is right.
    pub probability: f64,
}

impl PoseUncertainty {
    /// Largest standard deviations in any direction: of the rotation in degrees, of the position of
    /// the scan's centre in metres.
    pub fn deviation(&self) -> Option<(f64, f64)> {
        let covariance = self.covariance?;
        let largest = |at: usize| {
            covariance.fixed_view::<3, 3>(at, at).into_owned().symmetric_eigenvalues().max().max(0.0).sqrt()
        };
        Some((largest(0).to_degrees(), largest(3)))
    }
}

/// A scan with a pose, and what speaks for it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Placement {
    /// Pose in the frame of its component: takes coordinates of the scan's file to those of the
    /// pivot's file.
    pub world_from_scan: RigidMotion,
    /// Component it belongs to; poses of different components are unrelated.
    pub component: usize,
    /// Growth step at which it joined, 0 for the pivot of its component.
    pub step: usize,
    /// Placed scan that shares the most inliers with it; `None` for a pivot.
    pub parent: Option<ScanId>,
    /// Mutual descriptor matches with the meta-shape.
    pub matches: usize,
    /// Matches within τ under the pose.
    pub inliers: usize,
    /// Root mean square distance of the inlier matches, metres.
    pub residual_m: f64,
    /// Evidence at the time it joined; `None` for a pivot.
    pub evidence: Option<Evidence>,
    /// Agreement with every placed scan it touches.
    pub neighbours: Vec<NeighbourEvidence>,
    /// Its uncertainty; `None` where that was not measured.
    pub pose_uncertainty: Option<Box<PoseUncertainty>>,
}

impl Placement {
    /// A pivot at a pose, of which nothing else is known.
    pub fn at(world_from_scan: RigidMotion, component: usize) -> Self {
        Self {
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
        }
    }
}

/// What is doubtful about a placed scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Doubt {
    /// Other poses are not ruled out: the stated probability is below nine tenths.
    Ambiguous,
    /// The stated standard deviation of its centre, relative to the pivot, exceeds the inlier radius, or
    /// that of its rotation five degrees.
    PoorlyLocalised,
}

impl Placement {
    /// What is doubtful about it, for an inlier radius τ in metres.
    pub fn doubts(&self, inlier_radius_m: f64) -> Vec<Doubt> {
        /// Probability from which other poses are ruled out.
        const UNAMBIGUOUS: f64 = 0.9;
        /// Largest deviation of the rotation of a well localised scan, degrees.
        const LOCALISED_DEG: f64 = 5.0;
        let probability = self.evidence.and_then(|e| e.probability);
        let ambiguous = probability.is_some_and(|p| p < UNAMBIGUOUS);
        let deviation = self.pose_uncertainty.as_ref().and_then(|u| u.deviation());
        let loose = deviation.is_some_and(|(deg, m)| deg > LOCALISED_DEG || m > inlier_radius_m);
        let doubts = [(ambiguous, Doubt::Ambiguous), (loose, Doubt::PoorlyLocalised)];
        doubts.into_iter().filter(|d| d.0).map(|d| d.1).collect()
    }

    /// Inliers over matches, 0 when there was no match.
    pub fn inlier_ratio(&self) -> f64 {
        if self.matches == 0 { 0.0 } else { self.inliers as f64 / self.matches as f64 }
    }
}

/// Why a scan has no pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "reason", rename_all = "kebab-case")]
#[non_exhaustive]
pub enum DeclineReason {
    /// Its best registration had too few inliers to be told from chance.
    TooFewInliers {
        /// Inliers of the best attempt.
        inliers: usize,
        /// Inliers that would have been needed.
        needed: usize,
        /// Mutual matches of the best attempt.
        matches: usize,
    },
    /// Its best registration is more likely wrong than the settings allow.
    WeakEvidence {
        /// What there is.
        evidence: Evidence,
        /// Probability that would have been needed, in `[0, 1]`.
        needed: f64,
    },
    /// Its registrations with single scans were all left out of the pose graph.
    Pruned {
        /// Inliers of the best of them.
        inliers: usize,
        /// Its median distance over the overlap, metres.
        median_distance_m: f64,
    },
    /// It has too few keypoints to be registered at all.
    TooFewKeypoints {
        /// Keypoints found.
        keypoints: usize,
        /// Keypoints needed.
        needed: usize,
    },
    /// Its shape does not fix a pose (all points on one plane or line).
    Degenerate {
        /// What it looks like, in words.
        detail: String,
    },
}

impl std::fmt::Display for DeclineReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            DeclineReason::TooFewInliers { inliers, needed, matches } => {
                write!(f, "best attempt had {inliers} inliers of {matches} matches, {needed} needed")
            }
            DeclineReason::WeakEvidence { evidence, needed } => write!(
                f,
                "best attempt is right with probability {:.2}, {needed:.2} needed \
                 ({} inliers of {} matches, next {}; overlap {:.2}, normals agree {:.2})",
                evidence.probability.unwrap_or(0.0),
                evidence.inliers,
                evidence.matches,
                evidence.second_best_inliers,
                evidence.overlap,
                evidence.normal_agreement,
            ),
            DeclineReason::Pruned { inliers, median_distance_m } => write!(
                f,
                "no pair was kept: the best, of {inliers} inliers, has its surfaces {median_distance_m:.3} m apart"
            ),
            DeclineReason::TooFewKeypoints { keypoints, needed } => {
                write!(f, "only {keypoints} keypoints, {needed} needed")
            }
            DeclineReason::Degenerate { detail } => write!(f, "shape does not fix a pose: {detail}"),
        }
    }
}

/// The outcome on one scan.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// It has a pose.
    Placed(Placement),
    /// It has none.
    Declined(DeclineReason),
}

impl Outcome {
    /// The placement, if there is one.
    pub fn placement(&self) -> Option<&Placement> {
        match self {
            Outcome::Placed(p) => Some(p),
            Outcome::Declined(_) => None,
        }
    }
}

/// The result of a registration: one outcome a scan, in the order of the input.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct Reconstruction {
    /// Outcome of scan `i` at index `i`.
    pub outcomes: Vec<Outcome>,
}

impl Reconstruction {
    /// One outcome a scan, in the order of the scans.
    pub fn new(outcomes: Vec<Outcome>) -> Self {
        Self { outcomes }
    }

    /// Pose of a scan, if placed.
    pub fn world_from_scan(&self, scan: ScanId) -> Option<&RigidMotion> {
        self.outcomes.get(scan.0)?.placement().map(|p| &p.world_from_scan)
    }

    /// Relative pose `i_from_j`, if both are placed in one component.
    pub fn relative(&self, i: ScanId, j: ScanId) -> Option<RigidMotion> {
        let a = self.outcomes.get(i.0)?.placement()?;
        let b = self.outcomes.get(j.0)?.placement()?;
        (a.component == b.component).then(|| a.world_from_scan.inverse() * b.world_from_scan)
    }

    /// [`Self::relative`], with the component that both are in.
    pub fn relative_in_component(&self, i: ScanId, j: ScanId) -> Option<(usize, RigidMotion)> {
        let component = self.outcomes.get(i.0)?.placement()?.component;
        self.relative(i, j).map(|i_from_j| (component, i_from_j))
    }

    /// Number of placed scans.
    pub fn placed(&self) -> usize {
        self.outcomes.iter().filter(|o| o.placement().is_some()).count()
    }

    /// Number of components, largest first.
    pub fn components(&self) -> usize {
        self.outcomes.iter().filter_map(|o| o.placement()).map(|p| p.component + 1).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    #[test]
    fn low_probabilities_and_loose_poses_are_doubtful() {
        let doubts = |probability: f64, variances: [f64; 6]| {
            let covariance = Some(Matrix6::from_diagonal(&Vector6::from(variances)));
            let uncertainty = PoseUncertainty { covariance, ..PoseUncertainty::default() };
            let placement = Placement {
                world_from_scan: RigidMotion::identity(),
                component: 0,
                step: 1,
                parent: Some(ScanId(0)),
                matches: 10,
                inliers: 8,
                residual_m: 0.01,
                evidence: Some(Evidence { probability: Some(probability), ..Evidence::default() }),
                neighbours: Vec::new(),
                pose_uncertainty: Some(Box::new(uncertainty)),
            };
            placement.doubts(0.07)
        };
        // Deviations of 0.06 rad = 3.4 degrees and 6 cm, the second of 6 degrees, the third of 8 cm.
        let (firm, loose) = ([0.06f64.powi(2); 6], 0.08f64.powi(2));
        let turning = {
            let mut v = firm;
            v[1] = 6f64.to_radians().powi(2);
            v
        };
        let sliding = {
            let mut v = firm;
            v[5] = loose;
            v
        };
        assert_eq!(doubts(0.95, firm), []);
        assert_eq!(doubts(0.85, firm), [Doubt::Ambiguous]);
        assert_eq!(doubts(0.95, turning), [Doubt::PoorlyLocalised]);
        assert_eq!(doubts(0.5, sliding), [Doubt::Ambiguous, Doubt::PoorlyLocalised]);
    }
}
