//! Where a depth image lies, and what the data sets keep beside it under which names.

use super::layout_lists::{TimedFile, nearest, timed_files};
use crate::files;
use std::fs;
use std::path::{Path, PathBuf};

/// A layout of images that tells more than the single image does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// `depth/<time>.png`, `depth.txt`, `rgb.txt`, `groundtruth.txt`: 5000 units a metre.
    /// <https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats>
    Tum,
    /// `frame-<n>.depth.png`, `.color.png`, `.pose.txt`: millimetres.
    /// <https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/>
    SevenScenes,
    /// `depth/<n>.png`, `color/<n>.jpg`, `pose/<n>.txt`, `intrinsic/intrinsic_depth.txt`: millimetres.
    /// <https://github.com/ScanNet/ScanNet/tree/master/SensReader>
    ScanNet,
    /// Any other.
    Other,
}

/// One depth image and its surroundings.
#[derive(Debug)]
pub(super) struct Frame {
    /// Name without the extension.
    pub stem: String,
    /// Folder of the image.
    pub folder: PathBuf,
    /// Folder above it.
    pub above: PathBuf,
    /// Whether its folder is named after depth, so that what goes with it lies in folders beside that.
    pub in_depth_folder: bool,
    /// Layout of the folder.
    pub layout: Layout,
}

/// Folders of colour images beside a folder of depth images.
const COLOR_FOLDERS: [&str; 5] = ["color", "rgb", "image", "images", "colour"];
/// Extensions of colour images.
const COLOR_EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];
/// What stands in the name of a colour image in place of `depth`.
const COLOR_WORDS: [&str; 5] = ["color", "rgb", "image", "colour", "frame"];
/// Lists that pair depth and colour images of the TUM layout.
const ASSOCIATIONS: [&str; 4] = ["associations.txt", "associated.txt", "association.txt", "associate.txt"];
/// Difference in time up to which the tools of the TUM benchmark pair images and poses, seconds.
pub(super) const SAME_TIME_S: f64 = 0.02;

impl Frame {
    /// The surroundings of an image.
    pub(super) fn of(image: &Path) -> Self {
        let stem = image.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let folder = image.parent().map(Path::to_path_buf).unwrap_or_default();
        let above = above(&folder);
        let in_depth_folder = name_of(&folder).to_ascii_lowercase().starts_with("depth");
        let mut frame = Self { stem, folder, above, in_depth_folder, layout: Layout::Other };
        frame.layout = frame.find_layout();
        frame
    }

    fn find_layout(&self) -> Layout {
        let has = |name: &str| self.above.join(name).is_file();
        let timed = self.stem.contains('.') && self.stem.parse::<f64>().is_ok();
        if self.stem.starts_with("frame-") && self.stem.ends_with(".depth") {
            Layout::SevenScenes
        } else if !self.in_depth_folder {
            Layout::Other
        } else if has("depth.txt")
            || ASSOCIATIONS.iter().any(|n| has(n))
            || (timed && (has("rgb.txt") || has("groundtruth.txt")))
        {
            Layout::Tum
        } else if has("intrinsic/intrinsic_depth.txt") {
            Layout::ScanNet
        } else {
            Layout::Other
        }
    }

    /// Folders in which a camera's calibration is looked for, nearest first.
    pub(super) fn folders(&self) -> Vec<PathBuf> {
        let mut folders = vec![self.folder.clone(), self.above.clone()];
        if self.in_depth_folder {
            folders.push(above(&self.above));
        }
        folders
    }

    /// The colour image that belongs to the depth image, by the names of the known layouts.
    pub(super) fn color_image(&self) -> Option<PathBuf> {
        if self.layout == Layout::Tum {
            return self.tum_color().or_else(|| self.in_color_folder());
        }
        self.named_after_depth().or_else(|| self.in_color_folder())
    }

    /// `frame-000010.color.png` for `frame-000010.depth.png`, `3_rgb.jpg` for `3_depth.png`.
    fn named_after_depth(&self) -> Option<PathBuf> {
        let at = self.stem.to_ascii_lowercase().rfind("depth")?;
        // Lower case may be of another length; such names are not those of data sets.
        let (before, after) = (self.stem.get(..at)?, self.stem.get(at + "depth".len()..)?);
        let named = |word: &&str| first_image(&self.folder, &format!("{before}{word}{after}"));
        COLOR_WORDS.iter().find_map(named)
    }

