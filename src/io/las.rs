//! LAS and LAZ (airborne and terrestrial laser scans), with cargo feature `las`.

use super::assemble::{NO_COLORS, assemble};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use std::path::Path;

/// Reads a LAS or LAZ file; 16-bit colours are scaled to bytes.
pub(super) fn read(path: &Path) -> Result<PointCloud> {
    let damaged = |e: las::Error| {
        let remedy = "copy or export the file again";
        Error::file(path, format!("a LAS file that cannot be decoded ({e})"), "LAS 1.0 to 1.4 or LAZ", remedy)
    };
    let mut reader = las::Reader::from_path(path).map_err(damaged)?;
    let promised = reader.header().number_of_points();
    let data = reader.read_all().map_err(damaged)?;
    if data.len() as u64 != promised {
        let expected = format!("{promised} as its header says");
        return Err(Error::file(
            path,
            format!("{} points", data.len()),
            expected,
            "copy the file again: it is cut short",
        ));
    }
    let xyz: Vec<[f64; 3]> = data.x().zip(data.y()).zip(data.z()).map(|((x, y), z)| [x, y, z]).collect();
    let colors = data.rgb().map(|rgb| {
        let values: Vec<[u16; 3]> = rgb.map(|(r, g, b)| [r, g, b]).collect();
        // The standard asks for 16-bit colours; files with 8-bit values in them are common.
        let bytes = values.iter().flatten().all(|&v| v <= 255);
        let scale = |v: u16| if bytes { v as u8 } else { (v >> 8) as u8 };
        values.into_iter().map(|c| c.map(scale)).collect::<Vec<[u8; 3]>>()
    });
    let at = |i: usize| xyz[i];
    Ok(match colors {
        Some(colors) => assemble(xyz.len(), at, Some(|i: usize| colors[i]), None),
        None => assemble(xyz.len(), at, NO_COLORS, None),
    })
}
