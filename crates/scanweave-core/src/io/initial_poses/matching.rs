//! Which scan a pose belongs to.

use super::Entry;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::io::scalar::counted;
use crate::io::trajectories::distinct_numbers;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Poses by the places of the scans.
type Assigned = Vec<Option<RigidMotion>>;

/// What the scans are called, and the file that gives their poses.
pub(super) struct Labels<'a> {
    path: &'a Path,
    names: &'a [String],
    /// Scans by what they may be called, from the exact to the loose.
    by_label: Vec<BTreeMap<String, Vec<usize>>>,
}

/// The last part of a path, and that without its extension.
fn last(text: &str) -> (String, String) {
    let name = text.rsplit(['/', '\\']).next().unwrap_or(text);
    let stem = Path::new(name).file_stem().map(|s| s.to_string_lossy().into_owned());
    (name.to_owned(), stem.unwrap_or_default())
}

impl<'a> Labels<'a> {
    pub(super) fn new(path: &'a Path, names: &'a [String], files: &[Option<PathBuf>]) -> Self {
        let mut by_label = vec![BTreeMap::<String, Vec<usize>>::new(); 4];
        for (scan, name) in names.iter().enumerate() {
            let mut add = |rank: usize, label: String| {
                let scans = by_label[rank].entry(label).or_default();
                if scans.last() != Some(&scan) {
                    scans.push(scan);
                }
            };
            add(0, name.clone());
            add(3, last(name).0);
            if let Some(file) = files.get(scan).and_then(Option::as_ref).map(|f| f.display().to_string()) {
                let (name, stem) = last(&file);
                add(1, file);
                add(2, name);
                add(3, stem);
            }
        }
        Self { path, names, by_label }
    }

    /// The scan of one of these names.
    fn named(&self, keys: &[String], at: &str) -> Result<usize> {
        let shown = keys.first().map(String::as_str).unwrap_or_default();
        for key in keys {
            let (name, stem) = last(key);
            let tried = [(0, key), (1, key), (2, &name), (3, &name), (3, &stem)];
            match tried
                .into_iter()
                .find_map(|(rank, label)| self.by_label[rank].get(label))
                .map(Vec::as_slice)
            {
                Some(&[scan]) => return Ok(scan),
                Some(scans) => {
                    let of: Vec<&str> = scans.iter().take(3).map(|&s| self.names[s].as_str()).collect();
                    let found =
                        format!("'{key}' in {at}, which fits {} scans ({})", scans.len(), of.join(", "));
                    return Err(self.wrong(found, "one scan", "name the pose by the whole name of its scan"));
                }
                None => {}
            }
        }
        Err(self.wrong(format!("a pose of '{shown}' in {at}"), self.expected("names"), REMEDY))
    }

    pub(super) fn by_name(&self, entries: &[Entry<Vec<String>>]) -> Result<Assigned> {
        let scans = entries.iter().map(|e| self.named(&e.key, &e.at)).collect::<Result<Vec<usize>>>()?;
        self.assigned(entries, &scans)
    }

    pub(super) fn by_number(&self, entries: &[Entry<u64>]) -> Result<Assigned> {
        let of_names = distinct_numbers(self.names.iter().map(String::as_str));
        let of_names: Option<BTreeMap<u64, usize>> = of_names.and_then(|numbers| {
            numbers.iter().enumerate().map(|(k, n)| Some((n.parse().ok()?, k))).collect()
        });
        let by_name = |n: u64| of_names.as_ref().and_then(|m| m.get(&n).copied());
        let by_place = |n: u64| usize::try_from(n).ok().filter(|&k| k < self.names.len());
        match (scans_by(entries, by_name), scans_by(entries, by_place)) {
            (Some(a), Some(b)) if a != b => {
                let differs = (0..a.len()).find(|&k| a[k] != b[k]).unwrap_or(0);
                let (number, at) = (entries[differs].key, &entries[differs].at);
                let [a, b] = [a[differs], b[differs]].map(|scan| &self.names[scan]);
                let found =
                    format!("the number {number} in {at}, which may mean {a} by name or {b} by place");
                let expected = "numbers that fit the names or the places of the scans";
                Err(self.wrong(found, expected, "give the poses with names: poses.json, or a table"))
            }
            (Some(scans), _) | (_, Some(scans)) => self.assigned(entries, &scans),
            (None, None) => {
                let stray = entries.iter().find(|e| by_name(e.key).or(by_place(e.key)).is_none());
                let stray = stray.or_else(|| entries.iter().find(|e| by_name(e.key).is_none()));
                let found = stray.map(|e| format!("a pose of number {} in {}", e.key, e.at));
                Err(self.wrong(found.unwrap_or_default(), self.expected("numbers"), REMEDY))
            }
        }
    }

