//! How good the matches of local descriptors are on the 3DMatch and 3DLoMatch pairs.
//!
//! FPFH for given radii, computed on the spot:
//! ```text
//! SCANWEAVE_DATA=… cargo run --release --example matching_quality -- \
//!     --voxel-m 0.025 --normal-voxels 3,5,7 --feature-voxels 7,9,12 --pairs 24
//! ```
//! Any descriptors, from folders DIR/<scene>/ that `scanweave describe` wrote; those after the
//! first are best made from the same keypoints (same settings but for the descriptor):
//! ```text
//! SCANWEAVE_DATA=… cargo run --release --example matching_quality -- \
//!     --features fpfh=DIR1 --features learned=DIR2 --keypoints 2500 --pairs 24
//! ```
//!
//! For every pair: mutual nearest neighbours among the descriptors of both fragments; the inlier
//! ratio (IR) is the share of them within 0.1 m under the true pose, the feature-matching recall
//! (FMR) the share of pairs whose ratio exceeds 5 %, the pairwise recall (RR) the share of pairs
//! whose robust estimate with the default settings has an RMSE of at most 0.2 m. Means over the
//! pairs of all scenes found; last, the root mean square distance of unrelated descriptors. Expects
//! `3dmatch/<scene>/PointCloud/cloud_bin_<i>.ply` and `benchmarks/{3DMatch,3DLoMatch}/<scene>/gt.{log,info}` below the data folder.

use anyhow::{Context, Result};
use clap::Parser;
use ndarray::ArrayView2;
use rayon::prelude::*;
use scanweave::descriptor::subsample_features;
use scanweave::descriptor::{self, DescriptorConfig, DescriptorKind, KeypointConfig};
use scanweave::evaluation::rmse_m;
use scanweave::geometry::PointMover;
use scanweave::io;
use scanweave::registration::Matches;
use scanweave::registration::RegistrationConfig;
use scanweave::registration::estimate;
use scanweave::scan::WorkingScale;
use scanweave::scan::{Features, PairTruth, Scan, ScanId};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

const SETS: [&str; 2] = ["3DMatch", "3DLoMatch"];
const INLIER_M: f32 = 0.1;
const MATCHED_RATIO: f64 = 0.05;
const REGISTERED_M: f64 = 0.2;
/// Inlier radius of the robust estimate, metres.
const ESTIMATE_RADIUS_M: f64 = 0.07;

