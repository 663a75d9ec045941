//! MiniSpinNet with the published weights against reference values, on real patches.
//!
//! `reference/` and `weights/` lie beside the folder that `SCANWEAVE_DATA` names.

mod real_common;

use ndarray::{Array1, Array2, Array3};
use ndarray_npy::NpzReader;
use real_common::beside_data;
use scanweave::descriptor::mini_spin_net::{Network, Patch, Workspace};
use scanweave::weight_import::buffer;
use std::fs::File;

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn descriptors_of_the_published_weights_equal_the_reference() {
    let reference = beside_data("reference/minispinnet.npz");
    let weights = beside_data("weights/buffer/threedmatch_desc.pth");
    let mut npz = NpzReader::new(File::open(reference).unwrap()).unwrap();
    let points: Array3<f32> = npz.by_name("patches.npy").unwrap();
    let counts: Array1<i32> = npz.by_name("counts.npy").unwrap();
    let expected: Array2<f32> = npz.by_name("descriptors.npy").unwrap();
    let patches: Vec<Patch> = points
        .outer_iter()
        .zip(&counts)
        .map(|(rows, &count)| {
            let mut patch = Patch::default();
            patch.fill(rows.outer_iter().take(count as usize).map(|p| [p[0], p[1], p[2]]));
            patch
        })
        .collect();
    let network = Network::new(&buffer(&weights).unwrap().weights);
    let mut values = vec![0.0; patches.len() * 32];
    network.describe(&patches, &mut Workspace::default(), &mut values);
    let worst = values.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0f32, f32::max);
    eprintln!("{} patches, largest difference {worst:e}", patches.len());
    assert!(worst < 1e-4, "{worst}");
}
