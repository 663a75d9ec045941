//! `scanweave diagnose`.

use super::{Status, Verbosity, terminal};
use clap::Args;
use scanweave::benchmark::Cell;
use scanweave::evaluation::dataset::evaluate_scene;
use scanweave::evaluation::diagnosis::{Case, Diagnosis};
use scanweave::evaluation::estimate::SceneEstimate;
use scanweave::evaluation::ground_truth::overlap_matrix;
use scanweave::evaluation::moments::Moments;
use scanweave::evaluation::protocol::Protocol;
use scanweave::evaluation::recall::RecallReport;
use scanweave::evaluation::scene::{Benchmark, SceneTruth};
use scanweave::files::{self, FolderLock};
use scanweave::geometry::Point;
use scanweave::geometry::voxel_means;
use scanweave::report::growth_tree;
use scanweave::result::Document;
use scanweave::scan::Reconstruction;
use scanweave::{Error, Silent, io};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Say why pairs failed: which scan went wrong first, at which step, and on what evidence.
///
/// Causes: declined; other component; wrong pose (joined wrongly); wrong order (joined wrongly
/// while it hardly overlapped the model, and a later scan overlapped it better); moved by
/// refinement (joined rightly); drift (every join is within the limit, errors add up). A pair is
/// carried along when neither of its scans went wrong itself.
///
/// Takes a cell of `benchmark`, or a result of `register` with --truth. With --output writes
/// diagnosis.md, scans.csv, pairs.csv and growth.svg.
#[derive(Debug, Args)]
pub struct Arguments {
    /// A file in the cells/ of a benchmark, or an output folder of `register`.
    #[arg(value_name = "CELL|RESULT")]
    subject: PathBuf,
    /// Folder of the scans with their true poses, for a result of `register`.
    #[arg(long, value_name = "SCENE")]
    truth: Option<PathBuf>,
    /// Folder with gt.log and gt.info. Without one, the pairs that truly overlap by more than 0.3
    /// are examined.
    #[arg(long, value_name = "DIR", requires = "truth")]
    benchmark: Option<PathBuf>,
    /// How that benchmark counts: 3dmatch, 3dlomatch or eth.
    #[arg(long, value_name = "NAME", requires = "truth", default_value = "3dmatch",
          value_parser = |name: &str| Protocol::parse(name).map_err(|e| e.to_string()))]
    protocol: Protocol,
    /// Distance within which points count as common, metres.
    #[arg(long, value_name = "M", default_value_t = 0.07)]
    overlap_radius: f64,
    /// Folder for tables and the picture of the tree of joins.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let (title, diagnosis) = match (&arguments.truth, arguments.subject.is_dir()) {
        (Some(truth), true) => (arguments.subject.display().to_string(), of_result(arguments, truth)?),
        (None, true) => {
            let remedy = "add --truth SCENE, the folder that the scans came from";
            return Err(Error::setting("--truth", "nothing", "the true poses of a result", remedy).into());
        }
        (_, false) => of_cell(&arguments.subject)?,
    };
    let text = diagnosis.markdown(&title);
    if let Some(folder) = &arguments.output {
        let _lock = FolderLock::take(folder)?;
        for (name, content) in [
            ("growth.svg", &growth_tree::svg(&diagnosis)),
            ("pairs.csv", &diagnosis.pairs_csv()),
            ("scans.csv", &diagnosis.scans_csv()),
            ("diagnosis.md", &text),
        ] {
            files::write(&folder.join(name), |out| out.write_all(content.as_bytes()))?;
        }
    }
    if !verbosity.quiet {
        terminal::print(&text)?;
    }
    Ok(Status::Success)
}

fn of_cell(path: &Path) -> Result<(String, Diagnosis), Error> {
    let cell = Cell::read(path)?;
    let title = cell.key.to_string();
    let diagnosis = cell.diagnosis.ok_or_else(|| {
        Error::file(path, "a cell without true poses", "a scene with true poses", "add them to the data set")
    })?;
    Ok((title, diagnosis))
}

fn of_result(arguments: &Arguments, truth_folder: &Path) -> Result<Diagnosis, Error> {
    let benchmark = arguments.benchmark.as_ref().map(|folder| Benchmark {
        name: folder.display().to_string(),
        protocol: arguments.protocol,
        folder: Some(folder.clone()),
    });
    let truth = SceneTruth::read(truth_folder, benchmark.as_slice())?;
    let reconstruction = Document::load(&arguments.subject.join("poses.json"))?.reconstruction()?;
    let report = evaluate_scene(&truth, &SceneEstimate::of(&reconstruction), false)?;
    let limit_m = truth.wrong_beyond_m();
    look_into(truth_folder, &truth, &reconstruction, arguments.overlap_radius, limit_m, &report.recalls)
}

/// Diagnoses a registration of the scans in `folder`, in the order of the truth. Points closer than
/// `overlap_radius_m` count as common.
///
/// # Errors
/// Scans that cannot be read or are not those of the result; a truth without poses.
pub fn look_into(
    folder: &Path,
    truth: &SceneTruth,
    reconstruction: &Reconstruction,
    overlap_radius_m: f64,
    limit_m: f64,
    recalls: &BTreeMap<String, RecallReport>,
) -> Result<Diagnosis, Error> {
    let Some(poses) = &truth.world_from_scan else {
        let expected = "truth.json, a pose file beside each scan, poses/, poses.txt or one .conf";
        return Err(Error::file(folder, "scans without true poses", expected, "name another folder"));
    };
    let scans = io::read_scans(&io::scan_files(folder)?, &Silent)?;
    if reconstruction.outcomes.len() != scans.len() {
        return Err(Error::file(
            folder,
            format!("{} scans", scans.len()),
            format!("the {} scans of the result", reconstruction.outcomes.len()),
            "name the folder that these scans came from with --truth",
        ));
    }
    let radius = overlap_radius_m as f32;
    let thinned: Vec<Vec<Point>> = scans.iter().map(|s| voxel_means(&s.cloud.points, 0.5 * radius)).collect();
    let views: Vec<&[Point]> = thinned.iter().map(Vec::as_slice).collect();
    let overlap = overlap_matrix(&views, poses, radius)?;
    let moments: Vec<Moments> = scans.iter().map(|s| Moments::of(&s.cloud.points)).collect();
    let case = Case {
        names: &truth.scans,
        numbers: &truth.numbers,
        reconstruction,
        truth: poses,
        moments: &moments,
        overlap: &overlap,
        limit_m,
    };
    Ok(case.diagnose(recalls))
}
