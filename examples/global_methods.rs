//! Incremental, agglomerative and global methods on real scenes, with the same features.
//!
//! Usage: `cargo run --release --example global_methods -- [--keypoints N] [--preset NAME]
//! [--set KEY=VALUE] [--features DIR] [--weights LITS_FILE] [--cache DIR] [--no-incremental | --default-only] DATA SCENE…`
//!
//! Features are computed, or read from DIR/SCENE/<scan>.npz: N keypoints a scan (2500), a sample where
//! more are given. The run of the preset `default` (agglomerative) uses only the descriptor settings of
//! `--set`. `--default-only` prints the lines of `default` alone.
//!
//! DATA holds 3dmatch/SCENE/PointCloud and benchmarks/{3DMatch,3DLoMatch}/SCENE. For every scene
//! and pose graph the pairs are registered once, and every global method gets the same graph. Their
//! poses are not refined afterwards. The incremental method runs with the preset, and refines poses where
//! that says so; it is followed by the preset `default`. Prints one line a scene, graph and method, then
//! the means over the scenes: registration recall on both benchmarks in percent, pairs registered and
//! kept, share of the kept ones that are right (10°, 0.3 m), and the seconds that pairs (when they were
//! registered) and synchronisation took.

use scanweave::config::{Layers, Method as Choice};
use scanweave::descriptor::DescriptorKind;
use scanweave::descriptor::subsample_features;
use scanweave::evaluation::{RecallConfig, RecallReport, registration_recall};
use scanweave::geometry::RigidMotion;
use scanweave::geometry::{rotation_error_rad, translation_error_m};
use scanweave::io::{Benchmark, read_benchmark, read_scene};
use scanweave::pipeline::{self, FeatureSource, PairCache, Run, run_with_pairs};
use scanweave::scan::{PoseGraph, Reconstruction, Scan, ScanId};
use scanweave::synchronization::{GraphKind, LitsWeights, Method, synchronize};
use scanweave::{Config, Silent, io};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

const BENCHMARKS: [&str; 2] = ["3DMatch", "3DLoMatch"];
const GRAPHS: [(GraphKind, &str); 3] =
    [(GraphKind::Full, "full"), (GraphKind::Pruned, "pruned"), (GraphKind::Sparse, "sparse")];

struct Options {
    config: Config,
    lits: Option<LitsWeights>,
    features: Option<PathBuf>,
    cache: Option<PathBuf>,
    keypoints: usize,
    incremental: bool,
    default_only: bool,
    data: PathBuf,
    scenes: Vec<String>,
}

/// What one method made of one scene.
struct Line {
    recalls: [RecallReport; 2],
    pairs: Option<usize>,
    seconds: f64,
}

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let options = options()?;
    let mut lines: BTreeMap<(usize, String), Vec<Line>> = BTreeMap::new();
    println!(
        "{:40} {:8} {:12} 3DMatch 3DLoMatch  pairs  edges right     seconds",
        "scene", "graph", "method"
    );
    for name in &options.scenes {
        for (rank, label, line) in scene(&options, name)? {
            lines.entry((rank, label)).or_default().push(line);
        }
    }
    println!("\nmean of {} scenes (pooled)", options.scenes.len());
    for ((_, label), lines) in &lines {
        let percent = |benchmark: usize| {
            let reports: Vec<&RecallReport> = lines.iter().map(|l| &l.recalls[benchmark]).collect();
            let mean = reports.iter().filter_map(|r| r.recall()).sum::<f64>() / reports.len() as f64;
            let succeeded: usize = reports.iter().map(|r| r.succeeded).sum();
            let counted: usize = reports.iter().map(|r| r.counted).sum();
            format!("{:5.1} ({:5.1})", 100.0 * mean, 100.0 * succeeded as f64 / counted.max(1) as f64)
        };
        let pairs: usize = lines.iter().filter_map(|l| l.pairs).sum();
        let seconds: f64 = lines.iter().map(|l| l.seconds).sum();
        println!("{label:22} {}  {}  {pairs:6} pairs  {seconds:8.2} s", percent(0), percent(1));
    }
    Ok(())
}

fn options() -> Result<Options, Failure> {
    let (mut preset, mut keypoints, mut weights, mut cache) = ("paper".to_owned(), 2500, None, None);
    let (mut incremental, mut default_only) = (true, false);
    let (mut features, mut set, mut rest) = (None, Vec::new(), Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
        match argument.as_str() {
            "--preset" => preset = value()?,
            "--keypoints" => keypoints = value()?.parse()?,
            "--weights" => weights = Some(PathBuf::from(value()?)),
            "--set" => set.push(value()?),
            "--cache" => cache = Some(PathBuf::from(value()?)),
            "--features" => features = Some(PathBuf::from(value()?)),
            "--no-incremental" => incremental = false,
            "--default-only" => default_only = true,
            _ => rest.push(argument),
        }
    }
    if rest.len() < 2 {
        return Err("usage: global_methods [options] DATA SCENE…".into());
    }
    let mut layers = Layers::new::<Config>();
    layers.add_preset(&preset)?;
    set.iter().try_for_each(|assignment| layers.add_assignment(assignment))?;
    let mut config = Config::from_layers(&layers)?;
    config.descriptor.keypoints.count = keypoints;
    let lits = weights.map(|path| LitsWeights::load(&path)).transpose()?;
    if features.is_some() {
        config.descriptor.kind = DescriptorKind::Precomputed;
    }
    let data = PathBuf::from(rest.remove(0));
    Ok(Options { config, lits, features, cache, keypoints, incremental, default_only, data, scenes: rest })
}

