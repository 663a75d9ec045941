//! Computing the cells that are not there yet.

use super::cell::{Cell, CellKey, Environment, PeakOf};
use super::loaded::LoadedScene;
use super::plan::{self, Plan, Task, Tasks};
use super::suite::{SimilarityChoice, Suite};
use crate::Monitor;
use crate::descriptor::subsample_features;
use crate::evaluation::dataset::evaluate_scene;
use crate::evaluation::estimate::SceneEstimate;
use crate::evaluation::retrieval_scores::RetrievalScores;
use crate::files;
use crate::pipeline::{self, Described, Shard, Stopwatch};
use crate::result::Document;
use crate::result::{StageTime, peak_memory_bytes, reset_peak_memory};
use crate::scan::SimilarityMatrix;
use crate::{Error, Result};
use std::collections::VecDeque;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Cut-off of the retrieval scores: recall@10.
const RETRIEVAL_CUTOFF: usize = 10;
/// The suite in an output folder, as it was run.
pub(super) const SUITE: &str = "suite.toml";
/// The list of all its cells.
pub(super) const PLAN: &str = "plan.json";

/// How a suite is run.
#[derive(Debug, Clone)]
pub struct Options<'a> {
    /// Folder that the suite's paths start from.
    pub data_root: &'a Path,
    /// Folder for cells, cache and tables.
    pub output: &'a Path,
    /// Cells computed at the same time, each on its share of the threads.
    pub jobs: usize,
    /// Part of the cells to compute.
    pub shard: Shard,
    /// Digest of the program; cells of another build are computed again.
    pub build: &'a str,
    /// Take cells of other builds as they are.
    pub any_build: bool,
}

/// What a run did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Progress {
    /// All cells of the suite.
    pub plan: Plan,
    /// Cells computed now.
    pub computed: usize,
    /// Cells of this shard that were there already.
    pub kept: usize,
}

/// Folder of the cells in an output folder.
pub fn cells_folder(output: &Path) -> PathBuf {
    output.join("cells")
}

/// Computes the cells of a suite that `options.output` does not hold yet.
///
/// # Errors
/// Data or settings that cannot be used, output that cannot be written, or the user asked to
/// stop; finished cells stay.
pub fn run(suite: &Suite, options: &Options<'_>, monitor: &dyn Monitor) -> Result<Progress> {
    suite.validate()?;
    let tasks = plan::tasks(suite, options.data_root, monitor)?;
    for folder in [cells_folder(options.output), options.output.join("cache")] {
        std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, e))?;
    }
    let plan = tasks.plan();
    write_text(&options.output.join(SUITE), &suite.to_toml()?)?;
    let listed = serde_json::to_string_pretty(&plan).unwrap_or_default();
    write_text(&options.output.join(PLAN), &(listed + "\n"))?;
    let shard = tasks.of_shard(options.shard);
    let missing: Vec<&Task> = shard.iter().filter(|t| !is_valid(t, options)).collect();
    let kept = shard.len() - missing.len();
    let computed = missing.len();
    monitor.begin("cells", computed);
    let result = compute_all(suite, &tasks, missing, options, monitor);
    monitor.end();
    result.map(|()| Progress { plan, computed, kept })
}

fn write_text(path: &Path, text: &str) -> Result<()> {
    files::write(path, |out| out.write_all(text.as_bytes()))
}

/// Whether the cell of a task is there and still holds.
fn is_valid(task: &Task, options: &Options<'_>) -> bool {
    let path = cells_folder(options.output).join(task.cell.key.file_name());
    if !path.exists() {
        return false;
    }
    match Cell::read(&path) {
        Ok(cell) => {
            cell.hash == task.cell.hash
                && cell.key == task.cell.key
                && (options.any_build || cell.environment.build == options.build)
        }
        Err(error) => {
            tracing::warn!("computing again what should be a cell: {error}");
            false
        }
    }
}

