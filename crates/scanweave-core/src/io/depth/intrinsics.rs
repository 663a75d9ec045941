//! Pinhole intrinsics in the forms in which cameras and data sets state them.

use super::camera_keys::{Keys, words};
use crate::error::{Error, Result};
use crate::io::scalar::parse_number;
use crate::io::scan_file::Note;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Pinhole camera without distortion, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Focal length along the columns.
    pub fx: f64,
    /// Focal length along the rows.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
}

/// What a calibration file says.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Camera {
    /// The file.
    pub path: PathBuf,
    /// `None` where it says other things only, such as the scale of depth.
    pub intrinsics: Option<Intrinsics>,
    /// Columns and rows of the images that the intrinsics are for.
    pub size: Option<[f64; 2]>,
    /// Units of depth in a metre.
    pub units_per_m: Option<f64>,
    /// Whether it states a lens distortion.
    pub distorted: bool,
}

/// Calibration files are small: a larger file is something else, and is not read to its end.
const LARGEST_FILE: u64 = 1 << 20;
/// Relative difference of two aspect ratios that still counts as the same. ScanNet's 1296×968 colour
/// and 640×480 depth differ by 0.4 %.
pub(super) const SAME_ASPECT: f64 = 0.01;

/// Extension of the files of ARKitScenes, `width height fx fy cx cy`.
pub(super) const SIZED_EXTENSION: &str = "pincam";
/// The file of Stray Scanner, which is for its colour images: they are larger than its depth images.
const OF_COLOR_IMAGES: &str = "camera_matrix.csv";
/// Principal points of phones lie off the middle of the image by less than this share of its size.
const OFF_MIDDLE: f64 = 0.03;

const EXPECTED: &str = "'fx fy cx cy' or a 3x3 camera matrix 'fx 0 cx / 0 fy cy / 0 0 1', in pixels";
const REMEDY: &str = "write the camera's intrinsics in one of these forms";

/// Keys of a matrix of 9 or 16 numbers, or of `fx fy cx cy`: ROS, OpenCV, Open3D, Kalibr, ScanNet.
const MATRIX: [&str; 14] = [
    "m_calibrationDepthIntrinsic",
    "depth_intrinsic",
    "K",
    "k",
    "camera_matrix.data",
    "camera_matrix",
    "intrinsic_matrix",
    "intrinsic.intrinsic_matrix",
    "intrinsics",
    "intrinsic",
    "cam0.intrinsics",
    "camera.K",
    "cam_K",
    "cam_k",
];
/// Keys of the four numbers: plain, ORB-SLAM 2 and 3, Replica, RealSense, ScanNet, NeRF.
const FOUR: [[&str; 4]; 8] = [
    ["fx", "fy", "cx", "cy"],
    ["Camera.fx", "Camera.fy", "Camera.cx", "Camera.cy"],
    ["Camera1.fx", "Camera1.fy", "Camera1.cx", "Camera1.cy"],
    ["camera.fx", "camera.fy", "camera.cx", "camera.cy"],
    ["intrinsics.fx", "intrinsics.fy", "intrinsics.cx", "intrinsics.cy"],
    ["fx", "fy", "ppx", "ppy"],
    ["fx_depth", "fy_depth", "mx_depth", "my_depth"],
    ["fl_x", "fl_y", "cx", "cy"],
];
const SIZE: [[&str; 2]; 9] = [
    ["m_depthWidth", "m_depthHeight"],
    ["depthWidth", "depthHeight"],
    ["width", "height"],
    ["image_width", "image_height"],
    ["intrinsic.width", "intrinsic.height"],
    ["Camera.width", "Camera.height"],
    ["camera.width", "camera.height"],
    ["camera.w", "camera.h"],
    ["w", "h"],
];
const UNITS: [&str; 8] = [
    "depth_scale",
    "DepthMapFactor",
    "RGBD.DepthMapFactor",
    "m_depthShift",
    "depthShift",
    "depth_factor",
    "png_depth_scale",
    "camera.scale",
];
const DISTORTION: [&str; 11] = [
    "D",
    "d",
    "distortion_coefficients.data",
    "distortion_coefficients",
    "cam0.distortion_coeffs",
    "Camera.k1",
    "Camera.k2",
    "Camera.p1",
    "Camera.p2",
    "Camera1.k1",
    "k1",
];

