//! Agreement with independent golden values. Needs `SCANWEAVE_DATA`.

mod real_common;

use ndarray::Array2;
use ndarray_npy::NpzReader;
use real_common::beside_data;
use scanweave::Silent;
use scanweave::geometry::Point;
use scanweave::retrieval::{self, RetrievalConfig};
use scanweave::scan::{Descriptors, Features};
use scanweave::weight_import as import;

/// A folder beside the data, or `None` when the variable is unset.
fn largest_gap(got: &[f32], expected: &[f64]) -> f64 {
    assert_eq!(got.len(), expected.len());
    got.iter().zip(expected).map(|(g, e)| (f64::from(*g) - e).abs()).fold(0.0, f64::max)
}

fn read(npz: &mut NpzReader<std::fs::File>, name: &str) -> Array2<f64> {
    match npz.by_name::<ndarray::OwnedRepr<f64>, ndarray::Ix2>(name) {
        Ok(array) => array,
        Err(_) => {
            let single: Array2<f32> = npz.by_name(name).unwrap();
            single.mapv(f64::from)
        }
    }
}

/// The reference is numpy in double precision; ours is single precision, agreement to 1e-5.
#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn imported_netvlad_agrees_with_the_reference() {
    let reference = beside_data("reference/netvlad_sghr.npz");
    let weights = beside_data("weights/sghr/netvlad_yoho.pth");
    let checkpoint = import::sghr(&weights, "yoho").unwrap();
    assert_eq!(checkpoint.meta.descriptor.dim, 32);
    let mut npz = NpzReader::new(std::fs::File::open(reference).unwrap()).unwrap();
    let features: Vec<Features> = (0..6)
        .map(|i| {
            let rows = read(&mut npz, &format!("descriptors_{i}"));
            let (n, dim) = rows.dim();
            let values: Vec<f32> = rows.iter().map(|&v| v as f32).collect();
            let descriptors = Descriptors::new(dim, values).unwrap();
            Features::new(vec![Point::origin(); n], None, descriptors).unwrap()
        })
        .collect();
    let scans: Vec<&Descriptors> = features.iter().map(|f| &f.descriptors).collect();
    let layer = checkpoint.weights.head();
    let global: Vec<Vec<f32>> =
        retrieval::global_features(&layer, &scans, &Silent).unwrap().into_iter().flatten().collect();
    let expected = read(&mut npz, "global_features");
    let gap = largest_gap(&global.concat(), expected.as_slice().unwrap());
    assert!(gap < 1e-5, "global features differ by {gap}");
    let fused = retrieval::fuse(&global, 3, 0.5, &Silent).unwrap();
    let gap = largest_gap(&fused.concat(), read(&mut npz, "fused").as_slice().unwrap());
    assert!(gap < 1e-5, "fused features differ by {gap}");
    let config = RetrievalConfig::default();
    let (s, origin) = retrieval::similarity_of(&features, &config, Some(&checkpoint), 0, &Silent).unwrap();
    let rows: Vec<f32> = (0..6).flat_map(|i| s.row(i).to_vec()).collect();
    let gap = largest_gap(&rows, read(&mut npz, "similarity").as_slice().unwrap());
    assert!(gap < 1e-5, "similarity differs by {gap}");
    assert_eq!(origin.to_string(), "trained checkpoint netvlad-yoho-sghr");
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn a_foreign_file_is_refused_with_its_tensors_named() {
    let other = beside_data("weights/buffer/threedmatch_desc.pth");
    let message = import::imvr(&other, "yoho").unwrap_err().to_string();
    assert!(message.contains("no centroids among the tensors"), "{message}");
    let text = beside_data("reference/README.md");
    let message = import::sghr(&text, "yoho").unwrap_err().to_string();
    assert!(message.contains("found something else"), "{message}");
}
