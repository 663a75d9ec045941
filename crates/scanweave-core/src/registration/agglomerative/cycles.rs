//! Consistency of cycles: what a third component says of a join of two others.
//!
//! Where a component k has a likely pose relative to a and to b, and the two together contradict a proposal for a
//! and b, not all three are right. Before this was known they were right with p, q₁ and q₂; so the odds of p fall
//! by the factor 1 − q₁ q₂, the share of cases in which one of the others is wrong. Sides of a thing that look
//! alike match well two by two, and contradict each other by threes.

use super::agglomeration::{Agglomeration, ComponentId, Proposal};
use super::edge::ComponentEdge;
use crate::geometry::RigidMotion;
use crate::geometry::rigid::rotation_error_rad;
use nalgebra::Point3;

impl Agglomeration<'_> {
    /// A proposal with the odds that third components leave it: what contradicts it most counts, as several of
    /// them mostly err or are right together.
    pub(super) fn among_cycles(&self, mut proposal: Proposal) -> Proposal {
        if !self.settings.cycle_consistency {
            return proposal;
        }
        let contradiction = self.contradiction(&proposal);
        if contradiction > 0.0 {
            proposal.scored.evidence.probability =
                Some(with_contradiction(proposal.probability(), contradiction));
        }
        proposal
    }

    /// Probability that two poses of a third component are both right which contradict a proposal together,
    /// the largest of all third components.
    fn contradiction(&self, proposal: &Proposal) -> f64 {
        let Proposal { a, b, scored, .. } = proposal;
        let at = self.centre(*b);
        let mut most = 0.0f64;
        for &k in self.components.keys().filter(|k| *k != a && *k != b) {
            let Some((a_from_k, of_a)) = self.likely(*a, k) else { continue };
            if of_a <= most {
                continue;
            }
            let Some((k_from_b, of_b)) = self.likely(k, *b) else { continue };
            if self.differ(&(a_from_k * k_from_b), &scored.a_from_b, &at) {
                most = most.max(of_a * of_b);
            }
        }
        most
    }

    /// Whether two motions contradict each other even if one of them is composed of two.
    fn differ(&self, one: &RigidMotion, other: &RigidMotion, at: &Point3<f64>) -> bool {
        /// Twice what two motions differ by that count as distinct.
        const FAR_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
        const FAR_RADII: f64 = 8.0;
        let apart = (one * at - other * at).norm();
        rotation_error_rad(one, other) > FAR_RAD || apart > FAR_RADII * self.verifier.radius_m
    }

    /// The most probable `x_from_y` and its probability: as measured between the components, or as long as that
    /// was not done as pairs of scans tell.
    fn likely(&self, x: ComponentId, y: ComponentId) -> Option<(RigidMotion, f64)> {
        let edge = self.edges.get(&(x.min(y), x.max(y)))?;
        let (motion, probability) = match edge {
            ComponentEdge { scored: Some(scored), .. } => {
                let best = &scored.first()?.0;
                (best.a_from_b, best.probability())
            }
            ComponentEdge { proposals, prior_score, .. } => {
                (proposals.first()?.0, 1.0 - (-prior_score).exp())
            }
        };
        Some((if x < y { motion } else { motion.inverse() }, probability))
    }
}

/// A probability given that what is right with probability `contradiction` contradicts it.
fn with_contradiction(probability: f64, contradiction: f64) -> f64 {
    let odds = probability * (1.0 - contradiction);
    let against = 1.0 - probability;
    if odds + against > 0.0 { odds / (odds + against) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Direction, Point};
    use crate::monitor::Silent;
    use crate::registration::agglomerative::pairs::ScanPair;
    use crate::registration::config::{
        AgglomerativeConfig, RegistrationConfig, Strategy, SurfaceVerification,
    };
    use crate::registration::scan_model::ScanModel;
    use crate::registration::verification::verifier::{ScoredHypothesis, Verifier};
    use crate::scan::{Evidence, ScanId, Surface};
    use approx::assert_relative_eq;

    /// Three scans in a row, a metre apart, and how probable the pose of the third relative to the first is that is
    /// off by so many metres, where the others are right with 0.99 and 0.98, and it with 0.995.
    fn best_of_three(off_m: f64, cycle_consistency: bool) -> f64 {
        let points = vec![Point::new(-0.1, 0.0, 0.0), Point::new(0.1, 0.0, 0.0)];
        let surface = Surface { normals: vec![Direction::z(); 2], points, ..Surface::default() };
        let settings = SurfaceVerification::default();
        let agglomerative = AgglomerativeConfig { cycle_consistency, ..AgglomerativeConfig::default() };
        let config = RegistrationConfig {
            strategy: Strategy::Agglomerative(agglomerative),
            ..RegistrationConfig::default()
        };
        let models: Vec<ScanModel<'_>> =
            (0..3).map(|_| ScanModel::with_sizes(&surface, 0.07, 2, 0.14)).collect();
        let verifier = Verifier::new(&models, &settings, 0.07);
        let scans = [0, 1, 2].map(ScanId);
        let mut agglomeration = Agglomeration::new(&verifier, &config, vec![&[]; 3], &scans);
        let pair = |i: usize, j: usize, x: f64, probability: f64| ScanPair {
            i: ScanId(i),
            j: ScanId(j),
            matches: Box::default(),
            hypotheses: vec![ScoredHypothesis {
                a_from_b: RigidMotion::translation(x, 0.0, 0.0),
                evidence: Evidence { probability: Some(probability), ..Evidence::default() },
                seen_through: [0.0; 2],
            }],
        };
        let pairs = vec![pair(0, 1, 1.0, 0.99), pair(1, 2, 1.0, 0.98), pair(0, 2, 2.0 + off_m, 0.995)];
        agglomeration.add_pairs(pairs);
        agglomeration.best_join(&Silent).unwrap().unwrap().probability()
    }

    #[test]
    fn the_most_probable_of_three_joins_is_as_probable_as_the_third_component_leaves_it() {
        assert_relative_eq!(best_of_three(0.0, true), 0.995);
        // Half a metre is less than eight radii of seven centimetres, a metre is more.
        assert_relative_eq!(best_of_three(0.5, true), 0.995);
        let odds = 0.995 / 0.005 * (1.0 - 0.99 * 0.98);
        assert_relative_eq!(best_of_three(1.0, true), odds / (1.0 + odds), epsilon = 1e-12);
        assert_relative_eq!(best_of_three(1.0, false), 0.995);
    }

    #[test]
    fn of_three_that_contradict_each_other_each_is_right_in_two_of_three_cases() {
        let p = 0.999;
        assert_relative_eq!(with_contradiction(p, p * p), 2.0 / 3.0, epsilon = 1e-3);
        // By enumeration of which are right, all three right excluded.
        let (p, q, r) = (0.9, 0.7, 0.4);
        let possible = 1.0 - p * q * r;
        assert_relative_eq!(with_contradiction(p, q * r), (p - p * q * r) / possible, epsilon = 1e-12);
        assert_eq!([with_contradiction(0.0, 0.5), with_contradiction(1.0, 1.0)], [0.0, 0.0]);
        assert_relative_eq!(with_contradiction(0.8, 0.0), 0.8, epsilon = 1e-12);
    }
}