/// Reads pinhole intrinsics.
///
/// Plain numbers are `fx fy cx cy`, a 3×3 camera matrix or a 4×4 one (ScanNet), or `fx fy cx cy d0 …`
/// with a distortion (TUM), or `width height fx fy cx cy` (`.pincam` of ARKitScenes); commas and `#` comments are
/// allowed. JSON is that of Open3D
/// (`intrinsic_matrix`, by columns) or has `fx`, `fy`, `cx`, `cy`. YAML is that of a ROS `camera_info`
/// or of ORB-SLAM, and `key = value` that of ScanNet.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] when the numbers are none of these, the matrix is skewed, or a focal
/// length is not positive.
pub fn read_intrinsics(path: impl AsRef<Path>) -> Result<Intrinsics> {
    let path = path.as_ref();
    let camera = read_camera(path)?;
    camera.intrinsics.ok_or_else(|| Error::file(path, "a calibration without intrinsics", EXPECTED, REMEDY))
}

/// Reads a calibration file; it may hold no intrinsics if it holds a scale of depth.
///
/// # Errors
/// Those of [`read_intrinsics`].
pub(super) fn read_camera(path: &Path) -> Result<Camera> {
    let text = small_text(path)?;
    let text = text.trim_start_matches('\u{feff}');
    if text.trim_start().starts_with('{') {
        let keys = Keys::of_json(text).ok_or_else(|| {
            Error::file(path, "JSON that is damaged", "a JSON document", "write the file again")
        })?;
        return of_keys(path, &keys);
    }
    let bare = text.lines().flat_map(|l| words(l.split('#').next().unwrap_or("")));
    if let Some(numbers) = bare.map(parse_number).collect::<Option<Vec<f64>>>() {
        // Elsewhere six numbers may have the size first or last.
        let sized = path.extension().is_some_and(|e| e == SIZED_EXTENSION);
        let (size, numbers) = match numbers[..] {
            [w, h, ref four @ ..]
                if sized && four.len() == 4 && [w, h].iter().all(|v| *v >= 1.0 && v.fract() == 0.0) =>
            {
                (Some([w, h]), four)
            }
            _ => (None, &numbers[..]),
        };
        let (intrinsics, distorted) = of_numbers(path, numbers)?;
        let path = path.to_path_buf();
        return Ok(Camera { path, intrinsics: Some(intrinsics), size, units_per_m: None, distorted });
    }
    of_keys(path, &Keys::of_lines(text))
}

