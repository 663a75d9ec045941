//! A registration in stages and shards at the prompt: the same bytes as in one process, and one clear error
//! where the stages do not fit each other.

mod cli_common;

use cli_common::{folder, json, names, scanweave, synth};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

/// Quick features; the first pairs are few enough to be fewer than scans times neighbours.
const FAST: [&str; 4] = ["--set", "descriptor.kind=fpfh", "--set", "registration.strategy.neighbours=3"];
/// What does not depend on when and how a result was made.
const FILES: [&str; 6] =
    ["poses.json", "merged.ply", "trajectory.log", "overlap.csv", "config.toml", "registration.html"];

/// Six scans, and what one process makes of them, for all tests.
struct Shared {
    _place: TempDir,
    scans: PathBuf,
    whole: PathBuf,
    features: PathBuf,
}

fn shared() -> &'static Shared {
    static SHARED: OnceLock<Shared> = OnceLock::new();
    SHARED.get_or_init(|| {
        let place = folder();
        let scans = synth(place.path(), 6);
        let (whole, features) = (place.path().join("whole"), place.path().join("features"));
        stage("register", &scans, &whole, &[]).assert().success();
        stage("describe", &scans, &features, &[]).assert().success();
        Shared { _place: place, scans, whole, features }
    })
}

fn stage(name: &str, scans: &Path, output: &Path, more: &[&str]) -> assert_cmd::Command {
    let mut command = scanweave();
    let scheduler = ["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX"];
    scheduler.iter().for_each(|variable| {
        command.env_remove(variable);
    });
    command.arg(name).arg(scans).arg("-o").arg(output).args(FAST).args(more);
    command
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

/// Registers all pairs in so many shards.
fn pairs(output: &Path, shards: usize, more: &[&str]) {
    let Shared { scans, features, .. } = shared();
    for index in 0..shards {
        let shard = format!("{index}/{shards}");
        let described = ["--described", text(features), "--shard", &shard];
        stage("pairs", scans, output, &[&described, more].concat()).assert().success();
    }
}

/// Joins them.
fn join(pairs: &Path, output: &Path, more: &[&str]) -> assert_cmd::assert::Assert {
    let Shared { scans, features, .. } = shared();
    let stages = ["--described", text(features), "--pairs", text(pairs)];
    stage("register", scans, output, &[&stages, more].concat()).assert()
}

#[test]
fn any_number_of_shards_and_threads_gives_the_bytes_of_one_process() {
    let (place, Shared { scans, whole, features, .. }) = (folder(), shared());
    for (shards, threads) in [(1, "2"), (2, "1"), (5, "2")] {
        let at = |name: &str| place.path().join(format!("{name}-{shards}"));
        // The last shard first: none waits for another.
        for index in (0..shards).rev() {
            let shard = format!("{index}/{shards}");
            let more = ["--shard", &shard, "--threads", threads];
            stage("describe", scans, &at("features"), &more).assert().success();
        }
        for name in names(features).iter().filter(|name| name.ends_with(".npz")) {
            assert!(
                bytes(&features.join(name)) == bytes(&at("features").join(name)),
                "{name}, {shards} shards"
            );
        }
        assert_eq!(names(&at("features")), names(features));
        // Features and surface of every scan, each made by one of them.
        assert_eq!(names(&at("features").join("cache")), names(&features.join("cache")));
        assert_eq!(names(&features.join("cache")).len(), 12);
        pairs(&at("pairs"), shards, &["--threads", threads]);
        assert_eq!(names(&at("pairs")).len(), shards);
        let described = at("features");
        let stages = ["--described", text(&described), "--pairs", text(&at("pairs")), "--threads", threads]
            .map(str::to_owned);
        let stages: Vec<&str> = stages.iter().map(String::as_str).collect();
        stage("register", scans, &at("result"), &stages).assert().success();
        for file in FILES {
            assert!(bytes(&whole.join(file)) == bytes(&at("result").join(file)), "{file}, {shards} shards");
        }
    }
    // Something was placed, and by pairs of files.
    assert!(json(whole.join("report.json"))["placed"].as_u64().unwrap() >= 4);
    let report = json(place.path().join("result-5/report.json"));
    assert_eq!(report["sizes"][0]["features_reused"], true);
}

#[test]
fn pairs_come_from_the_files_and_are_not_registered_again() {
    let place = folder();
    pairs(&place.path().join("pairs"), 2, &[]);
    let path = place.path().join("pairs/pairs-0-of-2.npz");
    let mut shard = scanweave::io::read_pair_shard(&path).unwrap();
    assert!(shard.pairs.iter().any(|pair| !pair.hypotheses.is_empty()));
    shard.pairs.iter_mut().for_each(|pair| pair.hypotheses.clear());
    scanweave::io::write_pair_shard(&path, &shard).unwrap();
    join(&place.path().join("pairs"), &place.path().join("result"), &[]);
    let [one, other] = [&shared().whole, &place.path().join("result")].map(|f| bytes(&f.join("poses.json")));
    assert!(one != other);
}

#[test]
fn schedulers_choose_the_shard_and_a_flag_overrules_them() {
    let (place, Shared { scans, features, .. }) = (folder(), shared());
    let out = place.path().join("pairs");
    let slurm =
        [("SLURM_ARRAY_TASK_ID", "2"), ("SLURM_ARRAY_TASK_MIN", "1"), ("SLURM_ARRAY_TASK_COUNT", "3")];
    let described = ["--described", text(features)];
    stage("pairs", scans, &out, &described).envs(slurm).assert().success().stdout(contains("shard 1/3: "));
    let job = [("JOB_COMPLETION_INDEX", "2"), ("JOB_COMPLETIONS", "3")];
    stage("pairs", scans, &out, &described).envs(job).assert().success().stdout(contains("shard 2/3: "));
    let flag = ["--described", text(features), "--shard", "0/3"];
    stage("pairs", scans, &out, &flag).envs(job).assert().success().stdout(contains("shard 0/3: "));
    join(&out, &place.path().join("result"), &[]).success();
    let some = place.path().join("some");
    stage("describe", scans, &some, &[]).envs(job).assert().success().stdout(contains("of 2 scans"));
    let lost = [("JOB_COMPLETION_INDEX", "2")];
    stage("describe", scans, &some, &[])
        .envs(lost)
        .assert()
        .code(4)
        .stderr(contains("JOB_COMPLETIONS: found"));
}

#[test]
fn a_shard_that_is_started_again_keeps_what_is_there() {
    let (place, Shared { scans, features, .. }) = (folder(), shared());
    let out = place.path().join("pairs");
    pairs(&out, 2, &[]);
    let path = out.join("pairs-1-of-2.npz");
    let (before, when) = (bytes(&path), std::fs::metadata(&path).unwrap().modified().unwrap());
    let again = ["--described", text(features), "--shard", "1/2"];
    stage("pairs", scans, &out, &again).assert().success().stdout(contains("which were there"));
    assert_eq!(std::fs::metadata(&path).unwrap().modified().unwrap(), when);
    // One of which only a part is left is not taken for whole.
    std::fs::write(&path, &before[..before.len() / 2]).unwrap();
    stage("pairs", scans, &out, &again)
        .assert()
        .code(3)
        .stderr(contains("bytes that are").and(contains("--force")));
    let forced = [&again[..], &["--force"]].concat();
    stage("pairs", scans, &out, &forced).assert().success();
    assert!(bytes(&path) == before);

    // Features: kept, made again where they are missing, and never replaced by others unasked.
    let some = place.path().join("some");
    let shard = ["--shard", "0/2"];
    stage("describe", scans, &some, &shard).assert().success().stdout(contains("0 not computed now"));
    std::fs::remove_file(some.join("cloud_bin_0.npz")).unwrap();
    let kept = std::fs::metadata(some.join("cloud_bin_1.npz")).unwrap().modified().unwrap();
    stage("describe", scans, &some, &shard).assert().success().stdout(contains("3 not computed now"));
    assert_eq!(std::fs::metadata(some.join("cloud_bin_1.npz")).unwrap().modified().unwrap(), kept);
    assert!(bytes(&some.join("cloud_bin_0.npz")) == bytes(&features.join("cloud_bin_0.npz")));
    let other = ["--shard", "0/2", "--seed", "5"];
    stage("describe", scans, &some, &other)
        .assert()
        .code(5)
        .stderr(contains("cloud_bin_0.npz: already holds"));
}

#[test]
fn pairs_of_another_run_are_one_clear_error_that_names_the_file() {
    let (place, Shared { scans, features, .. }) = (folder(), shared());
    let (out, result) = (place.path().join("pairs"), place.path().join("result"));
    join(&out, &result, &[]).code(3).stderr(contains("pairs: cannot read it"));
    std::fs::create_dir(&out).unwrap();
    join(&out, &result, &[]).code(3).stderr(contains("no file pairs-I-of-N.npz"));
    pairs(&out, 2, &[]);
    let refused = |more: &[&str], code: i32, said: &str| {
        let run = join(&out, &result, more).code(code).stderr(contains(said));
        assert_eq!(run.get_output().stderr.iter().filter(|b| **b == b'\n').count(), 1, "{said}");
        assert!(!result.join("poses.json").exists());
    };
    let both = "found pairs with registration.strategy.retrieval_rounds = 2, expected registration.strategy.retrieval_rounds = 1";
    refused(&["--set", "registration.strategy.retrieval_rounds=1"], 3, both);
    refused(&["--seed", "5"], 3, "pairs-0-of-2.npz: found pairs with seed = 0, expected seed = 5");
    refused(&["--method", "incremental"], 4, "--method: found incremental, with --pairs");
    refused(&["--method", "sghr"], 4, "--method: found sghr, with --pairs");
    // What is only written does not matter.
    join(&out, &place.path().join("other"), &["--set", "output.merged_voxel_m=0.05"]).success();

    // Other scans: fewer, and one that was changed; features computed, as those that are kept do not fit either.
    let few = place.path().join("few");
    std::fs::create_dir(&few).unwrap();
    for name in names(scans).iter().filter(|name| name.ends_with(".ply")) {
        std::fs::copy(scans.join(name), few.join(name)).unwrap();
    }
    let of_few = |said: &str| {
        let run = stage("register", &few, &result, &["--pairs", text(&out)]).assert().code(3);
        run.stderr(contains("pairs-0-of-2.npz: found").and(contains(said)));
    };
    let changed = few.join("cloud_bin_5.ply");
    std::fs::copy(scans.join("cloud_bin_4.ply"), &changed).unwrap();
    of_few("pairs of other scans or features");
    std::fs::remove_file(&changed).unwrap();
    of_few("pairs of 6 scans, expected pairs of these 5");
    // The lengths are those of the collection, so that its features are, too.
    stage("register", &few, &result, &["--described", text(features)]).assert().code(3).stderr(
        contains("features/cache: found no features of cloud_bin_0").and(contains("scanweave describe")),
    );

    // Files: another number of shards, one under the name of another, cut short, of another version, missing.
    let shards = ["--described", text(features), "--shard", "0/3"];
    stage("pairs", scans, &out, &shards)
        .assert()
        .code(3)
        .stderr(contains("expected files of 2 shards").not());
    stage("pairs", scans, &out, &shards)
        .assert()
        .code(3)
        .stderr(contains("a file of another number of shards"));
    let [first, second] = [0, 1].map(|i| out.join(format!("pairs-{i}-of-2.npz")));
    let good = bytes(&second);
    std::fs::copy(&first, &second).unwrap();
    refused(&[], 3, "pairs-1-of-2.npz: found the pairs of shard 0/2, expected those of shard 1/2");
    std::fs::write(&second, &good[..good.len() - 40]).unwrap();
    refused(&[], 3, "pairs-1-of-2.npz: found");
    let mut shard = scanweave::io::read_pair_shard(&first).unwrap();
    (shard.header.program, shard.header.shard) = ("0.0.9".to_owned(), 1);
    scanweave::io::write_pair_shard(&second, &shard).unwrap();
    refused(&[], 3, "found pairs by version 0.0.9, expected version");
    std::fs::remove_file(&second).unwrap();
    refused(&[], 3, "pairs-1-of-2.npz: found no file, though there are others of 2 shards");
    std::fs::write(&second, good).unwrap();
    std::fs::copy(&first, out.join("pairs-0-of-3.npz")).unwrap();
    refused(&[], 3, "found files of 2 and of 3 shards");
}

#[test]
fn a_shard_that_is_none_is_a_usage_error() {
    let (place, Shared { scans, .. }) = (folder(), shared());
    for (name, bad) in
        [("describe", "2/2"), ("pairs", "3/2"), ("pairs", "1"), ("describe", "a/b"), ("pairs", "0/0")]
    {
        let out = place.path().join("out");
        stage(name, scans, &out, &["--shard", bad])
            .assert()
            .code(2)
            .stderr(contains("--shard").and(contains("as in 0/4")));
        assert!(!out.exists());
    }
    let out = place.path().join("out");
    stage("pairs", scans, &out, &["--method", "hara"])
        .assert()
        .code(4)
        .stderr(contains("--method: found hara"));
    assert!(!out.exists());
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_and_leaves_no_part_of_a_file() {
    let (place, Shared { scans, features, .. }) = (folder(), shared());
    let out = place.path().join("pairs");
    // 2 blocks of 1 KiB: room for the lock, not for pairs.
    let run = std::process::Command::new("bash")
        .args(["-c", "ulimit -f 2; exec \"$0\" pairs \"$@\" -q", env!("CARGO_BIN_EXE_scanweave")])
        .args([scans, Path::new("-o"), &out, Path::new("--described"), features])
        .args(FAST)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(5), "{said}");
    assert!(said.contains("pairs-0-of-1.npz: cannot write it") && said.contains("File too large"), "{said}");
    assert!(!out.exists() || names(&out).is_empty());
}
