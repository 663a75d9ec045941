//! Evidence for possible relative poses of two groups of scans.

use crate::geometry::RigidMotion;
use crate::geometry::fit::fit_rigid;
use crate::geometry::rigid::same_motion;
use crate::registration::config::SurfaceVerification;
use crate::registration::pairwise::correspondences::Correspondences;
use crate::registration::prior;
use crate::registration::scan_model::ScanModel;
use crate::registration::verification::alignment::align;
use crate::registration::verification::noise_level::NoiseLevel;
use crate::registration::verification::probability::{self, UNDECIDED};
use crate::registration::verification::surface_fit::{Posed, SurfaceFit, surface_fit};
use crate::scan::Evidence;
use nalgebra::Point3;
use rayon::prelude::*;

/// A proposal is worth a look at the surfaces when it has one in so many of the inliers of the best.
pub const RIVAL: usize = 8;

/// A possible relative pose, with what speaks for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoredHypothesis {
    /// Takes coordinates of the second group to those of the first.
    pub a_from_b: RigidMotion,
    /// What speaks for it; the probability is always there.
    pub evidence: Evidence,
    /// What either group saw through of the other: [`SurfaceFit::seen_through`].
    pub seen_through: [f64; 2],
}

impl ScoredHypothesis {
    /// The same with the two groups exchanged.
    pub fn turned(&self) -> Self {
        let [of_a, of_b] = self.seen_through;
        Self { a_from_b: self.a_from_b.inverse(), evidence: self.evidence, seen_through: [of_b, of_a] }
    }

    /// Probability that it is right.
    pub fn probability(&self) -> f64 {
        self.evidence.probability.unwrap_or(0.0)
    }
}

/// Every n-th of the points that evidence is measured with is looked at in a coarse check.
const COARSE_STRIDE: usize = 8;

/// Measures evidence with one set of models and settings.
pub struct Verifier<'a> {
    /// The scans' surfaces, in the order of the scans.
    pub models: &'a [ScanModel<'a>],
    /// Settings.
    pub settings: &'a SurfaceVerification,
    /// τ, metres.
    pub radius_m: f64,
    /// What perceptual aliasing costs of the log odds: [`probability::aliasing`].
    pub aliasing: f64,
    /// How surfaces sit on each other where poses are right.
    pub noise: NoiseLevel,
}

