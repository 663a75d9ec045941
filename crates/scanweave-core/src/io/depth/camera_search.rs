//! The calibration and the scale of depth that lie beside depth images.

use super::frame::{Frame, Layout, SAME_TIME_S, name_of};
use super::intrinsics::{Camera, CameraMatrix, SIZED_EXTENSION, read_camera, small_text, units_per_m};
use crate::error::{Error, Result};
use crate::io::scalar::counted;
use crate::io::scan_file::Note;
use std::path::{Path, PathBuf};

/// Units of a depth image in a metre where nothing else is said: millimetres.
pub const UNITS_PER_M: f32 = 1000.0;
/// Units in a metre of the TUM layout.
const TUM_UNITS_PER_M: f64 = 5000.0;

/// Names of files that hold intrinsics and nothing else.
const INTRINSICS_FILES: [&str; 19] = [
    "K.txt",
    "camera_matrix.csv",
    "camera-intrinsics.txt",
    "intrinsics.txt",
    "camera_intrinsics.txt",
    "intrinsic.txt",
    "intrinsic_depth.txt",
    "intrinsics_depth.txt",
    "depth_intrinsics.txt",
    "intrinsic/intrinsic_depth.txt",
    "camera_intrinsic.json",
    "camera_intrinsics.json",
    "intrinsic.json",
    "intrinsics.json",
    "depth_camera_info.yaml",
    "depth_camera_info.yml",
    "camera_info.yaml",
    "camera_info.yml",
    "camera_info.json",
];
/// Names of files that may hold intrinsics, or something else that is then passed over.
const MAYBE_INTRINSICS_FILES: [&str; 12] = [
    "calibration.txt",
    "camera.txt",
    "calib.txt",
    "camera.json",
    "cam_params.json",
    "calibration.json",
    "camera.yaml",
    "camera.yml",
    "calibration.yaml",
    "calibration.yml",
    "_info.txt",
    "info.txt",
];
/// Folders of ARKitScenes with a file of intrinsics for every image.
const FRAME_FOLDERS: [&str; 5] =
    ["lowres_wide_intrinsics", "wide_intrinsics", "color_intrinsics", "vga_wide_intrinsics", "intrinsics"];
/// Names of files that hold the scale of depth alone.
const SCALE_FILES: [&str; 4] = ["depth_scale.txt", "depth-scale.txt", "depthscale.txt", "depth_factor.txt"];

/// Intrinsics that lie beside `image`, one folder up, or two up from a folder `depth`: `K.txt`,
/// `camera-intrinsics.txt`, `intrinsic/intrinsic_depth.txt`, `camera_intrinsic.json`,
/// `camera_info.yaml`, `calibration.txt`, …, as that file states them.
///
/// # Errors
/// [`Error::File`] naming the image when there is none; those of
/// [`read_intrinsics`](super::read_intrinsics).
pub fn find_intrinsics(image: &Path) -> Result<CameraMatrix> {
    let camera = find_camera(image, &Frame::of(image), None)?;
    camera.intrinsics.ok_or_else(|| missing(image, Layout::Other))
}

/// The calibration with intrinsics that the user names, else the nearest one.
pub(super) fn find_camera(image: &Path, frame: &Frame, named: Option<&Path>) -> Result<Camera> {
    if let Some(path) = named {
        return read_camera(path);
    }
    if let Some(path) = of_frame(frame) {
        return read_camera(&path);
    }
    let mut unusable = None;
    for folder in frame.folders() {
        let read = |name: &str| Some(folder.join(name)).filter(|p| p.is_file()).map(|p| read_camera(&p));
        if let Some(camera) = INTRINSICS_FILES.iter().find_map(|n| read(n)) {
            return camera;
        }
        // ScanNet keeps the calibration of a scene in a file named after the folder.
        let of_scene = format!("{}.txt", name_of(&folder));
        for name in MAYBE_INTRINSICS_FILES.iter().copied().chain([of_scene.as_str()]) {
            match read(name) {
                Some(Ok(camera)) if camera.intrinsics.is_some() => return Ok(camera),
                Some(Err(error)) if name != of_scene => unusable = unusable.or(Some(error)),
                _ => {}
            }
        }
    }
    Err(unusable.unwrap_or_else(|| missing(image, frame.layout)))
}

/// The file with the intrinsics of one image: of the same name beside it or in a folder beside its own, else
/// the nearest in time there, as the clocks of images and intrinsics differ by some milliseconds.
fn of_frame(frame: &Frame) -> Option<PathBuf> {
    let name = format!("{}.{SIZED_EXTENSION}", frame.stem);
    let folders: Vec<PathBuf> = FRAME_FOLDERS.iter().map(|f| frame.above.join(f)).collect();
    let same = std::iter::once(&frame.folder).chain(&folders).map(|f| f.join(&name)).find(|p| p.is_file());
    let time = time_of(&frame.stem);
    same.or_else(|| folders.iter().find_map(|folder| nearest_in(folder, time?)))
}

