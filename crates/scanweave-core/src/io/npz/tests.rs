use super::*;
use crate::geometry::{Direction, Point};
use ndarray::{Array1, Array2, array};
use ndarray_npy::NpzWriter;
use std::io::Write;
use zip::CompressionMethod;
use zip::write::SimpleFileOptions;

type Writer = NpzWriter<Cursor<Vec<u8>>>;

fn npz(fill: impl FnOnce(&mut Writer)) -> Vec<u8> {
    let mut npz = NpzWriter::new_compressed(Cursor::new(Vec::new()));
    fill(&mut npz);
    npz.finish().unwrap().into_inner()
}

fn read_npz(bytes: &[u8]) -> Result<ScanFile> {
    read(Path::new("a.npz"), bytes, &ReadOptions { attributes: true, ..ReadOptions::default() })
}

fn two() -> Vec<Point> {
    vec![Point::new(1.0, 2.0, 3.0), Point::new(4.0, 5.0, 6.0)]
}

#[test]
fn coordinates_may_stand_in_arrays_of_their_own() {
    let bytes = npz(|npz| {
        for (key, values) in
            [("x", [1.0f32, 4.0]), ("y", [2.0, 5.0]), ("z", [3.0, 6.0]), ("intensity", [0.5, 7.0])]
        {
            npz.add_array(key, &Array1::from(values.to_vec())).unwrap();
        }
        for key in ["r", "g", "b"] {
            npz.add_array(key, &array![1u8, 200]).unwrap();
        }
        npz.add_array("other", &array![[1.0f64, 2.0, 3.0]]).unwrap();
    });
    let cloud = read_npz(&bytes).unwrap().scans.swap_remove(0).cloud;
    assert_eq!((cloud.points, cloud.colors), (two(), Some(vec![[1; 3], [200; 3]])));
    assert_eq!(cloud.intensities, Some(vec![0.5, 7.0]));
    let uneven = npz(|npz| {
        npz.add_array("x", &array![1.0f32, 2.0]).unwrap();
        npz.add_array("y", &array![1.0f32, 2.0]).unwrap();
        npz.add_array("z", &array![1.0f32]).unwrap();
    });
    assert!(matches!(read_npz(&uneven), Err(Error::NotAScan { .. })));
}

#[test]
fn colours_and_normals_of_the_points_are_taken_where_they_are_as_many() {
    let points = array![[1.0f32, 2.0, 3.0], [4.0, 5.0, 6.0]];
    let bytes = npz(|npz| {
        npz.add_array("points", &points).unwrap();
        npz.add_array("colors", &array![[0.0f32, 0.5, 1.0], [1.0, 0.0, 0.0]]).unwrap();
        npz.add_array("normals", &array![[0.0f32, 0.0, 1.0], [0.0, 1.0, 0.0]]).unwrap();
    });
    let cloud = read_npz(&bytes).unwrap().scans.swap_remove(0).cloud;
    assert_eq!((cloud.points, cloud.colors), (two(), Some(vec![[0, 128, 255], [255, 0, 0]])));
    assert_eq!(cloud.normals, Some(vec![Direction::z(), Direction::y()]));
    let fewer = npz(|npz| {
        npz.add_array("points", &points).unwrap();
        npz.add_array("colors", &array![[0.0f32, 0.5, 1.0]]).unwrap();
    });
    assert_eq!(read_npz(&fewer).unwrap().scans[0].cloud.colors, None);
}

#[test]
fn without_a_known_name_the_only_array_of_points_is_taken() {
    let with = |second: &Array2<f32>| {
        npz(|npz| {
            npz.add_array("scan", &array![[1.0f32, 2.0, 3.0], [4.0, 5.0, 6.0]]).unwrap();
            npz.add_array("time", second).unwrap();
        })
    };
    let cloud = read_npz(&with(&array![[1.0], [2.0]])).unwrap().scans.swap_remove(0).cloud;
    assert_eq!(cloud.points, two());
    let said = read_npz(&with(&array![[1.0, 2.0, 3.0]])).unwrap_err();
    assert!(
        matches!(&said, Error::NotAScan { found, .. } if found.contains("arrays [scan, time]")),
        "{said}"
    );
}

/// An archive whose entry has this header, and so many zeros after it.
fn zeros(key: &str, header: &str, bytes: usize) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    // Little enough to be found in the archive is stored as it is.
    let method = if bytes < 1000 { CompressionMethod::Stored } else { CompressionMethod::Deflated };
    zip.start_file(format!("{key}.npy"), SimpleFileOptions::default().compression_method(method)).unwrap();
    zip.write_all(b"\x93NUMPY\x01\x00").unwrap();
    zip.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
    zip.write_all(header.as_bytes()).unwrap();
    zip.write_all(&vec![0; bytes]).unwrap();
    zip.finish().unwrap().into_inner()
}

#[test]
fn an_entry_is_unpacked_as_far_as_its_shape_needs() {
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }";
    let bytes = zeros("points", header, 1 << 24);
    let path = Path::new("a.npz");
    let unpacked = Archive::open(path, &bytes).unwrap().unpack("points").unwrap().unwrap();
    // Its header, the 24 bytes of six numbers, and one more.
    assert_eq!(unpacked.len(), 10 + header.len() + 24 + 1);
    assert_eq!(read_npz(&bytes).unwrap().scans[0].cloud.len(), 2);
    // A shape beyond the entry is refused before anything is unpacked.
    let said =
        read_npz(&zeros("points", &header.replace("2, 3", "99999999, 3"), 24)).unwrap_err().to_string();
    assert!(said.contains("array 'points': 24 bytes of data, expected 1199999988 bytes"), "{said}");
    // What no header begins is not unpacked at all.
    let mut archive = zeros("points", "", 1 << 24);
    assert!(read_npz(&archive).unwrap_err().to_string().contains("no NPY array"));
    // One bit of the data turned over, as the checksum tells.
    archive = zeros("points", header, 24);
    let at = archive.windows(header.len()).position(|w| w == header.as_bytes()).unwrap() + header.len();
    archive[at] ^= 1;
    let said = read_npz(&archive).unwrap_err().to_string();
    assert!(said.contains("a damaged array 'points'"), "{said}");
}
