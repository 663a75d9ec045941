//! PCD (Point Cloud Library): ASCII, binary and binary_compressed; organised clouds with NaN; colours.

pub(super) mod blocks;

use super::colors::channels_of;
use super::fields::whole_number_note;
use super::lzf;
use super::pcd_header::{CUT_SHORT, Color, Encoding, Header, Place, Places, parse_header};
use super::pcd_viewpoint::place_sensor;
use super::scalar::{Endian, Scalar, counted, parse_between_blanks, parse_number};
use super::scan_file::{ReadOptions, ScanFile, StoredScan};
use super::scanner::without_zeros;
use super::unpack_limit::UnpackLimit;
use super::vertices::Vertices;
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{Attributes, assemble_with};
use std::path::Path;

/// Reads the points (and colours, where there are any) of a PCD file's `bytes`.
///
/// # Errors
/// [`Error::File`] when the header cannot be used or disagrees with the data.
pub(super) fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    let mut header = parse_header(path, bytes)?;
    let data = &bytes[header.data_start..];
    header.settle_counts_of_zero(path, data)?;
    let stride = header.stride(path)?;
    let columnar = header.encoding == Encoding::Compressed;
    let mut places = header.places(path, stride, columnar)?;
    if !options.attributes {
        (places.intensity, places.normal) = (None, None);
    }
    let mut cloud = match header.encoding {
        Encoding::Ascii => read_ascii(path, data, &header, &places)?,
        Encoding::Binary => {
            check_rows(path, data, &header, stride)?;
            decode(data, header.points, &places)
        }
        Encoding::Compressed => {
            let limit = UnpackLimit::of_scan(options, bytes.len() as u64);
            let columns = decompress(path, data, limit)?;
            if stride.checked_mul(header.points) != Some(columns.len()) {
                return Err(short(path, &header, stride, columns.len()));
            }
            decode(&columns, header.points, &places)
        }
    };
    let pose = header.viewpoint.as_ref().and_then(|sensor| place_sensor(sensor, &mut cloud));
    let mut file = ScanFile::of(vec![StoredScan { cloud, pose }]);
    file.notes.extend(whole_number_note(places.xyz.map(|p| p.scalar), options));
    Ok(file)
}

fn unpack(bits: u32) -> [u8; 3] {
    let [_, r, g, b] = bits.to_be_bytes();
    [r, g, b]
}

fn short(path: &Path, header: &Header, stride: usize, found: usize) -> Error {
    let rows = found.checked_div(stride).unwrap_or(0);
    let needed = stride.checked_mul(header.points).map_or_else(|| "more".to_owned(), |n| n.to_string());
    Error::file(
        path,
        format!("{found} bytes of data with {rows} complete points"),
        format!("{needed} bytes with {} as its header says", counted(header.points, "point")),
        CUT_SHORT,
    )
}

fn check_rows(path: &Path, data: &[u8], header: &Header, stride: usize) -> Result<()> {
    let needed = stride.checked_mul(header.points).filter(|&n| n <= data.len());
    let Some(needed) = needed else { return Err(short(path, header, stride, data.len())) };
    // Padding with zeros up to a page is common; other bytes mean that the count is wrong.
    let rest = &data[needed..];
    if rest.len() >= stride.max(17) && rest.iter().any(|&b| b != 0) {
        return Err(Error::file(
            path,
            format!("{} bytes of data with {} complete points", data.len(), data.len() / stride.max(1)),
            format!("{needed} bytes with {} as its header says", counted(header.points, "point")),
            "correct POINTS, WIDTH and HEIGHT in the header or export the scan again",
        ));
    }
    Ok(())
}

/// Values at their places in memory; the caller has checked the length.
fn decode(data: &[u8], n: usize, places: &Places) -> PointCloud {
    let bytes = |i: usize, p: Place| data.get(p.first + i * p.step..).unwrap_or(&[]);
    let number = |i: usize, p: Place| p.scalar.read(bytes(i, p), Endian::Little);
    // Read as bits: a float whose alpha byte is 255 is NaN as a number.
    let packed = |i: usize, p: Place| unpack(bytes(i, p).first_chunk().map_or(0, |b| u32::from_le_bytes(*b)));
    let colors: Option<Vec<[u8; 3]>> = places.color.map(|color| match color {
        Color::Packed(p) => (0..n).map(|i| packed(i, p)).collect(),
        Color::Channels(c) => {
            let values: Vec<[f64; 3]> = (0..n).map(|i| c.map(|p| number(i, p))).collect();
            channels_of(&values, c[0].scalar)
        }
    });
    let rgb = colors.as_ref().map(|c| |i: usize| c[i]);
    let intensity = places.intensity.map(|p| move |i: usize| number(i, p) as f32);
    let normal = places.normal.map(|c| move |i: usize| c.map(|p| number(i, p) as f32));
    let attributes = Attributes {
        rgb: rgb.as_ref().map(|f| f as &dyn Fn(usize) -> [u8; 3]),
        intensity: intensity.as_ref().map(|f| f as &dyn Fn(usize) -> f32),
        normal: normal.as_ref().map(|f| f as &dyn Fn(usize) -> [f32; 3]),
    };
    assemble_with(n, without_zeros(n, |i| places.xyz.map(|p| number(i, p))), &attributes, None)
}

