//! The trained heads that come with the program.

use super::{Checkpoint, DescriptorTag};
use crate::error::Result;
use std::path::Path;

/// File and content of every head, in the repository's `checkpoints/`.
const HEADS: [(&str, &[u8]); 2] = [
    ("netvlad-fpfh.safetensors", include_bytes!("../../../../checkpoints/netvlad-fpfh.safetensors")),
    (
        "netvlad-minispinnet.safetensors",
        include_bytes!("../../../../checkpoints/netvlad-minispinnet.safetensors"),
    ),
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
    use crate::descriptor::{Describer, DescriptorConfig, DescriptorKind};
    use crate::scan::WorkingScale;

    /// The tag of a descriptor at a scale, by the same text as a registration.
    fn tag(config: &DescriptorConfig, dim: usize, scale: &WorkingScale) -> DescriptorTag {
        let settings_hash = Describer::new(config).unwrap().settings_hash(scale);
        DescriptorTag { name: config.descriptor_name().into(), dim, settings_hash }
    }

    #[test]
    fn a_head_fits_its_descriptor_at_every_scale_and_no_other() {
        let of = |kind| DescriptorConfig { kind, ..DescriptorConfig::default() };
        let fpfh = (of(DescriptorKind::Fpfh), "netvlad-fpfh", 33);
        let default = (DescriptorConfig::default(), "netvlad-mini-spin-net-fpfh", 65);
        for (config, name, dim) in [fpfh, default] {
            for voxel_m in [0.0013, 0.02, 0.025, 0.031, 0.17] {
                let scale = WorkingScale::from_voxel(voxel_m);
                let head = head_for(&tag(&config, dim, &scale)).unwrap().expect(name);
                assert_eq!((head.meta.name.as_str(), head.weights.dim()), (name, dim));
                // It must not carry the optimiser's state around.
                assert!(head.optimizer.is_none());
                let wider = WorkingScale { feature_radius_m: 2.0 * scale.feature_radius_m, ..scale };
                assert_eq!(head_for(&tag(&config, dim, &wider)).unwrap(), None);
                assert_eq!(head_for(&tag(&config, dim - 1, &scale)).unwrap(), None);
            }
        }
        let alone = tag(&of(DescriptorKind::MiniSpinNet), 32, &WorkingScale::from_voxel(0.025));
        assert_eq!(head_for(&alone).unwrap(), None);
    }

    #[test]
    fn the_shipped_network_named_as_a_file_is_the_built_in_one() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../checkpoints/minispinnet.safetensors");
        let named = DescriptorConfig { checkpoint: Some(file), ..DescriptorConfig::default() };
        let scale = WorkingScale::from_voxel(0.025);
        assert_eq!(tag(&named, 65, &scale), tag(&DescriptorConfig::default(), 65, &scale));
    }
}
