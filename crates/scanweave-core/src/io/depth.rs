//! Depth images as single-frame scans.

use super::scalar::parse_number;
use crate::error::{Error, Result};
use crate::scan::assemble::{NO_COLORS, assemble};
use crate::scan::{self, PointCloud};
use std::fs;
use std::io::Cursor;
use std::path::Path;

/// Units of a depth PNG in a metre where nothing else is said: millimetres.
pub const UNITS_PER_M: f32 = 1000.0;

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

/// A depth image: distance along the optical axis, 0 and 65535 for no measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height·width]`, row-major.
    pub values: Vec<u16>,
}

impl DepthImage {
    /// Back-projects every measured pixel: z = d/depth_scale, x = (u−cx)·z/fx, y = (v−cy)·z/fy,
    /// with pixel centres at whole u, v. The camera, at the origin, is the viewpoint.
    ///
    /// `depth_scale` is in units a metre (1000 for millimetres). Pixels without a measurement
    /// count as dropped rows.
    ///
    /// # Errors
    /// [`Error::Setting`] when the scale or a focal length is not positive.
    pub fn to_cloud(&self, intrinsics: &Intrinsics, depth_scale: f32) -> Result<PointCloud> {
        let Intrinsics { fx, fy, cx, cy } = *intrinsics;
        for (key, value) in [("depth scale", f64::from(depth_scale)), ("fx", fx), ("fy", fy)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::setting(
                    key,
                    value.to_string(),
                    "a positive number",
                    "check the camera's calibration",
                ));
            }
        }
        let scale = f64::from(depth_scale);
        let at = |i: usize| match self.values[i] {
            0 | u16::MAX => [f64::NAN; 3],
            d => {
                let z = f64::from(d) / scale;
                let (u, v) = ((i % self.width) as f64, (i / self.width) as f64);
                [(u - cx) * z / fx, (v - cy) * z / fy, z]
            }
        };
        Ok(assemble(self.values.len(), at, NO_COLORS, Some([0.0; 3])))
    }

    /// The image in metres with its camera; `depth_scale` is in units a metre.
    pub fn to_metric(&self, intrinsics: &Intrinsics, depth_scale: f32) -> scan::DepthImage {
        let Intrinsics { fx, fy, cx, cy } = *intrinsics;
        let metres = |d: &u16| if matches!(*d, 0 | u16::MAX) { 0.0 } else { f32::from(*d) / depth_scale };
        scan::DepthImage {
            intrinsics: scan::Intrinsics { width: self.width, height: self.height, fx, fy, cx, cy },
            depth_m: self.values.iter().map(metres).collect(),
        }
    }
}

/// Reads a 16-bit depth PNG in millimetres, with the intrinsics found beside it.
///
/// # Errors
/// Those of [`read_depth_png`] and [`find_intrinsics`].
pub fn read_frame(path: impl AsRef<Path>) -> Result<scan::DepthImage> {
    let intrinsics = find_intrinsics(path.as_ref())?;
    Ok(read_depth_png(path)?.to_metric(&intrinsics, UNITS_PER_M))
}

/// Reads a 16-bit greyscale PNG.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for a damaged PNG or another pixel type.
pub fn read_depth_png(path: impl AsRef<Path>) -> Result<DepthImage> {
    let path = path.as_ref();
    decode_depth_png(path, &fs::read(path).map_err(|e| Error::read(path, e))?)
}

