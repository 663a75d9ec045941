//! Registration of two scans with each other: matches, distinct hypotheses for the relative
//! pose, and the evidence for each.

use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::registration::config::EstimatorConfig;
use crate::registration::config::SurfaceVerification;
use crate::registration::input::{ContentDigest, ScanInput};
use crate::registration::pairwise::correspondences::Correspondences;
use crate::registration::pairwise::matching::MatchTarget;
use crate::registration::pairwise::registrar::{PairHypotheses, PairRegistrar};
use crate::registration::prior;
use crate::registration::scan_model::ScanModel;
use crate::registration::verification::noise_level::NoiseLevel;
use crate::registration::verification::probability::{self, SurePair};
use crate::registration::verification::surface_fit::{Posed, violation};
use crate::registration::verification::verifier::{ScoredHypothesis, Verifier};
use crate::scan::{ScanId, SimilarityMatrix};
use rayon::prelude::*;

/// Everything known about the relative pose of two scans, i < j.
#[derive(Debug, Clone)]
pub struct ScanPair {
    /// The scan whose frame hypotheses map into.
    pub i: ScanId,
    /// The other one.
    pub j: ScanId,
    /// Mutual matches, as `(keypoint of i, keypoint of j)`; none without a hypothesis. A large collection of scans has
    /// tens of thousands of pairs, so that nothing more is kept of them.
    pub matches: Box<[(u32, u32)]>,
    /// Distinct hypotheses `i_from_j`, most probable first.
    pub hypotheses: Vec<ScoredHypothesis>,
}

impl ScanPair {
    /// What the two scans saw through of each other, where their best pose is sure without it.
    pub fn if_sure_without_free_space(&self, settings: &SurfaceVerification) -> Option<SurePair> {
        let best = self.hypotheses.first()?;
        let sure = probability::is_sure_without_free_space(&best.evidence, settings);
        sure.then_some(((self.i.0, self.j.0), best.seen_through))
    }

    /// Probability of the second most probable hypothesis, each taken alone: it is as good as always
    /// wrong.
    pub fn runner_up(&self, verifier: &Verifier<'_>) -> Option<f64> {
        let mut alone: Vec<f64> = self.hypotheses.iter().map(|h| verifier.probability(&h.evidence)).collect();
        alone.sort_by(|x, y| y.total_cmp(x));
        alone.get(1).copied()
    }

    /// Puts the hypotheses in the order of what the verifier makes of their evidence, as far as the
    /// viewpoints are reliable now.
    pub fn rescore(&mut self, verifier: &Verifier<'_>) {
        let [of_i, of_j] = [self.i, self.j].map(|s| verifier.models[s.0].viewpoint_reliability);
        for h in &mut self.hypotheses {
            // Points of i count as far as the viewpoint of j is reliable, and the other way round.
            let violating = of_j * h.seen_through[0] + of_i * h.seen_through[1];
            h.evidence.free_space_violation = violation(violating, 0.5 * (of_i + of_j));
            h.evidence.probability = Some(verifier.probability_of_pair(&h.evidence));
        }
        verifier.compete(&mut self.hypotheses);
        self.hypotheses.sort_by(|x, y| y.probability().total_cmp(&x.probability()));
    }
}

