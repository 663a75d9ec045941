//! Pairwise registrations of all scans, those known from before included, as a pose graph;
//! and poses from it.

use crate::config::Config;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::geometry::neighbours::RadiusGrid;
use crate::io::{self, pairs::Pairs};
use crate::monitor::Monitor;
use crate::registration::canonical_order::CanonicalOrder;
use crate::registration::input::MIN_KEYPOINTS;
use crate::registration::multiview_icp::{PosedScan, refine_poses};
use crate::registration::neighbours::neighbours;
use crate::registration::pairwise::edge::EdgeRegistrar;
use crate::registration::scan_model::ScanModel;
use crate::registration::{Lengths, ScanInput};
use crate::scan::{
    DeclineReason, Outcome, PairKey, PairRegistration, PoseEdge, PoseGraph, Reconstruction, ScanId,
    SimilarityMatrix,
};
use crate::synchronization::{self, LitsWeights, Method, graph};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Raised when cached pairs of an older version must not be used any more.
const CACHE_VERSION: u32 = 2;
const STAGE: &str = "pairs";

/// Registered pairs by the settings and contents they belong to, for any number of runs.
#[derive(Debug, Default)]
pub struct PairCache {
    /// Where they are kept for later processes.
    folder: Option<PathBuf>,
    /// By name of the settings.
    known: Mutex<BTreeMap<String, Pairs>>,
}

impl PairCache {
    /// Pairs of this process only.
    pub fn in_memory() -> Self {
        Self::default()
    }

    /// Pairs that are also kept in files of this folder, which is made when needed.
    pub fn in_folder(folder: &Path) -> Self {
        Self { folder: Some(folder.to_path_buf()), ..Self::default() }
    }

    fn take(&self, settings: &str) -> Pairs {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pairs) = known.get(settings) {
            return pairs.clone();
        }
        let Some(path) = self.file(settings).filter(|p| p.exists()) else { return Pairs::new() };
        let pairs = io::pairs::read_pairs(&path, settings).unwrap_or_else(|error| {
            tracing::warn!("registering again what the cache should hold: {error}");
            Pairs::new()
        });
        known.insert(settings.to_owned(), pairs.clone());
        pairs
    }

    fn keep(&self, settings: &str, pairs: Pairs) -> Result<()> {
        if let (Some(folder), Some(path)) = (&self.folder, self.file(settings)) {
            std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
            io::pairs::write_pairs(&path, settings, &pairs)?;
        }
        self.known.lock().unwrap_or_else(PoisonError::into_inner).insert(settings.to_owned(), pairs);
        Ok(())
    }

    fn file(&self, settings: &str) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("pairs-{settings}.npz")))
    }
}

/// Everything but the scans that a pair's registration depends on.
fn settings_hash(config: &Config, lengths: Lengths) -> Result<String> {
    let estimator = serde_json::to_string(&config.registration.estimator)
        .map_err(|e| Error::setting("registration.estimator", e.to_string(), "plain values", "correct it"))?;
    let text = format!("{CACHE_VERSION};{estimator};{:?};{}", lengths.inlier_radius_m, config.seed);
    Ok(blake3::hash(text.as_bytes()).to_hex()[..32].to_owned())
}

/// The pose graph of these scans, and poses of all from it by `method`.
pub(super) fn synchronize(
    inputs: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    method: Method,
    config: &Config,
    lengths: Lengths,
    cache: &PairCache,
    monitor: &dyn Monitor,
) -> Result<(PoseGraph, Reconstruction)> {
    // Before hours are spent on pairs.
    let lits = match (&config.synchronization.lits_weights, method) {
        (Some(path), Method::Lits) => Some(LitsWeights::load(path)?),
        _ => None,
    };
    synchronization::check_weights(method, lits.as_ref())?;
    let order = CanonicalOrder::new(inputs);
    let (inputs, similarity) = (&order.scans(inputs), &order.similarity(similarity)?);
    let pairwise = EdgeRegistrar::new(inputs, &config.registration.estimator, lengths, config.seed);
    let graph = pose_graph(&pairwise, similarity, config, lengths, cache, monitor)?;
    let mut reconstruction = synchronization::synchronize(&graph, method, lits.as_ref(), monitor)?;
    finish(&mut reconstruction, inputs, config, lengths, monitor)?;
    Ok((order.restore_graph(graph), order.restore(reconstruction)))
}

