//! What tells the files of one result from those of another: a mixture must not pass for a result.

use super::poses::Document;
use super::run::RunReport;
use crate::error::{Error, Result};
use crate::files;
use crate::io::merged_run;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// The `run` of a `poses.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunIdentity {
    /// Digest of the scans' names, their poses and the settings, hexadecimal: the same for every run that
    /// gives the same result. `report.json`, the pages and the merged clouds state it too.
    pub id: String,
    /// BLAKE3 of the other files of the result that are the same for every such run, hexadecimal, by name.
    pub files: BTreeMap<String, String>,
}

/// The id of a result: a digest of `document` without its `run`, and of the settings.
pub fn run_id(document: &Document, settings: &str) -> String {
    const DIGITS: usize = 32;
    let document = Document { run: None, ..document.clone() };
    let mut digest = blake3::Hasher::new();
    digest.update(document.to_json().as_bytes()).update(&[0]).update(settings.as_bytes());
    digest.finalize().to_hex()[..DIGITS].to_owned()
}

/// Digests of `names` in `folder`.
///
/// # Errors
/// Those of [`files::open`].
pub fn digests_of_files(
    folder: &Path,
    names: impl IntoIterator<Item = String>,
) -> Result<BTreeMap<String, String>> {
    names.into_iter().map(|name| Ok((name.clone(), digest(&folder.join(name))?))).collect()
}

fn digest(path: &Path) -> Result<String> {
    let failed = |e| Error::read(path, e);
    let mut digest = blake3::Hasher::new();
    digest.update_reader(files::open(path)?).map_err(failed)?;
    Ok(digest.finalize().to_hex().to_string())
}

/// What a page says before the id of the run that it shows.
pub const PAGE_MARK: &str = "<meta name=\"scanweave-run\" content=\"";

/// The id of the run that a page shows; none where it states none.
fn page_run(path: &Path) -> Result<Option<String>> {
    /// The head of a page, before its style and all that is in it.
    const MOST_BYTES: u64 = 4096;
    let mut bytes = Vec::new();
    files::open(path)?.take(MOST_BYTES).read_to_end(&mut bytes).map_err(|e| Error::read(path, e))?;
    let text = String::from_utf8_lossy(&bytes);
    let id = text.split_once(PAGE_MARK).and_then(|(_, after)| after.split_once('"'));
    Ok(id.map(|(id, _)| id.to_owned()))
}

/// Declines pages (files of these names in `folder`) of another run than `document`. Pages that are gone
/// are no error.
///
/// # Errors
/// [`Error::File`] for the first that is, [`Error::Read`].
pub fn check_pages(document: &Document, folder: &Path, pages: &[&str]) -> Result<()> {
    let paths = pages.iter().map(|name| folder.join(name));
    paths.filter(|path| path.exists()).try_for_each(|path| check_id(document, page_run(&path)?, &path))
}

/// Declines a folder that holds files of different runs. `document` is its `poses.json`, `report` the
/// name of its `report.json`, and `merged` those of its merged clouds. Files that are gone are no error.
///
/// # Errors
/// [`Error::File`] for the first file that is not of the run, [`Error::Read`].
pub fn check_folder(document: &Document, folder: &Path, report: &str, merged: &[String]) -> Result<()> {
    let report = folder.join(report);
    if report.exists() {
        check_report(document, &RunReport::load(&report)?, &report)?;
    }
    let Some(run) = &document.run else {
        // An old poses.json has no digests, but beside it there can be a merged cloud of a newer run.
        let places = merged.iter().map(|name| folder.join(name));
        return places.filter(|p| p.exists()).try_for_each(|path| match merged_run(&path)? {
            Some(id) => Err(mixed(&path, &format!("a file of the run {id}"), None)),
            None => Ok(()),
        });
    };
    for (name, stated) in &run.files {
        let path = folder.join(name);
        if path.exists() && digest(&path)? != *stated {
            return Err(mixed(&path, "another content than that run wrote", Some(&run.id)));
        }
    }
    Ok(())
}

/// Declines a `report.json` (which was read from `path`) of another run than `document`.
///
/// # Errors
/// [`Error::File`].
pub fn check_report(document: &Document, report: &RunReport, path: &Path) -> Result<()> {
    check_id(document, report.run_id.clone(), path)
}

