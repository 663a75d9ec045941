use super::network::Network;
use super::precision::{Deviations, Strength, in_words};
use super::*;
use crate::geometry::RigidMotion;
use crate::result::Component;
use crate::scan::{
    DeclineReason, Evidence, NeighbourEvidence, Outcome, Placement, PointCloud, PoseUncertainty,
    Reconstruction, Scan, ScanEdge, ScanId, WorkingScale,
};
use nalgebra::{Matrix3, Matrix6, Point3, Rotation3, Vector3, Vector6};

fn placed(component: usize, parent: Option<usize>, neighbours: &[(usize, f64, f64)]) -> Placement {
    let near = |&(scan, overlap, distance_m): &(usize, f64, f64)| {
        let mut near = NeighbourEvidence::new(ScanId(scan), overlap, 0.05);
        near.plane_distance_m = Some(distance_m);
        near
    };
    let mut placement = Placement::at(RigidMotion::identity(), component);
    placement.step = usize::from(parent.is_some());
    placement.parent = parent.map(ScanId);
    placement.matches = 9;
    placement.inliers = 8;
    placement.residual_m = 0.004;
    placement.evidence = Some({
        let mut changed = Evidence::default();
        changed.probability = Some(0.97);
        changed
    });
    placement.neighbours = neighbours.iter().map(near).collect();
    placement
}

/// Scans of these names, with an inlier radius of 7 cm.
fn document(names: &[&str], outcomes: Vec<Outcome>) -> Document {
    let scan = |(i, name): (usize, &&str)| Scan {
        id: ScanId(i),
        name: (*name).to_owned(),
        path: Some(format!("{name}.ply").into()),
        cloud: PointCloud::default(),
        ..Scan::default()
    };
    let scans: Vec<Scan> = names.iter().enumerate().map(scan).collect();
    Document::new(&scans, &Reconstruction::new(outcomes), 0.07)
}

fn run_report(document: &Document, seconds: f64) -> RunReport {
    RunReport {
        generator: document.generator.clone(),
        run_id: None,
        seed: 42,
        preset: "default".to_owned(),
        threads: seconds as usize,
        scale: WorkingScale { inlier_radius_m: 0.07, ..WorkingScale::from_voxel(0.025) },
        overlap_head: "none".to_owned(),
        method: "agglomerative".to_owned(),
        registered_pairs: None,
        pair_seconds: None,
        edges: None,
        placed: 0,
        declined: 0,
        components: 0,
        evidence: crate::result::rows(document),
        sizes: Vec::new(),
        timings: Vec::new(),
        total_seconds: seconds,
        peak_memory_bytes: Some(seconds as u64),
    }
}

fn page_of(poses: &Document, reference: Option<&str>) -> String {
    page(&Input { poses, run: &run_report(poses, 1.0), reference })
}

/// The text of every cell of the rows that hold `name` in a cell of its own.
fn rows(page: &str, name: &str) -> Vec<Vec<String>> {
    let cells = |row: &str| -> Vec<String> {
        let cell = |c: &str| {
            let (_, text) = c.split_once('>').unwrap();
            text.split("</td>").next().unwrap().replace("<bdi>", "").replace("</bdi>", "")
        };
        row.split("<td").skip(1).map(cell).collect()
    };
    let all = page.split("<tr>").skip(1).map(|r| cells(r.split("</tr>").next().unwrap()));
    // Not the tables of facts, which have one cell.
    all.filter(|row| row.len() > 1 && row.iter().any(|c| c == name)).collect()
}

/// What a table of facts says of `name`, in the order of the components.
fn facts<'a>(page: &'a str, name: &str) -> Vec<&'a str> {
    let start = format!("<th scope=\"row\">{name}</th><td><bdi>");
    let lines = page.split(start.as_str()).skip(1);
    lines.map(|l| l.split("</bdi>").next().unwrap()).collect()
}

fn with_covariance(mut placement: Placement, covariance: Matrix6<f64>) -> Placement {
    let uncertainty = PoseUncertainty { covariance: Some(covariance), ..PoseUncertainty::default() };
    placement.pose_uncertainty = Some(Box::new(uncertainty));
    placement
}

