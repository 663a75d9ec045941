//! Lists of the TUM layout, and poses that lie beside depth images.

use super::frame::{Frame, Layout, SAME_TIME_S};
use crate::files;
use crate::geometry::RigidMotion;
use crate::geometry::rigid::motion_from_matrix;
use crate::io::poses::ORTHONORMAL_TOLERANCE;
use crate::io::scalar::parse_number;
use crate::io::scan_file::Note;
use nalgebra::{Matrix4, Quaternion, Translation3, UnitQuaternion};
use std::path::Path;

/// A line `time file` of `rgb.txt` or `depth.txt`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TimedFile {
    /// Seconds.
    pub time_s: f64,
    /// The file, relative to the list.
    pub file: String,
}

/// The lines `time file` of a list; none where there is no list.
pub(super) fn timed_files(list: &Path) -> Vec<TimedFile> {
    let text = files::read_text(list).unwrap_or_default();
    let lines = text.lines().filter(|l| !l.starts_with('#'));
    let timed = lines.filter_map(|line| {
        let (time, file) = line.trim().split_once(char::is_whitespace)?;
        Some(TimedFile { time_s: time.parse().ok()?, file: file.trim().to_owned() })
    });
    timed.collect()
}

/// The file nearest in time, the first of two that are as near.
pub(super) fn nearest(files: &[TimedFile], time_s: f64, within_s: f64) -> Option<&TimedFile> {
    let away = |f: &TimedFile| (f.time_s - time_s).abs();
    let nearest = files.iter().min_by(|a, b| away(a).total_cmp(&away(b)))?;
    (away(nearest) <= within_s).then_some(nearest)
}

/// `world_from_camera` that lies beside an image, and what is worth saying of it.
pub(super) fn pose_beside(frame: &Frame) -> (Option<RigidMotion>, Option<Note>) {
    if let Some(text) = frame.pose_file().and_then(|p| files::read_text(&p).ok()) {
        return pose_of_matrix(&text);
    }
    if frame.layout != Layout::Tum {
        return (None, None);
    }
    let text = files::read_text(&frame.above.join("groundtruth.txt")).unwrap_or_default();
    (frame.time_s().and_then(|time_s| pose_at(&text, time_s)), None)
}

/// A pose of 16 numbers by rows. Frames that a tracker lost have NaN or infinity there: no pose.
fn pose_of_matrix(text: &str) -> (Option<RigidMotion>, Option<Note>) {
    let numbers: Option<Vec<f64>> = text.split_whitespace().map(parse_number).collect();
    let numbers = numbers.filter(|n| n.len() == 16);
    if numbers.as_ref().is_some_and(|n| n.iter().any(|v| !v.is_finite())) {
        return (None, None);
    }
    let motion = numbers
        .and_then(|n| motion_from_matrix(&Matrix4::from_row_slice(&n), ORTHONORMAL_TOLERANCE))
        .map(|(motion, _)| motion);
    let note = Note::warning(
        "pose files beside depth images that are not a rigid motion of 4x4 numbers are left out",
    );
    (motion, motion.is_none().then_some(note))
}

/// The pose nearest in time among lines `time tx ty tz qx qy qz qw`.
fn pose_at(text: &str, time_s: f64) -> Option<RigidMotion> {
    let away = |time: f64| (time - time_s).abs();
    let mut nearest: Option<(f64, &str)> = None;
    for line in text.lines().map(str::trim).filter(|l| !l.starts_with('#')) {
        let Some(time) = line.split_whitespace().next().and_then(|w| w.parse::<f64>().ok()) else { continue };
        if away(time) <= SAME_TIME_S && nearest.is_none_or(|(best, _)| away(time) < away(best)) {
            nearest = Some((time, line));
        }
    }
    let numbers: Option<Vec<f64>> = nearest?.1.split_whitespace().map(parse_number).collect();
    let [_, tx, ty, tz, qx, qy, qz, qw] = numbers?[..] else { return None };
    let rotation = Quaternion::new(qw, qx, qy, qz);
    let finite = [tx, ty, tz].iter().all(|v| v.is_finite());
    // Listed with 4 digits, a quaternion is of length one to within 1e-3.
    let unit = (rotation.norm() - 1.0).abs() < 1e-2;
    (finite && unit).then(|| {
        RigidMotion::from_parts(Translation3::new(tx, ty, tz), UnitQuaternion::from_quaternion(rotation))
    })
}