/// Tasks by scene: a worker stays with its scene while that has any left.
struct Queue(Vec<VecDeque<usize>>);

impl Queue {
    fn new(tasks: &[&Task], scenes: usize) -> Self {
        let mut by_scene = vec![VecDeque::new(); scenes];
        for (at, task) in tasks.iter().enumerate() {
            by_scene[task.scene].push_back(at);
        }
        Self(by_scene)
    }

    /// The next task of `scene`, or else of the first scene with most tasks left.
    fn next(&mut self, scene: Option<usize>) -> Option<usize> {
        if let Some(task) = scene.and_then(|s| self.0[s].pop_front()) {
            return Some(task);
        }
        let most = self.0.iter().map(VecDeque::len).max().filter(|n| *n > 0)?;
        self.0.iter_mut().find(|tasks| tasks.len() == most)?.pop_front()
    }
}

fn compute_all(
    suite: &Suite,
    tasks: &Tasks,
    missing: Vec<&Task>,
    options: &Options<'_>,
    monitor: &dyn Monitor,
) -> Result<()> {
    let queue = Mutex::new(Queue::new(&missing, tasks.scenes.len()));
    let failed = AtomicBool::new(false);
    let jobs = options.jobs.clamp(1, missing.len().max(1));
    let work = || -> Result<()> {
        let mut worker = Worker { suite, tasks, options, jobs, monitor: Quiet(monitor), scene: None };
        loop {
            let held = worker.scene.as_ref().map(|s| s.0);
            let next = queue.lock().unwrap_or_else(PoisonError::into_inner).next(held);
            let Some(at) = next.filter(|_| !failed.load(Ordering::SeqCst)) else { return Ok(()) };
            monitor.check("benchmark")?;
            monitor.note(&missing[at].cell.key.to_string());
            let result = worker.compute(missing[at]);
            if let Err(error) = result {
                if !failed.swap(true, Ordering::SeqCst) && !matches!(error, Error::Interrupted { .. }) {
                    tracing::error!("in the cell {}", missing[at].cell.key);
                }
                return Err(error);
            }
            monitor.advance(1);
        }
    };
    if jobs == 1 {
        return work();
    }
    let threads = (rayon::current_num_threads() / jobs).max(1);
    let pools = (0..jobs)
        .map(|_| rayon::ThreadPoolBuilder::new().num_threads(threads).build())
        .collect::<Result<Vec<_>, _>>()
        .map_err(|e| {
            Error::setting("--jobs", jobs.to_string(), "threads for as many", format!("use fewer ({e})"))
        })?;
    std::thread::scope(|scope| {
        let workers: Vec<_> = pools.iter().map(|pool| scope.spawn(|| pool.install(work))).collect();
        let results: Vec<Result<()>> = workers
            .into_iter()
            .map(|w| w.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect();
        // A real error says more than that another worker was stopped by the user.
        let (stopped, rest): (Vec<_>, Vec<_>) =
            results.into_iter().partition(|r| matches!(r, Err(Error::Interrupted { .. })));
        rest.into_iter().chain(stopped).collect()
    })
}

/// Passes on only that the user asked to stop: the stages of a cell draw no bars.
struct Quiet<'a>(&'a dyn Monitor);

impl Monitor for Quiet<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

struct Worker<'a> {
    suite: &'a Suite,
    tasks: &'a Tasks,
    options: &'a Options<'a>,
    jobs: usize,
    monitor: Quiet<'a>,
    /// The scene at hand and its index.
    scene: Option<(usize, LoadedScene)>,
}

