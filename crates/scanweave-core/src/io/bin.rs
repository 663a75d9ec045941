//! Bare rows of single-precision numbers: KITTI (x y z intensity) and nuScenes (x y z intensity ring).
//!
//! Such a file has no header. It is taken for a scan only where its numbers leave no doubt.

use super::scan_file::{Note, ReadOptions, ScanFile};
use super::scanner::without_zeros;
use crate::error::{Error, Result};
use crate::scan::assemble::{Attributes, assemble_with};
use std::path::Path;

/// Coordinates of a sensor on a vehicle are far below; numbers of another type read as `f32` are mostly not.
const LARGEST_M: f32 = 1e5;
/// Intensities are fractions or bytes.
const LARGEST_INTENSITY: f32 = 255.0;
/// More rings than any spinning sensor has.
const RINGS: f32 = 256.0;
/// Every second or third row of a scan spans about as much as the others. Where rows are twice or three
/// times as long, it holds scores or flags, which span far less.
const ALIKE: f32 = 20.0;
/// Fewest rows of each kind to compare.
const FEWEST_ALIKE: usize = 16;
/// A scan is wider than this. Whole numbers read as `f32` are about 1e-43.
const LEAST_EXTENT_M: f32 = 0.01;

/// Reads rows relative to the sensor, which is the viewpoint.
///
/// # Errors
/// [`Error::NotAScan`] for content that is neither layout.
pub(super) fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    if let Some(rows) = rows::<4>(bytes).filter(|rows| like_kitti(rows)) {
        return Ok(cloud(&rows, options, "a .bin file is read as float32 rows x y z intensity (KITTI)"));
    }
    if let Some(rows) = rows::<5>(bytes).filter(|rows| like_nuscenes(rows)) {
        return Ok(cloud(
            &rows,
            options,
            "a .bin file is read as float32 rows x y z intensity ring (nuScenes)",
        ));
    }
    Err(Error::not_a_scan(
        path,
        format!("a .bin file of {} bytes that are no rows of a scan", bytes.len()),
        "little-endian float32 rows x y z intensity (KITTI) or x y z intensity ring (nuScenes), \
         coordinates in metres, intensities from 0 to 255",
        "convert it to PLY, or with NumPy: \
         numpy.save('scan.npy', numpy.fromfile('scan.bin', numpy.float32).reshape(-1, COLUMNS)[:, :3])",
    ))
}

/// Rows of `N` numbers, where they fill the file.
fn rows<const N: usize>(bytes: &[u8]) -> Option<Vec<[f32; N]>> {
    let (numbers, rest) = bytes.as_chunks::<4>();
    let (rows, left) = numbers.as_chunks::<N>();
    let whole = rest.is_empty() && left.is_empty() && !rows.is_empty();
    whole.then(|| rows.iter().map(|row| row.map(f32::from_le_bytes)).collect())
}

fn like_kitti<const N: usize>(rows: &[[f32; N]]) -> bool {
    let sound = |row: &[f32; N]| {
        row[..3].iter().all(|c| c.abs() < LARGEST_M) && (0.0..=LARGEST_INTENSITY).contains(&row[3])
    };
    // A direction without a return; half of the rows or more must have one.
    let missing = |row: &[f32; N]| row[..3].iter().all(|c| c.is_nan());
    let returns = rows.iter().filter(|row| sound(row)).count();
    rows.iter().all(|row| sound(row) || missing(row))
        && 2 * returns >= rows.len()
        && extent(rows, 0, 1) > LEAST_EXTENT_M
        && !(2..=3).any(|period| is_mixed(rows, period))
}

/// Whether the rows are those of two or three kinds in turn.
fn is_mixed<const N: usize>(rows: &[[f32; N]], period: usize) -> bool {
    let extents = (0..period).map(|first| extent(rows, first, period));
    let (least, most) = extents.fold((f32::MAX, 0.0f32), |(a, b), e| (a.min(e), b.max(e)));
    rows.len() >= FEWEST_ALIKE * period && least * ALIKE < most
}

/// The largest extent along an axis of every `step`th row from `first`.
fn extent<const N: usize>(rows: &[[f32; N]], first: usize, step: usize) -> f32 {
    let along = |axis: usize| {
        let values = || rows.iter().skip(first).step_by(step).map(move |row| row[axis]);
        values().fold(f32::MIN, f32::max) - values().fold(f32::MAX, f32::min)
    };
    (0..3).map(along).fold(0.0, f32::max)
}

fn like_nuscenes(rows: &[[f32; 5]]) -> bool {
    let ring = |v: f32| v.fract() == 0.0 && (0.0..RINGS).contains(&v);
    like_kitti(rows) && rows.iter().all(|row| ring(row[4]))
}

fn cloud<const N: usize>(rows: &[[f32; N]], options: &ReadOptions, note: &str) -> ScanFile {
    let at = |i: usize| [0, 1, 2].map(|k| f64::from(rows[i][k]));
    let intensity = |i: usize| rows[i][3];
    let attributes = Attributes {
        intensity: options.attributes.then_some(&intensity as &dyn Fn(usize) -> f32),
        ..Attributes::default()
    };
    let xyz = without_zeros(rows.len(), at);
    let cloud = assemble_with(rows.len(), xyz, &attributes, Some([0.0; 3]));
    ScanFile::from(cloud).with(Note::info(note))
}

