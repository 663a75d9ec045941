//! The trained heads that come with the program.

use super::{Checkpoint, DescriptorTag};
use crate::error::Result;
use std::path::Path;

/// File and content of every head, in the repository's `checkpoints/`.
const HEADS: [(&str, &[u8]); 2] = [
    ("netvlad-fpfh.safetensors", include_bytes!("../../checkpoints/netvlad-fpfh.safetensors")),
    ("netvlad-minispinnet.safetensors", include_bytes!("../../checkpoints/netvlad-minispinnet.safetensors")),
];

/// The head for a descriptor: of its name, dimension and settings; `None` when there is none.
///
/// # Errors
/// None for a program that was built whole.
pub fn head_for(descriptor: &DescriptorTag) -> Result<Option<Checkpoint>> {
    for (file, bytes) in HEADS {
        let checkpoint = Checkpoint::from_bytes(Path::new(file), bytes)?;
        if checkpoint.meta.descriptor == *descriptor {
            return Ok(Some(checkpoint));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::descriptor::{Describer, DescriptorConfig, DescriptorKind, WorkingScale};

    #[test]
    fn the_head_fits_the_default_descriptor_at_every_scale_and_no_other() {
        for voxel_m in [0.0013, 0.02, 0.025, 0.031, 0.17] {
            let scale = WorkingScale::from_voxel(voxel_m);
            let fpfh = Describer::new(&DescriptorConfig::default()).unwrap();
            let settings_hash = fpfh.settings_hash(&scale);
            let tag = DescriptorTag { name: "fpfh".into(), dim: 33, settings_hash };
            let head = head_for(&tag).unwrap().expect("a head for the default descriptor");
            assert_eq!((head.meta.name.as_str(), head.weights.dim()), ("netvlad-fpfh", 33));
            // It must not carry the optimiser's state around.
            assert!(head.optimizer.is_none());
            let wider = WorkingScale { feature_radius_m: 2.0 * scale.feature_radius_m, ..scale };
            let settings_hash = fpfh.settings_hash(&wider);
            assert_eq!(head_for(&DescriptorTag { settings_hash, ..tag.clone() }).unwrap(), None);
            assert_eq!(head_for(&DescriptorTag { dim: 32, ..tag }).unwrap(), None);
        }
    }

    #[test]
    fn the_shipped_network_beside_fpfh_has_a_head_and_other_weights_have_none() {
        let file = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("checkpoints").join(name);
        let config = DescriptorConfig {
            kind: DescriptorKind::MiniSpinNetFpfh,
            checkpoint: Some(file("minispinnet.safetensors")),
            ..DescriptorConfig::default()
        };
        let describer = Describer::new(&config).unwrap();
        let settings_hash = describer.settings_hash(&WorkingScale::from_voxel(0.025));
        let tag = DescriptorTag { name: "mini-spin-net-fpfh".into(), dim: 65, settings_hash };
        let head = head_for(&tag).unwrap().expect("a head for the shipped network");
        assert_eq!((head.meta.name.as_str(), head.weights.dim()), ("netvlad-mini-spin-net-fpfh", 65));
        assert!(head.optimizer.is_none());
        let alone =
            Describer::new(&DescriptorConfig { kind: DescriptorKind::MiniSpinNet, ..config }).unwrap();
        let settings_hash = alone.settings_hash(&WorkingScale::from_voxel(0.025));
        assert_eq!(head_for(&DescriptorTag { settings_hash, ..tag }).unwrap(), None);
    }
}