impl Worker<'_> {
    /// Computes and writes one cell.
    fn compute(&mut self, task: &Task) -> Result<()> {
        let cell = self.cell(task)?;
        cell.write(&cells_folder(self.options.output).join(cell.key.file_name()))
    }

    fn cell(&mut self, task: &Task) -> Result<Cell> {
        let key = &task.cell.key;
        let dataset = &self.suite.datasets[self.tasks.scenes[task.scene].dataset];
        let method = &self.suite.methods[task.method];
        let cache = self.options.output.join("cache");
        let held = self.scene.take().filter(|(at, _)| *at == task.scene);
        let loaded = match held {
            Some((_, scene)) => scene,
            None => {
                let scene = &self.tasks.scenes[task.scene];
                LoadedScene::load(self.suite, scene, self.options.data_root, &cache, &self.monitor)?
            }
        };
        let scene = &mut self.scene.insert((task.scene, loaded)).1;
        let alone = self.jobs == 1 && reset_peak_memory();
        let seed = plan::feature_seed(self.suite, key.seed);
        let features_config = method.config_for(dataset, seed, self.suite.computed_keypoints)?;
        let (all, stages) = scene.described(&features_config, &cache, &self.monitor)?;
        let mut clock = Stopwatch { stages: stages.to_vec() };
        let sampled = all.features.iter().map(|f| subsample_features(f, key.keypoints, key.seed)).collect();
        let described = Described { features: sampled, ..all.clone() };
        let config = method.config_for(dataset, key.seed, key.keypoints)?;
        let (similarity, overlap_head) = match method.similarity {
            SimilarityChoice::Predicted => {
                let (s, head) = pipeline::predict_overlap(&described, &config, &self.monitor, &mut clock)?;
                (s, head.to_string())
            }
            SimilarityChoice::Oracle => (oracle(scene, key, &method.name)?, "true overlap".to_owned()),
        };
        let registered = pipeline::register_with_pairs(
            &described,
            &similarity,
            &config,
            &scene.pairs,
            &self.monitor,
            &mut clock,
        )?;
        // Another cell may have registered the pairs: what they cost belongs to this one as well.
        if let Some(seconds) = registered.pose_graph.map(|g| g.reused_seconds).filter(|s| *s > 0.0) {
            clock.stages.push(StageTime { stage: "registration".to_owned(), seconds });
        }
        let reconstruction = registered.reconstruction;
        let peak_memory_bytes = peak_memory_bytes();
        let report = evaluate_scene(&scene.truth, &SceneEstimate::of(&reconstruction), false)?;
        let (format, version) = Cell::stamp();
        Ok(Cell {
            format,
            version,
            key: key.clone(),
            hash: task.cell.hash.clone(),
            environment: environment(self.options.build, self.jobs),
            overlap_head,
            benchmarks: dataset.benchmarks.iter().map(|b| (b.name.clone(), b.protocol)).collect(),
            pair_overlaps: scene.pair_overlaps(&report.recalls),
            retrieval: match &scene.overlap {
                Some(truth) => Some(RetrievalScores::of(&similarity, truth, RETRIEVAL_CUTOFF)?),
                None => None,
            },
            diagnosis: scene.diagnose(&reconstruction, &report.recalls),
            report,
            timings: clock.stages,
            features_reused: described.reused.iter().filter(|r| **r).count(),
            peak_memory_bytes,
            peak_memory_of: if alone { PeakOf::Cell } else { PeakOf::Process },
            poses: Document::new(&scene.scans, &reconstruction, described.scale.inlier_radius_m),
        })
    }
}

/// The true overlap in place of a predicted one.
fn oracle(scene: &LoadedScene, key: &CellKey, method: &str) -> Result<SimilarityMatrix> {
    scene.overlap.clone().ok_or_else(|| {
        Error::setting(
            format!("methods: {method}: similarity"),
            format!("oracle, but the scene {} has no true poses", key.scene),
            "a scene with true poses",
            "use similarity = \"predicted\"",
        )
    })
}

fn environment(build: &str, jobs: usize) -> Environment {
    Environment {
        generator: concat!("scanweave ", env!("CARGO_PKG_VERSION")).to_owned(),
        build: build.to_owned(),
        threads: rayon::current_num_threads(),
        jobs,
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
    }
}