#[test]
fn deviations_and_the_least_held_direction_of_a_known_covariance() {
    // 2 mm, 3 mm and 100 mm along axes turned by 30 degrees about Z so that the last lies along
    // (cos 30°, sin 30°, 0): variances along X and Y are c² 0.1² + s² 0.002² and s² 0.1² + c² 0.002².
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), 30f64.to_radians()).into_inner();
    let shift = turn * Matrix3::from_diagonal(&Vector3::new(0.01, 4e-6, 9e-6)) * turn.transpose();
    let mut covariance = Matrix6::from_diagonal(&Vector6::new(1e-4, 0.04, 1e-6, 0.0, 0.0, 0.0));
    covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&shift);
    let uncertainty = PoseUncertainty { covariance: Some(covariance), ..PoseUncertainty::default() };
    let found = Deviations::of(Some(&uncertainty)).unwrap();
    let along = [(0.75 * 0.01 + 0.25 * 4e-6f64).sqrt(), (0.25 * 0.01 + 0.75 * 4e-6f64).sqrt(), 0.003];
    let close = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
    assert!(close(found.along_m, along), "{found:?}");
    assert!(close(found.about_rad, [0.01, 0.2, 0.001]), "{found:?}");
    let (direction, deviation) = found.least_held;
    assert!((direction - Vector3::new(0.75f64.sqrt(), 0.5, 0.0)).norm() < 1e-12, "{direction}");
    assert!((deviation - 0.1).abs() < 1e-12);
    // Limits 7 cm and 5 degrees: 8.7 cm, 5 cm, 3 mm; 0.57, 11.5 and 0.06 degrees.
    use Strength::{Free, Held, Weak};
    assert_eq!(found.strengths(0.07), [Free, Weak, Held, Weak, Free, Held]);
    assert_eq!(
        in_words(&found.strengths(0.07)),
        "not held along X and about Y; weakly held along Y and about X; held along Z and about Z"
    );
    assert_eq!(in_words(&[Held; 6]), "all six held");

    let outcomes = vec![
        Outcome::Placed(with_covariance(placed(0, None, &[]), Matrix6::zeros())),
        Outcome::Placed(with_covariance(placed(0, Some(0), &[]), covariance)),
    ];
    let page = page_of(&document(&["a", "b"], outcomes), None);
    let stated = |name: &str| rows(&page, name).pop().unwrap();
    let row = stated("b");
    assert_eq!(row[2..8], ["86.6", "50.0", "3.00", "0.573", "11.5", "0.0573"]);
    assert_eq!(row[8..10], ["(0.87, 0.50, 0.00)", "100"]);
    assert_eq!(stated("a")[10], "pivot: others refer to it");
}

#[test]
fn a_result_without_covariances_says_that_nothing_was_measured() {
    let mut broken = Matrix6::zeros();
    broken[(3, 3)] = f64::NAN;
    let outcomes = vec![
        Outcome::Placed(placed(0, None, &[])),
        Outcome::Placed(placed(0, Some(0), &[])),
        Outcome::Placed(with_covariance(placed(0, Some(0), &[]), Matrix6::zeros())),
    ];
    let mut poses = document(&["a", "b", "c"], outcomes);
    let EntryOutcome::Placed(pose) = &mut poses.scans[2].outcome else { panic!() };
    pose.pose_uncertainty.as_mut().unwrap().covariance = Some(broken);
    let page = page_of(&poses, None);
    for name in ["a", "b", "c"] {
        assert_eq!(rows(&page, name).pop().unwrap()[10], "not measured", "{name}");
    }
    assert!(rows(&page, "b")[0][4].ends_with(" *") && page.contains("The centre is not known"));
}

#[test]
fn names_files_and_reasons_stay_text() {
    const HOSTILE: &str = "</td><script>alert(1)</script><!--body-->\"'&";
    let reason = DeclineReason::Degenerate { detail: HOSTILE.to_owned() };
    let outcomes = vec![
        Outcome::Placed(placed(0, None, &[(1, 0.4, 0.02)])),
        Outcome::Placed(placed(0, Some(0), &[(0, 0.4, 0.02)])),
        Outcome::Declined(reason),
    ];
    let mut poses = document(&[HOSTILE, "b", "c"], outcomes);
    poses.generator = HOSTILE.to_owned();
    let mut run = run_report(&poses, 1.0);
    (run.preset, run.method, run.overlap_head) = (HOSTILE.to_owned(), HOSTILE.to_owned(), HOSTILE.to_owned());
    let page = page(&Input { poses: &poses, run: &run, reference: Some(HOSTILE) });
    for element in ["<script", "<!--", "\"'&\""] {
        assert!(!page.contains(element), "{element}");
    }
    let shown = "&lt;/td&gt;&lt;script&gt;alert(1)&lt;/script&gt;&lt;!--body--&gt;&quot;&#39;&amp;";
    // Program, settings, prediction, frame, least overlap, both tables of scans, file, parent, pair, reason.
    assert!(page.matches(shown).count() >= 11, "{}", page.matches(shown).count());
    assert!(!TEMPLATE.contains("http:") && !TEMPLATE.contains("<script") && !TEMPLATE.contains("url("));
}

