use super::*;
use crate::evaluation::dataset::{Declined, SceneReport};
use crate::evaluation::diagnosis::{Cause, Diagnosis, PairFinding, ScanFinding};
use crate::evaluation::pose_error::{PairError, PoseError, PoseReport, ScanError};
use crate::evaluation::recall::{PairRecall, RecallReport, RecallSummary};
use crate::report::chart::Series;
use crate::report::grid::{Row, heads};
use crate::scan::ScanId;
use std::collections::BTreeMap;

const HOSTILE: &str =
    "</title></script><script>alert(1)</script><img src=x onerror=\"alert('2')\"><!--body-->";

#[test]
fn the_template_refers_to_nothing_outside_and_lets_nothing_else_run() {
    assert_eq!(TEMPLATE.matches("default-src 'none'; script-src 'sha256-").count(), 1);
    for outside in ["<link", "src=\"", "@import", "url(http", "unsafe-inline", "unsafe-eval", "href=\"http"] {
        assert!(!TEMPLATE.contains(outside), "{outside}");
    }
    let marks = ["title", "brand", "headline", "note", "body", "generator"];
    let places: Vec<usize> = marks.map(|m| TEMPLATE.find(&format!("<!--{m}-->")).unwrap()).to_vec();
    assert!(places.is_sorted(), "{places:?}");
}

#[test]
fn hostile_text_stays_text_wherever_it_stands() {
    let hostile = || HOSTILE.to_owned();
    let grid = Grid::new(vec![hostile(), "n".to_owned()], 1, vec![vec![hostile(), hostile()]]);
    let panel = Panel {
        title: hostile(),
        x_label: hostile(),
        y_label: hostile(),
        x_names: vec![hostile()],
        series: vec![Series { name: hostile(), points: vec![(0.0, 1.0)], line: false, spread: Vec::new() }],
        y_most: 1.0,
    };
    let blocks = vec![
        Block::Figures(vec![(hostile(), hostile())]),
        Block::Text(hostile()),
        Block::Grid(grid.clone()),
        Block::Folded(hostile(), grid),
        Block::chart(&[panel], hostile()).unwrap(),
    ];
    let section = Section { title: hostile(), text: hostile(), blocks };
    let sheet = Sheet { brand: hostile(), headline: hostile(), note: hostile(), sections: vec![section] };
    let page = sheet.html();
    for element in ["<script", "</script", "</title", "<img", "<!--"] {
        let marks = if element == "<!--" { 6 } else { 0 };
        assert_eq!(page.matches(element).count() + marks, TEMPLATE.matches(element).count(), "{element}");
    }
    // Title (brand and headline), brand, headline, note; heading, text, two figures, text, two tables
    // of three cells and a name each, a fold, a plot of five texts, its name and caption.
    let shown = page.matches("alert(1)").count();
    assert_eq!(shown, 2 + 3 + 2 + 2 + 1 + 2 * 4 + 1 + 5 + 2);
}

#[test]
fn columns_of_numbers_and_quoted_rows_are_marked() {
    let mut grid = Grid::new(
        heads(&["name", "recall", "cause"]),
        1,
        vec![heads(&["1", "97.1 (96–98)", "drift"]), heads(&["b", "–", ""]), heads(&["c", "", ""])],
    );
    grid.rows.push(Row { cells: heads(&["theirs", "12.5", ""]), quoted: true });
    let mut page = String::new();
    table(&grid, "x", &mut page);
    for (column, class) in [("name", "text"), ("recall", "number"), ("cause", "text")] {
        assert!(page.contains(&format!("<th scope=\"col\" class=\"{class}\">{column}</th>")), "{page}");
    }
    assert!(page.contains("<tr class=\"quoted\"><th scope=\"row\" class=\"text\">theirs</th>"), "{page}");
    assert_eq!(page.matches("class=\"quoted\"").count(), 1);
}

fn finding(scan: &str, step: usize, parent: Option<usize>) -> ScanFinding {
    ScanFinding {
        scan: scan.to_owned(),
        component: Some(0),
        step: Some(step),
        parent,
        cause: None,
        origin: None,
        join_error_m: None,
        final_error_m: None,
        pivot_error_m: None,
        matches: 310,
        inliers: 83,
        probability: Some(0.75),
        best_before: None,
        best_after: None,
        reason: None,
    }
}

