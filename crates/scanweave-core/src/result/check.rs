//! Whether the parts of a `poses.json` fit each other: a document from elsewhere may be cut, edited or
//! joined from two, and every number in it that names a scan or component is used as an index.

use super::poses::{Component, Document, Entry, EntryOutcome, Pose};
use crate::geometry::rigid::motion_from_matrix;
use nalgebra::Matrix4;
use std::collections::BTreeSet;
use std::path::Path;

/// Largest deviation of a rotation from orthonormal: what is written has 16 digits.
pub(super) const ORTHONORMAL: f64 = 1e-6;

/// What was found in place of what belongs there.
pub(super) type Misfit = (String, String);

/// The first part of a document that does not fit the others.
pub(super) fn misfit(document: &Document) -> Option<Misfit> {
    let scans = &document.scans;
    if scans.is_empty() {
        return Some(("an empty list of scans".to_owned(), "one entry a scan".to_owned()));
    }
    wrong_id(scans)
        .or_else(|| wrong_name(scans))
        .or_else(|| scans.iter().find_map(|entry| wrong_pose(entry, document)))
        .or_else(|| {
            document
                .components
                .iter()
                .enumerate()
                .find_map(|(c, component)| wrong_members(c, component, scans))
        })
        .or_else(|| cycle(scans))
}

fn pose(entry: &Entry) -> Option<&Pose> {
    match &entry.outcome {
        EntryOutcome::Placed(pose) => Some(pose),
        EntryOutcome::Declined { .. } => None,
    }
}

fn wrong_id(scans: &[Entry]) -> Option<Misfit> {
    let (place, entry) = scans.iter().enumerate().find(|(place, entry)| entry.id != *place)?;
    let expected = format!("{place}: ids count the entries from 0, in order");
    Some((format!("id {} in entry {place} of scans", entry.id), expected))
}

/// Names become names of files.
fn wrong_name(scans: &[Entry]) -> Option<Misfit> {
    let mut seen = BTreeSet::new();
    for Entry { id, name, .. } in scans {
        let normal = |c| matches!(c, std::path::Component::Normal(_));
        if name.is_empty() || !Path::new(name).components().all(normal) {
            let expected = "a name without a root or '..', of which files can be named";
            return Some((format!("the name '{name}' of scan {id}"), expected.to_owned()));
        }
        if !seen.insert(name) {
            let found = format!("the name '{name}' of scan {id} for a second time");
            return Some((found, "a name of its own for every scan".to_owned()));
        }
    }
    None
}

/// A pose that is none, or that names scans or a component that are not there.
fn wrong_pose(entry: &Entry, document: &Document) -> Option<Misfit> {
    let Entry { id, .. } = entry;
    let pose = pose(entry)?;
    let matrix = Matrix4::from_fn(|r, c| pose.world_from_scan[r][c]);
    if motion_from_matrix(&matrix, ORTHONORMAL).is_none() {
        let expected = "a rotation and a translation above 0 0 0 1".to_owned();
        return Some((format!("a world_from_scan of scan {id} that is no rigid motion"), expected));
    }
    let members = document.components.get(pose.component);
    if !members.is_some_and(|c| c.scans.contains(id)) {
        let expected = format!("one of the {} components, which lists scan {id}", document.components.len());
        return Some((format!("component {} of scan {id}", pose.component), expected));
    }
    let with_it = |other: usize| {
        other != *id
            && document.scans.get(other).and_then(self::pose).is_some_and(|p| p.component == pose.component)
    };
    let expected = format!("another scan of component {}", pose.component);
    if let Some(parent) = pose.parent.filter(|&p| !with_it(p)) {
        return Some((format!("parent {parent} of scan {id}"), expected));
    }
    if let Some(n) = pose.neighbours.iter().find(|n| !with_it(n.scan.0)) {
        return Some((format!("neighbour {} of scan {id}", n.scan.0), expected));
    }
    let edge = pose.pose_uncertainty.as_ref().and_then(|u| u.weakest_edge)?;
    let ends = [edge.scans.0.0, edge.scans.1.0];
    let lost = ends.into_iter().find(|&end| end >= document.scans.len())?;
    let expected = format!("one of the {} scans", document.scans.len());
    Some((format!("scan {lost} in the weakest edge of scan {id}"), expected))
}

