//! The page of `scanweave evaluate --report`.

use super::diagnose::look_into;
use scanweave::Error;
use scanweave::evaluation::dataset::{Declined, SceneReport};
use scanweave::evaluation::diagnosis::Diagnosis;
use scanweave::evaluation::estimate::SceneEstimate;
use scanweave::evaluation::pose_error::{PoseReport, evaluate_against_truth};
use scanweave::evaluation::recall::{RecallReport, RecallSummary};
use scanweave::evaluation::scene::SceneTruth;
use scanweave::files;
use scanweave::report::sheet::{Evaluation, SceneSheet, evaluation};
use scanweave::result::{Document, EntryOutcome};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;

/// Where the page goes and how it judges.
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// The file.
    pub file: &'a Path,
    /// Distance within which points of two scans count as common, metres.
    pub overlap_radius_m: f64,
}

/// One result against the truth in `folder`.
pub struct OneResult<'a> {
    /// The result.
    pub document: &'a Document,
    /// Its errors.
    pub poses: &'a PoseReport,
    /// How far the worst true rotation was from orthonormal.
    pub truth_deviation: f64,
    /// Recall by benchmark.
    pub recalls: &'a BTreeMap<String, RecallReport>,
    /// Error from which a pose is wrong, metres.
    pub limit_m: f64,
}

/// The sheet of one result.
pub fn of_result(
    wanted: &Wanted<'_>,
    folder: &Path,
    result: &OneResult<'_>,
) -> Result<Vec<SceneSheet>, Error> {
    let truth = SceneTruth::read(folder, &[])?;
    let recalls = by_short_name(result.recalls, &truth.name);
    let declined = result.document.scans.iter().filter_map(|entry| match &entry.outcome {
        EntryOutcome::Placed(_) => None,
        EntryOutcome::Declined { explanation, .. } => {
            Some(Declined { scan: entry.name.clone(), reason: explanation.clone() })
        }
    });
    let report = SceneReport {
        scene: truth.name.clone(),
        scans: result.poses.total,
        placed: result.poses.placed,
        declined: declined.collect(),
        truth_deviation: result.truth_deviation,
        recalls: recalls.clone(),
        pairs: Vec::new(),
        errors: None,
    };
    let diagnosis = diagnosis(wanted, folder, &truth, result.document, result.limit_m, &recalls)?;
    let names = result.document.scans.iter().map(|s| s.name.clone()).collect();
    Ok(vec![SceneSheet { report, names, poses: Some(result.poses.clone()), diagnosis }])
}

/// Benchmarks are named by their folders, of which the last part that is not the scene's name tells them
/// apart; where it does not, the whole path does.
fn by_short_name(recalls: &BTreeMap<String, RecallReport>, scene: &str) -> BTreeMap<String, RecallReport> {
    let short = |path: &String| {
        let parts = Path::new(path).iter().map(|part| part.to_string_lossy());
        parts.rev().find(|part| part != scene).map_or_else(|| path.clone(), String::from)
    };
    let named: BTreeMap<String, RecallReport> = recalls.iter().map(|(k, v)| (short(k), v.clone())).collect();
    if named.len() == recalls.len() { named } else { recalls.clone() }
}

/// The sheet of one scene of a data set.
pub fn of_scene(
    wanted: &Wanted<'_>,
    (folder, results): (&Path, &Path),
    truth: &SceneTruth,
    estimate: &SceneEstimate,
    report: &SceneReport,
) -> Result<SceneSheet, Error> {
    let poses = match &truth.world_from_scan {
        Some(poses) => Some(evaluate_against_truth(&estimate.reconstruction(), poses)?),
        None => None,
    };
    let file = SceneEstimate::file(results, &truth.name)?;
    let diagnosis = match file.extension().is_some_and(|e| e == "json") {
        true => {
            let document = Document::load(&file)?;
            diagnosis(wanted, folder, truth, &document, truth.wrong_beyond_m(), &report.recalls)?
        }
        false => {
            Err("These poses come from a trajectory, which does not tell how the model grew: what went \
                      wrong first is not known."
                .to_owned())
        }
    };
    Ok(SceneSheet { report: report.clone(), names: truth.scans.clone(), poses, diagnosis })
}

/// What went wrong first, or why that is not known.
fn diagnosis(
    wanted: &Wanted<'_>,
    folder: &Path,
    truth: &SceneTruth,
    document: &Document,
    limit_m: f64,
    recalls: &BTreeMap<String, RecallReport>,
) -> Result<Result<Diagnosis, String>, Error> {
    let unknown = |why: &str| Ok(Err(format!("What went wrong first is not known: {why}.")));
    if truth.world_from_scan.is_none() {
        return unknown("the true poses are not");
    }
    let short = |name: &String| name.rsplit('/').next().unwrap_or(name).to_owned();
    let (ours, theirs): (Vec<String>, Vec<String>) =
        (document.scans.iter().map(|s| short(&s.name)).collect(), truth.scans.iter().map(short).collect());
    if ours != theirs {
        return unknown("the result is not one of exactly these scans in this order");
    }
    let reconstruction = document.reconstruction()?;
    look_into(folder, truth, &reconstruction, wanted.overlap_radius_m, limit_m, recalls).map(Ok)
}

/// Writes the page.
pub fn write(wanted: &Wanted<'_>, scenes: Vec<SceneSheet>) -> Result<(), Error> {
    let names: BTreeSet<String> = scenes.iter().flat_map(|s| s.report.recalls.keys().cloned()).collect();
    let summary =
        |name: &String| RecallSummary::new(scenes.iter().filter_map(|s| s.report.recalls.get(name)));
    let recalls = names.iter().map(|name| (name.clone(), summary(name))).collect();
    let page = evaluation(&Evaluation { scenes, recalls })?.html();
    files::write(wanted.file, |out| out.write_all(page.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn benchmarks_are_called_by_what_tells_them_apart() {
        let called = |paths: &[&str]| -> Vec<String> {
            let all = paths.iter().map(|p| ((*p).to_owned(), RecallReport::default())).collect();
            by_short_name(&all, "kitchen").into_keys().collect()
        };
        assert_eq!(called(&["a/3DMatch/kitchen", "a/3DLoMatch/kitchen"]), ["3DLoMatch", "3DMatch"]);
        assert_eq!(called(&["mine"]), ["mine"]);
        assert_eq!(called(&["a/own/kitchen", "b/own/kitchen"]), ["a/own/kitchen", "b/own/kitchen"]);
    }
}