/// Four scans: the pivot, a wrong one, one that it carried along, and one that was left out.
fn scene() -> SceneSheet {
    let mut scans = vec![
        finding("zero", 0, None),
        finding("one", 1, Some(0)),
        finding("two", 2, Some(1)),
        finding("three", 0, None),
    ];
    (scans[1].cause, scans[1].origin, scans[1].join_error_m) = (Some(Cause::WrongPose), Some(1), Some(0.574));
    scans[2].origin = Some(1);
    (scans[3].component, scans[3].step, scans[3].reason) = (None, None, Some("no keypoints".to_owned()));
    let pair = |j: usize, cause: Cause, scan: usize, carried: bool| PairFinding {
        benchmark: "3dmatch".to_owned(),
        i: 0,
        j,
        rmse_m: (cause != Cause::Declined).then_some(0.5),
        overlap: 0.25,
        cause,
        scan,
        carried,
    };
    let pairs = vec![pair(2, Cause::WrongPose, 1, true), pair(3, Cause::Declined, 3, false)];
    let judged = |j: usize, rmse_m: Option<f64>, success: bool| PairRecall {
        i: ScanId(0),
        j: ScanId(j),
        rmse_m,
        success,
        zero_information: false,
    };
    let recall = RecallReport {
        counted: 3,
        succeeded: 1,
        succeeded_in_largest: Some(0),
        zero_information: 0,
        declined: vec![(ScanId(0), ScanId(3))],
        pairs: vec![judged(1, Some(0.1), true), judged(2, Some(0.5), false), judged(3, None, false)],
    };
    let error = |rotation_deg: f64, translation_m: f64| PoseError { rotation_deg, translation_m };
    let off = [error(0.25, 0.01), error(1.5, 0.02), error(40.0, 0.6)];
    let scan_error = |i: usize| ScanError { scan: ScanId(i), component: 0, error: off[i] };
    let pairs_within = vec![
        PairError { i: ScanId(0), j: ScanId(1), error: Some(off[0]) },
        PairError { i: ScanId(0), j: ScanId(2), error: Some(off[2]) },
        PairError { i: ScanId(1), j: ScanId(2), error: Some(off[2]) },
    ];
    SceneSheet {
        report: SceneReport {
            scene: "kitchen".to_owned(),
            scans: 4,
            placed: 3,
            declined: vec![Declined { scan: "three".to_owned(), reason: "no keypoints".to_owned() }],
            truth_deviation: 0.0,
            recalls: BTreeMap::from([("3dmatch".to_owned(), recall)]),
            pairs: Vec::new(),
            errors: None,
        },
        names: heads(&["zero", "one", "two", "three"]),
        poses: Some(PoseReport {
            total: 4,
            placed: 3,
            components: 1,
            scan_summary: crate::evaluation::pose_error::ErrorSummary::new(&off),
            pair_summary: crate::evaluation::pose_error::ErrorSummary::new(&off),
            scans: (0..3).map(scan_error).collect(),
            pairs: pairs_within,
            pairs_at_centre: 3,
            false_joins: Vec::new(),
        }),
        diagnosis: Ok(Diagnosis { limit_m: 0.2, scans, pairs }),
    }
}

fn all(scenes: Vec<SceneSheet>) -> Evaluation {
    let recalls = scenes.iter().filter_map(|s| s.report.recalls.get("3dmatch"));
    let recalls = BTreeMap::from([("3dmatch".to_owned(), RecallSummary::new(recalls))]);
    Evaluation { scenes, recalls }
}

