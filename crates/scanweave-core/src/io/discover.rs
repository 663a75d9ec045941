//! From what a user names (files, folders, globs, lists) to scan files in a fixed order.

use super::cloud::FORMATS;
use super::depth::{depth_images, is_depth};
use super::exported::exported;
use super::merged::is_merged;
use crate::error::{Error, Result};
use crate::files;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Extensions of formats that hold nothing but clouds.
const CLOUD_EXTENSIONS: [&str; 12] =
    ["ply", "pcd", "xyz", "pts", "ptx", "asc", "csv", "xyzrgb", "xyzn", "las", "laz", "e57"];
/// Extensions that hold a cloud only if nothing better is in the folder: features are kept in these too,
/// a mesh is often a scan's copy, and `.bin` may be anything.
const OTHER_EXTENSIONS: [&str; 7] = ["npy", "npz", "bin", "obj", "stl", "off", "glb"];
/// Extensions of packed files, which are looked through.
const PACKED_EXTENSIONS: [&str; 2] = ["gz", "zip"];
/// Files that this program writes beside scans, well-known lists of poses, and what Stray Scanner writes
/// beside depth images.
const NO_SCANS: [&str; 6] =
    ["overlap.csv", "poses.csv", "trajectory.csv", "camera_matrix.csv", "odometry.csv", "imu.csv"];

/// A file that may hold scans.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FoundFile {
    /// The file.
    pub path: PathBuf,
    /// Whether the user named it (itself, in a list or by a pattern) and not only its folder.
    pub named: bool,
}

/// A file that was not taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeftOut {
    /// The file.
    pub path: PathBuf,
    /// What was found in place of a scan.
    pub why: String,
    /// Whether it is a scan that cannot be read, and not something else.
    pub unreadable: bool,
}

/// What the user's inputs stand for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Discovered {
    /// Files to read, naturally sorted.
    pub files: Vec<FoundFile>,
    /// Files of the folders that are known not to be scans by their names.
    pub left_out: Vec<LeftOut>,
}

/// Scan files named by `inputs`, naturally sorted (`s2` before `s10`), each once: see [`discover_with`].
///
/// # Errors
/// Those of [`discover_with`].
pub fn discover(inputs: &[String]) -> Result<Vec<PathBuf>> {
    Ok(discover_with(inputs, false)?.files.into_iter().map(|f| f.path).collect())
}

/// Scan files named by `inputs`, naturally sorted (`s2` before `s10`), each once.
///
/// An input is
/// - a file, taken as it is;
/// - a folder: its `PointCloud/` if it has one (the 3DMatch layout), else its cloud files, packed
///   (`scan.ply.gz`) or not; NPY, NPZ, BIN, meshes and archives of another name only if there are no
///   others, then depth images, then those of a subfolder `depth/`.
///   Plain `.txt` is never taken from a folder, since poses and notes have that extension too;
/// - a glob (`scans/*.ply`), where no file of that very name exists;
/// - `@list.txt`: a text file of inputs, one a line, relative to its folder; `#` begins a comment.
///
/// With `recursive`, the folders in a folder count as inputs too, without the scans that were exported into
/// them. Hidden files are ignored. The order
/// never depends on that of a directory or of `inputs`.
///
/// # Errors
/// [`Error::Read`] for an input that does not exist, [`Error::Input`] when an input
/// (or all of them) yields no scan file, saying what was looked for.
pub fn discover_with(inputs: &[String], recursive: bool) -> Result<Discovered> {
    let mut found = Search { recursive, ..Search::default() };
    for input in inputs {
        match input.strip_prefix('@') {
            Some(list) if !Path::new(input).exists() => read_list(Path::new(list), &mut found)?,
            _ => resolve(input, Path::new(""), &mut found)?,
        }
    }
    let Search { mut files, mut left_out, .. } = found;
    if files.is_empty() {
        return Err(Error::input(
            "inputs",
            "no scan",
            format!("files, folders, globs or @lists of scans: {FORMATS}"),
            "name at least one scan file or folder",
        ));
    }
    // What is named itself comes before the same file of a folder, so that it counts as named.
    files.sort_by_cached_key(|f| (natural_key(&f.path), f.path.clone(), !f.named));
    let mut seen = HashSet::new();
    // The same file by two names is one scan; what cannot be resolved is told apart by its name.
    let same = |path: &Path| fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    files.retain(|f| seen.insert(same(&f.path)));
    left_out.retain(|f| seen.insert(same(&f.path)));
    Ok(Discovered { files, left_out })
}

