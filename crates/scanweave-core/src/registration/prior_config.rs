//! Settings of what is known of poses before any scan is compared.

use crate::error::{Error, Result};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// An axis of the coordinates of the files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Axis {
    /// +x
    #[serde(rename = "x")]
    X,
    /// +y
    #[serde(rename = "y")]
    Y,
    /// +z
    #[serde(rename = "z")]
    Z,
    /// −x
    #[serde(rename = "-x")]
    MinusX,
    /// −y, as in the frame of a camera whose image is upright
    #[serde(rename = "-y")]
    MinusY,
    /// −z
    #[serde(rename = "-z")]
    MinusZ,
}

impl Axis {
    /// As a unit vector.
    pub fn direction(self) -> Vector3<f64> {
        match self {
            Axis::X => Vector3::x(),
            Axis::Y => Vector3::y(),
            Axis::Z => Vector3::z(),
            Axis::MinusX => -Vector3::x(),
            Axis::MinusY => -Vector3::y(),
            Axis::MinusZ => -Vector3::z(),
        }
    }
}

/// What is known of poses before any scan is compared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct PriorConfig {
    /// Whether the rough poses that files state, or that were given with them, are used.
    pub initial_poses: bool,
    /// Standard deviation of a rough position along each axis, metres; ten inlier radii where not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_deviation_m: Option<f64>,
    /// Standard deviation of a rough rotation about each axis, degrees.
    pub rotation_deviation_deg: f64,
    /// Which axis of the coordinates of every file points up, where that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<Axis>,
    /// Standard deviation of that axis about each horizontal direction, degrees: 10 for scanners that
    /// stand or are held roughly upright, 1 for levelled ones.
    pub tilt_deviation_deg: f64,
}

impl Default for PriorConfig {
    fn default() -> Self {
        Self {
            initial_poses: false,
            position_deviation_m: None,
            rotation_deviation_deg: 10.0,
            up: None,
            tilt_deviation_deg: 10.0,
        }
    }
}

impl PriorConfig {
    /// Whether anything is known.
    pub fn is_in_use(&self) -> bool {
        self.initial_poses || self.up.is_some()
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        let positive = |key: &str, value: f64| match value > 0.0 && value.is_finite() {
            true => Ok(()),
            false => Err(Error::setting(
                format!("registration.prior.{key}"),
                value.to_string(),
                "a positive number",
                "give the deviation that is expected, not none",
            )),
        };
        positive("position_deviation_m", self.position_deviation_m.unwrap_or(1.0))?;
        positive("rotation_deviation_deg", self.rotation_deviation_deg)?;
        positive("tilt_deviation_deg", self.tilt_deviation_deg)
    }
}
