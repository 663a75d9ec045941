//! Which images of a folder are depth, by their names.

use super::frame::name_of;
use std::path::{Path, PathBuf};

/// Extensions of depth images.
const READ: [&str; 2] = ["png", "pgm"];
/// Extensions of depth images that cannot be read; reading them says what to do.
const NOT_READ: [&str; 3] = ["tif", "tiff", "exr"];
/// What a name has somewhere in it if the image is one of colours.
const COLOR: [&str; 3] = ["color", "colour", "rgb"];
/// Words of the names of other images that go with depth.
const OTHER_WORDS: [&str; 15] = [
    "mask",
    "masks",
    "label",
    "labels",
    "instance",
    "instances",
    "semantic",
    "semantics",
    "segmentation",
    "normal",
    "normals",
    "confidence",
    "infrared",
    "preview",
    "thumbnail",
];
/// Words beside those in the names of folders of such images; `label-filt` is ScanNet's.
const FOLDER_WORDS: [&str; 4] = ["image", "images", "raw", "filt"];

/// The depth images among files: where some are named after depth, only those.
pub(in crate::io) fn depth_images(files: &[PathBuf]) -> Vec<PathBuf> {
    let images: Vec<&PathBuf> = files.iter().filter(|p| is_depth(p)).collect();
    let any = |keep: fn(&Path) -> bool| images.iter().any(|p| keep(p));
    let (any_named, any_read) = (any(is_named), any(|p| has_extension(p, &READ)));
    let wanted = |p: &&PathBuf| (!any_named || is_named(p)) && (!any_read || has_extension(p, &READ));
    images.iter().copied().filter(wanted).cloned().collect()
}

fn is_named(path: &Path) -> bool {
    name_of(path).to_ascii_lowercase().contains("depth")
}

/// An image that is not, by its name or that of its folder, one of colours or labels.
pub(in crate::io) fn is_depth(path: &Path) -> bool {
    let folder = path.parent().map(name_of).unwrap_or_default().to_ascii_lowercase();
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let image = has_extension(path, &READ) || has_extension(path, &NOT_READ);
    // A data set may be named after colours; a folder of colour images has no other word in its name.
    // Only whole words of it count: what a folder is called may hold any letters.
    let other = |w: &str| OTHER_WORDS.contains(&w) || COLOR.contains(&w.trim_end_matches('s'));
    let of_others = words(&folder).all(|w| other(w) || FOLDER_WORDS.contains(&w));
    image && !(of_others && words(&folder).any(other)) && !words(&stem).any(is_other)
}

fn words(name: &str) -> impl Iterator<Item = &str> {
    name.split(|c: char| !c.is_ascii_alphabetic()).filter(|w| !w.is_empty())
}

/// Whether a word is that of images of colours, labels and the like.
fn is_other(word: &str) -> bool {
    // RGB-D is both, and says nothing.
    OTHER_WORDS.contains(&word) || (!word.contains("rgbd") && COLOR.iter().any(|c| word.contains(c)))
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|e| extensions.iter().any(|x| e.eq_ignore_ascii_case(x)))
}