impl Discovered {
    /// Leaves out files of folders (none that the user named) that `is_own` says to be output of this run.
    pub fn leave_out(&mut self, is_own: impl Fn(&Path) -> bool) {
        let (own, others) =
            std::mem::take(&mut self.files).into_iter().partition(|f| !f.named && is_own(&f.path));
        self.files = others;
        let why = "it lies where this run writes its output";
        let left_out = |f: FoundFile| LeftOut { path: f.path, why: why.to_owned(), unreadable: false };
        self.left_out.extend(Vec::into_iter(own).map(left_out));
    }
}

/// What was found so far.
#[derive(Default)]
struct Search {
    recursive: bool,
    files: Vec<FoundFile>,
    left_out: Vec<LeftOut>,
}

impl Search {
    fn add_named(&mut self, path: PathBuf) {
        self.files.push(FoundFile { path, named: true });
    }

    fn add_folder(&mut self, folder: &Path) -> Result<()> {
        let found = if self.recursive { tree(folder)? } else { scan_files_of(folder)? };
        self.files.extend(found.0.into_iter().map(|path| FoundFile { path, named: false }));
        self.left_out.extend(found.1);
        Ok(())
    }
}

fn read_list(list: &Path, found: &mut Search) -> Result<()> {
    let bytes = files::read(list)?;
    let text = String::from_utf8(bytes).map_err(|_| {
        Error::file(
            list,
            "bytes that are not UTF-8",
            "one path a line, in UTF-8",
            "save the list as UTF-8 text",
        )
    })?;
    let before = found.files.len();
    let folder = list.parent().unwrap_or(Path::new(""));
    for line in text.trim_start_matches('\u{feff}').lines().map(str::trim) {
        if !line.is_empty() && !line.starts_with('#') {
            resolve(line, folder, found)?;
        }
    }
    if found.files.len() == before {
        return Err(Error::file(
            list,
            "no path",
            "one path a line",
            "list the scans, one a line, relative to the list",
        ));
    }
    Ok(())
}

/// Adds what one input names; relative ones start from `base`.
fn resolve(input: &str, base: &Path, found: &mut Search) -> Result<()> {
    let path = base.join(input);
    if path.is_dir() {
        return found.add_folder(&path);
    }
    if path.exists() {
        found.add_named(path);
        return Ok(());
    }
    if !input.contains(['*', '?', '[']) {
        let missing = std::io::Error::new(std::io::ErrorKind::NotFound, "no such file or folder");
        return Err(Error::read(path, missing));
    }
    let matching = expand(&path, base, input)?;
    if matching.is_empty() {
        let expected = "at least one scan file that matches it";
        let remedy = "check the pattern; hidden files and folders are not matched";
        return Err(Error::input(input, "no file", expected, remedy));
    }
    matching.into_iter().for_each(|path| found.add_named(path));
    Ok(())
}

fn expand(pattern: &Path, base: &Path, input: &str) -> Result<Vec<PathBuf>> {
    // A folder name with [ in it must not become part of the pattern.
    let pattern = match base.to_str() {
        Some(b) if !b.is_empty() && !Path::new(input).is_absolute() => {
            format!("{}/{input}", glob::Pattern::escape(b))
        }
        _ => pattern.to_string_lossy().into_owned(),
    };
    let options = glob::MatchOptions { require_literal_leading_dot: true, ..glob::MatchOptions::new() };
    let matches = glob::glob_with(&pattern, options).map_err(|e| {
        Error::input(
            input,
            format!("a pattern that is not valid: {e}"),
            "a glob such as scans/*.ply",
            "correct the pattern",
        )
    })?;
    let files = matches.map(|m| m.map_err(|e| Error::read(e.path(), std::io::Error::from(e.error().kind()))));
    let files: Vec<PathBuf> = files.collect::<Result<_>>()?;
    let wanted = |p: &PathBuf| p.is_file() && (is_scan(p) || is_depth(p));
    Ok(files.into_iter().filter(wanted).collect())
}

