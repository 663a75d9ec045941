//! Registered pairs of one shard, handed from `scanweave pairs` to `scanweave register --pairs`: one NPZ.
//!
//! `header` bytes: JSON of [`PairShardHeader`]; `pairs` `[P,4]`: both scans in the canonical order, numbers of
//! hypotheses and matches; `hypotheses` `[H,20]`: translation (3, metres), rotation as x y z w, what either
//! scan saw through of the other (2), evidence (11); `matches` `[M,2]`: keypoints of both scans; `digest` 32
//! bytes: BLAKE3 of all that.

use super::npy::{Array, Number};
use super::npz::{self, Archive};
use crate::atomic;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::scan::Evidence;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use ndarray::{Array1, Array2};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

/// Raised when files of an older version must not be read any more.
const VERSION: u32 = 1;
const OF_PAIR: usize = 4;
const OF_HYPOTHESIS: usize = 20;

/// What the pairs of a file belong to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairShardHeader {
    /// Version of the program that wrote it.
    pub program: String,
    /// Which part of the pairs it holds, from 0.
    pub shard: usize,
    /// Of how many.
    pub shards: usize,
    /// Settings by their dotted keys.
    pub settings: BTreeMap<String, String>,
    /// Number of scans.
    pub scans: usize,
    /// Digest of everything else that pairs are registered from, in hexadecimal digits.
    pub content: String,
    /// Pairs that all shards register together.
    pub planned: usize,
}

/// A possible relative pose of a pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShardHypothesis {
    /// Takes coordinates of the second scan to those of the first.
    pub first_from_second: RigidMotion,
    /// What speaks for it; no pose of a parent.
    pub evidence: Evidence,
    /// What either scan saw through of the other.
    pub seen_through: [f64; 2],
}

/// A registered pair.
#[derive(Debug, Clone, PartialEq)]
pub struct ShardPair {
    /// Both scans in the canonical order.
    pub scans: (usize, usize),
    /// Mutual matches as keypoints of both scans.
    pub matches: Box<[(u32, u32)]>,
    /// Possible relative poses, most probable first.
    pub hypotheses: Vec<ShardHypothesis>,
}

/// The content of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct PairShard {
    /// What the pairs belong to.
    pub header: PairShardHeader,
    /// The pairs, in the order in which they were planned.
    pub pairs: Vec<ShardPair>,
}

/// The name of the file of shard number `index` of `count`.
pub fn pair_shard_name(index: usize, count: usize) -> String {
    format!("pairs-{index}-of-{count}.npz")
}

/// The shard and the number of shards that a file is named for.
pub fn pair_shard_of_name(name: &str) -> Option<(usize, usize)> {
    let (index, count) = name.strip_prefix("pairs-")?.strip_suffix(".npz")?.split_once("-of-")?;
    let shard = (index.parse().ok()?, count.parse().ok()?);
    // Not another spelling of the same numbers.
    (pair_shard_name(shard.0, shard.1) == name).then_some(shard)
}

/// Reads what [`write_pair_shard()`] writes, to the last bit.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] for a file of another version, and one that is cut short or altered.
pub fn read_pair_shard(path: &Path) -> Result<PairShard> {
    read(path).map_err(|error| match error {
        Error::File { path, found, expected, .. } => {
            Error::file(path, found, expected, "delete it and run `scanweave pairs` for its shard again")
        }
        other => other,
    })
}