/// Registers the pairs that the settings ask for and are not known yet.
fn pose_graph(
    pairwise: &EdgeRegistrar<'_>,
    similarity: &SimilarityMatrix,
    config: &Config,
    lengths: Lengths,
    cache: &PairCache,
    monitor: &dyn Monitor,
) -> Result<PoseGraph> {
    let usable = |s: ScanId| pairwise.unusable(s).is_none();
    let pairs: Vec<(ScanId, ScanId)> = graph::pairs(similarity, &config.synchronization)
        .into_iter()
        .filter(|(i, j)| usable(*i) && usable(*j))
        .collect();
    let settings = settings_hash(config, lengths)?;
    let mut known = cache.take(&settings);
    let missing: Vec<(ScanId, ScanId)> =
        pairs.iter().copied().filter(|(i, j)| !known.contains_key(&pairwise.key(*i, *j).0)).collect();
    let new = register_all(pairwise, &missing, monitor)?;
    let registered_now: BTreeSet<PairKey> = new.keys().copied().collect();
    if !new.is_empty() {
        known.extend(new);
        cache.keep(&settings, known.clone())?;
    }
    let min_inliers = config.registration.verification.min_inliers().max(MIN_KEYPOINTS);
    let (mut registration_seconds, mut reused_seconds) = (0.0, 0.0);
    let (mut edges, mut best) = (Vec::new(), vec![PairRegistration::default(); similarity.len()]);
    for &(i, j) in &pairs {
        let (key, forward) = pairwise.key(i, j);
        let Some((found, seconds)) = known.get(&key) else { continue };
        registration_seconds += seconds;
        reused_seconds += if registered_now.contains(&key) { 0.0 } else { *seconds };
        let pair = if forward { *found } else { found.reversed() };
        if graph::keeps(&pair, &config.synchronization, min_inliers, lengths.inlier_radius_m) {
            edges.push(PoseEdge { i, j, pair, similarity: f64::from(similarity.get(i.0, j.0)) });
        }
        for scan in [i, j] {
            if pair.inliers > best[scan.0].inliers || best[scan.0].matches == 0 {
                best[scan.0] = pair;
            }
        }
    }
    let without_edges = (0..similarity.len())
        .map(|scan| match pairwise.unusable(ScanId(scan)) {
            Some(reason) => reason.clone(),
            None => without_edge(&best[scan], min_inliers),
        })
        .collect();
    Ok(PoseGraph {
        scans: similarity.len(),
        inlier_radius_m: lengths.inlier_radius_m,
        edges,
        without_edges,
        registered_pairs: pairs.len(),
        registration_seconds,
        reused_seconds,
    })
}

/// Registers pairs, each with its share of the time they took together.
fn register_all(
    pairwise: &EdgeRegistrar<'_>,
    pairs: &[(ScanId, ScanId)],
    monitor: &dyn Monitor,
) -> Result<Pairs> {
    let start = Instant::now();
    monitor.begin(STAGE, pairs.len());
    let registered: Vec<Result<(PairKey, PairRegistration)>> = pairs
        .par_iter()
        .map(|&(i, j)| {
            monitor.check(STAGE)?;
            let registered = pairwise.register(i, j);
            monitor.advance(1);
            Ok((pairwise.key(i, j).0, registered))
        })
        .collect();
    monitor.end();
    let seconds = start.elapsed().as_secs_f64() / pairs.len().max(1) as f64;
    registered.into_iter().map(|pair| pair.map(|(key, pair)| (key, (pair, seconds)))).collect()
}

/// Why a scan whose best registration was `best` has no edge.
fn without_edge(best: &PairRegistration, needed: usize) -> DeclineReason {
    let PairRegistration { inliers, matches, median_distance_m, .. } = *best;
    if inliers >= needed {
        return DeclineReason::Pruned { inliers, median_distance_m };
    }
    DeclineReason::TooFewInliers { inliers, needed, matches }
}

/// Refines every component jointly where the settings ask for it, and measures how its scans
/// agree at their final poses.
fn finish(
    reconstruction: &mut Reconstruction,
    inputs: &[ScanInput<'_>],
    config: &Config,
    lengths: Lengths,
    monitor: &dyn Monitor,
) -> Result<()> {
    let grids: Vec<RadiusGrid<'_>> = inputs
        .par_iter()
        .map(|s| RadiusGrid::new(&s.features.keypoints, lengths.inlier_radius_m as f32))
        .collect();
    for component in 0..reconstruction.components() {
        let mut members: Vec<(usize, ScanId, RigidMotion)> = reconstruction
            .outcomes
            .iter()
            .enumerate()
            .filter_map(|(scan, outcome)| Some((scan, outcome.placement()?)))
            .filter(|(_, placement)| placement.component == component)
            .map(|(scan, placement)| (placement.step, ScanId(scan), placement.world_from_scan))
            .collect();
        // The pivot first: it fixes the frame.
        members.sort_by_key(|m| m.0);
        let mut poses: Vec<(ScanId, RigidMotion)> = members.into_iter().map(|m| (m.1, m.2)).collect();
        if config.registration.multiview_icp.enabled {
            let radius_m = lengths.inlier_radius_m as f32;
            let models: Vec<ScanModel<'_>> = poses
                .par_iter()
                .map(|(scan, _)| ScanModel::new(inputs[scan.0].surface, radius_m, &config.registration))
                .collect();
            let scans: Vec<PosedScan<'_>> = poses
                .iter()
                .zip(&models)
                .map(|((_, pose), model)| PosedScan { model, world_from_scan: *pose })
                .collect();
            let refined =
                refine_poses(&scans, &config.registration.multiview_icp, lengths.inlier_radius_m, monitor)?;
            poses.iter_mut().zip(refined).for_each(|(member, pose)| member.1 = pose);
        }
        let neighbours = neighbours(&poses, &grids, &[]);
        for ((scan, pose), neighbours) in poses.into_iter().zip(neighbours) {
            if let Outcome::Placed(placement) = &mut reconstruction.outcomes[scan.0] {
                placement.world_from_scan = pose;
                placement.neighbours = neighbours;
            }
        }
    }
    Ok(())
}