/// A component must list, in order, exactly the scans that say they are in it.
fn wrong_members(number: usize, component: &Component, scans: &[Entry]) -> Option<Misfit> {
    let inside = |entry: &&Entry| pose(entry).is_some_and(|p| p.component == number);
    let members: Vec<usize> = scans.iter().filter(inside).map(|entry| entry.id).collect();
    if members.is_empty() {
        let expected = "components with a scan each, numbered without gaps".to_owned();
        return Some((format!("component {number} without a placed scan"), expected));
    }
    if component.scans != members {
        let (found, placed) = (component.scans.len(), members.len());
        let expected = format!("in ascending order the {placed} that are placed in it");
        return Some((format!("{found} scans listed in component {number}"), expected));
    }
    let roots = |scan: &usize| scans.get(*scan).and_then(pose).is_some_and(|p| p.parent.is_none());
    match component.pivot {
        Some(pivot) if members.contains(&pivot) && roots(&pivot) => None,
        // Where every scan has a parent, there is a cycle, which is named better.
        None if !members.iter().any(roots) => None,
        Some(pivot) => Some((
            format!("pivot {pivot} of component {number}"),
            "one of its scans without a parent".to_owned(),
        )),
        None => Some((format!("no pivot of component {number}"), "its scan without a parent".to_owned())),
    }
}