/// Writes the pairs of a shard.
///
/// # Errors
/// [`Error::Write`].
pub fn write_pair_shard(path: &Path, shard: &PairShard) -> Result<()> {
    let header = Versioned { format_version: VERSION, header: shard.header.clone() };
    let header = serde_json::to_vec(&header).map_err(|e| Error::write(path, io::Error::other(e)))?;
    let arrays = Arrays::of(header, &shard.pairs);
    let digest = Array1::from_iter(arrays.digest());
    let Arrays { header, pairs, hypotheses, matches } = arrays;
    fn table<T>(values: Vec<T>, columns: usize) -> io::Result<Array2<T>> {
        Array2::from_shape_vec((values.len() / columns, columns), values).map_err(io::Error::other)
    }
    atomic::write(path, |sink| {
        let (header, pairs) = (Array1::from_vec(header), table(pairs, OF_PAIR)?);
        let (hypotheses, matches) = (table(hypotheses, OF_HYPOTHESIS)?, table(matches, 2)?);
        let archive = npz::archive(|npz| {
            npz.add_array("header", &header)?;
            npz.add_array("pairs", &pairs)?;
            npz.add_array("hypotheses", &hypotheses)?;
            npz.add_array("matches", &matches)?;
            npz.add_array("digest", &digest)
        })?;
        sink.write_all(&archive)
    })
}

/// The header as it stands in the file: a version that is unknown must be told before its fields are.
#[derive(Serialize)]
struct Versioned {
    format_version: u32,
    #[serde(flatten)]
    header: PairShardHeader,
}

/// The arrays of a file, row after row.
struct Arrays {
    header: Vec<u8>,
    pairs: Vec<f64>,
    hypotheses: Vec<f64>,
    matches: Vec<u32>,
}

impl Arrays {
    fn of(header: Vec<u8>, pairs: &[ShardPair]) -> Self {
        let counts = |p: &ShardPair| {
            [p.scans.0, p.scans.1, p.hypotheses.len(), p.matches.len()].map(|number| number as f64)
        };
        Self {
            header,
            pairs: pairs.iter().flat_map(counts).collect(),
            hypotheses: pairs.iter().flat_map(|p| &p.hypotheses).flat_map(numbers).collect(),
            matches: pairs.iter().flat_map(|p| &p.matches).flat_map(|&(a, b)| [a, b]).collect(),
        }
    }

