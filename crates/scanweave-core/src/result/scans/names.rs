//! Names of the files that scans are exported to.

use std::collections::HashSet;
use std::path::PathBuf;

/// Names that are taken, in lower case: folders of some systems know no other difference.
#[derive(Default)]
pub(super) struct Names {
    taken: HashSet<String>,
}

impl Names {
    /// The file of a scan: `<scan>.<extension>`, in `component_<number>/` beyond the first component. Where
    /// that is taken the scan gets a number: `<scan>_2.<extension>`.
    pub(super) fn file(&mut self, component: usize, scan: &str, extension: &str) -> PathBuf {
        let scan = relative(scan);
        let stem = if component == 0 { scan } else { format!("component_{component}/{scan}") };
        let mut file = format!("{stem}.{extension}");
        let mut number = 1;
        while !self.taken.insert(file.to_lowercase()) {
            number += 1;
            file = format!("{stem}_{number}.{extension}");
        }
        file.into()
    }
}

/// The name of a scan as a place within a folder, whatever a result says that its name is: no part of it
/// leads out of the folder, and none is hidden.
fn relative(scan: &str) -> String {
    let unusual = |c: char| c.is_control() || matches!(c, '\\' | ':' | '\u{fffd}');
    let part = |part: &str| {
        let part = part.replace(unusual, "_");
        if part.starts_with('.') { format!("_{part}") } else { part }
    };
    let parts: Vec<String> = scan.split('/').filter(|p| !p.is_empty()).map(part).collect();
    if parts.is_empty() { "scan".to_owned() } else { parts.join("/") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_scans_have_one_file() {
        let mut names = Names::default();
        let mut file = |component, scan| names.file(component, scan, "ply").display().to_string();
        assert_eq!(file(0, "a/room"), "a/room.ply");
        assert_eq!(file(0, "b/room"), "b/room.ply");
        // The second scan of room.pts, and room#2.ply.
        assert_eq!(file(0, "room#2"), "room#2.ply");
        assert_eq!(file(0, "room#2"), "room#2_2.ply");
        assert_eq!(file(0, "Room#2"), "Room#2_3.ply");
        // A folder of the user that is called as one of ours.
        assert_eq!(file(0, "component_1/room"), "component_1/room.ply");
        assert_eq!(file(1, "room"), "component_1/room_2.ply");
    }

    #[test]
    fn names_stay_within_the_folder() {
        for (scan, expected) in [
            ("../../etc/passwd", "_../_../etc/passwd"),
            ("/root", "root"),
            ("c:\\a\n", "c__a_"),
            (".hidden", "_.hidden"),
            ("", "scan"),
        ] {
            assert_eq!(relative(scan), expected);
        }
    }
}
