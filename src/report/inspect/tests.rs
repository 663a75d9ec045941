use super::*;
use crate::geometry::Point;
use crate::scan::{Descriptors, Features};
use safetensors::tensor::{Dtype, TensorView};
use std::collections::HashMap;

fn inspected(path: &Path) -> Result<Vec<Finding>> {
    inspect(path, &ReadOptions::default())
}

fn write(folder: &Path, name: &str, content: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, content).unwrap();
    path
}

fn one(path: &Path) -> Content {
    inspected(path).unwrap().remove(0).content
}

#[test]
fn a_scan_tells_its_size_colour_box_and_spacing() {
    let place = tempfile::tempdir().unwrap();
    // A row of points 0.5 m apart, and one row that is not finite.
    let mut text = String::new();
    for i in 0..9 {
        text.push_str(&format!("{} -1 2 10 20 30\n", 0.5 * f64::from(i)));
    }
    text.push_str("nan 0 0 1 2 3\n");
    let path = write(place.path(), "row.xyz", text.as_bytes());
    let Content::Scan(scan) = one(&path) else { panic!("no scan") };
    assert_eq!((scan.points, scan.dropped_rows, scan.colors), (9, 1, true));
    assert_eq!(scan.box_m, Some([[0.0, -1.0, 2.0], [4.0, -1.0, 2.0]]));
    assert!((scan.spacing_m.unwrap() - 0.5).abs() < 1e-6);
    let table = super::text(&inspected(&path).unwrap(), Some(200));
    for part in ["row.xyz", "4.00 m × 0.00 mm × 0.00 mm", "50.0 cm", "yes", "points"] {
        assert!(table.contains(part), "{part} is missing in\n{table}");
    }
}

#[test]
fn features_and_clouds_in_archives_are_told_apart() {
    let place = tempfile::tempdir().unwrap();
    let keypoints = [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]].map(Point::from).to_vec();
    let descriptors = Descriptors::new(2, vec![0.6, -0.8, 0.0, 0.0]).unwrap();
    let path = place.path().join("f.npz");
    io::write_features(&path, &Features::new(keypoints, None, descriptors).unwrap()).unwrap();
    let Content::Features(features) = one(&path) else { panic!("no features") };
    assert_eq!((features.keypoints, features.dim, features.normals), (2, 2, false));
    assert_eq!((features.values, features.zero_descriptors), (Some([-0.8, 0.6]), 1));
    assert_eq!(features.box_m, Some([[0.0; 3], [1.0, 2.0, 3.0]]));
    let cloud = place.path().join("c.npz");
    let mut npz = ndarray_npy::NpzWriter::new(fs::File::create(&cloud).unwrap());
    npz.add_array("points", &ndarray::arr2(&[[1.0f32, 2.0, 3.0], [2.0, 2.0, 3.0]])).unwrap();
    npz.finish().unwrap();
    assert!(matches!(one(&cloud), Content::Scan(ScanContent { points: 2, .. })));
    // A folder is all that is in it.
    assert_eq!(inspected(place.path()).unwrap().len(), 2);
}

#[test]
fn a_shipped_checkpoint_is_told_with_its_papers_and_a_damaged_one_is_refused() {
    for name in ["netvlad-fpfh", "minispinnet"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("checkpoints/{name}.safetensors"));
        let Content::Checkpoint(found) = one(&path) else { panic!("no checkpoint") };
        assert!(found.ours && found.metadata.is_object());
        // A safetensors file is the length of its header, the header, and four bytes a number.
        let bytes = fs::read(&path).unwrap();
        let header = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        assert_eq!(8 + header + 4 * found.parameters, bytes.len());
        assert!(found.tensors.iter().all(|t| t.range.is_some_and(|[a, b]| a <= b) && t.not_finite == 0));
        let table = super::text(&inspected(&path).unwrap(), Some(160));
        assert!(table.contains("checksum right") && table.contains(&found.tensors[0].name), "{table}");
        // One flipped bit of the last number.
        let mut bytes = bytes;
        *bytes.last_mut().unwrap() ^= 1;
        let place = tempfile::tempdir().unwrap();
        let damaged = write(place.path(), "bad.safetensors", &bytes);
        assert!(inspected(&damaged).unwrap_err().to_string().contains("bad.safetensors"));
    }
}

#[test]
fn a_foreign_checkpoint_is_listed_as_it_is() {
    let place = tempfile::tempdir().unwrap();
    let values: Vec<u8> = [1.0f32, f32::NAN, -3.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let view = TensorView::new(Dtype::F32, vec![3], &values).unwrap();
    let info = HashMap::from([("author".to_owned(), "some\u{1b}[2Jone".to_owned())]);
    let bytes = safetensors::serialize([("w", view)], Some(info)).unwrap();
    let path = write(place.path(), "foreign.safetensors", &bytes);
    let Content::Checkpoint(found) = one(&path) else { panic!("no checkpoint") };
    assert!(!found.ours);
    let tensor = &found.tensors[0];
    assert_eq!((tensor.range, tensor.mean, tensor.not_finite), (Some([-3.0, 1.0]), Some(-1.0), 1));
    let table = super::text(&inspected(&path).unwrap(), Some(160));
    assert!(table.contains("author") && table.contains("not finite") && !table.contains('\u{1b}'), "{table}");
}

#[test]
fn what_cannot_be_read_is_one_error_that_names_it() {
    let place = tempfile::tempdir().unwrap();
    for (name, content) in [
        ("a.safetensors", &b"no"[..]),
        ("b.npz", b"PK\x03\x04"),
        ("c.ply", b"ply\n"),
        ("d.zip", b"\0\0"),
        ("poses.json", b"{}"),
    ] {
        let path = write(place.path(), name, content);
        let error = inspected(&path).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
        fs::remove_file(path).unwrap();
    }
    assert!(inspected(&place.path().join("none.ply")).unwrap_err().to_string().contains("none.ply"));
    assert!(inspected(place.path()).is_err());
}
