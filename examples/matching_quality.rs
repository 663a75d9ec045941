//! How good the matches of FPFH are on the 3DMatch and 3DLoMatch pairs, for given radii.
//!
//! ```text
//! SCANWEAVE_DATA=… cargo run --release --example matching_quality -- \
//!     --voxel-m 0.025 --normal-voxels 3,5,7 --feature-voxels 7,9,12 --pairs 24
//! ```
//!
//! For every pair: mutual nearest neighbours among the descriptors of both fragments; the
//! inlier ratio is the share of them within 0.1 m under the true pose, the feature-matching
//! recall the share of pairs whose ratio exceeds 5 %. Means over pairs of all scenes found.
//! Expects `3dmatch/<scene>/PointCloud/cloud_bin_<i>.ply` and
//! `benchmarks/{3DMatch,3DLoMatch}/<scene>/gt.log` below the data folder.

use anyhow::{Context, Result, ensure};
use clap::Parser;
use ndarray::ArrayView2;
use rayon::prelude::*;
use scanweave::descriptor::{self, DescriptorConfig, KeypointConfig, WorkingScale, surface};
use scanweave::geometry::rigid::{PointMover, motion_from_matrix};
use scanweave::geometry::{Point, RigidMotion};
use scanweave::scan::{Features, PointCloud, Scan, ScanId};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

const INLIER_M: f32 = 0.1;
const MATCHED_RATIO: f64 = 0.05;