/// The seconds at the end of a name, after that of the video.
fn time_of(stem: &str) -> Option<f64> {
    let time = stem.rsplit('_').next()?;
    time.contains('.').then(|| time.parse().ok()).flatten()
}

fn nearest_in(folder: &Path, time_s: f64) -> Option<PathBuf> {
    let files = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let timed = files.filter(|p| p.extension().is_some_and(|e| e == SIZED_EXTENSION)).filter_map(|p| {
        let apart = (time_of(&p.file_stem()?.to_string_lossy())? - time_s).abs();
        (apart <= SAME_TIME_S).then_some((apart, p))
    });
    timed.min_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1))).map(|(_, path)| path)
}

fn missing(image: &Path, layout: Layout) -> Error {
    let expected = "K.txt, camera-intrinsics.txt, camera_intrinsic.json, camera_info.yaml or another \
                    calibration beside it, one folder up, or two up from a folder 'depth'";
    let mut remedy = "write 'fx fy cx cy' in pixels to a file K.txt beside the images, \
                      or pass --intrinsics FILE"
        .to_owned();
    if layout == Layout::Tum {
        // Published with the benchmark: <https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats>
        remedy.push_str(
            "; those of the TUM sequences are 517.3 516.5 318.6 255.3 (freiburg1), \
             520.9 521.0 325.1 249.7 (freiburg2) and 535.4 539.2 320.1 247.6 (freiburg3)",
        );
    }
    Error::file(image, "a depth image without camera intrinsics", expected, remedy)
}

/// Units of depth in a metre, and whether nothing beside the images tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DepthUnits {
    /// Units in a metre.
    pub per_m: f64,
    /// Whether that is an assumption.
    pub assumed: bool,
}

/// Units of depth in a metre: the user's, else those of the calibration, of a file with the scale, of
/// the layout, or millimetres.
pub(super) fn find_units(
    frame: &Frame,
    camera: &Camera,
    named: Option<f64>,
) -> Result<(DepthUnits, Option<Note>)> {
    let known = |per_m: f64| DepthUnits { per_m, assumed: false };
    if let Some(per_m) = named {
        return Ok((known(per_m), None));
    }
    if let Some(per_m) = camera.units_per_m.map_or_else(|| stated_units(frame), |u| Ok(Some(u)))? {
        let note = (per_m != f64::from(UNITS_PER_M)).then(|| {
            Note::info(format!("depth in {per_m} units a metre, as a file beside the images states"))
        });
        return Ok((known(per_m), note));
    }
    let open3d = camera.path.extension().is_some_and(|e| e == "json");
    match frame.layout {
        Layout::Tum => {
            let text = format!(
                "depth in {TUM_UNITS_PER_M} units a metre, as in the layout of TUM RGB-D: pass --depth-scale for another"
            );
            Ok((known(TUM_UNITS_PER_M), Some(Note::info(text))))
        }
        Layout::SevenScenes | Layout::ScanNet => Ok((known(f64::from(UNITS_PER_M)), None)),
        // The default of Open3D, which leaves it out of the file.
        Layout::Other if open3d => Ok((known(f64::from(UNITS_PER_M)), None)),
        Layout::Other => {
            let text = "depth in millimetres (1000 units a metre): pass --depth-scale for another";
            Ok((DepthUnits { per_m: f64::from(UNITS_PER_M), assumed: true }, Some(Note::info(text))))
        }
    }
}

/// The scale of a file that holds nothing else, or of a calibration that was not asked for intrinsics.
fn stated_units(frame: &Frame) -> Result<Option<f64>> {
    for folder in frame.folders() {
        let here = |name: &&str| Some(folder.join(name)).filter(|p| p.is_file());
        if let Some(path) = SCALE_FILES.iter().find_map(here) {
            return scale_of(&path).map(Some);
        }
        let others: Vec<PathBuf> = MAYBE_INTRINSICS_FILES.iter().filter_map(here).collect();
        let units = others.iter().find_map(|p| read_camera(p).ok().and_then(|c| c.units_per_m));
        if units.is_some() {
            return Ok(units);
        }
    }
    Ok(None)
}

/// The only number of a file, with or without words around it.
fn scale_of(path: &Path) -> Result<f64> {
    let text = small_text(path)?;
    let words = text.split(|c: char| c.is_whitespace() || matches!(c, ':' | '=' | ','));
    let numbers: Vec<f64> = words.filter_map(|w| w.parse().ok()).collect();
    match numbers[..] {
        [scale] => units_per_m(path, scale),
        _ => {
            let found = counted(numbers.len(), "number");
            let remedy = "write the units in a metre alone, or pass --depth-scale";
            Err(Error::file(path, found, "the units of depth in a metre", remedy))
        }
    }
}
