//! Names and contents of files that try to drive a terminal or to turn a line around.

mod cli_common;

use cli_common::{corner, folder, json, ply_text, scanweave, write_ply};
use std::path::Path;

/// A PLY whose header has an ESC sequence, a bell, a C1 control and a change of direction in the type of
/// a property.
const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty \u{1b}]0;PWNED\u{7}\u{1b}[31m\u{9b}2J\u{202e}foo x\n\
                      end_header\n1 2 3\n";

/// Runs a command; all that it says on both streams, which must be free of such characters.
fn said(command: &mut assert_cmd::Command) -> String {
    let output = command.output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    let bad = |c: char| {
        (c.is_control() && c != '\n')
            || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
    };
    assert!(!text.contains(bad), "{text:?}");
    assert!(!text.is_empty());
    text
}

/// A file system may have no room for such a name.
fn made(path: &Path, content: &str) -> bool {
    std::fs::write(path, content).is_ok()
}

#[test]
fn a_hostile_header_and_a_hostile_name_are_shown_as_escapes() {
    let place = folder();
    let file = place.path().join("scan.ply");
    std::fs::write(&file, HEADER).unwrap();
    let text = said(scanweave().arg("inspect").arg(&file));
    assert!(text.contains(r"\u{1b}]0;PWNED\u{7}") && text.contains(r"\u{202e}foo"), "{text}");

    for name in ["a\u{1b}[2Jb.ply", "a\nerror: b.ply", "a\u{202e}ylp.b.ply", "a\u{9b}31m.ply"] {
        let path = place.path().join(name);
        if !made(&path, HEADER) {
            continue;
        }
        let text = said(scanweave().arg("inspect").arg(&path));
        assert_eq!(text.lines().count(), 1, "{text}");
        said(scanweave().args(["register", "-o"]).arg(place.path().join("none")).args([&path, &file]));
        // A name that the shell found in the place of an argument.
        said(scanweave().arg("report").arg(place.path()).arg(&path));
        said(scanweave().arg(&path));
    }
    let scans = [place.path().join("k\u{fc}che.ply"), place.path().join("\u{8d70}\u{67fb} \u{1f642}.ply")];
    for path in &scans {
        write_ply(path, &corner());
        let text = said(scanweave().arg("inspect").arg(path));
        assert!(text.contains(path.file_name().unwrap().to_str().unwrap()), "{text}");
    }
}

#[test]
fn a_run_over_hostile_names_prints_none_of_them_raw() {
    let place = folder();
    let scans = place.path().join("scans");
    std::fs::create_dir(&scans).unwrap();
    let names = ["a\u{1b}[2J\nb.ply", "c\u{202e}d\u{2066}.ply", "e\u{9b}31m.ply"];
    let points = corner();
    // The same corner, seen as it is, moved, and with rows that are left out and reported.
    for (k, name) in names.iter().enumerate() {
        let moved: Vec<[f64; 3]> = points.iter().map(|p| [p[0] + 0.2 * k as f64, p[1], p[2]]).collect();
        let mut text = ply_text(moved.len() + 1, &moved);
        text.push_str("nan nan nan\n");
        if !made(&scans.join(name), &text) {
            return;
        }
    }
    std::fs::write(scans.join("notes\u{202e}\n.txt"), "no scan\u{1b}[2J at all\n").unwrap();
    let result = place.path().join("result");
    for more in [&[][..], &["-vvv"][..], &["--json", "-q"][..]] {
        let mut command = scanweave();
        command.args(["register", "--force"]).arg(&scans).arg("-o").arg(&result).args(more);
        let text = said(&mut command);
        assert!(more.contains(&"--json") || text.contains("3 of 3 scans"), "{text}");
    }
    // A program still gets the name of the file itself.
    let mut command = scanweave();
    command.args(["register", "--force", "--json", "-q"]).arg(&scans).arg("-o").arg(&result);
    let printed: serde_json::Value = serde_json::from_slice(&command.output().unwrap().stdout).unwrap();
    let written = json(result.join("poses.json"));
    assert_eq!(printed["poses"], written);
    assert!(written["scans"][1]["file"].as_str().unwrap().ends_with(names[1]));

    said(scanweave().arg("inspect").arg(&scans));
    said(scanweave().args(["inspect", "--json"]).arg(&scans));
    said(scanweave().arg("inspect").arg(&result));
    said(scanweave().arg("report").arg(&result));
    said(scanweave().arg("describe").arg(&scans).arg("-o").arg(place.path().join("features")));
    std::fs::remove_dir_all(&scans).unwrap();
    said(scanweave().arg("report").arg(&result));
}