    /// `color/0.jpg` for `depth/0.png`; `image/0000012-000000400400.jpg` for
    /// `depth/0000012-000000433766.png`, where the second number is the time (Redwood).
    fn in_color_folder(&self) -> Option<PathBuf> {
        if !self.in_depth_folder {
            return None;
        }
        let folders = || COLOR_FOLDERS.iter().map(|f| self.above.join(f)).filter(|f| f.is_dir());
        if let Some(same) = folders().find_map(|f| first_image(&f, &self.stem)) {
            return Some(same);
        }
        let (number, time) = self.stem.split_once('-')?;
        if !is_digits(number) || !is_digits(time) {
            return None;
        }
        folders().find_map(|folder| {
            let start = format!("{number}-");
            let entries = fs::read_dir(folder).ok()?.flatten().map(|e| e.path());
            let same = |p: &PathBuf| name_of(p).starts_with(&start) && has_color_extension(p);
            // The order of a directory must not decide.
            entries.filter(same).min()
        })
    }

    /// The colour image of a list of pairs, or the one taken at the nearest time.
    fn tum_color(&self) -> Option<PathBuf> {
        let mine = |file: &str| Path::new(file).file_stem().is_some_and(|s| s == self.stem.as_str());
        for name in ASSOCIATIONS {
            for line in files::read_text(&self.above.join(name)).unwrap_or_default().lines() {
                let words: Vec<&str> = line.split_whitespace().collect();
                // `time file time file`, in either order.
                let [_, a, _, b] = words[..] else { continue };
                let of_depth = |file: &str| mine(file) && file.contains("depth");
                let other = if of_depth(a) {
                    b
                } else if of_depth(b) {
                    a
                } else {
                    continue;
                };
                let path = self.above.join(other);
                return (has_color_extension(&path) && path.is_file()).then_some(path);
            }
        }
        let listed = timed_files(&self.above.join("rgb.txt"));
        let image = nearest(&listed, self.time_s()?, SAME_TIME_S)?;
        let path = self.above.join(&image.file);
        (has_color_extension(&path) && path.is_file()).then_some(path)
    }

    /// When an image of the TUM layout was taken: by its list, else by its name.
    pub(super) fn time_s(&self) -> Option<f64> {
        let mine = |f: &TimedFile| Path::new(&f.file).file_stem().is_some_and(|s| s == self.stem.as_str());
        let listed = timed_files(&self.above.join("depth.txt"));
        listed.into_iter().find(mine).map(|f| f.time_s).or_else(|| self.stem.parse().ok())
    }

    /// The file with the pose of this image alone, by the names of the known layouts.
    pub(super) fn pose_file(&self) -> Option<PathBuf> {
        let beside = self.stem.strip_suffix("depth").map(|s| self.folder.join(format!("{s}pose.txt")));
        let folders = ["pose", "poses"].map(|f| self.above.join(f).join(format!("{}.txt", self.stem)));
        let folders = folders.into_iter().filter(|_| self.in_depth_folder);
        beside.into_iter().chain(folders).find(|p| p.is_file())
    }
}

/// The folder above one, by its name where it has one: a link to a folder lies where it is named.
fn above(folder: &Path) -> PathBuf {
    match (folder.file_name(), folder.parent()) {
        (Some(_), Some(parent)) => parent.to_path_buf(),
        _ => folder.join(".."),
    }
}

/// The last part of a path; that of the working folder too.
pub(super) fn name_of(path: &Path) -> String {
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    let whole = || fs::canonicalize(if path.as_os_str().is_empty() { Path::new(".") } else { path }).ok();
    name(path).or_else(|| whole().and_then(|p| name(&p))).unwrap_or_default()
}

fn first_image(folder: &Path, stem: &str) -> Option<PathBuf> {
    COLOR_EXTENSIONS.iter().map(|e| folder.join(format!("{stem}.{e}"))).find(|p| p.is_file())
}

fn has_color_extension(path: &Path) -> bool {
    path.extension().is_some_and(|e| COLOR_EXTENSIONS.iter().any(|x| e.eq_ignore_ascii_case(x)))
}

fn is_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
}
