//! Pickles are programs for Python: here nothing in them is called, and what is no tensor is not taken for one.

use super::overlap_head::sghr;
use crate::Error;
use std::io::{Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;

/// An archive as `torch.save` writes it: the pickle and one storage of two floats.
fn archive(pickle: &[u8]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let values: Vec<u8> = [1.0f32, 2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    for (name, bytes) in
        [("data.pkl", pickle), ("data/0", &values), ("version", b"3\n"), ("byteorder", b"little")]
    {
        let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        zip.start_file(format!("archive/{name}"), stored).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// A text as pickles of protocol 2 spell it.
fn text(text: &str) -> Vec<u8> {
    [b"X".as_slice(), &(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// The call `module.function(argument)`.
fn call(module: &str, function: &str, argument: &[u8]) -> Vec<u8> {
    [format!("c{module}\n{function}\n").as_bytes(), argument, b"\x85R"].concat()
}

/// A tensor of two values, of the storage "0".
fn tensor() -> Vec<u8> {
    let storage =
        [b"(", &*text("storage"), b"ctorch\nFloatStorage\n", &*text("0"), &*text("cpu"), b"K\x02tQ"];
    let built =
        [b"ctorch._utils\n_rebuild_tensor_v2\n(", &*storage.concat(), b"K\x00K\x02\x85K\x01\x85\x89}tR"];
    built.concat()
}

fn dictionary(key: &str, value: &[u8]) -> Vec<u8> {
    [b"\x80\x02}", &*text(key), value, b"s."].concat()
}

fn refused(path: &Path, bytes: &[u8]) -> String {
    std::fs::write(path, bytes).unwrap();
    let error = sghr(path, "fpfh").unwrap_err();
    assert!(matches!(&error, Error::File { path: named, .. } if named == path), "{error}");
    error.to_string()
}

#[test]
fn a_pickle_that_calls_something_is_refused_and_nothing_is_called() {
    let place = tempfile::tempdir().unwrap();
    let (path, made) = (place.path().join("head.pth"), place.path().join("made"));
    let command = text(&format!("touch '{}'", made.display()));
    for (module, function) in
        [("posix", "system"), ("os", "system"), ("builtins", "eval"), ("subprocess", "run")]
    {
        let alone = [b"\x80\x02", &*call(module, function, &command), b"."].concat();
        let in_place_of_a_tensor = dictionary("pool.centroids", &call(module, function, &command));
        for pickle in [alone, in_place_of_a_tensor] {
            for bytes in [archive(&pickle), pickle.clone()] {
                refused(&path, &bytes);
                assert!(!made.exists(), "{module}.{function} was called");
            }
        }
    }
}

#[test]
fn a_tensor_that_another_call_would_change_is_refused_and_a_plain_one_is_found() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("head.pth");
    // Found, as the next one is missed.
    let said = refused(&path, &archive(&dictionary("pool.centroids", &tensor())));
    assert!(said.contains("no conv.bias among the tensors [pool.centroids]"), "{said}");
    let said = refused(&path, &archive(&dictionary("pool.centroids", &call("numpy", "negative", &tensor()))));
    assert!(said.contains("something else") && said.contains("numpy.negative"), "{said}");
}
