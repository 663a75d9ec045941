//! From scans to a reconstruction: every stage in order, each timed.

mod agreement;
mod component_frames;
mod features;
mod fine_refinement;
mod frames;
mod overruled;
mod pair_shards;
mod pairs;
mod shard;
mod stopwatch;
mod surfaces;

use component_frames::StatedFrames;
pub use features::{FeatureSource, read_features};
pub use overruled::Overruled;
use pair_shards::PairShards;
pub use pair_shards::{RegisteredShard, check_shards, register_shard};
pub use pairs::PairCache;
pub use shard::Shard;
pub use stopwatch::Stopwatch;
use surfaces::Store;

use crate::config::Config;
use crate::descriptor::{Describer, DescriptorKind};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::preprocessing::{ScaleChoice, ScaleWarning, local_frame, scale};
use crate::registration::{self, Lengths, PosePrior, ScanInput, ScanPair, prior};
use crate::result::StageTime;
use crate::retrieval::{self, Checkpoint, DescriptorTag, HeadChoice, HeadOrigin, SimilaritySource, shipped};
use crate::scan::{
    Features, PointCloud, PoseGraph, Reconstruction, Scan, SimilarityMatrix, Surface, WorkingScale,
};
use std::ops::Range;
use std::path::Path;

/// What a run made, stage by stage; everything is in the order of the scans.
#[derive(Debug)]
pub struct Run {
    /// Lengths it worked at.
    pub scale: WorkingScale,
    /// Scans these lengths may not suit.
    pub warnings: Vec<ScaleWarning>,
    /// `scan_from_local` of every scan: surfaces and features are in frames of their own, `scan` are
    /// the coordinates of the file.
    pub frames: Vec<RigidMotion>,
    /// Thinned scans with normals.
    pub surfaces: Vec<Surface>,
    /// Keypoints and descriptors.
    pub features: Vec<Features>,
    /// Whether a scan's features were read instead of computed.
    pub reused: Vec<bool>,
    /// Predicted overlap.
    pub similarity: SimilarityMatrix,
    /// Where the head that predicted it came from.
    pub head: HeadOrigin,
    /// The registered pairs, for methods that register pairs first.
    pub pose_graph: Option<PoseGraph>,
    /// The outcome on every scan.
    pub reconstruction: Reconstruction,
    /// Rough poses that the scans contradict.
    pub overruled: Vec<Overruled>,
    /// Time each stage took.
    pub timings: Vec<StageTime>,
}

/// Registers `scans` (at least two): own frames and scale → surfaces → features → similarity → growth and
/// fine refinement, or pairs and synchronisation; poses are in the coordinates of the files, each component in
/// the frame of the least motion where these have a frame in common, else in that of its pivot's file. Pairs are cached beside features.
///
/// # Errors
/// Unusable scans, settings or features, or the user asked to stop.
pub fn run(
    scans: &[Scan],
    config: &Config,
    source: &FeatureSource<'_>,
    monitor: &dyn Monitor,
) -> Result<Run> {
    let pairs = match source {
        FeatureSource::Cached(folder) => PairCache::in_folder(folder),
        _ => PairCache::in_memory(),
    };
    run_with_pairs(scans, config, source, &pairs, monitor)
}

/// [`run`] with a cache of pairs that several runs may share.
///
/// # Errors
/// As [`run`].
pub fn run_with_pairs(
    scans: &[Scan],
    config: &Config,
    source: &FeatureSource<'_>,
    pairs: &PairCache,
    monitor: &dyn Monitor,
) -> Result<Run> {
    run_with_shards(scans, config, source, pairs, None, monitor)
}

