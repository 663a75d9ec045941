//! Intrinsics for images of another size than theirs.

use super::intrinsics::{Camera, CameraMatrix, EXPECTED, REMEDY};
use crate::error::{Error, Result};
use crate::io::scan_file::Note;

/// Relative difference of two aspect ratios that still counts as the same. ScanNet's 1296×968 colour
/// and 640×480 depth differ by 0.4 %.
pub(super) const SAME_ASPECT: f64 = 0.01;
/// The file of Stray Scanner, which is for its colour images: they are larger than its depth images.
const OF_COLOR_IMAGES: &str = "camera_matrix.csv";
/// Principal points of phones lie off the middle of the image by less than this share of its size.
const OFF_MIDDLE: f64 = 0.03;

impl Camera {
    /// The intrinsics for images of this size, and what is worth saying of them.
    ///
    /// # Errors
    /// [`Error::File`] where the file has none, or states a size of another shape.
    pub(super) fn for_images(&self, width: usize, height: usize) -> Result<(CameraMatrix, Vec<Note>)> {
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
fn scaled(k: &CameraMatrix, [sx, sy]: [f64; 2]) -> CameraMatrix {
    CameraMatrix { fx: sx * k.fx, fy: sy * k.fy, cx: sx * (k.cx + 0.5) - 0.5, cy: sy * (k.cy + 0.5) - 0.5 }
}

/// How many times as large the images are that the intrinsics are for, in halves, where the principal point
/// is too far out for depth images of this size and near the middle of larger ones of their shape.
fn larger_images(k: &CameraMatrix, size: [f64; 2]) -> Option<f64> {
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