#[derive(Parser)]
struct Arguments {
    /// Data folder; by default that of the variable SCANWEAVE_DATA.
    #[arg(long)]
    data: Option<PathBuf>,
    /// Features of every scene, NAME=DIR; may be repeated. FPFH is computed where none are given.
    #[arg(long, value_name = "NAME=DIR")]
    features: Vec<String>,
    /// Voxel size, metres.
    #[arg(long, default_value_t = 0.025)]
    voxel_m: f64,
    /// Normal radii in voxels.
    #[arg(long, value_delimiter = ',', default_value = "5")]
    normal_voxels: Vec<f64>,
    /// Feature radii in voxels.
    #[arg(long, value_delimiter = ',', default_value = "12")]
    feature_voxels: Vec<f64>,
    /// Keypoints a fragment.
    #[arg(long, value_delimiter = ',', default_value = "2500")]
    keypoints: Vec<usize>,
    /// Pairs a scene and benchmark, evenly picked from gt.log; 0 for all.
    #[arg(long, default_value_t = 24)]
    pairs: usize,
    /// One line a scene besides the means.
    #[arg(long)]
    scenes: bool,
    /// Seed of the keypoints.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// Where the features of a scan come from.
enum Source {
    Folder(PathBuf),
    Fpfh(WorkingScale),
}

/// Sums over pairs.
#[derive(Default, Clone, Copy)]
struct Score {
    pairs: usize,
    ratio: f64,
    matched: usize,
    registered: usize,
    /// Squared distance of descriptors that have nothing to do with each other.
    apart: f64,
}

impl Score {
    fn add(&mut self, other: &Score) {
        self.pairs += other.pairs;
        self.ratio += other.ratio;
        self.matched += other.matched;
        self.registered += other.registered;
        self.apart += other.apart;
    }
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let data = arguments.data.clone().or_else(|| std::env::var_os("SCANWEAVE_DATA").map(PathBuf::from));
    let data = data.context("name the data folder with --data or SCANWEAVE_DATA")?;
    println!("{:<32} keypoints |  3DMatch IR    FMR     RR | 3DLoMatch IR    FMR     RR | apart, s/scan", "");
    for &count in &arguments.keypoints {
        for (name, source) in sources(&arguments)? {
            measure(&data, &name, &source, count, &arguments)?;
        }
    }
    Ok(())
}

fn sources(arguments: &Arguments) -> Result<Vec<(String, Source)>> {
    let given = arguments.features.iter().map(|text| {
        let (name, folder) = text.split_once('=').context("--features takes NAME=DIR")?;
        Ok((name.to_owned(), Source::Folder(folder.into())))
    });
    if !arguments.features.is_empty() {
        return given.collect();
    }
    let voxel_m = arguments.voxel_m;
    let radii =
        arguments.normal_voxels.iter().flat_map(|n| arguments.feature_voxels.iter().map(move |f| (n, f)));
    let fpfh = radii.map(|(normal, feature)| {
        let scale = WorkingScale {
            normal_radius_m: normal * voxel_m,
            feature_radius_m: feature * voxel_m,
            ..WorkingScale::from_voxel(voxel_m)
        };
        Ok((format!("fpfh, radii {normal} and {feature} voxels"), Source::Fpfh(scale)))
    });
    fpfh.collect()
}

/// Prints the scores of both benchmarks, and the mean wall time that features of a scan took.
fn measure(data: &Path, name: &str, source: &Source, count: usize, arguments: &Arguments) -> Result<()> {
    let mut total = [Score::default(); SETS.len()];
    let (mut seconds, mut scans) = (0.0, 0);
    let folder = data.join("3dmatch");
    let mut scenes: Vec<_> = std::fs::read_dir(&folder)
        .with_context(|| folder.display().to_string())?
        .map(|entry| entry.map(|e| e.file_name().to_string_lossy().into_owned()))
        .collect::<Result<_, _>>()?;
    scenes.sort();
    for scene in scenes {
        let lists =
            SETS.map(|set| pairs_of(&data.join("benchmarks").join(set).join(&scene), arguments.pairs));
        let lists = lists.into_iter().collect::<Result<Vec<_>>>()?;
        let mut features = BTreeMap::new();
        for id in lists.iter().flatten().flat_map(|p| [p.i, p.j]) {
            if let std::collections::btree_map::Entry::Vacant(entry) = features.entry(id) {
                let start = Instant::now();
                let cloud = folder.join(&scene).join(format!("PointCloud/cloud_bin_{id}.ply"));
                entry.insert(features_of(source, &scene, id, &cloud, count, arguments.seed)?);
                seconds += start.elapsed().as_secs_f64();
                scans += 1;
            }
        }
        let mut of_scene = [Score::default(); SETS.len()];
        for (list, score) in lists.iter().zip(&mut of_scene) {
            let scores: Vec<Score> =
                list.par_iter().map(|p| scored(&features[&p.i], &features[&p.j], p)).collect();
            scores.iter().for_each(|s| score.add(s));
        }
        total.iter_mut().zip(&of_scene).for_each(|(t, s)| t.add(s));
        if arguments.scenes {
            print_line(&format!("  {}", scene.trim_start_matches("sun3d-")), count, &of_scene, None);
        }
    }
    print_line(name, count, &total, Some(seconds / f64::from(scans.max(1))));
    Ok(())
}

fn print_line(name: &str, count: usize, scores: &[Score], seconds: Option<f64>) {
    let name: String = name.chars().take(32).collect();
    print!("{name:<32} {count:>9} |");
    for s in scores {
        let n = s.pairs.max(1) as f64;
        let (matched, registered) = (s.matched as f64 / n, s.registered as f64 / n);
        print!(" {:>4} {:>6.3} {matched:>6.3} {registered:>6.3} |", s.pairs, s.ratio / n);
    }
    let (apart, pairs) = scores.iter().fold((0.0, 0), |(a, n), s| (a + s.apart, n + s.pairs));
    print!(" {:.2}", (apart / pairs.max(1) as f64).sqrt());
    println!("{}", seconds.map(|s| format!(" {s:.3}")).unwrap_or_default());
}

fn features_of(
    source: &Source,
    scene: &str,
    id: ScanId,
    cloud: &Path,
    count: usize,
    seed: u64,
) -> Result<Features> {
    match source {
        Source::Folder(folder) => {
            let path = folder.join(scene).join(format!("cloud_bin_{id}.npz"));
            Ok(subsample_features(&io::read_features(path)?, count, seed))
        }
        Source::Fpfh(scale) => {
            let scan = Scan { id, cloud: io::read_cloud(cloud)?, ..Scan::default() };
            let surface = scanweave::preprocessing::thin(&scan.cloud, scale);
            let keypoints = KeypointConfig::new(count);
            let mut config = DescriptorConfig::default();
            config.kind = DescriptorKind::Fpfh;
            config.keypoints = keypoints;
            Ok(descriptor::describe(&scan, &surface, scale, &config, seed)?)
        }
    }
}

fn scored(target: &Features, source: &Features, truth: &PairTruth) -> Score {
    let matches = mutual_matches(target, source);
    let mover = PointMover::new(&truth.i_from_j);
    let near = |(t, s): (&_, &_)| (t - mover.point(s)).norm() < INLIER_M;
    let inliers = matches.target.iter().zip(&matches.source).filter(|&(t, s)| near((t, s))).count();
    let ratio = inliers as f64 / matches.len().max(1) as f64;
    let config = RegistrationConfig::default().estimator;
    let best = estimate(&matches, &config, ESTIMATE_RADIUS_M, 0).into_iter().next();
    let registered = best.zip(truth.information).is_some_and(|(hypothesis, information)| {
        rmse_m(&truth.i_from_j, &hypothesis.target_from_source, &information) <= REGISTERED_M
    });
    Score {
        pairs: 1,
        ratio,
        matched: usize::from(ratio > MATCHED_RATIO),
        registered: usize::from(registered),
        apart: apart(target, source),
    }
}

/// Mean squared distance of the descriptors of two scans taken in the order of their keypoints, which
/// is one by chance.
fn apart(target: &Features, source: &Features) -> f64 {
    let (a, b) = (&target.descriptors, &source.descriptors);
    let n = a.len().min(b.len());
    let squared =
        |k: usize| a.row(k).iter().zip(b.row(k)).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>();
    (0..n).map(squared).sum::<f64>() / n.max(1) as f64
}

/// Mutual nearest neighbours of unit descriptors: largest inner product both ways.
fn mutual_matches(target: &Features, source: &Features) -> Matches {
    const BLOCK: usize = 256;
    let dim = target.descriptors.dim();
    let view = |f: &[f32]| ArrayView2::from_shape((f.len() / dim, dim), f).map(|v| v.to_owned());
    let (Ok(left), Ok(right)) = (view(source.descriptors.values()), view(target.descriptors.values())) else {
        return Matches::default();
    };
    let mut to_target = vec![(f32::MIN, 0); source.len()];
    let mut to_source = vec![(f32::MIN, 0); target.len()];
    for (block, rows) in left.axis_chunks_iter(ndarray::Axis(0), BLOCK).enumerate() {
        for (row, products) in rows.dot(&right.t()).outer_iter().enumerate() {
            let s = block * BLOCK + row;
            for (t, &product) in products.iter().enumerate() {
                if product > to_target[s].0 {
                    to_target[s] = (product, t);
                }
                if product > to_source[t].0 {
                    to_source[t] = (product, s);
                }
            }
        }
    }
    let mut matches = Matches::default();
    for (s, &(score, t)) in to_target.iter().enumerate() {
        if !target.is_empty() && to_source[t].1 == s {
            matches.pairs.push((s as u32, t as u32));
            matches.source.push(source.keypoints[s]);
            matches.target.push(target.keypoints[t]);
            matches.scores.push(score);
        }
    }
    matches
}

/// Up to `limit` pairs of a benchmark that are not neighbours in time, evenly picked.
fn pairs_of(folder: &Path, limit: usize) -> Result<Vec<PairTruth>> {
    let mut pairs = io::read_benchmark(folder)?.pairs;
    pairs.retain(|p| p.i.0.abs_diff(p.j.0) > 1);
    let total = pairs.len();
    let wanted = if limit == 0 { total } else { limit.min(total) };
    Ok((0..wanted).map(|k| pairs[k * total / wanted].clone()).collect())
}
