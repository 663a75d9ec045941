//! What is logged where.

use crate::Written;
use crate::merged::Merged;
use crate::poses::{Outcome, Poses};
use anyhow::{Result, bail, ensure};
use re_sdk::{EntityPath, EntityPathPart, RecordingStream};
use re_sdk_types::archetypes::{LineStrips3D, Points3D, TextLog, Transform3D};
use re_sdk_types::components::Color;
use re_sdk_types::components::TextLogLevel;
use re_sdk_types::datatypes::Quaternion;

/// Timeline of the growth.
const STEP: &str = "step";
/// Colour of the lines of the growth tree.
const GREY: [u8; 3] = [140; 3];

/// The colour of a scan, as in Scanweave's own pictures: hues a golden angle apart stay distinct
/// for any number of scans.
pub fn colour(scan: usize) -> [u8; 3] {
    let hue = (scan as f64 * 137.508).rem_euclid(360.0) / 60.0;
    [5.0, 3.0, 1.0].map(|n| {
        let k: f64 = (n + hue).rem_euclid(6.0);
        (255.0 * 0.8 * (1.0 - 0.75 * k.min(4.0 - k).clamp(0.0, 1.0))).round() as u8
    })
}

/// An entity below `world/model_N`; names are taken as they are, whatever they hold.
fn entity(component: usize, more: &[&str]) -> EntityPath {
    let model = format!("model_{}", component + 1);
    let parts = ["world", model.as_str()].into_iter().chain(more.iter().copied());
    EntityPath::new(parts.map(|part| EntityPathPart::new(part.to_owned())).collect())
}

/// Logs a result: at the step at which a scan joined, its pose and its points in its own frame
/// under `world/model_N/scans/<name>`, the line to its parent under `world/model_N/growth/<name>` and a
/// line of text under `log`; after the last step, why scans were left out.
///
/// # Errors
/// Points of a scan that has no pose in their component; a recording that cannot be written.
pub fn record(stream: &RecordingStream, poses: &Poses, merged: &[Merged]) -> Result<Written> {
    let points = points_of_scans(poses, merged)?;
    let mut written = Written { placed: 0, declined: 0, points: 0 };
    let mut last = 0;
    for (scan, entry) in poses.scans.iter().enumerate() {
        let Outcome::Placed { component, step, world_from_scan, quaternion_xyzw, parent, matches, inliers } =
            &entry.outcome
        else {
            continue;
        };
        (written.placed, last) = (written.placed + 1, last.max(*step));
        stream.set_time_sequence(STEP, *step);
        let place = entity(*component, &["scans", &entry.name]);
        let at = position(world_from_scan);
        let rotation = Quaternion(quaternion_xyzw.map(|v| v as f32));
        stream.log(place.clone(), &Transform3D::from_translation_rotation(at, rotation))?;
        let [r, g, b] = colour(scan);
        if !points[scan].is_empty() {
            let own = Points3D::new(points[scan].iter().copied()).with_colors([Color::from_rgb(r, g, b)]);
            stream.log(place, &own)?;
            written.points += points[scan].len();
        }
        let said = match parent.map(|p| &poses.scans[p]) {
            None => format!("{} begins model {}", entry.name, component + 1),
            Some(other) => {
                if let Outcome::Placed { world_from_scan, .. } = &other.outcome {
                    let [r, g, b] = GREY;
                    let line = LineStrips3D::new([[position(world_from_scan), at]]);
                    stream.log(
                        entity(*component, &["growth", &entry.name]),
                        &line.with_colors([Color::from_rgb(r, g, b)]),
                    )?;
                }
                format!("{} joins {}: {inliers} of {matches} matches agree", entry.name, other.name)
            }
        };
        stream.log("log", &TextLog::new(said).with_level(TextLogLevel::INFO))?;
    }
    stream.set_time_sequence(STEP, last);
    for entry in &poses.scans {
        let Outcome::Declined { explanation } = &entry.outcome else { continue };
        written.declined += 1;
        let said = format!("{} was left out: {explanation}", entry.name);
        stream.log("log", &TextLog::new(said).with_level(TextLogLevel::WARN))?;
    }
    Ok(written)
}

fn position(world_from_scan: &[[f64; 4]; 4]) -> [f32; 3] {
    [0, 1, 2].map(|r| world_from_scan[r][3] as f32)
}

/// The points of every scan in its own frame: Rᵀ (p − t) of those in the frame of the component.
fn points_of_scans(poses: &Poses, merged: &[Merged]) -> Result<Vec<Vec<[f32; 3]>>> {
    let mut points = vec![Vec::new(); poses.scans.len()];
    for (at, cloud) in merged.iter().enumerate() {
        for (p, &scan) in cloud.points.iter().zip(&cloud.scans) {
            let pose = match poses.scans.get(scan).map(|entry| &entry.outcome) {
                Some(Outcome::Placed { component, world_from_scan, .. }) if *component == at => {
                    world_from_scan
                }
                _ => {
                    bail!(
                        "the merged cloud of model {} has points of the scan {scan}, which has no pose in it: register again",
                        at + 1
                    )
                }
            };
            let off = [0, 1, 2].map(|r| p[r] - pose[r][3]);
            let own = [0, 1, 2].map(|c| (0..3).map(|r| pose[r][c] * off[r]).sum::<f64>() as f32);
            ensure!(own.iter().all(|v| v.is_finite()), "a point of the scan {scan} that is not finite");
            points[scan].push(own);
        }
    }
    Ok(points)
}
