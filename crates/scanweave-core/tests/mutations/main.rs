//! Damaged files of every kind that the core reads: none of them may panic, hang, take memory out of proportion
//! or be read as something that cannot be.
//!
//! The damage is drawn by numbers, so that a case is the same everywhere. `SCANWEAVE_MUTATION_SECONDS=60` takes
//! as many cases as a minute for every kind has time for, `SCANWEAVE_MUTATION_KINDS=ply,e57` only these kinds
//! (`scans`: the formats of scans, `documents`: all others), and `SCANWEAVE_SEEDS=folder` writes the whole files
//! that the damage is done to, for `fuzz/`. A case that fails is left in the folder for temporary files.

#[path = "../memory_limits/allocations.rs"]
mod allocations;
mod documents;
#[path = "../memory_limits/files.rs"]
#[allow(dead_code, reason = "its lying headers are for the tests of memory")]
mod files;
mod mutate;
mod seeds;

use allocations::{Cost, cost_of};
use documents::{DOCUMENTS, Document, Place};
use mutate::{Draw, mutated};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::panic::{self, AssertUnwindSafe};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// Cases of a kind where no time is set.
const CASES: u64 = 400;
/// What a case may take. Milliseconds are usual; the rest is for machines that are busy.
const LONGEST: Duration = Duration::from_secs(5);
/// After so long a case counts as one that never ends.
const ENDLESS: Duration = Duration::from_secs(60);
/// What a file of some kilobytes may cost. Packed features may unpack to 64 MiB and 100 times their size.
const MOST_BYTES: usize = 200 << 20;
/// Failures of a kind that are told; more of the same say no more.
const TOLD: usize = 3;

#[test]
fn whole_files_of_every_kind_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let seeds = seeds::all(folder.path());
    for document in DOCUMENTS {
        let own: Vec<&[u8]> = seeds_of(document, &seeds);
        assert!(!own.is_empty(), "no seed of {}", document.name);
        let place = Place::new(&format!("whole-{}", document.name));
        let read = own.iter().filter(|bytes| document.read(&place, bytes)).count();
        println!(
            "{:<16} {read} of {} seeds are read, {} bytes",
            document.name,
            own.len(),
            own.concat().len()
        );
        assert!(read > 0, "no seed of {} is read", document.name);

        if let Some(folder) = std::env::var_os("SCANWEAVE_SEEDS") {
            write_seeds(&Path::new(&folder).join(document.name), &own);
        }
    }
}

fn write_seeds(folder: &Path, seeds: &[&[u8]]) {
    std::fs::create_dir_all(folder).unwrap();
    for (number, bytes) in seeds.iter().enumerate() {
        std::fs::write(folder.join(format!("seed-{number:02}")), bytes).unwrap();
    }
}

fn seeds_of<'a>(document: &Document, seeds: &'a [seeds::Seed]) -> Vec<&'a [u8]> {
    let kind = seeds::kind_for(document.name);
    seeds.iter().filter(|(name, _)| *name == kind).map(|(_, bytes)| &bytes[..]).collect()
}

#[test]
fn damaged_files_of_every_kind_break_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let seeds = seeds::all(folder.path());
    let kinds = std::env::var("SCANWEAVE_MUTATION_KINDS").unwrap_or_default();
    let group = |d: &Document| if d.is_scan() { "scans" } else { "documents" };
    let wanted =
        |d: &&Document| kinds.is_empty() || kinds.split(',').any(|kind| kind == d.name || kind == group(d));
    let documents: Vec<&Document> = DOCUMENTS.iter().filter(wanted).collect();
    assert!(!documents.is_empty(), "no kind is named '{kinds}'");
    keep_panics_to_ourselves();
    let (next, running, failures) =
        (AtomicUsize::new(0), Mutex::new(BTreeMap::new()), Mutex::new(Vec::new()));
    println!(
        "{:<16} {:>9} {:>9} {:>10} {:>9} {:>9}",
        "kind", "cases", "read", "cases/s", "peak KiB", "longest ms"
    );
    std::thread::scope(|scope| {
        let work = || {
            while let Some(document) = documents.get(next.fetch_add(1, Relaxed)) {
                let own = seeds_of(document, &seeds);
                let failed = run(document, &own, &running);
                failures.lock().unwrap().extend(failed);
            }
        };
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        while !workers.iter().all(|worker| worker.is_finished()) {
            std::thread::sleep(Duration::from_millis(20));
            stop_where_endless(&running.lock().unwrap());
        }
    });
    let failures = failures.into_inner().unwrap();
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

/// The case that a kind is at, and since when.
type Running = Mutex<BTreeMap<&'static str, (u64, Instant)>>;

