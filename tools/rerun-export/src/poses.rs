//! poses.json, as far as a recording shows it.

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;
use std::path::Path;

/// The verdict on every scan.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Poses {
    format: String,
    version: u32,
    /// Scans that were joined; poses of different components are unrelated.
    pub components: Vec<Component>,
    /// One entry a scan.
    pub scans: Vec<Entry>,
}

/// Scans with poses in one frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Component {
    /// Its scans.
    pub scans: Vec<usize>,
}

/// One scan.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Entry {
    /// Short unique name.
    pub name: String,
    /// What became of it.
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// What became of a scan.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "outcome", rename_all = "lowercase")]
pub enum Outcome {
    /// It has a pose.
    Placed {
        /// Index into the components.
        component: usize,
        /// Growth step at which it joined.
        step: i64,
        /// Takes coordinates of the scan to those of the component, row by row.
        world_from_scan: [[f64; 4]; 4],
        /// The rotation again.
        quaternion_xyzw: [f64; 4],
        /// The scan that it joined.
        parent: Option<usize>,
        /// Matches with the model at that step.
        matches: usize,
        /// Those that agree on the pose.
        inliers: usize,
    },
    /// It has none.
    Declined {
        /// Why.
        explanation: String,
    },
}

/// Reads poses.json.
///
/// # Errors
/// A file that cannot be read, is of another kind or version, or contradicts itself.
pub fn read_poses(path: &Path) -> Result<Poses> {
    let place = path.display();
    let text = std::fs::read_to_string(path).with_context(|| {
        format!("{place}: cannot read it; name the output folder of `scanweave register`")
    })?;
    let poses: Poses = serde_json::from_str(&text)
        .with_context(|| format!("{place}: no poses.json of `scanweave register`"))?;
    ensure!(
        poses.format == "scanweave-poses" && poses.version == 2,
        "{place}: {} of version {}; expected scanweave-poses of version 2",
        poses.format,
        poses.version
    );
    let known = |i: usize| i < poses.scans.len();
    for entry in &poses.scans {
        let Outcome::Placed { component, parent, .. } = &entry.outcome else { continue };
        if *component >= poses.components.len() || parent.is_some_and(|p| !known(p)) {
            bail!("{place}: the scan {} is in a component or has a parent that is not there", entry.name);
        }
    }
    Ok(poses)
}
