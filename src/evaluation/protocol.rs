//! The evaluation protocols of the literature, by name.

use super::recall::RecallConfig;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub enum Protocol {
    /// Registration recall at 0.2 m over pairs that overlap by more than 0.3.
    #[serde(rename = "3dmatch")]
    ThreeDMatch,
    /// Registration recall at 0.2 m over pairs that overlap by 0.1 to 0.3.
    #[serde(rename = "3dlomatch")]
    ThreeDLoMatch,
    /// Registration recall at 0.5 m.
    #[serde(rename = "eth")]
    Eth,
    /// Distributions of the errors of all relative poses.
    #[serde(rename = "scannet")]
    Scannet,
}

impl Protocol {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::ThreeDMatch, Self::ThreeDLoMatch, Self::Eth, Self::Scannet];

    /// Name in files and flags.
    pub fn name(self) -> &'static str {
        match self {
            Self::ThreeDMatch => "3dmatch",
            Self::ThreeDLoMatch => "3dlomatch",
            Self::Eth => "eth",
            Self::Scannet => "scannet",
        }
    }

    /// The protocol of that name.
    ///
    /// # Errors
    /// [`Error::Setting`] naming all there are.
    pub fn parse(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|p| p.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::setting("protocol", format!("`{name}`"), format!("one of {names}"), "use one of these")
        })
    }

    /// How its recall counts; `None` for the protocol that has none.
    pub fn recall(self, reference_quirks: bool) -> Option<RecallConfig> {
        match self {
            Self::ThreeDMatch | Self::ThreeDLoMatch => {
                Some(RecallConfig { reference_quirks, ..RecallConfig::default() })
            }
            Self::Eth => Some(RecallConfig { reference_quirks, ..RecallConfig::eth() }),
            Self::Scannet => None,
        }
    }

    /// Error from which a pose is wrong when failures are looked into, metres.
    pub fn wrong_beyond_m(self) -> f64 {
        self.recall(false).unwrap_or_default().threshold_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_files_and_thresholds_those_of_the_field() {
        for p in Protocol::ALL {
            assert_eq!(Protocol::parse(p.name()).unwrap(), p);
            assert_eq!(serde_json::to_value(p).unwrap(), p.name());
        }
        assert!(
            Protocol::parse("kitti").unwrap_err().to_string().contains("3dmatch, 3dlomatch, eth, scannet")
        );
        let threshold = |p: Protocol| p.recall(false).map(|c| c.threshold_m);
        assert_eq!(Protocol::ALL.map(threshold), [Some(0.2), Some(0.2), Some(0.5), None]);
        assert!(Protocol::Eth.recall(true).unwrap().reference_quirks);
    }
}
