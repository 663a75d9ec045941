use super::*;
use crate::geometry::{Point, RigidMotion};
use crate::scan::WorkingScale;
use crate::scan::{DeclineReason, Outcome, Placement, Reconstruction, Scan, ScanId};

/// A placement without evidence.
pub(super) fn placed(world_from_scan: RigidMotion, step: usize, parent: Option<usize>) -> Placement {
    let mut placement = Placement::at(world_from_scan, 0);
    placement.step = step;
    placement.parent = parent.map(ScanId);
    placement
}

/// Scans `0`, `1`, … with these outcomes.
pub(super) fn document(verdicts: Vec<Outcome>) -> Document {
    let names = (0..verdicts.len()).map(|i| i.to_string()).collect::<Vec<_>>();
    named(&names.iter().map(String::as_str).collect::<Vec<_>>(), verdicts)
}

fn named(names: &[&str], outcomes: Vec<Outcome>) -> Document {
    let scan = |(i, name): (usize, &&str)| Scan {
        id: ScanId(i),
        name: (*name).to_owned(),
        path: Some(name.into()),
        cloud: PointCloud::default(),
        ..Scan::default()
    };
    let scans: Vec<Scan> = names.iter().enumerate().map(scan).collect();
    Document::new(&scans, &Reconstruction::new(outcomes), 0.07)
}

fn run_report(document: &Document) -> RunReport {
    RunReport {
        generator: document.generator.clone(),
        run_id: None,
        seed: 1,
        preset: "default".to_owned(),
        threads: 1,
        scale: WorkingScale::from_voxel(0.1),
        overlap_head: "none".to_owned(),
        method: "incremental".to_owned(),
        registered_pairs: None,
        pair_seconds: None,
        edges: None,
        placed: 0,
        declined: 0,
        components: 0,
        evidence: crate::result::rows(document),
        sizes: Vec::new(),
        timings: Vec::new(),
        total_seconds: 0.0,
        peak_memory_bytes: None,
    }
}

const HOSTILE: [&str; 4] = [
    "</script><script>alert(1)</script>",
    "\"><img src=x onerror=alert(1)>",
    "<!--data--> <!--headline--> &lt; ' \u{2028}",
    "line\nbreak\u{fffd}",
];

#[test]
fn hostile_names_stay_inside_the_json_and_come_back_printable() {
    let lost = || Outcome::Declined(DeclineReason::Degenerate { detail: HOSTILE[0].to_owned() });
    let document = named(&HOSTILE, vec![lost(), lost(), lost(), lost()]);
    let cloud = PointCloud::from_points(vec![Point::origin()]);
    let input = Input {
        poses: &document,
        run: &run_report(&document),
        config: "a = \"</script>\"",
        similarity: None,
        clouds: &[&cloud; 4],
        sources: &[PointSource::Scan; 4],
        surfaces: &vec![Surface::default(); 4],
        frames: &[RigidMotion::identity(); 4],
        truth: None,
    };
    let page = page(&input).unwrap();
    // No more elements than the template has.
    for element in ["<script", "</script", "<img", "<!--"] {
        let marks = if element == "<!--" { 3 } else { 0 };
        assert_eq!(page.matches(element).count() + marks, TEMPLATE.matches(element).count(), "{element}");
    }
    let (_, rest) = page.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
    let (json, _) = rest.split_once("</script>").unwrap();
    assert!(!json.contains(['<', '>', '&', '\u{2028}', '\n']), "{json}");
    let data: serde_json::Value = serde_json::from_str(json).unwrap();
    for (i, name) in HOSTILE.iter().enumerate() {
        let shown = name.replace('\n', "\\n").replace('\u{2028}', "\\u{2028}");
        assert_eq!(data["scans"][i]["name"], shown);
    }
    assert_eq!(data["config"], "a = \"</script>\"");
    assert!(data["scans"][0]["left_out"]["plain"].as_str().unwrap().contains(HOSTILE[0]));
    assert!(page.contains("No two of the 4 scans could be joined."));
}

#[test]
fn lists_of_different_lengths_are_refused() {
    let document =
        document(vec![Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 })]);
    let run = run_report(&document);
    let input = Input {
        poses: &document,
        run: &run,
        config: "",
        similarity: None,
        clouds: &[],
        sources: &[],
        surfaces: &[],
        frames: &[],
        truth: None,
    };
    assert!(page(&input).unwrap_err().to_string().contains("1 poses"));
}

#[test]
fn the_template_refers_to_nothing_outside_and_lets_nothing_else_run() {
    let policy = "default-src 'none'; script-src 'sha256-";
    assert_eq!(TEMPLATE.matches(policy).count(), 1);
    for outside in ["<link", "src=\"", "@import", "url(http", "unsafe-inline", "unsafe-eval"] {
        assert!(!TEMPLATE.contains(outside), "{outside}");
    }
    let marks: Vec<usize> = ["<!--headline-->", "<!--data-->"].map(|m| TEMPLATE.find(m).unwrap()).to_vec();
    assert!(marks[0] < marks[1]);
}