/// The columns of a binary_compressed body: compressed length, plain length, LZF stream.
fn decompress(path: &Path, data: &[u8], limit: UnpackLimit) -> Result<Vec<u8>> {
    let length = |at: usize| {
        let bytes = data.get(at..at + 4)?.first_chunk().copied()?;
        Some(u32::from_le_bytes(bytes) as usize)
    };
    let (Some(packed), Some(plain)) = (length(0), length(4)) else {
        return Err(Error::file(
            path,
            format!("{} bytes of data", data.len()),
            "two lengths before the compressed data",
            CUT_SHORT,
        ));
    };
    let Some(stream) = data.get(8..).and_then(|d| d.get(..packed)) else {
        return Err(Error::file(
            path,
            format!("{} bytes of compressed data", data.len() - 8),
            format!("{packed} bytes as its header says"),
            CUT_SHORT,
        ));
    };
    if plain as u64 > limit.bytes() {
        return Err(limit.exceeded(path, "points"));
    }
    lzf::decompress(stream, plain).map_err(|got| {
        let expected = format!("{plain} bytes as its header says");
        Error::file(
            path,
            format!("damaged compressed data after {got} bytes"),
            expected,
            "copy or export the file again",
        )
    })
}

fn read_ascii(path: &Path, data: &[u8], header: &Header, places: &Places) -> Result<PointCloud> {
    let text = String::from_utf8_lossy(data);
    let mut lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#')).peekable();
    // A further header that some writers put after the last line of the real one.
    if lines.peek().is_some_and(|line| line.starts_with("HEADER_EXT_START")) {
        lines.find(|line| line.starts_with("HEADER_EXT_END"));
    }
    let mut vertices = Vertices {
        intensity: places.intensity.map(|_| Vec::new()),
        normal: places.normal.map(|_| Vec::new()),
        ..Vertices::default()
    };
    let mut values: Vec<[f64; 3]> = Vec::new();
    let mut colors: Vec<[u8; 3]> = Vec::new();
    let mut colors_lost = false;
    let mut words: Vec<&str> = Vec::new();
    for row in 0..header.points {
        let Some(line) = lines.next() else {
            let expected = format!("{} rows as its header says", header.points);
            return Err(Error::file(path, format!("{row} rows"), expected, CUT_SHORT));
        };
        words.clear();
        words.extend(line.split_ascii_whitespace());
        let number = |p: Place| words.get(p.column).and_then(|w| parse_between_blanks(w));
        let bad = || bad_row(path, header, row, line);
        let three = |p: [Place; 3]| Some([number(p[0])?, number(p[1])?, number(p[2])?]);
        let xyz = three(places.xyz).ok_or_else(bad)?;
        vertices.xyz.push(xyz);
        match places.color {
            None => {}
            Some(Color::Packed(p)) => {
                let word = words.get(p.column).ok_or_else(bad)?;
                let bits = packed_bits(word, p.scalar).ok_or_else(bad)?;
                colors_lost |= bits.is_none() && xyz.iter().all(|v| v.is_finite());
                colors.push(unpack(bits.unwrap_or(0)));
            }
            Some(Color::Channels(c)) => values.push(three(c).ok_or_else(bad)?),
        }
        if let (Some(all), Some(p)) = (&mut vertices.intensity, places.intensity) {
            all.push(number(p).ok_or_else(bad)? as f32);
        }
        if let (Some(all), Some(p)) = (&mut vertices.normal, places.normal) {
            all.push(three(p).ok_or_else(bad)?.map(|v| v as f32));
        }
    }
    let more = lines.count();
    if more > 0 {
        let expected = format!("{} rows as its header says", header.points);
        let remedy = "correct POINTS, WIDTH and HEIGHT in the header or export the scan again";
        return Err(Error::file(path, format!("{} rows", header.points + more), expected, remedy));
    }
    vertices.rgb = places.color.filter(|_| !colors_lost).map(|color| match color {
        Color::Packed(_) => colors,
        Color::Channels(c) => channels_of(&values, c[0].scalar),
    });
    let xyz = without_zeros(vertices.xyz.len(), |i| vertices.xyz[i]);
    vertices.xyz = (0..vertices.xyz.len()).map(xyz).collect();
    Ok(vertices.into_cloud())
}