/// A loop that does not end cannot be left: the process says which case it is and ends.
fn stop_where_endless(running: &BTreeMap<&'static str, (u64, Instant)>) {
    for (name, (case, since)) in running {
        if since.elapsed() > ENDLESS {
            eprintln!("{name}, case {case}: no end after {ENDLESS:?}");
            std::process::exit(1);
        }
    }
}

/// Damages files of a kind, prints what came of it, and returns what went wrong.
fn run(document: &'static Document, seeds: &[&[u8]], running: &Running) -> Vec<String> {
    let seconds = std::env::var("SCANWEAVE_MUTATION_SECONDS").ok().map(|s| s.parse::<f64>().unwrap());
    let time = seconds.map(Duration::from_secs_f64);
    let place = Place::new(&format!("mutations-{}", document.name));
    let (start, mut failures) = (Instant::now(), Vec::new());
    let (mut cases, mut read, mut worst) = (0, 0, Cost { peak_bytes: 0, took: Duration::ZERO });
    while time.map_or(cases < CASES, |time| start.elapsed() < time) && failures.len() < TOLD {
        let bytes = mutated(seeds, &mut Draw::of(document.name, cases));
        running.lock().unwrap().insert(document.name, (cases, Instant::now()));
        let (outcome, cost) = attempt(document, &place, &bytes);
        read += usize::from(outcome == Ok(true));
        if let Some(wrong) = outcome.err().or_else(|| too_dear(cost)) {
            let kept = keep(document.name, cases, &bytes);
            failures.push(format!(
                "{}, case {cases}: {wrong}; the file is {}",
                document.name,
                kept.display()
            ));
        }
        worst.peak_bytes = worst.peak_bytes.max(cost.peak_bytes);
        worst.took = worst.took.max(cost.took);
        cases += 1;
    }
    running.lock().unwrap().remove(document.name);
    let (rate, kib) = (cases as f64 / start.elapsed().as_secs_f64(), worst.peak_bytes.div_ceil(1024));
    let (name, ms) = (document.name, worst.took.as_secs_f64() * 1e3);
    println!("{name:<16} {cases:>9} {read:>9} {rate:>10.0} {kib:>9} {ms:>9.1}");
    failures
}

fn too_dear(cost: Cost) -> Option<String> {
    match cost {
        Cost { peak_bytes, .. } if peak_bytes > MOST_BYTES => {
            Some(format!("it takes {} MiB", peak_bytes >> 20))
        }
        Cost { took, .. } if took > LONGEST => Some(format!("it takes {took:?}")),
        _ => None,
    }
}

fn keep(name: &str, case: u64, bytes: &[u8]) -> PathBuf {
    let path = std::env::temp_dir().join(format!("scanweave-{name}-{case}"));
    std::fs::write(&path, bytes).unwrap();
    path
}

thread_local! {
    /// What the last panic of an attempt said; none outside of one.
    static SAID: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Reads a file; the error is what a panic said.
fn attempt(document: &Document, place: &Place, bytes: &[u8]) -> (Result<bool, String>, Cost) {
    SAID.set(Some(String::new()));
    let read = || panic::catch_unwind(AssertUnwindSafe(|| document.read(place, bytes)));
    let (outcome, cost) = cost_of(read);
    let said = SAID.take().unwrap_or_default();
    (outcome.map_err(|_| said), cost)
}

/// Readers catch the panics of some decoders, which would be printed all the same.
fn keep_panics_to_ourselves() {
    let others = panic::take_hook();
    panic::set_hook(Box::new(move |info| match SAID.take() {
        Some(_) => SAID.set(Some(info.to_string().replace('\n', " "))),
        None => others(info),
    }));
}

#[test]
fn a_case_is_the_same_everywhere() {
    let seeds: [&[u8]; 2] = [b"ply\nelement vertex 12\n", b"1 2 3\n"];
    let of = |case| mutated(&seeds, &mut Draw::of("ply", case));
    assert_eq!(of(7), of(7));
    let different: std::collections::BTreeSet<Vec<u8>> = (0..1000).map(of).collect();
    // Some changes change nothing, such as an empty stretch that is taken out.
    assert!(different.len() > 700, "{}", different.len());
}

#[test]
fn checksums_are_those_of_the_formats() {
    let folder = tempfile::tempdir().unwrap();
    let e57 = files::e57(folder.path().join("a.e57").as_path(), "12");
    assert_eq!(documents::checksums::page_sums(&e57), e57);
    let png = files::png(8, 6, &files::pixels(8, 6), 3);
    assert_eq!(documents::checksums::png_sums(&png), png);
    let archive = documents::checksums::archive(&[("a", b"one"), ("b.txt", b"")]);
    let mut read = zip::ZipArchive::new(std::io::Cursor::new(archive)).unwrap();
    assert_eq!(read.file_names().collect::<Vec<_>>(), ["a", "b.txt"]);
    assert_eq!(std::io::read_to_string(read.by_name("a").unwrap()).unwrap(), "one");
}