/// Scan files of a folder, naturally sorted: see [`discover_with`].
///
/// # Errors
/// [`Error::Read`], or [`Error::Input`] when there is none.
pub fn scan_files(folder: &Path) -> Result<Vec<PathBuf>> {
    Ok(scan_files_of(folder)?.0)
}

/// Scan files of a folder, and files that are none by their names.
fn scan_files_of(folder: &Path) -> Result<(Vec<PathBuf>, Vec<LeftOut>)> {
    let named = folder.join("PointCloud");
    let (place, depth) = (if named.is_dir() { named } else { folder.to_path_buf() }, folder.join("depth"));
    let mut files = visible_files(&place)?;
    let mut left_out = Vec::new();
    files.retain(|path| {
        let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        let why = if NO_SCANS.contains(&name.as_str()) || is_trajectory(&name) {
            "a table that goes with scans, by its name"
        } else if has_extension(path, &["ply"]) && is_merged(path) {
            "a merged cloud that scanweave wrote; name the file itself to take it"
        } else {
            return true;
        };
        left_out.push(LeftOut { path: path.clone(), why: why.to_owned(), unreadable: false });
        false
    });
    let pick = |keep: fn(&Path) -> bool| files.iter().filter(|p| keep(p)).cloned().collect::<Vec<_>>();
    let mut scans = pick(is_cloud);
    if scans.is_empty() {
        scans = pick(is_other);
    }
    if scans.is_empty() {
        scans = depth_images(&files);
    }
    if scans.is_empty() && depth.is_dir() {
        scans = depth_images(&visible_files(&depth)?);
    }
    if scans.is_empty() {
        let remedy = "name another folder, or name the files themselves (.txt clouds must be named); \
                      --recursive looks into the folders in it";
        let expected = format!("scans: {FORMATS}");
        return Err(Error::input(place.display().to_string(), what_else(&files), expected, remedy));
    }
    left_out.extend(passed_over(&files, &scans));
    sort_naturally(&mut scans);
    Ok((scans, left_out))
}

/// Whether a file is called as the trajectory of a further component: `trajectory_1.csv`.
fn is_trajectory(name: &str) -> bool {
    let number = name.strip_prefix("trajectory_").and_then(|rest| rest.strip_suffix(".csv"));
    number.is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
}

/// Files of a folder that may well be scans and are not among those taken. NPY, NPZ and meshes are not
/// named: features and copies of the scans may lie there by hundreds.
fn passed_over(files: &[PathBuf], taken: &[PathBuf]) -> Vec<LeftOut> {
    let taken: HashSet<&PathBuf> = taken.iter().collect();
    let maybe = |p: &&PathBuf| (is_packed(p) || has_extension(p, &["bin"])) && !taken.contains(p);
    let why = |p: &Path| match is_other(p) {
        true => "a file that is taken only where its folder has no scan of a format that holds nothing else",
        false => "a packed file whose name is not that of a scan",
    };
    let left_out = |p: &PathBuf| LeftOut { path: p.clone(), why: why(p).to_owned(), unreadable: false };
    files.iter().filter(maybe).map(left_out).collect()
}

/// What a folder without a scan holds, by extension.
fn what_else(files: &[PathBuf]) -> String {
    if files.is_empty() {
        return "no visible file".to_owned();
    }
    let mut count: BTreeMap<String, usize> = BTreeMap::new();
    for file in files {
        let extension = file.extension().map(|e| format!(".{}", e.to_string_lossy()));
        *count.entry(extension.unwrap_or_else(|| "without extension".to_owned())).or_default() += 1;
    }
    let kinds: Vec<String> = count.iter().take(5).map(|(e, n)| format!("{n} {e}")).collect();
    let n = super::scalar::counted(files.len(), "file");
    format!("{n}, none of them a scan by its extension ({})", kinds.join(", "))
}