pub(super) fn decode_depth_png(path: &Path, bytes: &[u8]) -> Result<DepthImage> {
    let damaged = |e: String| {
        Error::file(
            path,
            format!("a damaged PNG ({e})"),
            "a 16-bit greyscale PNG",
            "copy or export the image again",
        )
    };
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().map_err(|e| damaged(e.to_string()))?;
    let (color, depth) = reader.output_color_type();
    if (color, depth) != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        let found = format!("a PNG of {color:?} pixels, {} bits a channel", depth as u8);
        let remedy = "give the depth image, not the colour image, saved with 16 bits";
        return Err(Error::file(path, found, "16-bit greyscale depth", remedy));
    }
    let size = reader.output_buffer_size().ok_or_else(|| damaged("too large".to_owned()))?;
    let mut buffer = vec![0; size];
    let info = reader.next_frame(&mut buffer).map_err(|e| damaged(e.to_string()))?;
    let (pairs, _) = buffer[..info.buffer_size()].as_chunks::<2>();
    Ok(DepthImage {
        width: info.width as usize,
        height: info.height as usize,
        values: pairs.iter().map(|b| u16::from_be_bytes(*b)).collect(),
    })
}

/// Reads pinhole intrinsics: `fx fy cx cy` (four numbers), or a 3×3 camera matrix (nine).
/// Commas and `#` comments are allowed.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] when the numbers are neither, the matrix is skewed, or a focal
/// length is not positive.
pub fn read_intrinsics(path: impl AsRef<Path>) -> Result<Intrinsics> {
    let path = path.as_ref();
    let text = fs::read(path).map_err(|e| Error::read(path, e))?;
    let text = String::from_utf8_lossy(&text);
    let words = text.lines().map(|l| l.split('#').next().unwrap_or(""));
    let words =
        words.flat_map(|l| l.split(|c: char| c.is_whitespace() || matches!(c, ',' | ';' | '[' | ']')));
    let numbers: Option<Vec<f64>> = words.filter(|w| !w.is_empty()).map(parse_number).collect();
    let bad = |found: String| {
        let expected = "'fx fy cx cy' or a 3x3 camera matrix 'fx 0 cx / 0 fy cy / 0 0 1', in pixels";
        Error::file(path, found, expected, "write the camera's intrinsics in one of these forms")
    };
    let intrinsics = match numbers.as_deref() {
        Some(&[fx, fy, cx, cy]) => Intrinsics { fx, fy, cx, cy },
        Some(&[fx, skew, cx, zero, fy, cy, a, b, one]) => {
            if [skew, zero, a, b, one - 1.0].iter().any(|v| v.abs() > 1e-9) {
                return Err(bad(format!("a matrix [{fx} {skew} {cx}; {zero} {fy} {cy}; {a} {b} {one}]")));
            }
            Intrinsics { fx, fy, cx, cy }
        }
        Some(other) => return Err(bad(format!("{} numbers", other.len()))),
        None => return Err(bad("text that is not numbers".to_owned())),
    };
    let Intrinsics { fx, fy, cx, cy } = intrinsics;
    if !(fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.is_finite())) {
        return Err(bad(format!("fx {fx} fy {fy} cx {cx} cy {cy}")));
    }
    Ok(intrinsics)
}

/// Names under which intrinsics are looked for beside a depth image and one folder up.
const INTRINSICS_FILES: [&str; 5] =
    ["K.txt", "camera-intrinsics.txt", "intrinsics.txt", "camera_intrinsics.txt", "intrinsic.txt"];

/// Intrinsics from `K.txt`, `camera-intrinsics.txt`, `intrinsics.txt`, … beside `image` or one folder up.
///
/// # Errors
/// [`Error::File`] naming the image when there is none; those of [`read_intrinsics`].
pub fn find_intrinsics(image: &Path) -> Result<Intrinsics> {
    let beside = image.parent().unwrap_or(Path::new(""));
    let folders = [beside.to_path_buf(), beside.join("..")];
    let candidates = folders.into_iter().flat_map(|f| INTRINSICS_FILES.map(|n| f.join(n)));
    match candidates.into_iter().find(|p| p.is_file()) {
        Some(path) => read_intrinsics(path),
        None => Err(Error::file(
            image,
            "a depth image without camera intrinsics",
            "K.txt or camera-intrinsics.txt beside it or one folder up",
            "write 'fx fy cx cy' in pixels to a file K.txt beside the images",
        )),
    }
}