/// [`run_with_pairs`], with the first pairs of the agglomerative registration from the files in the folder
/// `shards`, where one is given, as [`register_shard`] wrote them: the result is the same.
///
/// # Errors
/// As [`run`], and [`Error::File`] for a missing shard and for pairs of other scans or settings.
pub fn run_with_shards(
    scans: &[Scan],
    config: &Config,
    source: &FeatureSource<'_>,
    pairs: &PairCache,
    shards: Option<&Path>,
    monitor: &dyn Monitor,
) -> Result<Run> {
    check_scans(scans)?;
    config.validate()?;
    let mut clock = Stopwatch::default();
    // Before minutes are spent on scans that they are not of.
    let read = |folder| PairShards::read(folder, config, scans.len(), monitor);
    let shards = clock.time("registration", || shards.map(read).transpose())?;
    let described = describe_timed(scans, config, source, monitor, &mut clock)?;
    // Before minutes are spent, as a name may be wrong.
    let reference = config.output.reference.as_deref();
    let stated = StatedFrames::new(scans, &described.frames, &described.surfaces, reference)?;
    let (similarity, head) = predict_overlap(&described, config, monitor, &mut clock)?;
    let pairs_of = |shards: PairShards| shards.pairs(&described, &similarity, config);
    let first_round = clock.time("registration", || shards.map(pairs_of).transpose())?;
    let known = Known { pairs, first_round };
    let mut registered = register_locally(&described, &similarity, config, known, monitor, &mut clock)?;
    if config.method.synchronization().is_none() {
        clock.time("fine refinement", || {
            let Described { scale, frames, surfaces, .. } = &described;
            let (local, settings) = (&mut registered.reconstruction, &config.registration);
            fine_refinement::refine(local, scans, frames, surfaces, scale, settings, monitor)
        })?;
    }
    clock.time("agreement", || {
        let Described { scale, features, surfaces, .. } = &described;
        let local = &mut registered.reconstruction;
        agreement::measure(local, features, surfaces, scale.inlier_radius_m, monitor)
    })?;
    let Registered { pose_graph, reconstruction } = registered.in_files(&described.frames, &stated);
    let overruled = Overruled::all(scans, &described, &reconstruction);
    let Described { scale, warnings, frames, surfaces, features, reused, .. } = described;
    Ok(Run {
        scale,
        warnings,
        frames,
        surfaces,
        features,
        reused,
        similarity,
        head,
        pose_graph,
        reconstruction,
        overruled,
        timings: clock.stages,
    })
}

/// The stage "similarity" of [`run`]: predicted overlap, and where its head came from.
///
/// # Errors
/// A head that cannot be read or does not fit, or the user asked to stop.
pub fn predict_overlap(
    described: &Described,
    config: &Config,
    monitor: &dyn Monitor,
    clock: &mut Stopwatch,
) -> Result<(SimilarityMatrix, HeadOrigin)> {
    clock.time("similarity", || {
        let features = &described.features;
        let checkpoint = overlap_head(config, &described.scale, features)?;
        retrieval::similarity_of(features, &config.retrieval, checkpoint.as_ref(), config.seed, monitor)
    })
}

/// What the last stage makes.
#[derive(Debug)]
pub struct Registered {
    /// The registered pairs, for methods that register pairs first.
    pub pose_graph: Option<PoseGraph>,
    /// The outcome on every scan.
    pub reconstruction: Reconstruction,
}

impl Registered {
    /// The same in the coordinates of the files instead of the scans' own frames.
    fn in_files(self, scan_from_local: &[RigidMotion], stated: &StatedFrames) -> Self {
        Self {
            pose_graph: self.pose_graph.map(|graph| frames::pose_graph(graph, scan_from_local)),
            reconstruction: frames::reconstruction(self.reconstruction, scan_from_local, stated),
        }
    }
}

/// The stage "registration" of [`run`].
///
/// # Errors
/// Shapes or settings that cannot be used, or the user asked to stop.
pub fn register_described(
    described: &Described,
    similarity: &SimilarityMatrix,
    config: &Config,
    monitor: &dyn Monitor,
    clock: &mut Stopwatch,
) -> Result<Reconstruction> {
    let pairs = PairCache::in_memory();
    let registered = register_with_pairs(described, similarity, config, &pairs, monitor, clock)?;
    Ok(registered.reconstruction)
}

/// [`register_described`] with pairs that several runs may share, and the pose graph.
///
/// # Errors
/// Shapes or settings that cannot be used, or the user asked to stop.
pub fn register_with_pairs(
    described: &Described,
    similarity: &SimilarityMatrix,
    config: &Config,
    pairs: &PairCache,
    monitor: &dyn Monitor,
    clock: &mut Stopwatch,
) -> Result<Registered> {
    let known = Known { pairs, first_round: None };
    let registered = register_locally(described, similarity, config, known, monitor, clock)?;
    Ok(registered.in_files(&described.frames, &StatedFrames::of_pivots(&described.frames)))
}

/// Pairs that were registered before.
struct Known<'a> {
    /// Of pose graphs.
    pairs: &'a PairCache,
    /// Of the agglomerative registration, in the canonical order.
    first_round: Option<Vec<ScanPair>>,
}

/// [`register_with_pairs`] with poses of the scans' own frames.
fn register_locally(
    described: &Described,
    similarity: &SimilarityMatrix,
    config: &Config,
    known: Known<'_>,
    monitor: &dyn Monitor,
    clock: &mut Stopwatch,
) -> Result<Registered> {
    let (inputs, lengths) = (described.inputs(), described.lengths());
    clock.time("registration", || {
        let Some(method) = config.method.synchronization() else {
            let (settings, seed, first) = (&config.registration, config.seed, known.first_round);
            let reconstruction =
                registration::register_from(&inputs, similarity, settings, lengths, seed, first, monitor)?;
            return Ok(Registered { pose_graph: None, reconstruction });
        };
        let (graph, reconstruction) =
            pairs::synchronize(&inputs, similarity, method, config, lengths, known.pairs, monitor)?;
        Ok(Registered { pose_graph: Some(graph), reconstruction })
    })
}

