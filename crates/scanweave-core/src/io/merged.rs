//! Reading back the merged cloud of a result.

use super::named_file::check_regular;
use super::ply;
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use std::fs;
use std::path::Path;

/// Reads a PLY whose vertices have a property `scan`, as [`write_ply`](super::write_ply) writes
/// merged clouds: its points, and for each the number of the scan that it comes from.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for a file that is no such PLY, or that has a point that is
/// not finite or a number that is no index.
pub fn read_merged(path: impl AsRef<Path>) -> Result<(PointCloud, Vec<usize>)> {
    const SCAN: &str = "scan";
    let path = path.as_ref();
    let remedy = "register again, or remove the file";
    check_regular(path)?;
    let bytes = fs::read(path).map_err(|e| Error::read(path, e))?;
    let cloud = ply::read_points(path, &bytes)?;
    let numbers = ply::read_property(path, &bytes, SCAN)?;
    if cloud.dropped_rows > 0 {
        let found = format!("{} points that are not finite", cloud.dropped_rows);
        return Err(Error::file(path, found, "finite points, as in merged.ply", remedy));
    }
    let index = |&v: &f64| {
        let whole = v >= 0.0 && v.fract() == 0.0 && v <= f64::from(i32::MAX);
        let wrong = || Error::file(path, format!("the scan {v}"), "an index from 0", remedy);
        if whole { Ok(v as usize) } else { Err(wrong()) }
    };
    let scans = numbers.iter().map(index).collect::<Result<Vec<usize>>>()?;
    Ok((cloud, scans))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::io::{PlyCloud, write_ply};

    #[test]
    fn a_merged_cloud_comes_back_with_its_scans() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("merged.ply");
        let points: Vec<Point> = (0..4).map(|i| Point::new(i as f32, 0.5, -2.0)).collect();
        let colors = [[1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12]];
        // Beyond 10 000, where coordinates would be taken for georeferenced ones.
        let scans = [0, 20_001, 20_002, 20_001];
        let cloud =
            PlyCloud { points: &points, colors: Some(&colors), scans: Some(&scans), ..PlyCloud::default() };
        write_ply(&path, &cloud).unwrap();
        let (read, numbers) = read_merged(&path).unwrap();
        assert_eq!((read.points, read.colors), (points.clone(), Some(colors.to_vec())));
        assert_eq!(numbers, [0, 20_001, 20_002, 20_001]);

        write_ply(&path, &PlyCloud { points: &points, ..PlyCloud::default() }).unwrap();
        let said = read_merged(&path).unwrap_err().to_string();
        assert!(said.contains("merged.ply") && said.contains("property scan"), "{said}");
        write_ply(&path, &PlyCloud { points: &points, scans: Some(&[0, -1, 0, 0]), ..PlyCloud::default() })
            .unwrap();
        let said = read_merged(&path).unwrap_err().to_string();
        assert!(said.contains("scan -1"), "{said}");
    }

    #[test]
    fn text_files_and_other_number_types_are_read_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("merged.ply");
        let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
                      property float z\nproperty float Scan\nend_header\n";
        fs::write(&path, format!("{header}1 2 3 7\n4 5 6 0\n")).unwrap();
        let (read, numbers) = read_merged(&path).unwrap();
        assert_eq!(
            (read.points, numbers),
            (vec![Point::new(1.0, 2.0, 3.0), Point::new(4.0, 5.0, 6.0)], vec![7, 0])
        );
        for bad in ["1 2 3 0.5", "1 2 3 nan", "nan 2 3 1"] {
            fs::write(&path, format!("{header}{bad}\n4 5 6 0\n")).unwrap();
            assert!(matches!(read_merged(&path), Err(Error::File { .. })), "{bad}");
        }
    }
}
