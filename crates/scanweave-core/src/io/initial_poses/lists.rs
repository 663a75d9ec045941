//! Formats of a pose a line.

use super::{Entry, Poses};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::io::poses::{self, bad_line, lines, motion_from_quaternion, numbers, read_text};
use crate::io::trajectories::trajectory_names_file;
use std::path::Path;

/// A Redwood trajectory.
pub(super) fn read_log(path: &Path) -> Result<Poses> {
    let entry = |e: poses::LogEntry| {
        if e.i != e.j {
            let found = format!("an entry of the pair '{} {}'", e.i, e.j);
            let expected = "a trajectory, whose entries name one scan twice";
            return Err(Error::file(path, found, expected, "name a file of poses, not of pairs"));
        }
        Ok(Entry { key: e.i as u64, pose: e.pose, at: format!("entry '{} {} {}'", e.i, e.j, e.n) })
    };
    Ok(Poses::Numbered(poses::read_log(path)?.value.into_iter().map(entry).collect::<Result<_>>()?))
}

pub(super) fn read_tum(path: &Path) -> Result<Poses> {
    let text = read_text(path)?;
    let numbers = lines(&text).map(|l| l.0);
    let entry = |((key, pose), line): ((f64, RigidMotion), usize)| match key.is_finite() {
        true => Ok(Entry { key, pose, at: format!("line {line}") }),
        false => {
            let found = format!("the timestamp {key} in line {line}");
            Err(Error::file(path, found, "a finite number", "correct that line or write the file again"))
        }
    };
    let entries = poses::read_tum(path)?.value.into_iter().zip(numbers).map(entry);
    Ok(Poses::Stamped(entries.collect::<Result<_>>()?))
}

/// KITTI, with the names of the lines' scans where they lie beside it.
pub(super) fn read_kitti(path: &Path) -> Result<Poses> {
    let poses = poses::read_kitti(path)?.value;
    let beside = trajectory_names_file(path);
    if !beside.is_file() {
        return Ok(Poses::Ordered(poses));
    }
    let text = read_text(&beside)?;
    let names: Vec<&str> = text.lines().map(str::trim).filter(|l| !l.is_empty()).collect();
    if names.len() != poses.len() {
        let expected = format!("{}, one for each pose of {}", poses.len(), path.display());
        let remedy = "remove it if it does not belong to these poses";
        return Err(Error::file(beside, format!("{} names", names.len()), expected, remedy));
    }
    let entry = |(k, (name, pose)): (usize, (&str, RigidMotion))| Entry {
        key: vec![name.to_owned()],
        pose,
        at: format!("pose {} by {}", k + 1, beside.display()),
    };
    Ok(Poses::Named(names.into_iter().zip(poses).enumerate().map(entry).collect()))
}

/// The vertices of a g2o graph; everything else in it is passed over.
pub(super) fn read_g2o(path: &Path, text: &str) -> Result<Poses> {
    let entry = |line: (usize, &str)| {
        let rest = line.1.strip_prefix("VERTEX_SE3:QUAT")?.trim();
        let parsed = rest.split_once(char::is_whitespace).and_then(|(id, pose)| {
            let v = numbers(pose).filter(|v| v.len() == 7)?;
            Some((id.parse().ok()?, motion_from_quaternion(&v[..3], &v[3..])?.0))
        });
        let parsed = parsed.ok_or_else(|| {
            bad_line(path, line, "'VERTEX_SE3:QUAT id x y z qx qy qz qw' with a unit quaternion")
        });
        Some(parsed.map(|(key, pose)| Entry { key, pose, at: format!("line {}", line.0) }))
    };
    Ok(Poses::Numbered(lines(text).filter_map(entry).collect::<Result<_>>()?))
}

/// An image of COLMAP: `scan_from_world` turned round, and the name, which may have spaces.
fn image(line: &str) -> Option<(RigidMotion, String)> {
    let mut rest = line.trim();
    let mut word = || {
        let (word, after) = rest.split_once(char::is_whitespace)?;
        rest = after.trim_start();
        Some(word)
    };
    word()?.parse::<u64>().ok()?;
    let mut values = [0.0; 7];
    for value in &mut values {
        *value = word()?.parse().ok()?;
    }
    word()?.parse::<u64>().ok()?;
    let [qw, qx, qy, qz, tx, ty, tz] = values;
    let (pose, _) = motion_from_quaternion(&[tx, ty, tz], &[qx, qy, qz, qw])?;
    (!rest.is_empty()).then(|| (pose.inverse(), rest.to_owned()))
}

/// Whether a line could be an image of COLMAP.
pub(super) fn is_image(line: &str) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    words.len() >= 10 && words[..9].iter().all(|w| w.parse::<f64>().is_ok())
}

/// COLMAP `images.txt`: after every image a line of its points, which may be empty.
pub(super) fn read_images(path: &Path, text: &str) -> Result<Poses> {
    let mut entries = Vec::new();
    let mut after_image = false;
    for (number, line) in text.lines().enumerate().map(|(k, l)| (k + 1, l.trim())) {
        if line.starts_with('#') {
            continue;
        }
        let points = |l: &str| numbers(l).is_some_and(|n| n.len() % 3 == 0);
        if line.is_empty() || (after_image && points(line)) {
            after_image = false;
            continue;
        }
        let expected = "'IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME' with a unit quaternion";
        let (pose, name) = image(line).ok_or_else(|| bad_line(path, (number, line), expected))?;
        entries.push(Entry { key: vec![name], pose, at: format!("line {number}") });
        after_image = true;
    }
    Ok(Poses::Named(entries))
}
