//! The first pairs of an agglomerative registration in files, one a shard: written by as many processes, on any
//! machines, and read by the one that joins.

use super::{Described, FeatureSource, Shard, Stopwatch, describe_timed, predict_overlap};
use crate::config::{Config, Method};
use crate::error::{Error, Result};
use crate::io::{self, PairShard, PairShardHeader, ShardHypothesis, ShardPair};
use crate::monitor::Monitor;
use crate::registration::{FirstRound, ScanPair, ScoredHypothesis};
use crate::scan::{Scan, ScanId, SimilarityMatrix};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Version of the program, as files state it.
const PROGRAM: &str = env!("CARGO_PKG_VERSION");

/// What became of a shard.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RegisteredShard {
    /// Its file.
    pub path: PathBuf,
    /// Its pairs.
    pub pairs: usize,
    /// Pairs of all shards.
    pub planned: usize,
    /// Whether the file was there, whole and of these scans and settings.
    pub reused: bool,
}

/// Registers one shard of the pairs that the agglomerative registration of these scans begins with, and writes
/// them into `folder`, which exists. A file that is there and whole is kept; one of other scans or settings is
/// replaced if `force`.
///
/// # Errors
/// As [`run`](super::run); [`Error::Setting`] for another method; [`Error::OutputExists`]; [`Error::File`] where the folder
/// holds another number of shards; [`Error::Write`].
pub fn register_shard(
    scans: &[Scan],
    config: &Config,
    source: &FeatureSource<'_>,
    (folder, force): (&Path, bool),
    shard: Shard,
    monitor: &dyn Monitor,
) -> Result<RegisteredShard> {
    super::check_scans(scans)?;
    config.validate()?;
    check_shards(config)?;
    refuse_other_count(folder, shard.count)?;
    let mut clock = Stopwatch::default();
    let described = describe_timed(scans, config, source, monitor, &mut clock)?;
    let (similarity, _) = predict_overlap(&described, config, monitor, &mut clock)?;
    let round = first_round(&described, &similarity, config)?;
    let (planned, part) = (round.planned().len(), shard.range(round.planned().len()));
    let path = folder.join(io::pair_shard_name(shard.index, shard.count));
    let done = |reused: bool| RegisteredShard { path: path.clone(), pairs: part.len(), planned, reused };
    let origin = Origin::new(config, shard, scans.len());
    if path.exists() {
        let file = io::read_pair_shard(&path);
        let check = |file: PairShard| {
            origin.check(&path, &file.header)?;
            check_content(&path, &file, &origin, &round, part.clone())
        };
        match file.and_then(check) {
            Ok(()) => return Ok(done(true)),
            Err(Error::File { .. }) if force => {}
            Err(Error::File { path, found, expected, .. }) => {
                let remedy = "pass --force to replace it or choose another folder with --output";
                return Err(Error::file(path, found, expected, remedy));
            }
            Err(error) => return Err(error),
        }
    }
    let header = origin.header(&round);
    let pairs = round.register(part.clone(), monitor)?.into_iter().map(to_file).collect();
    io::write_pair_shard(&path, &PairShard { header, pairs })?;
    Ok(done(false))
}

/// The files of all shards of a folder.
pub(super) struct PairShards {
    /// By the number of the shard.
    files: Vec<(PathBuf, PairShard)>,
}

impl PairShards {
    /// Reads the files, and refuses those of other settings before anything is computed.
    ///
    /// # Errors
    /// [`Error::Setting`] for another method; [`Error::File`] for a missing shard, and for files of other
    /// settings or versions.
    pub(super) fn read(folder: &Path, config: &Config, scans: usize, monitor: &dyn Monitor) -> Result<Self> {
        const STAGE: &str = "reading pairs";
        check_method(config, "--pairs")?;
        let count = number_of_shards(folder)?;
        let mut files = Vec::new();
        monitor.begin(STAGE, count);
        for index in 0..count {
            monitor.check(STAGE)?;
            let (shard, path) = (Shard { index, count }, folder.join(io::pair_shard_name(index, count)));
            if !path.exists() {
                let found = format!("no file, though there are others of {count} shards");
                let remedy =
                    format!("run `scanweave pairs --shard {shard}` with the same scans and settings");
                return Err(Error::file(&path, found, format!("the pairs of shard {shard}"), remedy));
            }
            let file = io::read_pair_shard(&path)?;
            Origin::new(config, shard, scans).check(&path, &file.header)?;
            files.push((path, file));
            monitor.advance(1);
        }
        monitor.end();
        Ok(Self { files })
    }

