//! `scanweave evaluate-retrieval`.

use super::options::{SettingOptions, ThreadOption};
use super::progress::Progress;
use super::{Status, Verbosity, terminal};
use anyhow::Context;
use clap::Args;
use rand::{RngExt, SeedableRng};
use scanweave::config::Config;
use scanweave::evaluation::ground_truth::overlap_matrix;
use scanweave::evaluation::retrieval::{RetrievalReport, retrieval_scores};
use scanweave::geometry::Point;
use scanweave::geometry::voxel_means;
use scanweave::pipeline::{self, FeatureSource};
use scanweave::retrieval::{SimilaritySource, similarity_of};
use scanweave::scan::{Features, SimilarityMatrix};
use scanweave::{Error, Monitor, io};
use serde::Serialize;
use std::path::PathBuf;

/// Compare ways to predict overlap on scenes with true poses.
///
/// Prints for every scene and on average: recall@10 of the scans that truly overlap by more than
/// 0.3 and 0.1, and Spearman's rank correlation of similarity and true overlap over all pairs,
/// for a random order, mean pooling, GeM, k-means NetVLAD, and the trained head in effect.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folders of scans with a true pose each.
    #[arg(required = true, value_name = "SCENES")]
    scenes: Vec<PathBuf>,
    /// Trained head to compare; may be repeated. Default: the one `register` would use.
    #[arg(long = "checkpoint", value_name = "FILE")]
    checkpoints: Vec<PathBuf>,
    /// Distance within which points count as common, metres.
    #[arg(long, value_name = "M", default_value_t = 0.07)]
    overlap_radius: f64,
    /// Folder to keep features in.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Print one JSON document instead of a table.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    threads: ThreadOption,
    #[command(flatten)]
    settings: SettingOptions,
}

/// The scores of one way on one scene.
#[derive(Debug, Clone, Serialize)]
struct Row {
    scene: String,
    way: String,
    recall_overlap_30: Option<f64>,
    recall_overlap_10: Option<f64>,
    spearman: Option<f64>,
}

pub fn run(arguments: Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let config = arguments.settings.config()?;
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let mut rows = Vec::new();
    for folder in &arguments.scenes {
        rows.extend(scene_rows(folder, &arguments, &config, &progress)?);
    }
    if arguments.scenes.len() > 1 {
        let means = means(&rows);
        rows.extend(means);
    }
    if arguments.json {
        terminal::print_json(&(serde_json::to_string_pretty(&rows).context("writing the report")? + "\n"))?;
    } else if !verbosity.quiet {
        print(&rows)?;
    }
    Ok(Status::Success)
}

fn scene_rows(
    folder: &PathBuf,
    arguments: &Arguments,
    config: &Config,
    monitor: &dyn Monitor,
) -> anyhow::Result<Vec<Row>> {
    let scene = io::read_scene(folder)?;
    let Some(truth) = &scene.world_from_scan else {
        let expected = "truth.json, a pose file beside each scan, poses/, poses.txt or one .conf";
        return Err(Error::file(folder, "scans without true poses", expected, "name another folder").into());
    };
    let scans = io::read_scans_with(&scene.scans, &config.input, monitor)?;
    let source = arguments.cache.as_deref().map_or(FeatureSource::Computed, FeatureSource::Cached);
    let described = pipeline::describe(&scans, config, &source, monitor)?;
    let radius = arguments.overlap_radius as f32;
    let thinned: Vec<Vec<Point>> = scans.iter().map(|s| voxel_means(&s.cloud.points, 0.5 * radius)).collect();
    let views: Vec<&[Point]> = thinned.iter().map(Vec::as_slice).collect();
    let overlap = overlap_matrix(&views, &truth.value, radius)?;
    ways(arguments, config, &described, monitor)?
        .into_iter()
        .map(|(way, similarity)| {
            let at = |above| retrieval_scores(&similarity, &overlap, above, &[10]);
            let (high, low): (RetrievalReport, RetrievalReport) = (at(0.3)?, at(0.1)?);
            Ok(Row {
                scene: scene.name.clone(),
                way,
                recall_overlap_30: high.recall_at[0],
                recall_overlap_10: low.recall_at[0],
                spearman: low.spearman,
            })
        })
        .collect()
}

/// Similarity of all scans by every way that is compared.
fn ways(
    arguments: &Arguments,
    config: &Config,
    described: &pipeline::Described,
    monitor: &dyn Monitor,
) -> Result<Vec<(String, SimilarityMatrix)>, Error> {
    let features: &[Features] = &described.features;
    let mut all = vec![("random order".to_owned(), random(features.len(), config.seed)?)];
    let untrained = [
        ("mean pooling", SimilaritySource::Mean),
        ("GeM", SimilaritySource::Gem),
        ("k-means NetVLAD", SimilaritySource::Netvlad),
    ];
    for (name, source) in untrained {
        let mut settings = config.retrieval.clone();
        settings.source = source;
        all.push((name.to_owned(), similarity_of(features, &settings, None, config.seed, monitor)?.0));
    }
    let named = arguments.checkpoints.iter().cloned().map(Some);
    let asked: Vec<Option<PathBuf>> =
        if arguments.checkpoints.is_empty() { vec![None] } else { named.collect() };
    for checkpoint in asked {
        let mut config = config.clone();
        config.retrieval.checkpoint = checkpoint.or(config.retrieval.checkpoint);
        let Some(head) = pipeline::overlap_head(&config, &described.scale, features)? else { continue };
        let (similarity, origin) =
            similarity_of(features, &config.retrieval, Some(&head), config.seed, monitor)?;
        let file = config.retrieval.checkpoint.filter(|_| arguments.checkpoints.len() > 1);
        let name = file.map_or(origin.to_string(), |f| f.display().to_string());
        all.push((name, similarity));
    }
    Ok(all)
}

fn random(n: usize, seed: u64) -> Result<SimilarityMatrix, Error> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    SimilarityMatrix::new(n, (0..n * n).map(|_| rng.random_range(0.0f32..1.0)).collect())
}

/// Mean of every way over the scenes, in the order of the first scene.
fn means(rows: &[Row]) -> Vec<Row> {
    let Some(first) = rows.first() else { return Vec::new() };
    let ways = rows.iter().filter(|r| r.scene == first.scene).map(|r| &r.way);
    let mean = |way: &str, score: fn(&Row) -> Option<f64>| {
        let values: Vec<f64> = rows.iter().filter(|r| r.way == way).filter_map(score).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    ways.map(|way| Row {
        scene: "mean".to_owned(),
        way: way.clone(),
        recall_overlap_30: mean(way, |r| r.recall_overlap_30),
        recall_overlap_10: mean(way, |r| r.recall_overlap_10),
        spearman: mean(way, |r| r.spearman),
    })
    .collect()
}

fn print(rows: &[Row]) -> Result<(), Error> {
    let number = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.3}"));
    let width = rows.iter().map(|r| r.way.chars().count()).max().unwrap_or(0);
    let mut scene = "";
    for row in rows {
        if row.scene != scene {
            scene = &row.scene;
            terminal::print_line(&format!("{scene:<width$}    R@10>.3  R@10>.1  Spearman"))?;
        }
        terminal::print_line(&format!(
            "  {:<width$}  {:>7}  {:>7}  {:>8}",
            row.way,
            number(row.recall_overlap_30),
            number(row.recall_overlap_10),
            number(row.spearman)
        ))?;
    }
    Ok(())
}