    pub(super) fn by_timestamp(&self, entries: &[Entry<f64>]) -> Result<Assigned> {
        let of_names = distinct_numbers(self.names.iter().map(String::as_str)).unwrap_or_default();
        let mut of_names: Vec<(f64, usize)> =
            of_names.iter().enumerate().filter_map(|(k, n)| Some((n.parse().ok()?, k))).collect();
        of_names.sort_by(|a, b| a.0.total_cmp(&b.0));
        let by_name = |stamp: f64| {
            let after = of_names.partition_point(|n| n.0 < stamp);
            let around = of_names.get(after.saturating_sub(1)..(after + 1).min(of_names.len()))?;
            let apart = |n: &&(f64, usize)| (n.0 - stamp).abs();
            let nearest = around.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
            // Programs write timestamps with six digits after the point.
            (apart(&nearest) <= f64::max(1e-6, 4.0 * f64::EPSILON * stamp.abs())).then_some(nearest.1)
        };
        let count = self.names.len();
        let by_place = |stamp: f64| {
            (stamp >= 0.0 && stamp.fract() == 0.0 && stamp < count as f64).then_some(stamp as usize)
        };
        match scans_by(entries, by_name).or_else(|| scans_by(entries, by_place)) {
            Some(scans) => self.assigned(entries, &scans),
            None if entries.len() == count => Ok(entries.iter().map(|e| Some(e.pose)).collect()),
            None => {
                let stray = entries.iter().find(|e| by_name(e.key).is_none());
                let found = stray.map(|e| format!("a pose of the timestamp {} in {}", e.key, e.at));
                let expected = format!("{}, or {count} poses in order", self.expected("timestamps"));
                Err(self.wrong(found.unwrap_or_default(), expected, REMEDY))
            }
        }
    }

    pub(super) fn in_order(&self, poses: Vec<RigidMotion>) -> Result<Assigned> {
        if poses.len() != self.names.len() {
            let expected = format!("{}, one for each scan, in the order of the input", self.names.len());
            let remedy = "write a pose for every scan, or give the poses with names: poses.json, or a table";
            return Err(self.wrong(
                format!("{} without names", counted(poses.len(), "pose")),
                expected,
                remedy,
            ));
        }
        Ok(poses.into_iter().map(Some).collect())
    }

    /// The poses in the places of their scans, each at most once.
    fn assigned<K>(&self, entries: &[Entry<K>], scans: &[usize]) -> Result<Assigned> {
        if entries.is_empty() {
            let expected = "at least one pose";
            return Err(self.wrong(
                "none".to_owned(),
                expected,
                "name a file that holds poses of these scans",
            ));
        }
        let mut places: Vec<Option<&Entry<K>>> = vec![None; self.names.len()];
        for (entry, &scan) in entries.iter().zip(scans) {
            if let Some(before) = places[scan].replace(entry) {
                let found = format!("poses of {} in {} and {}", self.names[scan], before.at, entry.at);
                return Err(self.wrong(found, "one pose a scan", "remove one of them"));
            }
        }
        Ok(places.into_iter().map(|entry| entry.map(|e| e.pose)).collect())
    }

    fn expected(&self, what: &str) -> String {
        let first: Vec<&str> = self.names.iter().take(3).map(String::as_str).collect();
        let more = if self.names.len() > first.len() { ", …" } else { "" };
        format!("{what} of the {} ({}{more})", counted(self.names.len(), "scan"), first.join(", "))
    }

    fn wrong(&self, found: String, expected: impl Into<String>, remedy: &str) -> Error {
        Error::file(self.path, found, expected, remedy)
    }
}

/// The scan of every entry, if all have one.
fn scans_by<K: Copy>(entries: &[Entry<K>], scan: impl Fn(K) -> Option<usize>) -> Option<Vec<usize>> {
    entries.iter().map(|e| scan(e.key)).collect()
}

const REMEDY: &str = "name poses as the scans are named, or leave those of other scans out";