/// Declines a file that states this run, where that is not the one of `document`.
fn check_id(document: &Document, stated: Option<String>, path: &Path) -> Result<()> {
    let id = document.run.as_ref().map(|run| run.id.as_str());
    if stated.as_deref() == id {
        return Ok(());
    }
    let found = stated.map_or("a file of a run without id".to_owned(), |found| {
        format!("a file of the run {}", found.replace(char::is_control, "\u{fffd}"))
    });
    Err(mixed(path, &found, id))
}

fn mixed(path: &Path, found: &str, id: Option<&str>) -> Error {
    let run = id.map_or("as poses.json, which states none".to_owned(), |id| format!("{id} of poses.json"));
    let remedy = "the folder holds files of different runs, or this one was changed: register again";
    Error::file(path, found, format!("a file of the run {run}"), remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::io::{PlyCloud, write_ply};

    fn document(run: Option<RunIdentity>) -> Document {
        let mut document = Document::new(&[], &crate::Reconstruction { outcomes: Vec::new() }, 0.1);
        document.run = run;
        document
    }

    #[test]
    fn the_id_follows_poses_and_settings_and_nothing_else() {
        let plain = document(None);
        let id = run_id(&plain, "seed = 1");
        assert_eq!(
            run_id(&document(Some(RunIdentity { id: id.clone(), files: BTreeMap::new() })), "seed = 1"),
            id
        );
        assert_ne!(run_id(&plain, "seed = 2"), id);
        assert_ne!(run_id(&Document { generator: "other".to_owned(), ..plain }, "seed = 1"), id);
        assert_eq!(id.len(), 32);
    }

    #[test]
    fn a_file_of_another_run_is_named_and_missing_files_are_not_missed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("overlap.csv");
        // BLAKE3 of "abc", from the test vectors of other implementations (b3sum).
        const ABC: &str = "6437b3ac38465133ffb63b75273a8db548c558465d79db03fd359c6cd5bd9d85";
        std::fs::write(&file, "abc").unwrap();
        let files = digests_of_files(folder.path(), ["overlap.csv".to_owned()]).unwrap();
        assert_eq!(files["overlap.csv"], ABC);
        let document = document(Some(RunIdentity { id: "1f".to_owned(), files }));
        let check = || check_folder(&document, folder.path(), "report.json", &[]);
        check().unwrap();
        std::fs::write(&file, "abd").unwrap();
        let said = check().unwrap_err().to_string();
        assert!(
            said.contains("overlap.csv") && said.contains("different runs") && said.contains("1f"),
            "{said}"
        );
        std::fs::remove_file(&file).unwrap();
        check().unwrap();
    }

    #[test]
    fn a_page_of_another_run_or_of_none_is_a_mixture() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        let run = RunIdentity { id: "ab12".to_owned(), files: BTreeMap::new() };
        let of_run = document(Some(run));
        let check = |document: &Document| check_pages(document, folder.path(), &["report.html"]);
        check(&of_run).unwrap();
        for (page, of_this, of_none) in [
            (format!("<!doctype html>\n{PAGE_MARK}ab12\">\n<p>{PAGE_MARK}cd34\">"), true, false),
            (format!("<!doctype html>\n{PAGE_MARK}cd34\">"), false, false),
            ("<!doctype html>\n".to_owned(), false, true),
        ] {
            std::fs::write(&path, &page).unwrap();
            assert_eq!(
                [check(&of_run).is_ok(), check(&document(None)).is_ok()],
                [of_this, of_none],
                "{page}"
            );
        }
        let said = check(&of_run).unwrap_err().to_string();
        assert!(said.contains("report.html") && said.contains("ab12"), "{said}");
    }

    #[test]
    fn a_new_merged_cloud_beside_old_poses_is_a_mixture() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("merged.ply");
        let check =
            || check_folder(&document(None), folder.path(), "report.json", &["merged.ply".to_owned()]);
        let points = [Point::new(1.0, 2.0, 3.0)];
        let cloud = PlyCloud { points: &points, scans: Some(&[0]), ..PlyCloud::default() };
        write_ply(&path, &cloud).unwrap();
        check().unwrap();
        write_ply(&path, &PlyCloud { run: Some("ab12"), ..cloud }).unwrap();
        let said = check().unwrap_err().to_string();
        assert!(said.contains("run ab12"), "{said}");
    }
}