/// The text of a small file.
pub(super) fn small_text(path: &Path) -> Result<String> {
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    file.take(LARGEST_FILE + 1).read_to_end(&mut bytes).map_err(|e| Error::read(path, e))?;
    if bytes.len() as u64 > LARGEST_FILE {
        return Err(Error::file(
            path,
            "a file of more than 1 MiB",
            EXPECTED,
            "name the camera's calibration",
        ));
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn of_keys(path: &Path, keys: &Keys) -> Result<Camera> {
    if keys.is_empty() {
        return Err(Error::file(path, "text that is not numbers", EXPECTED, REMEDY));
    }
    let all = |names: &[&str]| names.iter().map(|n| keys.number(&[n])).collect::<Option<Vec<f64>>>();
    let stated = match keys.numbers(&MATRIX) {
        Some(numbers) => Some(of_numbers(path, numbers)?),
        None => FOUR.iter().find_map(|n| all(n)).map(|four| of_numbers(path, &four)).transpose()?,
    };
    let units_per_m = keys.number(&UNITS).map(|scale| units_per_m(path, scale)).transpose()?;
    if stated.is_none() && units_per_m.is_none() {
        let found = format!("no intrinsics under its keys ({} …)", keys.some_names());
        let expected = "fx, fy, cx, cy, or a matrix K, camera_matrix or intrinsic_matrix";
        return Err(Error::file(path, found, expected, REMEDY));
    }
    let size = SIZE.iter().find_map(|n| all(n)).map(|s| [s[0], s[1]]);
    let bent = |key: &&str| keys.numbers(&[*key]).is_some_and(|d| d.iter().any(|v| *v != 0.0));
    Ok(Camera {
        path: path.to_path_buf(),
        intrinsics: stated.map(|(intrinsics, _)| intrinsics),
        size: size.filter(|s| s.iter().all(|v| *v >= 1.0 && v.is_finite())),
        units_per_m,
        distorted: stated.is_some_and(|(_, distorted)| distorted) || DISTORTION.iter().any(bent),
    })
}

/// Units in a metre of a stated scale. RealSense states metres in a unit (0.001), the others units
/// in a metre; no camera has less than a unit in a metre.
pub(super) fn units_per_m(path: &Path, scale: f64) -> Result<f64> {
    if !(scale > 0.0 && scale.is_finite()) {
        let expected = "a positive number of units in a metre";
        let remedy = "correct it, or pass --depth-scale";
        return Err(Error::file(path, format!("a depth scale of {scale}"), expected, remedy));
    }
    Ok(if scale < 1.0 { scale.recip() } else { scale })
}

/// Intrinsics from their numbers alone, and whether they come with a distortion.
fn of_numbers(path: &Path, numbers: &[f64]) -> Result<(Intrinsics, bool)> {
    let bad = |found: String| Error::file(path, found, EXPECTED, REMEDY);
    let (intrinsics, distortion): (_, &[f64]) = match *numbers {
        // TUM and OpenCV: 1, 4 or 5 coefficients of distortion. Nine numbers are those if the first two,
        // the focal lengths, are alike: the second number of a matrix is zero.
        [fx, fy, cx, cy, ref d @ ..]
            if matches!(d.len(), 0 | 1 | 4) || (d.len() == 5 && fy.abs() > 0.5 * fx.abs()) =>
        {
            (Intrinsics { fx, fy, cx, cy }, d)
        }
        [a, b, c, d, e, f, g, h, i] => (of_matrix([a, b, c, d, e, f, g, h, i]).map_err(bad)?, &[]),
        // A 4×4 matrix is a 3×3 one in its corner.
        [a, b, c, p, d, e, f, q, g, h, i, r, s, t, u, v] => {
            if [p, q, r, s, t, u, v - 1.0].iter().any(|v| v.abs() > 1e-9) {
                return Err(bad(format!("a matrix {numbers:?}")));
            }
            (of_matrix([a, b, c, d, e, f, g, h, i]).map_err(bad)?, &[])
        }
        _ => return Err(bad(format!("{} numbers", numbers.len()))),
    };
    let Intrinsics { fx, fy, cx, cy } = intrinsics;
    if !(fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.is_finite())) {
        return Err(bad(format!("fx {fx} fy {fy} cx {cx} cy {cy}")));
    }
    Ok((intrinsics, distortion.iter().any(|d| *d != 0.0)))
}

/// A camera matrix by rows, or by columns as Open3D writes it: where the zeros stand tells which.
fn of_matrix([fx, b, c, d, fy, f, g, h, i]: [f64; 9]) -> Result<Intrinsics, String> {
    let zero = |values: &[f64]| values.iter().all(|v| v.abs() <= 1e-9);
    if zero(&[b, d, g, h, i - 1.0]) {
        Ok(Intrinsics { fx, fy, cx: c, cy: f })
    } else if zero(&[b, d, c, f, i - 1.0]) {
        Ok(Intrinsics { fx, fy, cx: g, cy: h })
    } else {
        Err(format!("a matrix [{fx} {b} {c}; {d} {fy} {f}; {g} {h} {i}]"))
    }
}

impl Camera {
    /// The intrinsics for images of this size, and what is worth saying of them.
    ///
    /// # Errors
    /// [`Error::File`] where the file has none, or states a size of another shape.
    pub(super) fn for_images(&self, width: usize, height: usize) -> Result<(Intrinsics, Vec<Note>)> {
        let mut k = self
            .intrinsics
            .ok_or_else(|| Error::file(&self.path, "a calibration without intrinsics", EXPECTED, REMEDY))?;
        let mut notes = Vec::new();
        let actual = [width as f64, height as f64];
        let of_color = self.path.file_name().is_some_and(|name| name == OF_COLOR_IMAGES);
        let guessed = of_color.then(|| larger_images(&k, actual)).flatten();
        if let Some(times) = guessed {
            k = scaled(&k, [times.recip(); 2]);
            notes.push(Note::warning(format!(
                "the principal point is that of images {times} times as large as depth images of \
                 {width}x{height}, and the intrinsics are scaled: if they are of others, pass --intrinsics"
            )));
        }
        if let Some(stated) = self.size.filter(|s| *s != actual) {
            if !same_aspect(stated, actual) {
                let found = format!("intrinsics for images of {}x{} pixels", stated[0], stated[1]);
                let expected = format!("those of images of {width}x{height} pixels, as the depth images are");
                let remedy = "give the intrinsics of the depth camera with --intrinsics";
                return Err(Error::file(&self.path, found, expected, remedy));
            }
            k = scaled(&k, [actual[0] / stated[0], actual[1] / stated[1]]);
            notes.push(Note::info(format!(
                "intrinsics for {}x{} pixels are scaled to depth images of {width}x{height}",
                stated[0], stated[1]
            )));
        }
        if self.distorted {
            notes.push(Note::warning(
                "the calibration states a lens distortion, which is not corrected: \
                 undistort the depth images for exact points",
            ));
        }
        // Intrinsics of the colour camera, or of images of another size.
        if !(0.0..=actual[0]).contains(&k.cx) || !(0.0..=actual[1]).contains(&k.cy) {
            notes.push(Note::warning(format!(
                "the principal point ({}, {}) lies outside of depth images of {width}x{height} pixels: \
                 check that the intrinsics are those of the depth camera",
                k.cx, k.cy
            )));
        }
        Ok((k, notes))
    }
}

/// The intrinsics of images of `s` times the size.
///
/// Pixel centres are at whole numbers, hence `cx' + ½ = s (cx + ½)`.
fn scaled(k: &Intrinsics, [sx, sy]: [f64; 2]) -> Intrinsics {
    Intrinsics { fx: sx * k.fx, fy: sy * k.fy, cx: sx * (k.cx + 0.5) - 0.5, cy: sy * (k.cy + 0.5) - 0.5 }
}

/// How many times as large the images are that the intrinsics are for, in halves, where the principal point
/// is too far out for depth images of this size and near the middle of larger ones of their shape.
fn larger_images(k: &Intrinsics, size: [f64; 2]) -> Option<f64> {
    let twice = [(2.0 * k.cx + 1.0) / size[0], (2.0 * k.cy + 1.0) / size[1]];
    let halves = twice.map(|times| (2.0 * times).round() / 2.0);
    let near = |at: usize| (twice[at] / halves[at] - 1.0).abs() < OFF_MIDDLE;
    // Twice the middle is the far edge.
    (k.cx > size[0] && k.cy > size[1] && halves[0] == halves[1] && near(0) && near(1)).then_some(halves[0])
}

/// Whether two sizes have the same shape but for rounding.
pub(super) fn same_aspect(a: [f64; 2], b: [f64; 2]) -> bool {
    let ratio = (a[0] * b[1]) / (a[1] * b[0]);
    (ratio - 1.0).abs() <= SAME_ASPECT
}

#[cfg(test)]
mod tests;