fn bad_row(path: &Path, header: &Header, row: usize, line: &str) -> Error {
    let found = format!("row {} '{}'", row + 1, line.chars().take(80).collect::<String>());
    let columns: usize = header.fields.iter().map(|f| f.count).sum();
    let remedy = "correct that row, or export the file again if it is cut short";
    Error::file(path, found, counted(columns, "number"), remedy)
}

/// The bits of a packed colour written as text: of the float, or of the integer. The inner value is `None`
/// where the colour is lost: a float with alpha 255 is written as nan.
fn packed_bits(word: &str, scalar: Scalar) -> Option<Option<u32>> {
    match scalar {
        Scalar::F32 if parse_number(word).is_some_and(f64::is_nan) => Some(None),
        Scalar::F32 => word.parse::<f32>().ok().map(|v| Some(v.to_bits())),
        _ => word.parse::<i64>().ok().map(|v| Some(v as u32)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Direction, Point};

    /// One point with a normal, an intensity and whole-number coordinates, by hand.
    fn one(data: &str, packed: &[u8]) -> Vec<u8> {
        let head = "FIELDS x y z normal_x normal_y normal_z intensity\nSIZE 4 4 4 4 4 4 4\n\
                    TYPE I I I F F F F\nWIDTH 1\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\n";
        [format!("{head}DATA {data}\n").as_bytes(), packed].concat()
    }

    #[test]
    fn intensities_and_normals_are_read_where_they_are_asked_for() {
        let rows: Vec<u8> = [1500i32, -20, 3]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .chain([0f32, 0.6, -0.8, 0.25].iter().flat_map(|v| v.to_le_bytes()))
            .collect();
        // One point in columns is the same bytes. LZF: one run of 28 literal bytes.
        let lzf = [&29u32.to_le_bytes()[..], &28u32.to_le_bytes(), &[27], &rows].concat();
        for bytes in [
            one("ascii", b"1500 -20 3 0 0.6 -0.8 0.25\n"),
            one("binary", &rows),
            one("binary_compressed", &lzf),
        ] {
            let all = ReadOptions { attributes: true, ..ReadOptions::default() };
            let file = read(Path::new("a.pcd"), &bytes, &all).unwrap();
            let cloud = &file.scans[0].cloud;
            assert_eq!(cloud.points, [Point::new(1500.0, -20.0, 3.0)]);
            assert_eq!(cloud.normals, Some(vec![Direction::new(0.0, 0.6, -0.8)]));
            assert_eq!(cloud.intensities, Some(vec![0.25]));
            assert!(file.notes[0].warning && file.notes[0].text.contains("--unit mm"));
            let bare = ReadOptions { unit_m: Some(1e-3), ..ReadOptions::default() };
            let file = read(Path::new("a.pcd"), &bytes, &bare).unwrap();
            assert!(file.notes.is_empty());
            assert_eq!((&file.scans[0].cloud.normals, &file.scans[0].cloud.intensities), (&None, &None));
        }
    }

    #[test]
    fn the_viewpoint_is_a_pose_where_the_points_are_in_the_frame_of_the_sensor() {
        // A quarter turn about z, and points around zero: the frame's x axis is the world's y axis.
        let half = 0.5f64.sqrt();
        let text = |points: &str| {
            format!(
                "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 4\nHEIGHT 1\n\
                 VIEWPOINT 104 52 1.5 {half} 0 0 {half}\nPOINTS 4\nDATA ascii\n{points}"
            )
        };
        let options = ReadOptions::default();
        let around_zero = text("1 0 0\n-1 0 0\n0 1 1\n0 -1 -1\n");
        let scan = read(Path::new("a.pcd"), around_zero.as_bytes(), &options).unwrap().scans.swap_remove(0);
        assert_eq!(scan.cloud.viewpoint, Some(Point::origin()));
        let moved = scan.pose.unwrap() * nalgebra::Point3::new(1.0, 0.0, 0.0);
        assert!((moved - nalgebra::Point3::new(104.0, 53.0, 1.5)).norm() < 1e-12, "{moved}");
        // The same points taken to the world.
        let in_world = text("104 53 1.5\n104 51 1.5\n103 52 2.5\n105 52 0.5\n");
        let scan = read(Path::new("a.pcd"), in_world.as_bytes(), &options).unwrap().scans.swap_remove(0);
        assert_eq!(scan.pose, None);
        let viewpoint = scan.cloud.viewpoint.unwrap().coords.cast::<f64>() + scan.cloud.origin_m;
        assert!((viewpoint - nalgebra::Vector3::new(104.0, 52.0, 1.5)).norm() < 1e-5, "{viewpoint}");
        // What is no rotation is no pose, and 100 m away no place to see a metre from.
        let broken = around_zero.replace(&format!("{half} 0 0 {half}"), "0 0 0 0");
        let scan = read(Path::new("a.pcd"), broken.as_bytes(), &options).unwrap().scans.swap_remove(0);
        assert_eq!((scan.pose, scan.cloud.viewpoint), (None, None));
    }

    /// A binary file with these fields, and the points of its only scan.
    fn points_of(head: &str, data: &[u8]) -> Result<Vec<Point>> {
        let bytes = [format!("{head}DATA binary\n").as_bytes(), data].concat();
        Ok(read(Path::new("a.pcd"), &bytes, &ReadOptions::default())?.scans.swap_remove(0).cloud.points)
    }

    #[test]
    fn padding_of_any_width_and_of_none() {
        let two = [Point::new(1.0, 2.0, 3.0), Point::new(4.0, 5.0, 6.0)];
        let head = |count: &str, stride: usize| {
            let fields = "FIELDS x y z _ ring _\nSIZE 4 4 4 1 2 1\nTYPE F F F U U U\n";
            let row = |p: &Point| [&p.x.to_le_bytes()[..], &p.y.to_le_bytes(), &p.z.to_le_bytes()].concat();
            let data: Vec<u8> = two
                .iter()
                .flat_map(|p| {
                    let mut row = row(p);
                    row.resize(stride, 0xee);
                    row
                })
                .collect();
            (format!("{fields}COUNT {count}\nWIDTH 2\nHEIGHT 1\nPOINTS 2\n"), data)
        };
        // 12 bytes of coordinates, 4 of padding, 2 of the ring, 10 of padding.
        for (count, stride) in [("1 1 1 4 1 10", 28), ("1 1 1 0 1 10", 25), ("1 1 1 0 1 10", 24)] {
            let (head, data) = head(count, stride);
            assert_eq!(points_of(&head, &data).unwrap(), two, "{count} {stride}");
        }
        let (head, data) = head("1 1 1 0 1 10", 23);
        assert!(points_of(&head, &data).unwrap_err().to_string().contains("46 bytes of data"));
    }

    #[test]
    fn a_further_header_decimal_commas_lost_colours_and_zeros() {
        let head = "VERSION 3.0      \nFIELDS x y z rgb\nSIZE 8 8 8 4\nTYPE F F F F\nWIDTH 4      \n\
                    HEIGHT 1      \nVIEWPOINT 0 0 0 1\nPOINTS 4      \nDATA ascii      \n";
        let more =
            "HEADER_EXT_START 6      \nSENSOR_TYPE VELODYNE_LIDAR      \nMODE None\nHEADER_EXT_END  \n";
        let cloud = |text: String| {
            read(Path::new("a.pcd"), text.as_bytes(), &ReadOptions::default())
                .unwrap()
                .scans
                .swap_remove(0)
                .cloud
        };
        // 0x00ff8000 as a float, and a value more than there are fields.
        let color = f32::from_bits(0x00ff_8000);
        let scan = cloud(format!("{head}{more}1,5 2 3 {color:e} 0\n0 0 0 0\n0 0 0 0\nnan nan nan nan\n"));
        assert_eq!(scan.points, [Point::new(1.5, 2.0, 3.0)]);
        assert_eq!((scan.colors, scan.dropped_rows), (Some(vec![[255, 128, 0]]), 3));
        // With alpha 255 the float is no number, and text does not keep its bits.
        let scan = cloud(format!("{head}1 2 3 nan\n4 5 6 -nan\n7 8 9 -nan(0x12)\n1 1 1 0\n"));
        assert_eq!((scan.len(), scan.colors), (4, None));
    }
}