#[test]
fn two_components_have_frames_pairs_and_figures_of_their_own() {
    // 0–1, 1–2 and 0–2 close a loop; 3 hangs on 2 alone. 4–5 touch too little to be measured.
    let turned = RigidMotion::new(Vector3::new(1.0, 2.0, 3.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
    let mut last = placed(0, Some(2), &[(2, 0.2, 0.04)]);
    last.world_from_scan = turned;
    let edge = ScanEdge { scans: (ScanId(2), ScanId(3)), probability: 0.912 };
    last.pose_uncertainty = Some(Box::new(PoseUncertainty {
        weakest_edge: Some(edge),
        covariance: None,
        centre: Some(Point3::new(10.0, 0.0, 0.5)),
    }));
    let mut other = placed(1, None, &[]);
    other.world_from_scan = turned;
    let outcomes = vec![
        Outcome::Placed(placed(0, None, &[(1, 0.5, 0.01), (2, 0.1, 0.03)])),
        Outcome::Placed(placed(0, Some(0), &[(0, 0.5, 0.01), (2, 0.3, 0.02)])),
        Outcome::Placed(placed(0, Some(1), &[(0, 0.1, 0.03), (1, 0.3, 0.02), (3, 0.2, 0.04)])),
        Outcome::Placed(last),
        Outcome::Placed(other),
        Outcome::Placed(placed(1, Some(4), &[])),
        Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 1, needed: 3 }),
    ];
    let mut poses = document(&["a", "b", "c", "d", "e", "f", "g"], outcomes);
    for entry in &mut poses.scans {
        let folder = if entry.name == "d" { "set/sub" } else { "set" };
        entry.file = Some(format!("{folder}/{}.ply", entry.name));
    }
    poses.scans[6].part = Some(1);
    let page = page_of(&poses, None);
    assert_eq!(facts(&page, "Scans"), ["7, of which 6 placed and 1 declined", "4", "2"]);
    assert_eq!(facts(&page, "Touching pairs"), ["4", "0"]);
    let loops = facts(&page, "Independent loops");
    assert!(loops[0] == "1" && loops[1].starts_with("none"), "{loops:?}");
    assert_eq!(facts(&page, "In one pair or none, so in no loop"), ["d", "e, f"]);
    // Distances of 10, 20, 30 and 40 mm: the median is the mean of the middle two.
    assert_eq!(facts(&page, "Cloud to cloud, median of pairs"), ["25.0 mm"]);
    assert_eq!(facts(&page, "Cloud to cloud, largest"), ["40.0 mm (c \u{2013} d)"]);
    // The least overlap of all, 10 %, is not of a parent edge.
    let least = ["20.0 % (c \u{2013} d)", "below 1 % (e \u{2013} f)"];
    assert_eq!(facts(&page, "Least overlap of a parent edge"), least);
    assert_eq!(facts(&page, "Weakest edge"), ["c \u{2013} d, probability 0.912"]);
    let frames = facts(&page, "Frame");
    assert_eq!(frames[0], "the coordinates of the file of a (pivot)");
    assert!(frames[1].starts_with("the coordinates that the files state") && frames[1].ends_with("pivot e"));
    assert!(facts(&page_of(&poses, Some("f")), "Frame")[1].starts_with("f, the reference"));

    // (10, 0, 0.5) turned by a quarter about Z and moved by (1, 2, 3).
    assert_eq!(rows(&page, "d")[0][4..7], ["1.0000", "12.0000", "3.5000"]);
    assert_eq!([&rows(&page, "d")[0][2], &rows(&page, "g")[0][2]], ["sub/d.ply", "g.ply #2"]);
    assert!(page.contains("<p>Files are in set.</p>"));
    // Of 30, 20 and 40 mm.
    assert_eq!(rows(&page, "c")[0][8..12], ["3", "30.0", "30.0", "b"]);
    assert_eq!(rows(&page, "g")[0][4], "only 1 keypoints, 3 needed");
    let pairs: Vec<Vec<String>> = rows(&page, "2 c");
    assert_eq!(pairs[0], ["1", "0 a", "2 c", "10.0", "30.0", ""]);
    assert_eq!(pairs[1], ["1", "1 b", "2 c", "30.0", "20.0", "yes"]);
    assert_eq!(rows(&page, "4 e")[0], ["2", "4 e", "5 f", "below 1", "\u{2013}", "yes"]);
}