/// Scan files of a folder and of all visible folders in it.
///
/// # Errors
/// [`Error::Read`], or [`Error::Input`] when there is none.
fn tree(folder: &Path) -> Result<(Vec<PathBuf>, Vec<LeftOut>)> {
    let (mut scans, mut left_out, mut first_error) = (Vec::new(), Vec::new(), None);
    let mut waiting = vec![folder.to_path_buf()];
    let mut visited = HashSet::new();
    while let Some(folder) = waiting.pop() {
        // A link that leads back up is followed once.
        if !visited.insert(fs::canonicalize(&folder).map_err(|e| Error::read(&folder, e))?) {
            continue;
        }
        match scan_files_of(&folder) {
            Ok(found) => {
                // Who names a folder of exported scans itself wants these; deeper ones are copies.
                let exported = if visited.len() > 1 { exported(&folder) } else { BTreeSet::new() };
                let is_copy = |path: &PathBuf| {
                    path.file_name().and_then(|n| n.to_str()).is_some_and(|n| exported.contains(n))
                };
                let (copies, own): (Vec<PathBuf>, Vec<PathBuf>) = found.0.into_iter().partition(is_copy);
                scans.extend(own);
                let why = "a scan that scanweave exported; name its folder to take it";
                let copy = |path| LeftOut { path, why: why.to_owned(), unreadable: false };
                left_out.extend(copies.into_iter().map(copy).chain(found.1));
            }
            Err(error @ Error::Input { .. }) => {
                first_error.get_or_insert(error);
            }
            Err(error) => return Err(error),
        }
        for entry in fs::read_dir(&folder).map_err(|e| Error::read(&folder, e))? {
            let entry = entry.map_err(|e| Error::read(&folder, e))?;
            // The cache of a result holds features, which could pass for clouds.
            let cache = entry.file_name() == "cache" && folder.join("poses.json").exists();
            if !cache && !entry.file_name().as_encoded_bytes().starts_with(b".") && entry.path().is_dir() {
                waiting.push(entry.path());
            }
        }
    }
    match first_error {
        Some(error) if scans.is_empty() => Err(error),
        _ => Ok((scans, left_out)),
    }
}

fn visible_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|e| Error::read(folder, e))?;
        // `path().is_file()` follows links, as opening will.
        if !entry.file_name().as_encoded_bytes().starts_with(b".") && entry.path().is_file() {
            files.push(entry.path());
        }
    }
    Ok(files)
}

pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|e| extensions.iter().any(|x| e.eq_ignore_ascii_case(x)))
}

pub(super) fn is_cloud(path: &Path) -> bool {
    holds(path, &CLOUD_EXTENSIONS)
}

pub(super) fn is_other(path: &Path) -> bool {
    // What is in an archive of another name is seen when it is read.
    let archive = has_extension(path, &["zip"]) && path.with_extension("").extension().is_none();
    archive || holds(path, &OTHER_EXTENSIONS)
}

/// Whether a file is packed, by its extension.
pub(super) fn is_packed(path: &Path) -> bool {
    has_extension(path, &PACKED_EXTENSIONS)
}

/// Whether a file is a scan by its extension, where it was named itself.
pub(super) fn is_scan(path: &Path) -> bool {
    is_cloud(path) || is_other(path) || holds(path, &["txt"])
}

/// Whether a file, packed or not, has one of these extensions.
fn holds(path: &Path, extensions: &[&str]) -> bool {
    match is_packed(path) {
        true => has_extension(&path.with_extension(""), extensions),
        false => has_extension(path, extensions),
    }
}

/// Sorts so that numbers in names count as numbers. Total, hence the same for every input order.
pub(super) fn sort_naturally(paths: &mut [PathBuf]) {
    paths.sort_by_cached_key(|p| (natural_key(p), p.clone()));
}

/// A stretch of a path: text, or the digits of a number.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    /// Number of digits without leading zeros, then those digits: ordered as the number is.
    Number(usize, Vec<u8>),
    Text(Vec<u8>),
}