/// Scans as the stages before retrieval leave them, in the order of the scans.
#[derive(Debug, Clone)]
pub struct Described {
    /// Lengths they were worked at.
    pub scale: WorkingScale,
    /// Scans these lengths may not suit.
    pub warnings: Vec<ScaleWarning>,
    /// `scan_from_local` of every scan: surfaces and features are in frames of their own, `scan` are
    /// the coordinates of the file.
    pub frames: Vec<RigidMotion>,
    /// Thinned scans with normals.
    pub surfaces: Vec<Surface>,
    /// Keypoints and descriptors.
    pub features: Vec<Features>,
    /// Whether a scan's features were read instead of computed.
    pub reused: Vec<bool>,
    /// What is known of their poses before any is compared.
    pub priors: Vec<PosePrior>,
}

impl Described {
    /// Features of every scan relative to its cloud's origin, as files hold them.
    pub fn features_of_files(&self, scans: &[Scan]) -> Vec<Features> {
        let of = |((features, scan), frame): ((&Features, &Scan), &RigidMotion)| {
            frames::from_local(features, scan, frame)
        };
        self.features.iter().zip(scans).zip(&self.frames).map(of).collect()
    }

    /// What the registration needs of every scan.
    fn inputs(&self) -> Vec<ScanInput<'_>> {
        let known = self.priors.iter().copied().chain(std::iter::repeat(PosePrior::default()));
        let scans = self.features.iter().zip(&self.surfaces).zip(known);
        scans
            .map(|((features, surface), prior)| ScanInput { prior, ..ScanInput::new(features, surface) })
            .collect()
    }

    fn lengths(&self) -> Lengths {
        Lengths { inlier_radius_m: self.scale.inlier_radius_m, voxel_m: self.scale.voxel_m }
    }
}

/// The first stages of [`run`]: scale → surfaces → features.
///
/// # Errors
/// Unusable scans, settings or features, or the user asked to stop.
pub fn describe(
    scans: &[Scan],
    config: &Config,
    source: &FeatureSource<'_>,
    monitor: &dyn Monitor,
) -> Result<Described> {
    describe_timed(scans, config, source, monitor, &mut Stopwatch::default())
}

/// [`describe`] with the time of every stage.
///
/// # Errors
/// As [`describe`].
pub fn describe_timed(
    scans: &[Scan],
    config: &Config,
    source: &FeatureSource<'_>,
    monitor: &dyn Monitor,
    clock: &mut Stopwatch,
) -> Result<Described> {
    let store = match source {
        FeatureSource::Kept(folder) => Store::Read(folder),
        _ => Store::None,
    };
    let prepared = Prepared::new(scans, config, (store, 0..scans.len()), monitor, clock)?;
    let (features, reused) =
        clock.time("features", || prepared.features(scans, config, source, 0..scans.len(), monitor))?;
    let Prepared { local, frames, surfaces, choice } = prepared;
    let known = local.iter().map(|s| s.initial_pose).zip(frames.iter().copied());
    let priors = prior::priors(&config.registration.prior, choice.scale.inlier_radius_m, known);
    let (scale, warnings) = (choice.scale, choice.warnings);
    Ok(Described { scale, warnings, frames, surfaces, features, reused, priors })
}

/// Features of the scans of a shard.
#[derive(Debug, Clone)]
pub struct DescribedShard {
    /// Which of the scans.
    pub scans: Range<usize>,
    /// Features of each of them relative to its cloud's origin, as files hold them.
    pub features: Vec<Features>,
    /// Whether they were read instead of computed.
    pub reused: Vec<bool>,
}

/// [`describe`] of one shard of the scans, a contiguous stretch. The lengths, and where scans were seen from, are
/// chosen from all scans: features are the same as without shards. Thinned scans are kept beside features, where
/// other shards and stages find them.
///
/// # Errors
/// As [`describe`].
pub fn describe_shard(
    scans: &[Scan],
    config: &Config,
    source: &FeatureSource<'_>,
    shard: Shard,
    monitor: &dyn Monitor,
) -> Result<DescribedShard> {
    let part = shard.range(scans.len());
    let store = match source {
        FeatureSource::Cached(folder) => {
            std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
            Store::ReadAndWrite(folder)
        }
        FeatureSource::Kept(folder) => Store::Read(folder),
        _ => Store::None,
    };
    let mut clock = Stopwatch::default();
    let prepared = Prepared::new(scans, config, (store, part.clone()), monitor, &mut clock)?;
    let (features, reused) = prepared.features(scans, config, source, part.clone(), monitor)?;
    let of = |(features, scan): (Features, usize)| {
        frames::from_local(&features, &scans[scan], &prepared.frames[scan])
    };
    let features = features.into_iter().zip(part.clone()).map(of).collect();
    Ok(DescribedShard { scans: part, features, reused })
}