#[test]
fn of_many_pairs_the_weakest_are_listed_and_the_others_counted() {
    // 30 scans that all touch each other: 435 pairs, 29 of them parent edges. Overlap falls with the distance.
    let of = |i: usize| {
        let near: Vec<(usize, f64, f64)> =
            (0..30).filter(|&j| j != i).map(|j| (j, 1.0 / (1.0 + i.abs_diff(j) as f64), 0.01)).collect();
        Outcome::Placed(placed(0, i.checked_sub(1), &near))
    };
    let names: Vec<String> = (0..30).map(|i| format!("s{i}")).collect();
    let poses = document(&names.iter().map(String::as_str).collect::<Vec<_>>(), (0..30).map(of).collect());
    let network = Network::new(&poses);
    assert_eq!(network.figures(0).loops, 435 - 30 + 1);
    let listed = network.listed(MOST_PAIRS, WEAKEST_PAIRS);
    assert_eq!(listed.len(), 200);
    assert!(listed[..29].iter().all(|p| p.parent) && listed[29..].iter().all(|p| !p.parent));
    assert_eq!(listed[29].scans, (0, 29));
    assert_eq!(network.listed(435, 200).len(), 435);
    let page = page_of(&poses, None);
    assert!(page.contains("The 200 weakest of 435 pairs") && page.contains("235 are left out"));
    assert_eq!(rows(&page, "0 s0").len(), 19, "the parent edge, and the scans 12 to 29");
}

#[test]
fn a_document_that_names_scans_that_are_not_there_is_no_failure() {
    let mut poses =
        document(&["a"], vec![Outcome::Placed(placed(3, Some(7), &[(0, 0.5, 0.1), (9, 0.5, 0.1)]))]);
    poses.components = vec![Component { pivot: Some(8), scans: vec![5, 0] }];
    assert!(page_of(&poses, None).contains("scan 7"));
    let empty = document(&[], Vec::new());
    assert!(page_of(&empty, None).contains("No scan is placed."));
}

#[test]
fn the_page_does_not_tell_when_and_how_fast_it_was_made() {
    let outcomes = || {
        vec![Outcome::Placed(placed(0, None, &[(1, 0.4, 0.02)])), Outcome::Placed(placed(0, Some(0), &[]))]
    };
    let poses = document(&["a", "b"], outcomes());
    let made =
        |seconds: f64| page(&Input { poses: &poses, run: &run_report(&poses, seconds), reference: None });
    assert_eq!(made(1.0), made(7.0));
    let read: Document = serde_json::from_str(&poses.to_json()).unwrap();
    assert_eq!(page(&Input { poses: &read, run: &run_report(&read, 1.0), reference: None }), made(1.0));
}

#[test]
fn numbers_have_the_digits_that_their_size_asks_for() {
    use super::table::{coordinate, degrees, millimetres, probability};
    assert_eq!(
        [0.0, 0.000_25, 0.0123, 1.5, 2e3].map(millimetres),
        ["0", "0.250", "12.3", "1500", "over 1 km"]
    );
    assert_eq!([0.01, 4.0].map(degrees), ["0.573", "over 180"]);
    assert_eq!([1.0, 0.9996, 0.9, f64::NAN].map(probability), ["1.000", "> 0.999", "0.900", "\u{2013}"]);
    // The last digit is below a hundredth of τ, and there is no negative zero.
    assert_eq!(coordinate(500_000.123_456, 0.448), "500000.123");
    assert_eq!([coordinate(-1e-9, 0.07), coordinate(-0.5, 30.0)], ["0.0000", "-0.50"]);
    assert_eq!(coordinate(1.0, 0.0), "1.000");
}
