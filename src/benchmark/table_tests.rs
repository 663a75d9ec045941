use super::super::cell::{CellKey, Environment, PeakOf};
use super::super::plan::PlannedCell;
use super::super::suite::{BenchmarkSource, DataSet, Method, Quoted, SimilarityChoice};
use super::*;
use crate::evaluation::dataset::{Declined, SceneReport};
use crate::evaluation::recall::RecallReport;
use crate::result::Document;
use crate::result::StageTime;
use crate::scan::Reconstruction;
use std::collections::BTreeMap;

fn suite() -> Suite {
    let benchmark = BenchmarkSource { name: "b".into(), protocol: Protocol::ThreeDMatch, folder: None };
    let method = |name: &str| Method {
        name: name.to_owned(),
        preset: "default".to_owned(),
        set: Vec::new(),
        similarity: SimilarityChoice::Predicted,
    };
    Suite {
        name: "s".to_owned(),
        keypoints: vec![100],
        seeds: vec![0, 1],
        datasets: vec![DataSet { name: "d".to_owned(), benchmarks: vec![benchmark], ..DataSet::default() }],
        methods: vec![method("m"), method("n")],
        quoted: vec![Quoted {
            source: "Somebody".to_owned(),
            method: "theirs".to_owned(),
            benchmark: "b".to_owned(),
            scenes: 8,
            keypoints: vec![100, 50],
            recall_percent: vec![81.5, 70.0],
        }],
        ..Suite::default()
    }
}

fn key(scene: &str, method: &str, seed: u64) -> CellKey {
    CellKey { dataset: "d".into(), scene: scene.into(), method: method.into(), keypoints: 100, seed }
}

fn cell(key: CellKey, counted: usize, succeeded: usize, declined: usize, seconds: f64) -> Cell {
    let (format, version) = Cell::stamp();
    // All but one in the largest component.
    let succeeded_in_largest = Some(succeeded - 1);
    let recall = RecallReport { counted, succeeded, succeeded_in_largest, ..RecallReport::default() };
    let lost = Declined { scan: "x".to_owned(), reason: "lost".to_owned() };
    let stage = |stage: &str, seconds: f64| StageTime { stage: stage.to_owned(), seconds };
    Cell {
        format,
        version,
        hash: "h".to_owned(),
        environment: Environment {
            generator: String::new(),
            build: String::new(),
            threads: 1,
            jobs: 1,
            cores: 1,
            system: String::new(),
        },
        overlap_head: String::new(),
        benchmarks: BTreeMap::from([("b".to_owned(), Protocol::ThreeDMatch)]),
        report: SceneReport {
            scene: key.scene.clone(),
            scans: 5,
            placed: 5 - declined,
            declined: vec![lost; declined],
            truth_deviation: 0.0,
            recalls: BTreeMap::from([("b".to_owned(), recall)]),
            pairs: Vec::new(),
            errors: None,
        },
        pair_overlaps: BTreeMap::new(),
        diagnosis: None,
        retrieval: None,
        timings: vec![stage("features", 100.0), stage("similarity", 0.5), stage("registration", seconds)],
        features_reused: 0,
        peak_memory_bytes: Some(1000 * counted as u64),
        peak_memory_of: PeakOf::Cell,
        poses: Document::new(&[], &Reconstruction::default(), 0.07),
        key,
    }
}

#[test]
fn the_spread_of_known_values() {
    let s = Spread::new(vec![1.0, 2.0, 4.0]).unwrap();
    assert_eq!((s.low, s.high), (1.0, 4.0));
    assert!((s.mean - 7.0 / 3.0).abs() < 1e-12);
    // Squares about the mean: 16/9 + 1/9 + 25/9 = 42/9, over n − 1 = 2.
    assert!((s.deviation.unwrap() - (21.0f64 / 9.0).sqrt()).abs() < 1e-12);
    assert_eq!(Spread::new(vec![3.0]).unwrap().deviation, None);
    assert_eq!(Spread::new(Vec::new()), None);
}

#[test]
fn recalls_are_averaged_over_scenes_then_seeds() {
    let suite = suite();
    let keys = ["m", "n"].into_iter().flat_map(|m| [0, 1].map(|seed| (m, seed)));
    let keys = keys.flat_map(|(m, seed)| ["one", "two"].map(|scene| key(scene, m, seed)));
    let cells = keys.map(|key| PlannedCell { key, hash: "h".to_owned() }).collect();
    let plan = Plan { cells };
    let there = [
        cell(key("one", "m", 0), 10, 10, 0, 1.5),
        cell(key("two", "m", 0), 30, 15, 1, 3.5),
        cell(key("one", "m", 1), 10, 6, 2, 1.5),
        cell(key("two", "m", 1), 30, 30, 0, 9.5),
    ];
    let table = Table::new(&suite, &plan, &there);
    assert_eq!((table.done, table.planned, table.recalls.len()), (4, 8, 3));
    let row = &table.recalls[0];
    let recall = row.recall.as_ref().unwrap();
    // Seed 0: (1 + ½)/2; seed 1: (0.6 + 1)/2. Pooled: 25/40 and 36/40.
    assert_eq!(recall.values, [0.75, 0.8]);
    assert_eq!(row.pooled.as_ref().unwrap().values, [0.625, 0.9]);
    // Seed 0: (9/10 + 14/30)/2; seed 1: (5/10 + 29/30)/2. Pooled: 23/40 and 34/40.
    let largest = &row.recall_in_largest.as_ref().unwrap().values;
    assert!((largest[0] - 41.0 / 60.0).abs() < 1e-12 && (largest[1] - 44.0 / 60.0).abs() < 1e-12);
    assert_eq!(row.pooled_in_largest.as_ref().unwrap().values, [0.575, 0.85]);
    assert_eq!(row.by_scene, [Some(0.8), Some(0.75)]);
    assert_eq!((row.cells, row.scenes, row.declined), ((4, 4), 2, 1.5));
    let cost = row.cost.as_ref().unwrap();
    // Without features: 2, 4, 2 and 10 seconds.
    assert_eq!((cost.seconds, cost.seconds_most, cost.peak_memory_bytes), (4.5, 10.0, Some(30_000)));
    let empty = &table.recalls[1];
    assert_eq!((empty.cells, &empty.recall, &empty.cost), ((0, 4), &None, &None));
    // Of the quoted figures, those for a number of keypoints that is compared.
    let quoted = &table.recalls[2];
    assert_eq!((quoted.quoted.as_deref(), quoted.keypoints, quoted.scenes), (Some("Somebody"), 100, 8));
    assert!((quoted.recall.as_ref().unwrap().mean - 0.815).abs() < 1e-12);
    assert_eq!(quoted.recall_in_largest, None);
    // One cell of an earlier version does not tell, and so the row does not.
    let mut there = there;
    there[2].report.recalls.get_mut("b").unwrap().succeeded_in_largest = None;
    let table = Table::new(&suite, &plan, &there);
    assert_eq!((&table.recalls[0].recall_in_largest, &table.recalls[0].pooled_in_largest), (&None, &None));
    assert_eq!(table.recalls[0].recall.as_ref().unwrap().values, [0.75, 0.8]);
}