/// Each component of the path as its stretches; folders sort before deeper files of the same name.
fn natural_key(path: &Path) -> Vec<Vec<Part>> {
    let component = |c: std::path::Component<'_>| {
        let bytes = c.as_os_str().as_encoded_bytes();
        let stretches = bytes.chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit());
        stretches
            .map(|s| {
                if !s[0].is_ascii_digit() {
                    return Part::Text(s.to_ascii_lowercase());
                }
                let digits: Vec<u8> = s.iter().copied().skip_while(|&d| d == b'0').collect();
                Part::Number(digits.len(), digits)
            })
            .collect()
    };
    path.components().map(component).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(files: &[&str]) -> (Vec<String>, Vec<String>) {
        let folder = tempfile::tempdir().unwrap();
        files.iter().for_each(|name| fs::write(folder.path().join(name), "x").unwrap());
        let name = |p: &Path| p.file_name().unwrap().to_string_lossy().into_owned();
        let found = discover_with(&[folder.path().to_string_lossy().into_owned()], false).unwrap();
        let mut left_out: Vec<String> = found.left_out.iter().map(|l| name(&l.path)).collect();
        left_out.sort();
        (found.files.iter().map(|f| name(&f.path)).collect(), left_out)
    }

    #[test]
    fn files_of_scanners_and_packed_scans_are_found_in_a_folder() {
        let files =
            ["a.ptx", "b.ply.gz", "c.xyz.zip", "d.e57", "f.LAZ", "e.laz", "notes.txt", "notes.txt.gz"];
        let (taken, left_out) = found(&files);
        assert_eq!(taken, ["a.ptx", "b.ply.gz", "c.xyz.zip", "d.e57", "e.laz", "f.LAZ"]);
        assert_eq!(left_out, ["notes.txt.gz"]);
    }

    #[test]
    fn merged_clouds_are_left_out_under_any_name_unless_they_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let new =
            "ply\nformat ascii 1.0\ncomment scanweave merged cloud of run 0a\nelement vertex 0\nend_header\n";
        let old = "ply\nformat ascii 1.0\ncomment lengths in metres\nelement vertex 1\nproperty float x\n\
                   property int scan\nend_header\n1 2";
        let scan = "ply\nformat ascii 1.0\ncomment lengths in metres\nelement vertex 0\nend_header\n";
        fs::write(path("model.PLY"), new).unwrap();
        fs::write(path("old.ply"), old).unwrap();
        fs::write(path("merged.ply"), scan).unwrap();
        fs::create_dir_all(path("out/cache")).unwrap();
        fs::write(path("out/cache/a.npz"), "x").unwrap();
        let find = |input: PathBuf| discover_with(&[input.to_string_lossy().into_owned()], true).unwrap();
        let mut found = find(folder.path().to_path_buf());
        let mut names: Vec<PathBuf> = found.left_out.iter().map(|l| l.path.clone()).collect();
        names.sort();
        assert_eq!(names, [path("model.PLY"), path("old.ply")]);
        let files = |found: &Discovered| found.files.iter().map(|f| f.path.clone()).collect::<Vec<_>>();
        assert_eq!(files(&found), [path("merged.ply"), path("out/cache/a.npz")]);
        // The cache of this very run, and that of a finished result.
        found.leave_out(|p| p.starts_with(path("out/cache")));
        assert_eq!(files(&found), [path("merged.ply")]);
        fs::write(path("out/poses.json"), "{}").unwrap();
        assert_eq!(files(&find(folder.path().to_path_buf())), [path("merged.ply")]);
        assert_eq!(files(&find(path("model.PLY"))), [path("model.PLY")]);
    }

    #[test]
    fn what_may_be_anything_is_taken_where_there_is_nothing_else() {
        assert_eq!(found(&["a.bin", "b.bin.gz", "c.zip"]).0, ["a.bin", "b.bin.gz", "c.zip"]);
        let (taken, left_out) = found(&["a.bin", "b.ply", "c.zip", "d.npy"]);
        assert_eq!(taken, ["b.ply"]);
        assert_eq!(left_out, ["a.bin", "c.zip"]);
    }
}