/// Parents that lead back to a scan.
fn cycle(scans: &[Entry]) -> Option<Misfit> {
    // Scans whose parents lead to a pivot.
    let mut rooted = vec![false; scans.len()];
    for start in 0..scans.len() {
        let (mut path, mut at) = (Vec::new(), Some(start));
        while let Some(scan) = at.filter(|&s| !rooted[s]) {
            // No path of parents is longer than there are scans.
            if path.len() > scans.len() {
                let expected = "parents that lead to a pivot".to_owned();
                return Some((format!("a cycle of parents from scan {start}"), expected));
            }
            path.push(scan);
            at = pose(&scans[scan]).and_then(|p| p.parent);
        }
        path.into_iter().for_each(|scan| rooted[scan] = true);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::poses::Document;
    use serde_json::{Value, json};

    const IDENTITY: [[f64; 4]; 4] =
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

    fn placed(id: usize, component: usize, parent: Option<usize>, neighbours: &[usize]) -> Value {
        let neighbours: Vec<Value> =
            neighbours.iter().map(|n| json!({"scan": n, "overlap": 0.5, "residual_m": 0.01})).collect();
        json!({
            "id": id, "name": format!("s{id}"), "file": format!("s{id}.ply"), "outcome": "placed",
            "component": component, "step": id, "world_from_scan": IDENTITY,
            "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "parent": parent, "matches": 9, "inliers": 5,
            "inlier_ratio": 0.5, "residual_m": 0.01, "evidence": null, "neighbours": neighbours,
            "pose_uncertainty": {"weakest_edge": null, "covariance": null},
        })
    }

    /// Three scans in a chain, one alone, one declined.
    fn whole() -> Value {
        json!({
            "format": "scanweave-poses", "version": 3, "generator": "a test",
            "components": [{"pivot": 0, "scans": [0, 1, 2]}, {"pivot": 3, "scans": [3]}],
            "scans": [
                placed(0, 0, None, &[1]), placed(1, 0, Some(0), &[0, 2]), placed(2, 0, Some(1), &[1]),
                placed(3, 1, None, &[]),
                {"id": 4, "name": "s4", "file": null, "outcome": "declined",
                 "decline": {"reason": "degenerate", "detail": "flat"}, "explanation": "flat"},
            ],
        })
    }

    fn read(text: &str) -> Result<Document, String> {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("poses.json");
        std::fs::write(&path, text).unwrap();
        Document::load(&path).map_err(|e| e.to_string())
    }

    #[test]
    fn a_document_whose_parts_fit_is_read() {
        assert_eq!(read(&whole().to_string()).unwrap().scans.len(), 5);
    }

    #[test]
    fn what_does_not_fit_is_one_error_that_names_it() {
        let edge = |scans: [usize; 2]| json!({"scans": scans, "probability": 0.9});
        for (at, value, said) in [
            ("/scans/2/parent", json!(99), "parent 99 of scan 2"),
            ("/scans/2/parent", json!(2), "parent 2 of scan 2"),
            ("/scans/2/parent", json!(3), "parent 3 of scan 2"),
            ("/scans/2/parent", json!(4), "parent 4 of scan 2"),
            ("/scans/1/neighbours/1/scan", json!(99), "neighbour 99 of scan 1"),
            ("/scans/1/neighbours/1/scan", json!(4), "neighbour 4 of scan 1"),
            ("/scans/1/pose_uncertainty/weakest_edge", edge([0, 5]), "scan 5 in the weakest edge of scan 1"),
            ("/components/0/scans/2", json!(99), "component 0 of scan 2"),
            ("/components/1/scans", json!([3, 99]), "2 scans listed in component 1"),
            ("/components/0/scans", json!([1, 0, 2]), "3 scans listed in component 0"),
            ("/components/1/scans", json!([3, 4]), "2 scans listed in component 1"),
            ("/components/0/pivot", json!(3), "pivot 3 of component 0"),
            ("/components/0/pivot", json!(1), "pivot 1 of component 0"),
            ("/components/0/pivot", json!(null), "no pivot of component 0"),
            ("/components/1", json!({"pivot": null, "scans": []}), "component 1 of scan 3"),
            ("/scans/3/component", json!(2), "component 2 of scan 3"),
            ("/scans/0/parent", json!(2), "a cycle of parents"),
            ("/scans/1/id", json!(0), "id 0 in entry 1"),
            ("/scans/1/id", json!(2), "id 2 in entry 1"),
            ("/scans/1/name", json!("s0"), "the name 's0' of scan 1 for a second time"),
            ("/scans/1/name", json!("../../s1"), "the name '../../s1' of scan 1"),
            ("/scans/1/name", json!("/there/s1"), "the name '/there/s1' of scan 1"),
            ("/scans/1/name", json!(""), "the name '' of scan 1"),
            ("/scans/1/world_from_scan/0/0", json!(1.001), "a world_from_scan of scan 1"),
            ("/scans/1/world_from_scan/0/0", json!(-1.0), "a world_from_scan of scan 1"),
            ("/scans/1/world_from_scan/3/0", json!(0.5), "a world_from_scan of scan 1"),
            ("/scans", json!([]), "an empty list of scans"),
        ] {
            let mut document = whole();
            // A cycle has no pivot.
            if said.contains("cycle") {
                document["components"][0]["pivot"] = Value::Null;
            }
            *document.pointer_mut(at).unwrap() = value;
            let message = read(&document.to_string()).unwrap_err();
            assert!(message.contains(&format!("poses.json: found {said}")), "{message}");
            assert!(
                message.contains("expected") && message.contains("register the scans again"),
                "{message}"
            );
        }
    }

    #[test]
    fn a_component_without_scans_and_numbers_that_are_none_are_refused() {
        let mut gap = whole();
        gap["components"].as_array_mut().unwrap().push(json!({"pivot": null, "scans": []}));
        assert!(read(&gap.to_string()).unwrap_err().contains("component 2 without a placed scan"));
        let text = whole().to_string();
        for number in ["NaN", "Infinity", "1e999", "null"] {
            let text = text.replacen("\"residual_m\":0.01", &format!("\"residual_m\":{number}"), 1);
            assert!(read(&text).unwrap_err().contains("text that does not fit"), "{number}");
        }
    }
}