    fn digest(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        let mut add = |bytes: &[u8]| {
            hasher.update(&(bytes.len() as u64).to_le_bytes()).update(bytes);
        };
        add(&self.header);
        for values in [&self.pairs, &self.hypotheses] {
            add(&values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
        }
        add(&self.matches.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
        hasher.finalize().into()
    }
}

fn read(path: &Path) -> Result<PairShard> {
    const EXPECTED: &str = "the pairs of a shard, as `scanweave pairs` writes them";
    let broken = |found: String| Error::file(path, found, EXPECTED, "");
    let bytes = crate::files::read(path)?;
    let mut archive = Archive::open(path, &bytes).map_err(|error| match error {
        Error::File { found, .. } => broken(format!("{} bytes that are {found}", bytes.len())),
        other => other,
    })?;
    fn values<T: Number>(array: Option<Array<T>>, columns: Option<usize>) -> Option<Vec<T>> {
        let array = array.filter(|a| match columns {
            None => a.shape.len() == 1,
            Some(columns) => a.matrix().is_some_and(|(_, c)| c == columns),
        })?;
        Some(array.values)
    }
    let missing = |name: &str| broken(format!("no array '{name}' of the right shape"));
    let header = values(archive.array::<u8>("header")?, None).ok_or_else(|| missing("header"))?;
    // Another version may have other arrays.
    let json: serde_json::Value =
        serde_json::from_slice(&header).map_err(|e| broken(format!("a header that is no JSON ({e})")))?;
    let version = json.get("format_version").and_then(serde_json::Value::as_u64);
    if version != Some(u64::from(VERSION)) {
        let found = version.map_or("no version".to_owned(), |v| format!("version {v} of the format"));
        return Err(Error::file(path, found, format!("version {VERSION}"), ""));
    }
    let arrays = Arrays {
        header,
        pairs: values(archive.array("pairs")?, Some(OF_PAIR)).ok_or_else(|| missing("pairs"))?,
        hypotheses: values(archive.array("hypotheses")?, Some(OF_HYPOTHESIS))
            .ok_or_else(|| missing("hypotheses"))?,
        matches: values(archive.array("matches")?, Some(2)).ok_or_else(|| missing("matches"))?,
    };
    let digest: Vec<u8> = values(archive.array("digest")?, None).ok_or_else(|| missing("digest"))?;
    if digest != arrays.digest() {
        return Err(broken("numbers that do not match their checksum".to_owned()));
    }
    let header = header_of(json).map_err(|e| broken(format!("a header of another kind ({e})")))?;
    let pairs = pairs_of(&arrays).ok_or_else(|| broken("counts that do not fit the arrays".to_owned()))?;
    Ok(PairShard { header, pairs })
}

fn header_of(mut json: serde_json::Value) -> serde_json::Result<PairShardHeader> {
    if let Some(fields) = json.as_object_mut() {
        fields.remove("format_version");
    }
    serde_json::from_value(json)
}

/// The pairs, if the counts add up.
fn pairs_of(arrays: &Arrays) -> Option<Vec<ShardPair>> {
    let mut hypotheses = arrays.hypotheses.as_chunks::<OF_HYPOTHESIS>().0;
    let mut matches = arrays.matches.as_chunks::<2>().0;
    let mut pairs = Vec::new();
    for row in arrays.pairs.as_chunks::<OF_PAIR>().0 {
        let whole = |v: &f64| *v >= 0.0 && v.fract() == 0.0 && *v < f64::from(u32::MAX);
        let [i, j, of_hypotheses, of_matches] = row.iter().all(whole).then(|| row.map(|v| v as usize))?;
        let (own, rest) = hypotheses.split_at_checked(of_hypotheses)?;
        hypotheses = rest;
        let (own_matches, rest) = matches.split_at_checked(of_matches)?;
        matches = rest;
        pairs.push(ShardPair {
            scans: (i, j),
            matches: own_matches.iter().map(|&[a, b]| (a, b)).collect(),
            hypotheses: own.iter().map(hypothesis).collect(),
        });
    }
    (hypotheses.is_empty() && matches.is_empty()).then_some(pairs)
}

fn numbers(hypothesis: &ShardHypothesis) -> [f64; OF_HYPOTHESIS] {
    let ShardHypothesis { first_from_second: pose, evidence: e, seen_through } = hypothesis;
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    let [matches, inliers, second] = [e.matches, e.inliers, e.second_best_inliers].map(|n| n as f64);
    let [of_first, of_second] = *seen_through;
    let p = e.probability.unwrap_or(f64::NAN);
    #[rustfmt::skip]
    let numbers = [
        t.x, t.y, t.z, q.x, q.y, q.z, q.w, of_first, of_second,
        matches, inliers, second, e.chance_inliers, e.overlap, e.normal_agreement, e.plane_residual,
        e.free_space_violation, e.localizability, e.prior_penalty, p,
    ];
    numbers
}

fn hypothesis(row: &[f64; OF_HYPOTHESIS]) -> ShardHypothesis {
    let [tx, ty, tz, x, y, z, w, of_first, of_second, evidence @ ..] = *row;
    let [matches, inliers, second, chance_inliers, overlap, normal_agreement, plane_residual, rest @ ..] =
        evidence;
    let [free_space_violation, localizability, prior_penalty, p] = rest;
    ShardHypothesis {
        // Not normalised again: the numbers must come back as they were.
        first_from_second: RigidMotion::from_parts(
            Translation3::new(tx, ty, tz),
            UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
        ),
        evidence: Evidence {
            matches: matches as usize,
            inliers: inliers as usize,
            second_best_inliers: second as usize,
            chance_inliers,
            overlap,
            normal_agreement,
            plane_residual,
            free_space_violation,
            localizability,
            prior_penalty,
            probability: (!p.is_nan()).then_some(p),
            parent_from_scan: None,
        },
        seen_through: [of_first, of_second],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn shard() -> PairShard {
        let hypothesis = |k: f64| ShardHypothesis {
            first_from_second: RigidMotion::new(Vector3::new(k / 3.0, -2.0, 0.1), Vector3::new(0.3, k, -0.7)),
            evidence: Evidence {
                matches: 412,
                inliers: 37,
                second_best_inliers: 3,
                chance_inliers: 0.1 * k,
                overlap: 0.4,
                normal_agreement: 0.7,
                plane_residual: 0.3,
                free_space_violation: 0.01,
                localizability: 1.0 / 3.0,
                prior_penalty: 4.6,
                probability: Some(0.9 / k),
                parent_from_scan: None,
            },
            seen_through: [0.1, k * 0.7],
        };
        let unmeasured = ShardHypothesis { evidence: Evidence::default(), ..hypothesis(2.0) };
        let header = PairShardHeader {
            program: "0.1.0".to_owned(),
            shard: 1,
            shards: 3,
            settings: BTreeMap::from([("seed".to_owned(), "7".to_owned())]),
            scans: 9,
            content: "ab12".to_owned(),
            planned: 8,
        };
        let pair = |scans, hypotheses, matches: &[(u32, u32)]| ShardPair {
            scans,
            hypotheses,
            matches: matches.iter().copied().collect(),
        };
        let pairs = vec![
            pair((0, 4), vec![hypothesis(1.0), unmeasured], &[(3, 70_000), (5, 1)]),
            pair((1, 2), Vec::new(), &[]),
            pair((1, 8), vec![hypothesis(3.0)], &[(0, 0)]),
        ];
        PairShard { header, pairs }
    }

    #[test]
    fn pairs_come_back_to_the_last_bit_and_a_flipped_bit_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(pair_shard_name(1, 3));
        let shard = shard();
        write_pair_shard(&path, &shard).unwrap();
        assert_eq!(read_pair_shard(&path).unwrap(), shard);
        let bytes = std::fs::read(&path).unwrap();
        // What the header of an archive's entry says of times and versions means nothing.
        let mut harmless = 0;
        for at in 0..bytes.len() {
            let mut flipped = bytes.clone();
            flipped[at] ^= 4;
            std::fs::write(&path, flipped).unwrap();
            match read_pair_shard(&path) {
                Ok(read) => {
                    assert_eq!(read, shard, "byte {at}");
                    harmless += 1;
                }
                Err(error) => assert!(error.to_string().contains("scanweave pairs"), "{error}"),
            }
        }
        assert!(harmless < bytes.len() / 5, "{harmless} of {}", bytes.len());
        for length in [0, 1, 100, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let error = read_pair_shard(&path).unwrap_err();
            assert!(matches!(error, Error::File { .. }), "{error}");
        }
        let none = PairShard { pairs: Vec::new(), ..shard };
        write_pair_shard(&path, &none).unwrap();
        assert_eq!(read_pair_shard(&path).unwrap(), none);
    }

    #[test]
    fn another_version_is_told_before_anything_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pairs-0-of-1.npz");
        let header = Array1::from_iter(br#"{"format_version":2,"unknown":1}"#.iter().copied());
        let archive = npz::archive(|npz| npz.add_array("header", &header)).unwrap();
        std::fs::write(&path, archive).unwrap();
        let said = read_pair_shard(&path).unwrap_err().to_string();
        assert!(said.contains("found version 2 of the format, expected version 1; delete it"), "{said}");
    }

    #[test]
    fn names_say_which_shard_a_file_is() {
        assert_eq!(pair_shard_of_name("pairs-3-of-12.npz"), Some((3, 12)));
        for other in ["pairs-03-of-12.npz", "pairs-3-of-12.npz.part", "pairs-ab12.npz", "pairs--of-.npz"] {
            assert_eq!(pair_shard_of_name(other), None, "{other}");
        }
    }
}