impl<'a> Verifier<'a> {
    /// A verifier that knows nothing of the collection yet.
    pub fn new(models: &'a [ScanModel<'a>], settings: &'a SurfaceVerification, radius_m: f64) -> Self {
        Self { models, settings, radius_m, aliasing: 0.0, noise: NoiseLevel::USUAL }
    }

    /// Aligns every proposed motion of group `b` to group `a`, drops repetitions, and measures
    /// the evidence for the first [`SurfaceVerification::hypotheses`] that are left, most inliers
    /// first. Most probable first; at most one of them is right, and their probabilities say so.
    ///
    /// `matches` pairs points of `b` (sources) with points of `a` (targets), in the groups' frames.
    pub fn score(
        &self,
        a: &[Posed<'_>],
        b: &[Posed<'_>],
        proposals: &[RigidMotion],
        matches: &Correspondences,
    ) -> Vec<ScoredHypothesis> {
        let mut scored = self.score_each(a, b, proposals, matches);
        self.compete(&mut scored);
        scored
    }

    /// Turns probabilities that hypotheses have each alone into those among each other.
    pub fn compete(&self, scored: &mut [ScoredHypothesis]) {
        let each: Vec<f64> = scored.iter().map(ScoredHypothesis::probability).collect();
        for (at, hypothesis) in scored.iter_mut().enumerate() {
            let rivals = each.iter().enumerate().filter(|r| r.0 != at).map(|r| *r.1);
            hypothesis.evidence.probability = Some(probability::among_rivals(each[at], rivals));
        }
    }

    /// [`Self::score`], each as if there were no other.
    pub fn score_each(
        &self,
        a: &[Posed<'_>],
        b: &[Posed<'_>],
        proposals: &[RigidMotion],
        matches: &Correspondences,
    ) -> Vec<ScoredHypothesis> {
        let centre = centre_of(b);
        // Motion, inliers, and the stride that its evidence is measured with; the rest are rivals only.
        let mut distinct: Vec<(RigidMotion, Vec<usize>, Option<usize>)> = Vec::new();
        let fitted: Vec<(RigidMotion, usize)> = proposals
            .par_iter()
            .map(|proposal| {
                let motion = self.fit_matches(a, b, proposal, matches);
                (motion, matches.count(&motion, self.radius_m))
            })
            .collect();
        // Side by side, as every one needs to know of those before it only how many inliers they have.
        let most_before = fitted.iter().scan(0, |most, fitted| {
            let before = *most;
            *most = before.max(fitted.1);
            Some(before)
        });
        let known: Vec<(&(RigidMotion, usize), usize)> = fitted.iter().zip(most_before).collect();
        let aligned: Vec<(RigidMotion, Vec<usize>, Option<usize>)> = known
            .into_par_iter()
            .map(|(&(fitted, inliers), most)| {
                let aligned = (inliers * RIVAL >= most)
                    .then(|| self.aligned(a, b, &fitted, matches, (inliers, most == 0)))
                    .flatten();
                let (motion, stride) =
                    aligned.map_or((fitted, None), |(motion, stride)| (motion, Some(stride)));
                (motion, matches.inliers(&motion, self.radius_m), stride)
            })
            .collect();
        for found in aligned {
            match distinct.iter_mut().find(|d| same_motion(&d.0, &found.0, &centre, self.radius_m)) {
                None => distinct.push(found),
                // One that was aligned stands for one that was not.
                Some(other) if found.2.is_some() && other.2.is_none() => *other = found,
                Some(_) => {}
            }
        }
        distinct.sort_by_key(|d| std::cmp::Reverse(d.1.len()));
        let considered: Vec<(usize, usize)> = (0..distinct.len())
            .filter_map(|h| Some((h, distinct[h].2?)))
            .take(if a.len().min(b.len()) > 1 { 2 } else { 1 } * self.settings.hypotheses)
            .collect();
        let mut scored: Vec<ScoredHypothesis> = considered
            .into_par_iter()
            .map(|(h, stride)| {
                let (a_from_b, inliers, _) = &distinct[h];
                let others = distinct.iter().enumerate().filter(|o| o.0 != h).map(|o| o.1.1.as_slice());
                let second_best_inliers = self.second_best_inliers(matches, a_from_b, others);
                self.measure(a, b, a_from_b, matches, (inliers.len(), second_best_inliers), stride)
            })
            .collect();
        // A stable sort: what is equally probable keeps the order of inliers.
        scored.sort_by(|x, y| y.probability().total_cmp(&x.probability()));
        scored
    }

    /// A proposal aligned by the surfaces, and the stride to measure it with; `None` where a coarse check shows
    /// that it is not worth it. If it must be measured (`.1` of what is known, besides its inliers) it is,
    /// between groups no better than at a coarse check.
    fn aligned(
        &self,
        a: &[Posed<'_>],
        b: &[Posed<'_>],
        proposal: &RigidMotion,
        matches: &Correspondences,
        (inliers, must_be): (usize, bool),
    ) -> Option<(RigidMotion, usize)> {
        /// Strides of a first alignment, between groups: so many times the usual one, and at most.
        const COARSER: usize = 4;
        const COARSEST: usize = 32;
        let rounds = self.settings.align_rounds;
        let stride = self.align_stride(a, b);
        let coarse = (COARSER * stride).min(COARSEST);
        let of_groups = a.len() + b.len() > 2;
        // Between groups a proposal may be off by more than what a coarse check measures it by.
        let motion = if of_groups { align(a, b, proposal, rounds, coarse) } else { *proposal };
        if (of_groups || !must_be) && self.is_hopeless(a, b, &motion, matches, inliers) {
            return must_be.then_some((motion, COARSE_STRIDE * fit_stride(a, b)));
        }
        let enough = of_groups && coarse <= stride;
        let motion = if enough { motion } else { align(a, b, &motion, rounds, stride) };
        Some((motion, fit_stride(a, b)))
    }

    /// Whether a coarse check at a few points shows that nothing is to be expected of a pose.
    fn is_hopeless(
        &self,
        a: &[Posed<'_>],
        b: &[Posed<'_>],
        a_from_b: &RigidMotion,
        matches: &Correspondences,
        inliers: usize,
    ) -> bool {
        /// Probability, without any rival, below which nothing is expected of two scans, which are not
        /// aligned yet, and of groups, which are.
        const HOPELESS: [f64; 2] = [1e-3, 0.01];
        let stride = COARSE_STRIDE * fit_stride(a, b);
        let inliers = inliers.max(matches.count(a_from_b, self.radius_m));
        let coarse_check =
            self.evidence_of(&surface_fit(a, b, a_from_b, stride), a_from_b, matches, (inliers, 0));
        let p = probability::probability(&coarse_check, self.settings, &self.noise);
        probability::with_scan_count_prior(p, self.models.len())
            < HOPELESS[usize::from(a.len() + b.len() > 2)]
    }

    /// Between groups, the closed-form fit to the matches near a proposal, narrowing down: what two
    /// scans say of their groups is far off where the groups reach far beyond the two.
    fn fit_matches(
        &self,
        a: &[Posed<'_>],
        b: &[Posed<'_>],
        proposal: &RigidMotion,
        matches: &Correspondences,
    ) -> RigidMotion {
        let mut motion = *proposal;
        if a.len() + b.len() <= 2 {
            return motion;
        }
        for factor in [4.0, 2.0, 1.5] {
            let near = matches.inliers(&motion, factor * self.radius_m);
            if near.len() < 6 {
                break;
            }
            let pairs = near.iter().map(|&i| {
                let (s, t) = matches.pair(i);
                (s, t, 1.0)
            });
            let Some(fitted) = fit_rigid(pairs) else { break };
            motion = fitted;
        }
        motion
    }

    /// Most inliers of another hypothesis that speak against this motion: those which it does not
    /// bring within 2τ.
    pub fn second_best_inliers<'m>(
        &self,
        matches: &Correspondences,
        a_from_b: &RigidMotion,
        others: impl Iterator<Item = &'m [usize]>,
    ) -> usize {
        let explained = matches.inliers(a_from_b, 2.0 * self.radius_m);
        others
            .map(|other| other.iter().filter(|&i| explained.binary_search(i).is_err()).count())
            .max()
            .unwrap_or(0)
    }

    /// Probability that a pose with this evidence is right; 0 with fewer inliers than are needed, and
    /// at most one half where reliable viewpoints contradict it.
    pub fn probability(&self, evidence: &Evidence) -> f64 {
        if evidence.inliers < self.settings.min_inliers {
            return 0.0;
        }
        let p = probability::probability(evidence, self.settings, &self.noise);
        let p = probability::with_scan_count_prior(p, self.models.len());
        let p = probability::with_aliasing(p, self.aliasing + evidence.prior_penalty);
        let limited = probability::exceeds_free_space_limit(evidence, self.settings, &self.noise);
        if limited { p.min(UNDECIDED) } else { p }
    }

    /// [`Self::probability`] of a pose of two scans alone: at most one half where another pose has more of
    /// their matches. What has grown is told apart by more than these.
    pub fn probability_of_pair(&self, evidence: &Evidence) -> f64 {
        let p = self.probability(evidence);
        if evidence.inliers < evidence.second_best_inliers { p.min(UNDECIDED) } else { p }
    }

    /// The evidence for one motion, which is not changed, with as many of the matches in agreement with
    /// it and with the next best one; every `stride`-th point is looked at, as `fit_stride` says.
    pub fn measure(
        &self,
        a: &[Posed<'_>],
        b: &[Posed<'_>],
        a_from_b: &RigidMotion,
        matches: &Correspondences,
        agreeing: (usize, usize),
        stride: usize,
    ) -> ScoredHypothesis {
        let mut fit = surface_fit(a, b, a_from_b, stride);
        let violation = self.noise.scaled_violation(fit.free_space_violation);
        if violation > probability::MOST_VIOLATION_OF_CORRECT {
            let within = violation_within(a, stride).max(violation_within(b, stride));
            fit.free_space_violation = (fit.free_space_violation - within).max(0.0);
        }
        let mut evidence = self.evidence_of(&fit, a_from_b, matches, agreeing);
        evidence.prior_penalty = prior::penalty(a, b, a_from_b);
        let alone = a.len() + b.len() <= 2;
        let p = if alone { self.probability_of_pair(&evidence) } else { self.probability(&evidence) };
        evidence.probability = Some(p);
        ScoredHypothesis { a_from_b: *a_from_b, evidence, seen_through: fit.seen_through }
    }

    /// What matches and surfaces say of a pose together.
    fn evidence_of(
        &self,
        fit: &SurfaceFit,
        a_from_b: &RigidMotion,
        matches: &Correspondences,
        (inliers, second_best_inliers): (usize, usize),
    ) -> Evidence {
        Evidence {
            matches: matches.len(),
            inliers,
            second_best_inliers,
            chance_inliers: matches.count_by_chance(a_from_b, self.radius_m),
            overlap: fit.overlap,
            normal_agreement: fit.normal_agreement,
            plane_residual: fit.plane_residual,
            free_space_violation: fit.free_space_violation,
            localizability: fit.localizability,
            ..Evidence::default()
        }
    }

    /// Large groups have points to spare: every n-th of their samples fixes six numbers as well.
    fn align_stride(&self, a: &[Posed<'_>], b: &[Posed<'_>]) -> usize {
        2 * a.len().min(b.len()).clamp(1, 16)
    }
}

/// Free-space violation between every other scan of a group and the rest: where it contradicts itself,
/// its viewpoints are not the sensor's, and it may contradict others as much.
fn violation_within(group: &[Posed<'_>], stride: usize) -> f64 {
    if group.len() < 2 {
        return 0.0;
    }
    let part = |rest: usize| group.iter().skip(rest).step_by(2).copied().collect::<Vec<_>>();
    surface_fit(&part(0), &part(1), &RigidMotion::identity(), stride).free_space_violation
}

/// Every n-th point is enough to measure the evidence between groups of this size.
pub fn fit_stride(a: &[Posed<'_>], b: &[Posed<'_>]) -> usize {
    (a.len().min(b.len()) / 8).max(1)
}

/// Mean of the centres of a group's scans, in the group's frame.
pub fn centre_of(group: &[Posed<'_>]) -> Point3<f64> {
    let sum = group
        .iter()
        .map(|p| (p.group_from_scan * p.model.centre.cast::<f64>()).coords)
        .sum::<nalgebra::Vector3<f64>>();
    Point3::from(sum / group.len().max(1) as f64)
}
