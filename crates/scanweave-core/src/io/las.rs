//! LAS and LAZ (airborne and terrestrial laser scans).

use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{NO_COLORS, assemble};
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

#[cfg(test)]
mod tests {
    use crate::io::read_cloud;

    #[test]
    fn las_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        for (name, compressed) in [("a.las", false), ("a.laz", true)] {
            let path = dir.path().join(name);
            let mut builder = ::las::Builder::from((1, 2));
            builder.point_format = ::las::point::Format::new(2).unwrap();
            builder.point_format.is_compressed = compressed;
            let transform = |offset: f64| ::las::Transform { scale: 0.001, offset };
            builder.transforms =
                ::las::Vector { x: transform(431_000.0), y: transform(5_812_000.0), z: transform(0.0) };
            let mut writer = ::las::Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
            for i in 0..10 {
                writer
                    .write_point(::las::Point {
                        x: 431_250.123 + f64::from(i),
                        y: 5_812_345.678,
                        z: 12.5,
                        color: Some(::las::Color::new(0xff00, 0x8000, 0)),
                        ..Default::default()
                    })
                    .unwrap();
            }
            writer.close().unwrap();
            let cloud = read_cloud(&path).unwrap();
            assert_eq!(cloud.origin_m, nalgebra::Vector3::new(431_300.0, 5_812_300.0, 0.0));
            assert_eq!(cloud.colors, Some(vec![[255, 128, 0]; 10]));
            let back = cloud.points[3].coords.cast::<f64>() + cloud.origin_m;
            // The file's own step is 1 mm.
            assert!(
                (back - nalgebra::Vector3::new(431_253.123, 5_812_345.678, 12.5)).amax() < 6e-4,
                "{back}"
            );
        }
    }
}
