//! MiniSpinNet with the published weights against reference values, on real patches.
//!
//! `SCANWEAVE_DATA` names the data folder; `reference/` and `weights/` lie beside it.

use ndarray::{Array1, Array2, Array3};
use ndarray_npy::NpzReader;
use scanweave::descriptor::mini_spin_net::{Network, Patch, Workspace};
use scanweave::weight_import::mini_spin_net::buffer;
use std::fs::File;
use std::path::PathBuf;

fn beside_data(path: &str) -> Option<PathBuf> {
    let Some(data) = std::env::var_os("SCANWEAVE_DATA") else {
        eprintln!("skipped: SCANWEAVE_DATA is not set");
        return None;
    };
    let found = PathBuf::from(data).join("..").join(path);
    assert!(found.exists(), "{} is missing", found.display());
    Some(found)
}

#[test]
fn descriptors_of_the_published_weights_equal_the_reference() {
    let Some(reference) = beside_data("reference/minispinnet.npz") else { return };
    let Some(weights) = beside_data("weights/buffer/threedmatch_desc.pth") else { return };
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