/// Scans as far as all of them together decide them, before features.
struct Prepared {
    /// In their own frames.
    local: Vec<Scan>,
    frames: Vec<RigidMotion>,
    surfaces: Vec<Surface>,
    choice: ScaleChoice,
}

impl Prepared {
    fn new(
        scans: &[Scan],
        config: &Config,
        store: (Store<'_>, Range<usize>),
        monitor: &dyn Monitor,
        clock: &mut Stopwatch,
    ) -> Result<Self> {
        let (local, frames) = clock.time("scale", || local_frame::localize(scans));
        let clouds: Vec<&PointCloud> = local.iter().map(|s| &s.cloud).collect();
        let choice = clock.time("scale", || scale::choose(&config.scale, &clouds))?;
        let surfaces =
            clock.time("surfaces", || surfaces::thinned(&local, &frames, &choice.scale, store, monitor))?;
        Ok(Self { local, frames, surfaces, choice })
    }

    /// Features of some of the scans, which `scans` are as they were read.
    fn features(
        &self,
        scans: &[Scan],
        config: &Config,
        source: &FeatureSource<'_>,
        part: Range<usize>,
        monitor: &dyn Monitor,
    ) -> Result<(Vec<Features>, Vec<bool>)> {
        let given: Vec<Features>;
        let (source, part) = match source {
            FeatureSource::Given(features) if features.len() == scans.len() => {
                let of = |i: usize| frames::to_local(&features[i], &scans[i], &self.frames[i]);
                given = part.clone().map(of).collect();
                (&FeatureSource::Given(&given), part)
            }
            // Refused, for all scans.
            FeatureSource::Given(_) => (source, 0..scans.len()),
            other => (other, part),
        };
        let (local, surfaces) = (&self.local[part.clone()], &self.surfaces[part]);
        features::of_scans(local, surfaces, &self.choice.scale, config, source, monitor)
    }
}

fn check_scans(scans: &[Scan]) -> Result<()> {
    if scans.len() >= 2 {
        return Ok(());
    }
    let found = match scans {
        [] => "no scan".to_owned(),
        [one, ..] => format!("one scan, {}", one.name),
    };
    Err(Error::input("inputs", found, "at least two scans to register with each other", "name more scans"))
}

/// The stage "surfaces": every scan, in its own frame, thinned to the working voxel, with normals;
/// `scan_from_local` tells where the zeros of the files lie.
///
/// # Errors
/// When the user asked to stop.
pub fn thin(
    scans: &[Scan],
    scan_from_local: &[RigidMotion],
    scale: &WorkingScale,
    monitor: &dyn Monitor,
) -> Result<Vec<Surface>> {
    surfaces::thinned(scans, scan_from_local, scale, (Store::None, 0..scans.len()), monitor)
}

/// What the descriptors of `features` mean; `None` when there is none.
///
/// # Errors
/// Those of [`Describer::new`].
pub fn descriptor_tag(
    config: &Config,
    scale: &WorkingScale,
    features: &[Features],
) -> Result<Option<DescriptorTag>> {
    let Some(dim) = features.iter().map(|f| f.descriptors.dim()).find(|&d| d > 0) else { return Ok(None) };
    let name = config.descriptor.descriptor_name().to_owned();
    let settings_hash = Describer::new(&config.descriptor)?.settings_hash(scale);
    Ok(Some(DescriptorTag { name, dim, settings_hash }))
}

/// The trained head that the settings ask for, if it fits these features.
///
/// # Errors
/// When the checkpoint that is named cannot be read or belongs to another descriptor.
pub fn overlap_head(
    config: &Config,
    scale: &WorkingScale,
    features: &[Features],
) -> Result<Option<Checkpoint>> {
    let Some(tag) = descriptor_tag(config, scale, features)? else { return Ok(None) };
    match &config.retrieval.checkpoint {
        // Files do not say which descriptor they hold; the dimension is checked where it is used.
        Some(path) if config.descriptor.kind == DescriptorKind::Precomputed => {
            Checkpoint::load(path).map(Some)
        }
        Some(path) => Checkpoint::load_for(path, &tag).map(Some),
        None if config.retrieval.head == HeadChoice::Trained
            && config.retrieval.source == SimilaritySource::Netvlad =>
        {
            shipped::head_for(&tag)
        }
        None => Ok(None),
    }
}