/// Pairs worth comparing: every scan with the `neighbours` most similar to it; ordered.
pub fn most_similar_pairs(
    similarity: &SimilarityMatrix,
    usable: &[ScanId],
    neighbours: usize,
) -> Vec<(ScanId, ScanId)> {
    let mut pairs: Vec<(ScanId, ScanId)> = usable
        .par_iter()
        .flat_map_iter(|&i| {
            let others = usable.iter().copied().filter(|&j| j != i);
            most_similar(similarity, i, others, neighbours).into_iter().map(move |j| (i.min(j), i.max(j)))
        })
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// The scans among `others` that are most similar to a scan, the most similar first, of equal ones the lower.
pub(super) fn most_similar(
    similarity: &SimilarityMatrix,
    scan: ScanId,
    others: impl Iterator<Item = ScanId>,
    at_most: usize,
) -> Vec<ScanId> {
    let like = similarity.row(scan.0);
    let order = |a: &ScanId, b: &ScanId| like[b.0].total_cmp(&like[a.0]).then(a.cmp(b));
    let mut others: Vec<ScanId> = others.collect();
    if at_most < others.len() {
        // Thousands of scans are not sorted for the sake of a few.
        others.select_nth_unstable_by(at_most, order);
        others.truncate(at_most);
    }
    others.sort_by(order);
    others
}

/// Registered pairs, with the probabilities that the whole collection leaves their hypotheses.
#[derive(Debug, Clone)]
pub struct ScoredPairs {
    /// The pairs, in the order in which they were retrieved.
    pub pairs: Vec<ScanPair>,
    /// What perceptual aliasing costs of the log odds: [`probability::aliasing`].
    pub aliasing: f64,
    /// How surfaces sit on each other where poses are right.
    pub noise: NoiseLevel,
}

/// Steps 1 and 2 of the agglomerative registration: registers the retrieved pairs, finds out from those with
/// most matches how well surfaces fit, from the surest how far each viewpoint is reliable, which it enters into the
/// models, and from the second-best hypotheses how much places resemble each other; scores again. `radius_m` is τ, metres.
///
/// # Errors
/// Only when the monitor is cancelled.
pub fn score_pairs(
    scorer: &PairScorer<'_>,
    retrieved: &[(ScanId, ScanId)],
    models: &mut [ScanModel<'_>],
    settings: &SurfaceVerification,
    radius_m: f64,
    monitor: &dyn Monitor,
) -> Result<ScoredPairs> {
    let pairs = scorer.register(retrieved, &Verifier::new(models, settings, radius_m), monitor)?;
    Ok(score_registered(pairs, models, settings, radius_m))
}

/// Step 2 of [`score_pairs`].
pub(super) fn score_registered(
    mut pairs: Vec<ScanPair>,
    models: &mut [ScanModel<'_>],
    settings: &SurfaceVerification,
    radius_m: f64,
) -> ScoredPairs {
    let sure = pairs.iter().filter_map(|pair| pair.if_sure_without_free_space(settings)).collect::<Vec<_>>();
    let reliability = probability::viewpoint_reliability(models.len(), &sure, settings);
    models.iter_mut().zip(reliability).for_each(|(model, r)| model.set_borne_out(r));
    let reliability: Vec<f64> = models.iter().map(|m| m.viewpoint_reliability).collect();
    tracing::debug!("reliability of the viewpoints: {reliability:.2?}");
    let verifier = Verifier::new(models, settings, radius_m);
    pairs.iter_mut().for_each(|pair| pair.rescore(&verifier));
    let noise = noise_level(&pairs, settings);
    tracing::debug!("right poses show {noise:.4?}");
    let verifier = Verifier { noise, ..verifier };
    pairs.iter_mut().for_each(|pair| pair.rescore(&verifier));
    let aliasing = probability::aliasing(pairs.iter().filter_map(|pair| pair.runner_up(&verifier)));
    tracing::debug!("perceptual aliasing costs {aliasing:.2} of the log odds");
    let verifier = Verifier { aliasing, ..verifier };
    pairs.iter_mut().for_each(|pair| pair.rescore(&verifier));
    ScoredPairs { pairs, aliasing, noise }
}

/// What the best poses of pairs show of the sensor.
fn noise_level(pairs: &[ScanPair], settings: &SurfaceVerification) -> NoiseLevel {
    if !settings.noise_level {
        return NoiseLevel::USUAL;
    }
    let best = pairs.iter().filter_map(|pair| Some(&pair.hypotheses.first()?.evidence));
    NoiseLevel::of(best.filter(|e| e.inliers >= settings.min_inliers))
}

/// Registers pairs of scans and scores what is found.
pub struct PairScorer<'a> {
    scans: &'a [ScanInput<'a>],
    estimator: &'a EstimatorConfig,
    digests: Vec<ContentDigest>,
    seed: u64,
}

impl<'a> PairScorer<'a> {
    /// Registers pairs of these scans with random numbers of `seed`.
    pub fn new(scans: &'a [ScanInput<'a>], estimator: &'a EstimatorConfig, seed: u64) -> Self {
        Self { scans, estimator, digests: scans.par_iter().map(ContentDigest::of).collect(), seed }
    }

    /// Registers pairs, in their order, and weighs what is found.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn register(
        &self,
        pairs: &[(ScanId, ScanId)],
        verifier: &Verifier<'_>,
        monitor: &dyn Monitor,
    ) -> Result<Vec<ScanPair>> {
        const STAGE: &str = "pairs";
        monitor.begin(STAGE, pairs.len());
        let registered = pairs
            .par_iter()
            .map(|&(i, j)| {
                monitor.check("registration")?;
                let pair = self.register_one(i, j, verifier);
                monitor.advance(1);
                Ok(pair)
            })
            .collect();
        monitor.end();
        registered
    }

    fn register_one(&self, i: ScanId, j: ScanId, verifier: &Verifier<'_>) -> ScanPair {
        let [target, source] = [i, j].map(|s| self.scans[s.0].features);
        let contents = [self.digests[i.0], self.digests[j.0]];
        let registrar =
            PairRegistrar { config: self.estimator, radius_m: verifier.radius_m, seed: self.seed };
        let PairHypotheses { matches, hypotheses: proposals } =
            registrar.register(&MatchTarget::of_scan(target), source, &contents);
        // What rough poses allow has few outliers, and may hold a motion that is lost among all matches.
        let [prior_i, prior_j] = [i, j].map(|s| &verifier.models[s.0].prior);
        let allowed = prior::allowed(prior_i, prior_j, &matches, verifier.radius_m);
        let guided = allowed.map(|allowed| registrar.hypotheses(&allowed, &contents)).unwrap_or_default();
        let motions: Vec<_> = proposals.into_iter().chain(guided).map(|p| p.target_from_source).collect();
        let alone =
            |s: ScanId| [Posed { model: &verifier.models[s.0], group_from_scan: RigidMotion::identity() }];
        let correspondences = Correspondences::new(&matches.source, &matches.target);
        let hypotheses = verifier.score(&alone(i), &alone(j), &motions, &correspondences);
        let of_scans = matches.pairs.iter().map(|&(of_j, of_i)| (of_i, of_j));
        let matches = if hypotheses.is_empty() { Box::default() } else { of_scans.collect() };
        ScanPair { i, j, matches, hypotheses }
    }
}
