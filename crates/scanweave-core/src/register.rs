//! Registration in one call.

use crate::config::Config;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::monitor::{Monitor, Silent};
use crate::pipeline::{self, FeatureSource};
use crate::registration::agglomerative::pairs::PairScorer;
use crate::registration::scan_model::ScanModel;
use crate::registration::usability;
use crate::registration::verification::decline;
use crate::registration::verification::verifier::Verifier;
use crate::registration::{ScanInput, input::MIN_KEYPOINTS};
use crate::scan::{DeclineReason, Evidence, Reconstruction, Scan, ScanId};

/// Registers scans: one outcome a scan, in their order. [`pipeline::run`] also gives what the stages
/// made, reports progress and can be stopped.
///
/// # Errors
/// Fewer than two scans, or settings that cannot be used. A scan that fits nothing is no error: it
/// is declined.
///
/// # Example
/// ```no_run
/// use scanweave_core::{Config, Scan, register};
///
/// # fn points_of(_: usize) -> Vec<[f64; 3]> { Vec::new() }
/// let scans: Vec<Scan> =
///     (0..5).map(|k| Scan::from_points(format!("scan {k}"), &points_of(k))).collect();
/// let result = register(&scans, &Config::default())?;
/// for (scan, outcome) in scans.iter().zip(&result.outcomes) {
///     match outcome.placement() {
///         Some(placement) => println!("{} at {}", scan.name, placement.world_from_scan),
///         None => println!("{} was not placed", scan.name),
///     }
/// }
/// # Ok::<(), scanweave_core::Error>(())
/// ```
pub fn register(scans: &[Scan], config: &Config) -> Result<Reconstruction> {
    Ok(pipeline::run(scans, config, &FeatureSource::Computed, &Silent)?.reconstruction)
}

/// What became of a pair of scans.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RegisteredPair {
    /// Takes coordinates of the source to those of the target; `None` where nothing was found.
    pub target_from_source: Option<RigidMotion>,
    /// Whether the evidence suffices by the settings: without it the motion is a guess.
    pub accepted: bool,
    /// What speaks for the motion.
    pub evidence: Evidence,
    /// Why it is not accepted; `None` when it is.
    pub declined: Option<DeclineReason>,
}

/// Registers one scan with another.
///
/// # Errors
/// Settings that cannot be used, or that verify by inliers alone.
///
/// # Example
/// ```no_run
/// use scanweave_core::{Config, Scan, register_pair};
///
/// # let (target_points, source_points) = (Vec::new(), Vec::new());
/// let target = Scan::from_points("target", &target_points);
/// let source = Scan::from_points("source", &source_points);
/// let pair = register_pair(&target, &source, &Config::default())?;
/// if let (true, Some(target_from_source)) = (pair.accepted, pair.target_from_source) {
///     println!("{target_from_source}, {} inliers", pair.evidence.inliers);
/// }
/// # Ok::<(), scanweave_core::Error>(())
/// ```
pub fn register_pair(target: &Scan, source: &Scan, config: &Config) -> Result<RegisteredPair> {
    register_pair_with(target, source, config, &Silent)
}

/// [`register_pair`], which reports progress and can be stopped.
///
/// # Errors
/// As [`register_pair`], or the user asked to stop.
pub fn register_pair_with(
    target: &Scan,
    source: &Scan,
    config: &Config,
    monitor: &dyn Monitor,
) -> Result<RegisteredPair> {
    config.validate()?;
    let Some(settings) = config.registration.verification.surfaces() else {
        return Err(Error::setting(
            "registration.verification.kind",
            "inlier-count",
            "surfaces, which says whether a pair is right",
            "set it to \"surfaces\"",
        ));
    };
    let scans = [target.clone(), source.clone()];
    let described = pipeline::describe(&scans, config, &FeatureSource::Computed, monitor)?;
    let radius_m = described.scale.inlier_radius_m;
    let [target_from_local, source_from_local] = [0, 1].map(|k: usize| described.frames[k]);
    let scans = described.features.iter().zip(&described.surfaces);
    let scans: Vec<ScanInput<'_>> =
        scans.map(|(features, surface)| ScanInput::new(features, surface)).collect();
    let refused = |declined: DeclineReason, evidence: Evidence| RegisteredPair {
        target_from_source: None,
        accepted: false,
        evidence,
        declined: Some(declined),
    };
    let unusable = |s: &ScanInput<'_>| usability::unusable(s, MIN_KEYPOINTS, described.scale.voxel_m);
    if let Some(reason) = scans.iter().find_map(unusable) {
        return Ok(refused(reason, Evidence::default()));
    }
    let models: Vec<ScanModel<'_>> =
        scans.iter().map(|s| ScanModel::new(s.surface, radius_m as f32, &config.registration)).collect();
    let verifier = Verifier::new(&models, settings, radius_m);
    let scorer = PairScorer::new(&scans, &config.registration.estimator, config.seed);
    let found = scorer.register(&[(ScanId(0), ScanId(1))], &verifier, monitor)?;
    let Some(best) = found.first().and_then(|pair| pair.hypotheses.first()) else {
        let (inliers, matches) = (0, 0);
        let reason = DeclineReason::TooFewInliers { inliers, needed: settings.min_inliers, matches };
        return Ok(refused(reason, Evidence::default()));
    };
    let declined = decline::refusal(&best.evidence, &config.registration.verification);
    Ok(RegisteredPair {
        target_from_source: Some(target_from_local * best.a_from_b * source_from_local.inverse()),
        accepted: declined.is_none(),
        evidence: best.evidence,
        declined,
    })
}