/// Lines of one scene, each with its place in the table and its label.
fn scene(options: &Options, name: &str) -> Result<Vec<(usize, String, Line)>, Failure> {
    let scene = read_scene(options.data.join("3dmatch").join(name).join("PointCloud"))?;
    let truth = scene.world_from_scan.ok_or("no true poses")?.value;
    let scans = io::read_scans(&scene.scans, &Silent)?;
    let mut benchmarks = Vec::new();
    for benchmark in BENCHMARKS {
        benchmarks.push(read_benchmark(options.data.join("benchmarks").join(benchmark).join(name))?);
    }
    let folder = match &options.cache {
        Some(cache) => cache.join(name),
        None => tempfile::tempdir()?.keep(),
    };
    std::fs::create_dir_all(&folder)?;
    let given = match &options.features {
        Some(features) => {
            let all =
                pipeline::read_features(&features.join(name), &scans, &io::ReadOptions::default(), &Silent)?;
            Some(all.iter().map(|f| subsample_features(f, options.keypoints, 0)).collect::<Vec<_>>())
        }
        None => None,
    };
    let source = given.as_deref().map_or(FeatureSource::Cached(&folder), FeatureSource::Given);
    let mut lines = Vec::new();
    let graphs = if options.default_only { &[][..] } else { &GRAPHS };
    for (g, &(kind, graph_name)) in graphs.iter().enumerate() {
        let mut config = options.config.clone();
        config.registration.multiview_icp.enabled = false;
        (config.method, config.synchronization.graph) = (Choice::Sghr, kind);
        let (run, _) = timed(&scans, &config, &source, &folder)?;
        let graph = run.pose_graph.ok_or("no pose graph")?;
        let pairs_seconds = graph.registration_seconds;
        for (m, method) in Method::ALL.into_iter().enumerate() {
            if method == Method::Lits && options.lits.is_none() {
                continue;
            }
            let start = Instant::now();
            let found = synchronize(&graph, method, options.lits.as_ref(), &Silent)?;
            let seconds = start.elapsed().as_secs_f64();
            let recalls = recalls(&found, &scans, &benchmarks)?;
            let kept = format!("{:6} {:4.0} %", graph.edges.len(), 100.0 * right(&graph, &truth));
            print(
                name,
                graph_name,
                &method.to_string(),
                &recalls,
                graph.registered_pairs,
                &kept,
                (pairs_seconds, seconds),
            );
            let seconds = pairs_seconds + seconds;
            let line = Line { recalls, pairs: Some(graph.registered_pairs), seconds };
            lines.push((10 * g + m, format!("{graph_name} {method}"), line));
        }
    }
    if options.incremental {
        let mut default = Config::preset("default")?;
        default.descriptor = options.config.descriptor.clone();
        let both = [(98, "incremental", &options.config), (99, "default", &default)];
        for (rank, label, config) in both.into_iter().skip(usize::from(options.default_only)) {
            let (run, seconds) = timed(&scans, config, &source, &folder)?;
            let recalls = recalls(&run.reconstruction, &scans, &benchmarks)?;
            print(name, "–", label, &recalls, 0, "", (0.0, seconds));
            lines.push((rank, label.to_owned(), Line { recalls, pairs: None, seconds }));
        }
    }
    Ok(lines)
}

/// A run, and the seconds of its registration.
fn timed(
    scans: &[Scan],
    config: &Config,
    source: &FeatureSource<'_>,
    folder: &Path,
) -> Result<(Run, f64), Failure> {
    let run = run_with_pairs(scans, config, source, &PairCache::in_folder(folder), &Silent)?;
    let seconds = run.timings.iter().find(|t| t.stage == "registration").map_or(0.0, |t| t.seconds);
    Ok((run, seconds))
}

/// Share of the edges within 10° and 0.3 m of the truth.
fn right(graph: &PoseGraph, truth: &[RigidMotion]) -> f64 {
    let right = graph.edges.iter().filter(|e| {
        let expected = truth[e.i.0].inverse() * truth[e.j.0];
        rotation_error_rad(e.i_from_j(), &expected) < 10f64.to_radians()
            && translation_error_m(e.i_from_j(), &expected) < 0.3
    });
    right.count() as f64 / graph.edges.len().max(1) as f64
}

fn recalls(
    found: &Reconstruction,
    scans: &[Scan],
    benchmarks: &[Benchmark],
) -> Result<[RecallReport; 2], Failure> {
    // The benchmarks call a scan by the number at the end of its name.
    let number = |name: &str| {
        let digits = name.bytes().rev().take_while(u8::is_ascii_digit).count();
        name[name.len() - digits..].parse::<usize>().ok()
    };
    let numbered: BTreeMap<usize, ScanId> =
        scans.iter().filter_map(|scan| Some((number(&scan.name)?, scan.id))).collect();
    let relative =
        |i: ScanId, j: ScanId| found.relative_in_component(*numbered.get(&i.0)?, *numbered.get(&j.0)?);
    let report = |b: &Benchmark| registration_recall(&b.pairs, relative, &RecallConfig::default());
    Ok([report(&benchmarks[0])?, report(&benchmarks[1])?])
}

fn print(
    scene: &str,
    graph: &str,
    method: &str,
    recalls: &[RecallReport; 2],
    pairs: usize,
    kept: &str,
    (pairs_seconds, seconds): (f64, f64),
) {
    let percent = |r: &RecallReport| 100.0 * r.recall().unwrap_or(0.0);
    println!(
        "{scene:40} {graph:8} {method:12} {:7.1} {:9.1} {pairs:6} {kept:14} {pairs_seconds:7.2} + {seconds:.2}",
        percent(&recalls[0]),
        percent(&recalls[1])
    );
}