#[test]
fn an_evaluation_says_what_came_out_and_which_scan_went_wrong_first() {
    let sheet = evaluation(&all(vec![scene()])).unwrap();
    assert_eq!(sheet.headline, "Registration recall 33.3 % on 3dmatch; 3 of 4 scans placed.");
    let titles: Vec<&str> = sheet.sections.iter().map(|s| s.title.as_str()).collect();
    assert_eq!(titles, ["Figures", "Scenes", "Errors of the poses", "kitchen"]);
    let Block::Figures(figures) = &sheet.sections[0].blocks[0] else { panic!() };
    assert_eq!(figures[0].0, "33.3 %");
    assert_eq!(figures[0].1, "3dmatch, within all components: mean of 1 scene; all pairs pooled 33.3 %");
    assert_eq!(figures[1].0, "0.0 %");
    assert_eq!(
        figures[1].1,
        "3dmatch, in the largest component alone: mean of 1 scene; all pairs pooled 0.0 %"
    );
    assert_eq!((figures[2].0.as_str(), figures[3].0.as_str()), ("2.0 cm", "1.50°"));
    let Block::Grid(scenes) = &sheet.sections[1].blocks[0] else { panic!() };
    assert_eq!(scenes.head[3..8], ["3dmatch %", "3dmatch largest %", "registered", "in largest", "counted"]);
    assert_eq!(scenes.rows[0].cells[..8], ["kitchen", "4", "3", "33.3", "0.0", "1", "0", "3"]);
    assert_eq!(scenes.rows[0].cells[8..], ["1", "1.50", "0.0200", "40.00", "0.6000"]);

    let blocks = &sheet.sections[3].blocks;
    let Block::Text(said) = &blocks[0] else { panic!() };
    assert!(said.starts_with("2 failed pairs: declined 1, wrong pose 1 (1 carried along"), "{said}");
    let Block::Grid(origins) = &blocks[1] else { panic!() };
    let one = origins.rows.iter().find(|r| r.cells[0] == "one").unwrap();
    assert!(one.cells[4].contains("joined to zero by 83 of 310 matches, probability 0.75; 0.57 m off"));
    let Block::Grid(pairs) = &blocks[2] else { panic!() };
    assert_eq!(pairs.rows.len(), 2);
    let Block::Folded(_, scans) = blocks.last().unwrap() else { panic!() };
    let verdicts: Vec<&str> = scans.rows.iter().map(|r| r.cells[2].as_str()).collect();
    assert_eq!(verdicts, ["right", "wrong pose", "carried along by one", ""]);
    assert_eq!(scans.rows[3].cells[1], "left out: no keypoints");
    assert_eq!(scans.rows[2].cells[4..6], ["40.000", "0.6000"]);
}

/// Points of a curve of the drawn plot, as the page has them.
fn curves(sheet: &Sheet) -> Vec<String> {
    let Block::Picture(svg, _) = &sheet.sections[2].blocks[0] else { panic!() };
    svg.split("<polyline").filter(|p| p.contains("stroke-width=\"2\"")).map(str::to_owned).collect()
}

#[test]
fn curves_end_at_the_share_that_has_an_estimate() {
    let sheet = evaluation(&all(vec![scene()])).unwrap();
    let curves = curves(&sheet);
    assert_eq!(curves.len(), 4, "two curves in two panels");
    // 0 % and 100 % are the lowest and the highest line of the axes; three of four scans have a
    // pose, and three of six pairs.
    let heights = |curve: &String| -> Vec<f64> {
        let points = curve.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
        points.split_whitespace().map(|p| p.split(',').nth(1).unwrap().parse().unwrap()).collect()
    };
    let (scans, pairs) = (heights(&curves[0]), heights(&curves[1]));
    let (zero, scans_end) = (scans[0], *scans.last().unwrap());
    let pairs_end = *pairs.last().unwrap();
    // Both start at 0 %; the heights above it are as 75 to 50, within a pixel.
    assert_eq!(zero, pairs[0]);
    assert!(((zero - scans_end) / (zero - pairs_end) - 1.5).abs() < 0.02, "{zero} {scans_end} {pairs_end}");
}

#[test]
fn without_a_diagnosis_the_failed_pairs_remain_and_without_truth_no_error_is_made_up() {
    let mut scene = scene();
    scene.diagnosis = Err("These poses come from a trajectory.".to_owned());
    scene.poses = None;
    let sheet = evaluation(&all(vec![scene])).unwrap();
    assert!(sheet.note.contains("kitchen"), "{}", sheet.note);
    let titles: Vec<&str> = sheet.sections.iter().map(|s| s.title.as_str()).collect();
    assert_eq!(titles, ["Figures", "Scenes", "kitchen"]);
    let blocks = &sheet.sections[2].blocks;
    assert_eq!(blocks[0], Block::Text("These poses come from a trajectory.".to_owned()));
    let Block::Grid(pairs) = &blocks[1] else { panic!() };
    assert_eq!(pairs.rows[0].cells, ["3dmatch", "0", "2", "0.500"]);
    assert_eq!(pairs.rows[1].cells, ["3dmatch", "0", "3", "no estimate"]);
}