#[derive(Parser)]
struct Arguments {
    /// Data folder; by default that of the variable SCANWEAVE_DATA.
    #[arg(long)]
    data: Option<PathBuf>,
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
    #[arg(long, value_delimiter = ',', default_value = "5000")]
    keypoints: Vec<usize>,
    /// Pairs a scene and benchmark, evenly picked from gt.log; 0 for all.
    #[arg(long, default_value_t = 24)]
    pairs: usize,
    /// Seed of the keypoints.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

struct Pair {
    i: usize,
    j: usize,
    i_from_j: RigidMotion,
}

/// Sums over the pairs of one benchmark.
#[derive(Default)]
struct Score {
    pairs: usize,
    ratio: f64,
    matched: usize,
    matches: usize,
    inliers: usize,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let data = arguments.data.clone().or_else(|| std::env::var_os("SCANWEAVE_DATA").map(PathBuf::from));
    let data = data.context("name the data folder with --data or SCANWEAVE_DATA")?;
    println!("voxel {} m, {} pairs a scene", arguments.voxel_m, arguments.pairs);
    println!(
        "keypoints normal feature |   3DMatch IR   FMR  inl/mat  | 3DLoMatch IR   FMR  inl/mat  | s/scan"
    );
    for &count in &arguments.keypoints {
        for &normal in &arguments.normal_voxels {
            for &feature in &arguments.feature_voxels {
                let scale = WorkingScale {
                    normal_radius_m: normal * arguments.voxel_m,
                    feature_radius_m: feature * arguments.voxel_m,
                    ..WorkingScale::from_voxel(arguments.voxel_m)
                };
                let (scores, seconds) = measure(&data, &scale, count, &arguments)?;
                print!("{count:9} {normal:6} {feature:7} |");
                for s in scores {
                    let n = s.pairs.max(1) as f64;
                    let (ratio, recall) = (s.ratio / n, s.matched as f64 / n);
                    let (inliers, matches) = (s.inliers as f64 / n, s.matches as f64 / n);
                    print!("   {ratio:10.4} {recall:5.3} {inliers:4.0}/{matches:<4.0} |");
                }
                println!(" {seconds:.3}");
            }
        }
    }
    Ok(())
}

/// Scores of both benchmarks, and the mean wall time of surface and descriptors a scan.
fn measure(
    data: &Path,
    scale: &WorkingScale,
    count: usize,
    arguments: &Arguments,
) -> Result<([Score; 2], f64)> {
    let mut scores = [Score::default(), Score::default()];
    let (mut seconds, mut scans) = (0.0, 0);
    let folder = data.join("3dmatch");
    let mut scenes: Vec<_> = std::fs::read_dir(&folder)
        .with_context(|| folder.display().to_string())?
        .map(|entry| entry.map(|e| e.file_name()))
        .collect::<Result<_, _>>()?;
    scenes.sort();
    for scene in scenes {
        let lists = ["3DMatch", "3DLoMatch"]
            .map(|set| read_pairs(&data.join("benchmarks").join(set).join(&scene), arguments.pairs));
        let lists = lists.into_iter().collect::<Result<Vec<_>>>()?;
        let mut features = BTreeMap::new();
        for id in lists.iter().flatten().flat_map(|p| [p.i, p.j]) {
            if let std::collections::btree_map::Entry::Vacant(entry) = features.entry(id) {
                let path = folder.join(&scene).join(format!("PointCloud/cloud_bin_{id}.ply"));
                let scan = read_scan(&path)?;
                let start = Instant::now();
                let surface = surface::thin(&scan.cloud, scale);
                let keypoints = KeypointConfig { count };
                let config = DescriptorConfig { keypoints, ..Default::default() };
                entry.insert(descriptor::describe(&scan, &surface, scale, &config, arguments.seed)?);
                seconds += start.elapsed().as_secs_f64();
                scans += 1;
            }
        }
        for (list, score) in lists.iter().zip(&mut scores) {
            let counts: Vec<(usize, usize)> =
                list.par_iter().map(|p| inliers(&features[&p.i], &features[&p.j], &p.i_from_j)).collect();
            for (inliers, matches) in counts {
                let ratio = inliers as f64 / matches.max(1) as f64;
                score.pairs += 1;
                score.ratio += ratio;
                score.matched += usize::from(ratio > MATCHED_RATIO);
                score.inliers += inliers;
                score.matches += matches;
            }
        }
    }
    Ok((scores, seconds / f64::from(scans.max(1))))
}

/// Mutual matches within [`INLIER_M`] under the true pose, and all mutual matches.
fn inliers(a: &Features, b: &Features, a_from_b: &RigidMotion) -> (usize, usize) {
    let matches = mutual_matches(a, b);
    let mover = PointMover::new(a_from_b);
    let near = |&&(i, j): &&(usize, usize)| (a.keypoints[i] - mover.point(&b.keypoints[j])).norm() < INLIER_M;
    (matches.iter().filter(near).count(), matches.len())
}

/// Mutual nearest neighbours of unit descriptors: largest inner product both ways.
fn mutual_matches(a: &Features, b: &Features) -> Vec<(usize, usize)> {
    const BLOCK: usize = 256;
    let dim = a.descriptors.dim();
    let view = |f: &[f32]| ArrayView2::from_shape((f.len() / dim, dim), f).map(|v| v.to_owned());
    let (Ok(left), Ok(right)) = (view(a.descriptors.values()), view(b.descriptors.values())) else {
        return Vec::new();
    };
    let mut to_b = vec![(f32::MIN, 0); a.len()];
    let mut to_a = vec![(f32::MIN, 0); b.len()];
    for (block, rows) in left.axis_chunks_iter(ndarray::Axis(0), BLOCK).enumerate() {
        for (row, products) in rows.dot(&right.t()).outer_iter().enumerate() {
            let i = block * BLOCK + row;
            for (j, &product) in products.iter().enumerate() {
                if product > to_b[i].0 {
                    to_b[i] = (product, j);
                }
                if product > to_a[j].0 {
                    to_a[j] = (product, i);
                }
            }
        }
    }
    (0..a.len()).filter(|&i| !b.is_empty() && to_a[to_b[i].1].1 == i).map(|i| (i, to_b[i].1)).collect()
}

/// Up to `limit` pairs of a `gt.log` that are not neighbours in time, evenly picked.
fn read_pairs(folder: &Path, limit: usize) -> Result<Vec<Pair>> {
    let path = folder.join("gt.log");
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let numbers: Vec<f64> =
        text.split_whitespace().map(str::parse).collect::<Result<_, _>>().context("gt.log")?;
    let mut pairs = Vec::new();
    for entry in numbers.chunks_exact(19) {
        let (i, j) = (entry[0] as usize, entry[1] as usize);
        let matrix = nalgebra::Matrix4::from_row_slice(&entry[3..]);
        let (i_from_j, _) = motion_from_matrix(&matrix, 1e-2).context("gt.log: not a rigid motion")?;
        if i.abs_diff(j) > 1 {
            pairs.push(Pair { i, j, i_from_j });
        }
    }
    let wanted = if limit == 0 { pairs.len() } else { limit.min(pairs.len()) };
    let total = pairs.len();
    let picked: Vec<usize> = (0..wanted).map(|k| k * total / wanted).collect();
    let mut at = 0;
    pairs.retain(|_| {
        at += 1;
        picked.binary_search(&(at - 1)).is_ok()
    });
    Ok(pairs)
}

/// A binary little-endian PLY of nothing but `float x y z`.
fn read_scan(path: &Path) -> Result<Scan> {
    const END: &[u8] = b"end_header\n";
    let name = path.display().to_string();
    let bytes = std::fs::read(path).with_context(|| name.clone())?;
    let end = bytes.windows(END.len()).position(|w| w == END).context("no end of header")? + END.len();
    let count = bytes[end..].len() / 12;
    let header = String::from_utf8_lossy(&bytes[..end]);
    ensure!(header.contains(&format!("element vertex {count}\n")), "{name}: not bare float x y z");
    let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let point = |b: &[u8]| Point::new(value(b), value(&b[4..]), value(&b[8..]));
    let cloud = PointCloud::from_points(bytes[end..].chunks_exact(12).map(point).collect());
    Ok(Scan { id: ScanId(0), name, path: Some(path.to_path_buf()), cloud })
}