#[cfg(test)]
mod tests {
    use crate::Error;
    use crate::geometry::Point;
    use crate::io::{ReadOptions, ScanFile, read_file};

    fn read(name: &str, bytes: &[u8]) -> crate::Result<ScanFile> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        read_file(&path, &ReadOptions { attributes: true, ..ReadOptions::default() })
    }

    fn bytes(numbers: &[f32]) -> Vec<u8> {
        numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    #[test]
    fn rows_of_four_and_of_five_are_told_apart() {
        // 5 rows of 4 numbers are as long as 4 rows of 5; the numbers decide.
        let four = [1.0, 2.0, 3.0, 0.5, -4.0, 5.0, 6.0, 0.0, 7.0, 8.0, -9.0, 1.0, 1.0, 1.0, 1.0, 0.25]
            .into_iter()
            .chain([2.0, 2.0, 2.0, 0.75]);
        let kitti = read("a.bin", &bytes(&four.collect::<Vec<f32>>())).unwrap();
        let cloud = &kitti.scans[0].cloud;
        assert_eq!(cloud.len(), 5);
        assert_eq!(cloud.points[1], Point::new(-4.0, 5.0, 6.0));
        assert_eq!(cloud.intensities, Some(vec![0.5, 0.0, 1.0, 0.25, 0.75]));
        assert_eq!(cloud.viewpoint, Some(Point::origin()));
        assert!(kitti.notes[0].text.contains("KITTI") && !kitti.notes[0].warning);
        let five = [[1.0, -2.0, 3.0, 10.0, 0.0], [4.0, -5.0, 6.0, 20.0, 31.0], [7.0, -8.0, 9.0, 255.0, 5.0]];
        let nuscenes =
            read("a.bin", &bytes(&[five.concat(), vec![0.0, -1.0, 0.0, 1.0, 2.0]].concat())).unwrap();
        let cloud = &nuscenes.scans[0].cloud;
        assert_eq!(cloud.points[2], Point::new(7.0, -8.0, 9.0));
        assert_eq!(cloud.intensities.as_ref().unwrap()[2], 255.0);
        assert!(nuscenes.notes[0].text.contains("nuScenes"));
    }

    #[test]
    fn what_may_be_anything_is_no_scan() {
        let sound = [[1.0, 2.0, 3.0, 0.5], [2.0, 2.0, 3.0, 0.5]].concat();
        assert!(read("a.bin", &bytes(&sound)).is_ok());
        let spoiled = |at: usize, value: f32| {
            let mut numbers = sound.clone();
            numbers[at] = value;
            bytes(&numbers)
        };
        let labels: Vec<u8> = (0u32..8).flat_map(u32::to_le_bytes).collect();
        let flat = bytes(&[[1.0, 2.0, 3.0, 0.5]; 2].concat());
        for (what, bytes) in [
            ("not finite", spoiled(0, f32::NAN)),
            ("too far", spoiled(5, 2e5)),
            ("too bright", spoiled(3, 256.0)),
            ("negative intensity", spoiled(7, -0.1)),
            ("cut short", bytes(&sound)[..31].to_vec()),
            ("whole numbers", labels),
            ("one place", flat),
        ] {
            let error = read("a.bin", &bytes).unwrap_err();
            assert!(matches!(error, Error::NotAScan { .. }), "{what}: {error}");
            let message = error.to_string();
            assert!(message.contains(".bin") && message.contains("numpy.fromfile"), "{message}");
        }
    }

    #[test]
    fn missing_returns_are_dropped_and_longer_rows_refused() {
        let place = |i: usize| [20.0 * (i as f32).sin(), 15.0 * (i as f32).cos(), 0.1 * i as f32];
        let rows = |beside: &[f32]| -> Vec<f32> {
            (0..64).flat_map(|i| [&place(i)[..], &[0.25], beside].concat()).collect()
        };
        let mut numbers = rows(&[]);
        numbers[4..7].fill(f32::NAN);
        numbers[8..11].fill(0.0);
        numbers[12..15].fill(0.0);
        let cloud = read("a.bin", &bytes(&numbers)).unwrap().scans.swap_remove(0).cloud;
        assert_eq!((cloud.len(), cloud.dropped_rows), (61, 3));
        assert_eq!(cloud.points[1], Point::from(place(4)));
        // Four scores of classes, or eight, behind each point.
        for scores in [&[1.0, 0.0, 0.0, 0.0][..], &[0.0, 0.0, 0.25, 0.5, 0.25, 0.0, 0.0, 0.0]] {
            let error = read("a.bin", &bytes(&rows(scores))).unwrap_err();
            assert!(matches!(error, Error::NotAScan { .. }), "{error}");
        }
        numbers.iter_mut().for_each(|v| *v = f32::NAN);
        assert!(read("a.bin", &bytes(&numbers)).is_err());
    }
}
