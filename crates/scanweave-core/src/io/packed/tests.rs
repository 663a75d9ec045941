use super::*;
use crate::io::{ReadOptions, ScanFile, read_file};
use std::io::{Cursor, Write};

const PLY: &[u8] = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
                     property float z\nend_header\n1 2 3\n4 5 6\n";
const XYZ: &[u8] = b"1 2 3\n4 5 6\n7 8 9\n1 0 0\n0 1 0\n0 0 1\n2 5 1\n3 3 3\n7 1 4\n5 2 6\n9 8 2\n4 4 1\n";

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packed.write_all(content).unwrap();
    packed.finish().unwrap()
}

fn archive(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in entries {
        let options =
            zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
        writer.start_file(*name, options).unwrap();
        writer.write_all(content).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn read(name: &str, bytes: &[u8]) -> Result<ScanFile> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    read_file(&path, &ReadOptions::default())
}

fn points(name: &str, bytes: &[u8]) -> usize {
    read(name, bytes).unwrap().scans[0].cloud.len()
}

fn failure(name: &str, bytes: &[u8]) -> String {
    let message = read(name, bytes).unwrap_err().to_string();
    assert!(message.contains(name), "{message}");
    message
}

#[test]
fn one_scan_in_a_packed_file() {
    assert_eq!(points("a.ply.gz", &gzip(PLY)), 2);
    // The name inside tells plain text; the content tells everything else.
    assert_eq!(points("a.xyz.GZ", &gzip(XYZ)), 12);
    assert_eq!(points("a.gz", &gzip(PLY)), 2);
    // A gzip file may be several, one after the other.
    assert_eq!(points("a.xyz.gz", &[gzip(XYZ), gzip(XYZ)].concat()), 24);
    assert_eq!(points("a.zip", &archive(&[("scans/a.xyz", XYZ)])), 12);
    let mac =
        archive(&[("readme.md", b"notes"), ("a.ply", PLY), ("__MACOSX/._a.ply", b"x"), (".b.ply", b"x")]);
    assert_eq!(points("a.zip", &mac), 2);
    // Where there is one file only, its name need not tell.
    assert_eq!(points("a.zip", &archive(&[("a.txt", XYZ)])), 12);
}

#[test]
fn files_of_scanners_are_read_from_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    let mut writer = ::las::Writer::from_path(&path, ::las::Header::default()).unwrap();
    (0..3).for_each(|i| writer.write_point(::las::Point { x: f64::from(i), ..Default::default() }).unwrap());
    writer.close().unwrap();
    let las = std::fs::read(&path).unwrap();
    assert_eq!(points("a.las.gz", &gzip(&las)), 3);
    assert_eq!(points("a.zip", &archive(&[("a.las", &las)])), 3);
}

#[test]
fn archives_of_arrays_stay_npz() {
    let mut npz = ndarray_npy::NpzWriter::new(Cursor::new(Vec::new()));
    npz.add_array("points", &ndarray::array![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]).unwrap();
    npz.add_array("weights", &ndarray::array![1.0, 2.0]).unwrap();
    let npz = npz.finish().unwrap().into_inner();
    assert_eq!(points("a.npz", &npz), 2);
    assert_eq!(points("a.zip", &npz), 2);
    assert_eq!(points("a.npz.gz", &gzip(&npz)), 2);
}

#[test]
fn archives_without_one_scan_list_what_they_hold() {
    let several = archive(&[("a.ply", PLY), ("notes.md", b"x"), ("b.ply", PLY)]);
    assert!(failure("a.zip", &several).contains("an archive of 2 scans (a.ply, b.ply)"));
    let none = archive(&[
        ("1.md", b"x"),
        ("2.md", b"x"),
        ("3.md", b"x"),
        ("4.md", b"x"),
        ("5.md", b"x"),
        ("6.md", b"x"),
    ]);
    let error = read("a.zip", &none).unwrap_err();
    assert!(matches!(error, Error::NotAScan { .. }));
    assert!(error.to_string().contains("an archive of 6 files (1.md, 2.md, 3.md, 4.md, 5.md, …)"), "{error}");
    assert!(failure("a.zip", &archive(&[])).contains("an archive of 0 files ()"));
}

#[test]
fn content_that_is_no_scan_is_refused_by_its_first_bytes() {
    assert!(failure("a.ply.gz", &gzip(&gzip(PLY))).contains("packed once"));
    assert!(failure("a.zip", &archive(&[("a.ply.gz", &gzip(PLY))])).contains("packed once"));
    let mut tar = vec![0; 1024];
    tar[257..262].copy_from_slice(b"ustar");
    assert!(failure("a.tar.gz", &gzip(&tar)).contains("a tar archive"));
    assert!(failure("a.ply.gz", &gzip(b"")).contains("an empty file"));
    assert!(failure("a.ply.gz", &gzip(&vec![0; 1 << 20])).contains("begins with"));
    let packed = gzip(PLY);
    assert!(failure("a.ply.gz", &packed[..packed.len() - 12]).contains("cannot be unpacked"));
    let packed = archive(&[("a.ply", PLY)]);
    assert!(failure("a.zip", &packed[..packed.len() - 30]).contains("a damaged archive"));
}

#[test]
fn more_than_the_limit_is_not_unpacked() {
    let content = [b"1 2 3\n".as_slice(), &[b' '; 9000]].concat();
    let unpack_to = |content: &mut dyn Read, mib: u64| {
        let options = ReadOptions { unpack_limit_mib: Some(mib), ..ReadOptions::default() };
        let limit = UnpackLimit::of_scan(&options, 0);
        unpack(Path::new("a.xyz.gz"), Path::new("a.xyz"), content, limit).map(|bytes| bytes.len())
    };
    // Exactly a MiB, and one byte more.
    let spaces = (1 << 20) - content.len() as u64;
    let padded = |more: u64| content.as_slice().chain(std::io::repeat(b' ').take(spaces + more));
    assert_eq!(unpack_to(&mut padded(0), 1).unwrap(), 1 << 20);
    let said = unpack_to(&mut padded(1), 1).unwrap_err().to_string();
    assert!(said.contains("content of more than 1 MiB when unpacked"), "{said}");
    assert_eq!(unpack_to(&mut padded(1), 2).unwrap(), (1 << 20) + 1);
    // Content without an end.
    assert!(unpack_to(&mut b"1 2 3\n".chain(std::io::repeat(b' ')), 1).is_err());
}