    /// All pairs, in the order in which they were planned.
    ///
    /// # Errors
    /// [`Error::File`] for pairs of other scans or features.
    pub(super) fn pairs(
        self,
        described: &Described,
        similarity: &SimilarityMatrix,
        config: &Config,
    ) -> Result<Vec<ScanPair>> {
        let round = first_round(described, similarity, config)?;
        let (count, mut all) = (self.files.len(), Vec::with_capacity(round.planned().len()));
        for (index, (path, file)) in self.files.into_iter().enumerate() {
            let shard = Shard { index, count };
            let origin = Origin::new(config, shard, described.features.len());
            check_content(&path, &file, &origin, &round, shard.range(round.planned().len()))?;
            all.extend(file.pairs.into_iter().map(of_file));
        }
        Ok(all)
    }
}

fn first_round<'a>(
    described: &'a Described,
    similarity: &SimilarityMatrix,
    config: &'a Config,
) -> Result<FirstRound<'a>> {
    FirstRound::new(&described.inputs(), similarity, &config.registration, described.lengths(), config.seed)
}

/// Refuses settings whose pairs cannot be registered in shards, before anything is computed.
///
/// # Errors
/// [`Error::Setting`] for another method than the agglomerative one.
pub fn check_shards(config: &Config) -> Result<()> {
    check_method(config, "shards of pairs")
}

fn check_method(config: &Config, who: &str) -> Result<()> {
    if config.method == Method::Multiview && config.registration.agglomerative().is_some() {
        return Ok(());
    }
    let found = format!("{}, with {who}", config.method_name());
    let expected = "agglomerative, the default, whose first pairs do not depend on each other";
    Err(Error::setting("--method", found, expected, "leave it out, or register in one process"))
}

/// What a file must state of the run that it is of.
struct Origin {
    shard: Shard,
    settings: BTreeMap<String, String>,
    scans: usize,
}

impl Origin {
    fn new(config: &Config, shard: Shard, scans: usize) -> Self {
        Self { shard, settings: settings(config), scans }
    }

    fn header(self, round: &FirstRound<'_>) -> PairShardHeader {
        PairShardHeader {
            program: PROGRAM.to_owned(),
            shard: self.shard.index,
            shards: self.shard.count,
            settings: self.settings,
            scans: self.scans,
            content: content(round),
            planned: round.planned().len(),
        }
    }

    /// Refuses a file of another program, shard, setting or number of scans.
    fn check(&self, path: &Path, found: &PairShardHeader) -> Result<()> {
        let refuse = |found: String, expected: String| Err(self.refused(path, found, expected));
        if found.program != PROGRAM {
            return refuse(format!("pairs by version {}", found.program), format!("version {PROGRAM}"));
        }
        let (stated, shard) = (Shard { index: found.shard, count: found.shards }, self.shard);
        if stated != shard {
            let expected = format!("those of shard {shard}, as its name says");
            return refuse(format!("the pairs of shard {stated}"), expected);
        }
        let keys: BTreeSet<&String> = found.settings.keys().chain(self.settings.keys()).collect();
        let values = |key: &String| [&found.settings, &self.settings].map(|s| s.get(key).cloned());
        for key in keys {
            let [stated, expected] = values(key);
            if stated != expected {
                let said =
                    |v: Option<String>| format!("{key} = {}", v.unwrap_or_else(|| "not set".to_owned()));
                return refuse(format!("pairs with {}", said(stated)), said(expected));
            }
        }
        if found.scans != self.scans {
            return refuse(
                format!("pairs of {} scans", found.scans),
                format!("pairs of these {}", self.scans),
            );
        }
        Ok(())
    }

    fn refused(&self, path: &Path, found: String, expected: String) -> Error {
        let again = format!("`scanweave pairs --shard {} --force`", self.shard);
        let remedy = format!("run all stages with the same scans, settings and program: {again}");
        Error::file(path, found, expected, remedy)
    }
}

/// Digest of what pairs are registered from, as files state it.
fn content(round: &FirstRound<'_>) -> String {
    blake3::Hash::from(round.digest()).to_hex()[..32].to_owned()
}

