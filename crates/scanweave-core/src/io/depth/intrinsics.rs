//! Pinhole intrinsics in the forms in which cameras and data sets state them.

use super::camera_keys::{Keys, words};
use crate::error::{Error, Result};
use crate::files;
use crate::io::scalar::parse_number;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Pinhole camera without distortion, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraMatrix {
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
    pub intrinsics: Option<CameraMatrix>,
    /// Columns and rows of the images that the intrinsics are for.
    pub size: Option<[f64; 2]>,
    /// Units of depth in a metre.
    pub units_per_m: Option<f64>,
    /// Whether it states a lens distortion.
    pub distorted: bool,
}

/// Calibration files are small: a larger file is something else, and is not read to its end.
const LARGEST_FILE: u64 = 1 << 20;

/// Extension of the files of ARKitScenes, `width height fx fy cx cy`.
pub(super) const SIZED_EXTENSION: &str = "pincam";

pub(super) const EXPECTED: &str =
    "'fx fy cx cy' or a 3x3 camera matrix 'fx 0 cx / 0 fy cy / 0 0 1', in pixels";
pub(super) const REMEDY: &str = "write the camera's intrinsics in one of these forms";

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
pub fn read_intrinsics(path: impl AsRef<Path>) -> Result<CameraMatrix> {
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
    let file = files::open(path)?;
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
fn of_numbers(path: &Path, numbers: &[f64]) -> Result<(CameraMatrix, bool)> {
    let bad = |found: String| Error::file(path, found, EXPECTED, REMEDY);
    let (intrinsics, distortion): (_, &[f64]) = match *numbers {
        // TUM and OpenCV: 1, 4 or 5 coefficients of distortion. Nine numbers are those if the first two,
        // the focal lengths, are alike: the second number of a matrix is zero.
        [fx, fy, cx, cy, ref d @ ..]
            if matches!(d.len(), 0 | 1 | 4) || (d.len() == 5 && fy.abs() > 0.5 * fx.abs()) =>
        {
            (CameraMatrix { fx, fy, cx, cy }, d)
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
    let CameraMatrix { fx, fy, cx, cy } = intrinsics;
    if !(fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.is_finite())) {
        return Err(bad(format!("fx {fx} fy {fy} cx {cx} cy {cy}")));
    }
    Ok((intrinsics, distortion.iter().any(|d| *d != 0.0)))
}

/// A camera matrix by rows, or by columns as Open3D writes it: where the zeros stand tells which.
fn of_matrix([fx, b, c, d, fy, f, g, h, i]: [f64; 9]) -> Result<CameraMatrix, String> {
    let zero = |values: &[f64]| values.iter().all(|v| v.abs() <= 1e-9);
    if zero(&[b, d, g, h, i - 1.0]) {
        Ok(CameraMatrix { fx, fy, cx: c, cy: f })
    } else if zero(&[b, d, c, f, i - 1.0]) {
        Ok(CameraMatrix { fx, fy, cx: g, cy: h })
    } else {
        Err(format!("a matrix [{fx} {b} {c}; {d} {fy} {f}; {g} {h} {i}]"))
    }
}

#[cfg(test)]
mod tests;
