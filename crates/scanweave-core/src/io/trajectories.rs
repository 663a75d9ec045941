//! Poses of placed scans for other programs: TUM, KITTI, CSV, COLMAP `images.txt`.
//!
//! A file holds one component, because poses of different components are unrelated. Scans without a
//! pose are left out. Numbers are written so that reading gives back the same bits.

use super::poses::write_kitti as write_matrices;
use crate::atomic;
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::scan::ScanId;
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Columns of the CSV.
pub const TRAJECTORY_CSV_HEAD: &str =
    "name,file,component,tx,ty,tz,qx,qy,qz,qw,probability,sigma_t_m,sigma_r_deg";

/// A placed scan, as trajectories state it.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedScan {
    /// Place in the input.
    pub id: ScanId,
    /// Unique name.
    pub name: String,
    /// File, as the user named it.
    pub file: Option<String>,
    /// Component.
    pub component: usize,
    /// Pose.
    pub world_from_scan: RigidMotion,
    /// Probability that the pose is right, where it was measured.
    pub probability: Option<f64>,
    /// Largest standard deviation of the scan's centre in any direction, metres, where assessed.
    pub sigma_t_m: Option<f64>,
    /// Largest standard deviation of the rotation about any axis, degrees, where assessed.
    pub sigma_r_deg: Option<f64>,
}

/// The number that a name ends in, `175.25` of `depth_175.25`: digits, with at most one point between
/// them.
pub fn number_at_end(name: &str) -> Option<&str> {
    let digits = |text: &str| text.len() - text.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let fraction = digits(name);
    if fraction == 0 {
        return None;
    }
    let before = &name[..name.len() - fraction];
    let whole = before.strip_suffix('.').map_or(0, digits);
    let length = if whole > 0 { whole + 1 + fraction } else { fraction };
    Some(&name[name.len() - length..])
}

/// The numbers that the names of all scans end in, if all end in one and no two are equal.
pub fn distinct_numbers<'a>(names: impl IntoIterator<Item = &'a str>) -> Option<Vec<&'a str>> {
    let numbers: Vec<&str> = names.into_iter().map(number_at_end).collect::<Option<_>>()?;
    // As readers see them: 07 and 7 are one number, and so are two that a double cannot tell apart.
    let values: Option<BTreeSet<u64>> =
        numbers.iter().map(|n| Some(n.parse::<f64>().ok()?.to_bits())).collect();
    (values?.len() == numbers.len()).then_some(numbers)
}

/// Writes `timestamp tx ty tz qx qy qz qw` a line (TUM).
///
/// The timestamp is the number at the end of the scan's name if the names of all scans of the input
/// (`all_names`, by [`ScanId`]) end in different numbers; else it is the scan's place in the input.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub fn write_tum_trajectory(path: impl AsRef<Path>, scans: &[PlacedScan], all_names: &[&str]) -> Result<()> {
    let numbers = distinct_numbers(all_names.iter().copied());
    atomic::write(path.as_ref(), |w| {
        writeln!(w, "# timestamp tx ty tz qx qy qz qw")?;
        for scan in scans {
            let number = numbers.as_ref().and_then(|n| n.get(scan.id.0));
            let stamp = number.map_or_else(|| scan.id.to_string(), |n| (*n).to_owned());
            writeln!(w, "{stamp} {}", joined(&translation_and_xyzw(&scan.world_from_scan), " "))?;
        }
        Ok(())
    })
}

/// Writes a 3×4 matrix a line (KITTI), and beside it in [`trajectory_names_file`] the name of each line's scan,
/// which the format has no place for.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub fn write_kitti_trajectory(path: impl AsRef<Path>, scans: &[PlacedScan]) -> Result<()> {
    let path = path.as_ref();
    // The names come first: matrices without names are read by their order.
    atomic::write(&trajectory_names_file(path), |w| {
        scans.iter().try_for_each(|s| writeln!(w, "{}", s.name))
    })?;
    write_matrices(path, &scans.iter().map(|s| s.world_from_scan).collect::<Vec<_>>())
}

/// `trajectory_kitti_names.txt` of `trajectory_kitti.txt`.
pub fn trajectory_names_file(path: &Path) -> PathBuf {
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!("{stem}_names.txt"))
}

/// Writes a table with the columns [`TRAJECTORY_CSV_HEAD`]; what is not known is left empty.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub fn write_csv_trajectory(path: impl AsRef<Path>, scans: &[PlacedScan]) -> Result<()> {
    let optional = |v: Option<f64>| v.map(|v| format!("{v:?}")).unwrap_or_default();
    atomic::write(path.as_ref(), |w| {
        writeln!(w, "{TRAJECTORY_CSV_HEAD}")?;
        for s in scans {
            let (name, file) = (quoted(&s.name), quoted(s.file.as_deref().unwrap_or_default()));
            let pose = joined(&translation_and_xyzw(&s.world_from_scan), ",");
            let known = [s.probability, s.sigma_t_m, s.sigma_r_deg].map(optional).join(",");
            writeln!(w, "{name},{file},{},{pose},{known}", s.component)?;
        }
        Ok(())
    })
}