/// Every setting by its dotted key; without the label of the preset and what is written.
fn settings(config: &Config) -> BTreeMap<String, String> {
    fn flatten(value: &serde_json::Value, key: String, into: &mut BTreeMap<String, String>) {
        match value {
            serde_json::Value::Object(fields) => {
                let separator = if key.is_empty() { "" } else { "." };
                fields.iter().for_each(|(k, v)| flatten(v, format!("{key}{separator}{k}"), into));
            }
            other => {
                into.insert(key, other.to_string());
            }
        }
    }
    let mut all = BTreeMap::new();
    // Settings are plain values, which JSON has a spelling for.
    flatten(&serde_json::to_value(config).unwrap_or_default(), String::new(), &mut all);
    all.retain(|key, _| key != "preset" && !key.starts_with("output."));
    all
}

/// Refuses a file that is of other scans, or does not hold the pairs that are planned here.
fn check_content(
    path: &Path,
    file: &PairShard,
    origin: &Origin,
    round: &FirstRound<'_>,
    part: Range<usize>,
) -> Result<()> {
    let refuse =
        |found: &str, expected: &str| Err(origin.refused(path, found.to_owned(), expected.to_owned()));
    if file.header.content != content(round) {
        return refuse("pairs of other scans or features", "those of these scans, to the last bit");
    }
    let planned = round.planned().get(part).unwrap_or_default();
    let scans = |p: &ShardPair| (ScanId(p.scans.0), ScanId(p.scans.1));
    if file.header.planned != round.planned().len()
        || !file.pairs.iter().map(scans).eq(planned.iter().copied())
    {
        let found = format!("{} of {} pairs", file.pairs.len(), file.header.planned);
        let (these, all) = (planned.len(), round.planned().len());
        return refuse(&found, &format!("the {these} of {all} that the predicted overlap suggests here"));
    }
    let is_usable = |p: &ShardPair| {
        let (of_i, of_j) = (round.keypoints(ScanId(p.scans.0)), round.keypoints(ScanId(p.scans.1)));
        let is_finite = |h: &ShardHypothesis| {
            let pose = h.first_from_second;
            pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
        };
        let exist = |&(i, j): &(u32, u32)| (i as usize) < of_i && (j as usize) < of_j;
        p.matches.iter().all(exist) && p.hypotheses.iter().all(is_finite)
    };
    match file.pairs.iter().all(is_usable) {
        true => Ok(()),
        false => refuse("matches of keypoints that there are not", "those of these scans"),
    }
}

fn to_file(pair: ScanPair) -> ShardPair {
    let hypotheses = pair.hypotheses.iter().map(|h| ShardHypothesis {
        first_from_second: h.a_from_b,
        evidence: h.evidence,
        seen_through: h.seen_through,
    });
    ShardPair { scans: (pair.i.0, pair.j.0), hypotheses: hypotheses.collect(), matches: pair.matches }
}

fn of_file(pair: ShardPair) -> ScanPair {
    let hypotheses = pair.hypotheses.iter().map(|h| ScoredHypothesis {
        a_from_b: h.first_from_second,
        evidence: h.evidence,
        seen_through: h.seen_through,
    });
    let (i, j) = pair.scans;
    ScanPair { i: ScanId(i), j: ScanId(j), hypotheses: hypotheses.collect(), matches: pair.matches }
}

/// Files of shards in a folder, with their numbers of shards.
fn files_of_shards(folder: &Path) -> Result<BTreeMap<usize, String>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    Ok(names.filter_map(|name| Some((io::pair_shard_of_name(&name)?.1, name))).collect())
}

fn number_of_shards(folder: &Path) -> Result<usize> {
    let counts = files_of_shards(folder)?;
    match counts.keys().collect::<Vec<_>>()[..] {
        [&count] => Ok(count),
        [] => Err(Error::file(
            folder,
            "no file pairs-I-of-N.npz",
            "those of all shards",
            "run `scanweave pairs` with the same scans and settings, for every shard",
        )),
        [one, other, ..] => {
            let found = format!("files of {one} and of {other} shards");
            let remedy = "delete those of the run that is not meant";
            Err(Error::file(folder, found, "files of one number of shards", remedy))
        }
    }
}

/// Declines to add to the files of another number of shards, before hours are spent.
fn refuse_other_count(folder: &Path, count: usize) -> Result<()> {
    match files_of_shards(folder)?.into_iter().find(|(other, _)| *other != count) {
        None => Ok(()),
        Some((_, name)) => Err(Error::file(
            folder.join(name),
            "a file of another number of shards",
            format!("files of {count} shards, or none"),
            "choose another folder with --output, or delete the files of the other run",
        )),
    }
}