/// Writes `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME` a scan, each followed by an empty line in place
/// of image points (COLMAP `images.txt`).
///
/// The pose is `scan_from_world`, as COLMAP has it. Ids start at 1 there: it is the place in the
/// input plus one. Every scan has camera 1; COLMAP itself reads names without spaces only.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub fn write_images_trajectory(path: impl AsRef<Path>, scans: &[PlacedScan]) -> Result<()> {
    atomic::write(path.as_ref(), |w| {
        writeln!(w, "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME")?;
        writeln!(w, "# POINTS2D[] as (X, Y, POINT3D_ID): none")?;
        for scan in scans {
            let [tx, ty, tz, qx, qy, qz, qw] = translation_and_xyzw(&scan.world_from_scan.inverse());
            let pose = joined(&[qw, qx, qy, qz, tx, ty, tz], " ");
            writeln!(w, "{} {pose} 1 {}\n", scan.id.0 + 1, scan.name)?;
        }
        Ok(())
    })
}

/// tx, ty, tz, qx, qy, qz, qw with qw ≥ 0.
pub(super) fn translation_and_xyzw(pose: &RigidMotion) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.into_inner());
    let q = if q.w < 0.0 { -q } else { q };
    [t.x, t.y, t.z, q.i, q.j, q.k, q.w]
}

/// Numbers with as many digits as it takes to read back the same bits.
pub(super) fn joined(numbers: &[f64], between: &str) -> String {
    numbers.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(between)
}

/// A field of a CSV (RFC 4180): in quotes where it would be taken for several.
fn quoted(field: &str) -> String {
    match field.contains([',', '"', '\n', '\r', ';', '\t']) || field.trim() != field {
        true => format!("\"{}\"", field.replace('"', "\"\"")),
        false => field.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn scan(id: usize, name: &str) -> PlacedScan {
        // A quarter turn about z, then a shift: qz = qw = √½.
        let turn = Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        PlacedScan {
            id: ScanId(id),
            name: name.to_owned(),
            file: Some(format!("in/{name}.ply")),
            component: 0,
            world_from_scan: RigidMotion::new(Vector3::new(1.0, -2.0, 0.5), turn),
            probability: Some(0.75),
            sigma_t_m: None,
            sigma_r_deg: Some(1.5),
        }
    }

    fn values(line: &str, separator: char) -> Vec<f64> {
        line.split(separator).filter_map(|v| v.parse().ok()).collect()
    }

    fn near(found: &[f64], expected: &[f64]) {
        assert_eq!(found.len(), expected.len(), "{found:?}");
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{found:?} {expected:?}");
    }

    #[test]
    fn the_number_at_the_end_of_a_name() {
        let cases = [
            ("cloud_bin_12", Some("12")),
            ("1305031102.175304", Some("1305031102.175304")),
            ("scan#2", Some("2")),
            ("a.5", Some("5")),
            ("v1.2.3", Some("2.3")),
            ("frame-7.pose", None),
            ("", None),
        ];
        for (name, number) in cases {
            assert_eq!(number_at_end(name), number, "{name}");
        }
        assert_eq!(distinct_numbers(["a7", "b08"]), Some(vec!["7", "08"]));
        assert_eq!(distinct_numbers(["a7", "b07"]), None);
        assert_eq!(distinct_numbers(["a7", "b"]), None);
    }

    #[test]
    fn timestamps_are_numbers_of_names_or_places() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("t.tum");
        let root = 0.5f64.sqrt();
        for (names, stamp) in [(["a5", "a9"], 9.0), (["a", "b"], 1.0), (["a5", "b5"], 1.0)] {
            write_tum_trajectory(&path, &[scan(1, names[1])], &names).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            let lines: Vec<&str> = text.lines().collect();
            assert_eq!(lines.len(), 2);
            near(&values(lines[1], ' '), &[stamp, 1.0, -2.0, 0.5, 0.0, 0.0, root, root]);
        }
    }

    #[test]
    fn kitti_lines_are_three_rows_and_the_names_stand_beside() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("k_1.txt");
        write_kitti_trajectory(&path, &[scan(0, "first"), scan(2, "third")]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        // R = [[0,-1,0],[1,0,0],[0,0,1]] with t as the last column, row by row.
        let expected = [0.0, -1.0, 0.0, 1.0, 1.0, 0.0, 0.0, -2.0, 0.0, 0.0, 1.0, 0.5];
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2);
        let found = values(lines[0], ' ');
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15) && found.len() == 12);
        assert_eq!(std::fs::read_to_string(place.path().join("k_1_names.txt")).unwrap(), "first\nthird\n");
    }

    #[test]
    fn the_table_quotes_what_it_must_and_leaves_the_unknown_empty() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("t.csv");
        write_csv_trajectory(&path, &[scan(0, "a, \"b\""), scan(1, "plain")]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "name,file,component,tx,ty,tz,qx,qy,qz,qw,probability,sigma_t_m,sigma_r_deg");
        assert!(
            lines[1].starts_with("\"a, \"\"b\"\"\",\"in/a, \"\"b\"\".ply\",0,1.0,-2.0,0.5,"),
            "{}",
            lines[1]
        );
        assert!(lines[2].starts_with("plain,in/plain.ply,0,1.0,"), "{}", lines[2]);
        assert!(lines[2].ends_with(",0.75,,1.5"), "{}", lines[2]);
    }

    #[test]
    fn images_hold_the_inverse_with_the_scalar_first() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("images.txt");
        write_images_trajectory(&path, &[scan(3, "a b")]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().filter(|l| !l.starts_with('#')).collect();
        assert_eq!(lines.len(), 2);
        assert!(lines[0].ends_with(" 1 a b") && lines[1].is_empty(), "{text}");
        // World to scan: Rᵀ = [[0,1,0],[-1,0,0],[0,0,1]], −Rᵀt = (2, 1, −0.5).
        let root = 0.5f64.sqrt();
        let expected = [4.0, root, 0.0, 0.0, -root, 2.0, 1.0, -0.5, 1.0];
        let found = values(lines[0], ' ');
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{found:?}");
    }
}
