//! An output folder belongs to one run at a time, holds the files of one result, and keeps no litter.

mod cli_common;

use cli_common::*;
use predicates::prelude::*;
use predicates::str::contains;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// The program, for tests that need several at once or one that is killed.
fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_scanweave"));
    command.env_remove("SCANWEAVE_LOG").stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn register(scans: &Path, output: &Path, more: &[&str]) -> Command {
    let mut command = program();
    command.arg("register").arg(scans).arg("-o").arg(output).args(["-q", "--threads", "1"]).args(more);
    command
}

/// Hidden files, which a run that ended by itself leaves none of.
fn litter(folder: &Path) -> Vec<String> {
    let inside = ["", "cache"].map(|f| folder.join(f));
    let all = inside.iter().filter(|f| f.is_dir()).flat_map(|f| names(f));
    all.filter(|n| n.starts_with('.')).collect()
}

fn code(output: &Output) -> Option<i32> {
    output.status.code()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Registers with two seeds at once. With `--force`, both may succeed one after the other.
fn race(scans: &Path, output: &Path, more: &[&str]) -> Vec<Output> {
    let start = |seed: &str| register(scans, output, more).args(["--seed", seed]).spawn().unwrap();
    let runs = [start("1"), start("2")];
    runs.into_iter().map(|r| r.wait_with_output().unwrap()).collect()
}

#[test]
fn of_two_runs_at_once_one_is_refused_and_the_result_is_whole() {
    const REPETITIONS: usize = 20;
    let place = folder();
    let scans = synth(place.path(), 2);
    // Features are found in the cache from here on: the runs are then short, and their writing weighs more.
    let out = place.path().join("out");
    assert!(register(&scans, &out, &["--seed", "1"]).status().unwrap().success());
    let kept = place.path().join("cache");
    std::fs::rename(out.join("cache"), &kept).unwrap();
    for repetition in 0..REPETITIONS {
        let force = repetition % 2 == 1;
        if !force {
            std::fs::remove_dir_all(&out).unwrap();
            std::fs::create_dir(&out).unwrap();
        }
        std::fs::create_dir_all(out.join("cache")).unwrap();
        for name in names(&kept) {
            std::fs::copy(kept.join(&name), out.join("cache").join(&name)).unwrap();
        }
        let runs = race(&scans, &out, if force { &["--force"] } else { &[] });
        let won = runs.iter().filter(|r| code(r) == Some(0)).count();
        let refused: Vec<_> = runs.iter().filter(|r| code(r) == Some(5)).collect();
        assert_eq!(won + refused.len(), 2, "{runs:?}");
        assert!(won == 1 || (force && won == 2), "{won} succeeded in repetition {repetition}");
        for run in refused {
            // The second came while the first worked, or after it.
            let said = said(run);
            let reason =
                said.contains("another run writes into it") || said.contains("already holds a result");
            assert!(reason && said.contains("--output") && said.lines().count() == 1, "{said}");
        }
        // `export` declines a mixture.
        scanweave()
            .args(["export", "-q", "--trajectory", "tum", "-o"])
            .arg(place.path().join("tum"))
            .arg(&out)
            .assert()
            .success();
        assert_eq!(litter(&out), Vec::<String>::new());
    }
}

#[test]
fn the_refusal_names_the_owner_and_other_commands_are_refused_too() {
    let place = folder();
    let scans = synth(place.path(), 2);
    let out = place.path().join("out");
    let mut first = register(&scans, &out, &["--seed", "1", "--set", "scale.voxel_m=0.02"]).spawn().unwrap();
    while !out.join(".scanweave.lock").exists() {
        assert!(first.try_wait().unwrap().is_none(), "the first run ended before it had a lock");
        std::thread::yield_now();
    }
    let owner = format!("process {}", first.id());
    let suite = place.path().join("suite.toml");
    std::fs::write(&suite, "").unwrap();
    let scan = scans.to_str().unwrap();
    for arguments in [
        vec!["register", scan],
        vec!["describe", scan],
        vec!["demo", "--scans", "2"],
        vec!["synth", "--scans", "2", "--force"],
        vec!["fuse", scan],
        vec!["sample", scan],
        vec!["ground-truth", scan],
    ] {
        scanweave().args(&arguments).arg("-o").arg(&out).assert().code(5).stderr(
            contains("out: another run writes into it")
                .and(contains("wait for its end"))
                .and(contains(&owner)),
        );
    }
    assert!(first.wait().unwrap().success());
    assert_eq!(litter(&out), Vec::<String>::new());
}

#[test]
fn a_run_that_fails_leaves_no_folder_that_it_made() {
    let place = folder();
    let out = place.path().join("a/b");
    scanweave().args(["register", "no-such-file.ply", "-o"]).arg(&out).assert().code(3);
    assert!(!place.path().join("a").exists());
    std::fs::create_dir(place.path().join("a")).unwrap();
    scanweave().args(["register", "no-such-file.ply", "-o"]).arg(&out).assert().code(3);
    assert_eq!(names(place.path()), ["a"]);
}

#[cfg(unix)]
#[test]
fn a_killed_run_stops_nobody_and_the_next_one_sweeps_after_it() {
    let place = folder();
    let scans = synth(place.path(), 3);
    let out = place.path().join("out");
    let mut run = register(&scans, &out, &[]).spawn().unwrap();
    // Killed while it has the lock; whether a file is half-written then is chance, so one is laid there.
    while names_of(&out).iter().all(|n| n != ".scanweave.lock") {
        assert!(run.try_wait().unwrap().is_none());
    }
    let tag = loop {
        let text = std::fs::read_to_string(out.join(".scanweave.lock")).unwrap_or_default();
        if let Some(tag) =
            text.lines().find_map(|l| l.strip_prefix("owner ")).filter(|_| text.ends_with('\n'))
        {
            break tag.to_owned();
        }
    };
    run.kill().unwrap();
    run.wait().unwrap();
    assert!(out.join(".scanweave.lock").exists());
    std::fs::write(out.join(format!(".scanweave-{tag}-q1w2e3.part")), "half").unwrap();
    assert!(register(&scans, &out, &[]).status().unwrap().success());
    assert_eq!(litter(&out), Vec::<String>::new());
}

fn names_of(folder: &Path) -> Vec<String> {
    if folder.is_dir() { names(folder) } else { Vec::new() }
}

#[cfg(target_os = "linux")]
#[test]
fn a_limit_of_file_sizes_is_an_error_and_leaves_no_litter() {
    let place = folder();
    let scans = synth(place.path(), 2);
    let out = place.path().join("out");
    // 8 blocks of 1 KiB: room for the lock, not for features.
    let run = Command::new("bash")
        .args([
            "-c",
            "ulimit -f 8; exec \"$0\" register \"$1\" -o \"$2\" -q",
            env!("CARGO_BIN_EXE_scanweave"),
        ])
        .args([&scans, &out])
        .output()
        .unwrap();
    assert_eq!(code(&run), Some(5), "{run:?}");
    assert!(contains("cannot write it").and(contains("File too large")).eval(&said(&run)), "{}", said(&run));
    assert!(!out.join("poses.json").exists());
    assert!(!out.exists() || litter(&out).is_empty());
}

#[test]
fn a_mixed_folder_is_declined_and_says_which_file() {
    let place = folder();
    let scans = synth(place.path(), 2);
    let (one, two) = (place.path().join("one"), place.path().join("two"));
    assert!(register(&scans, &one, &["--seed", "1"]).status().unwrap().success());
    assert!(register(&scans, &two, &["--seed", "2"]).status().unwrap().success());
    let run = json(one.join("poses.json"))["run"].clone();
    assert_eq!(run["id"], json(one.join("report.json"))["run_id"]);
    assert_ne!(run["id"], json(two.join("report.json"))["run_id"]);
    let header = std::fs::read(one.join("merged.ply")).unwrap();
    let comment = format!("comment scanweave merged cloud of run {}\n", run["id"].as_str().unwrap());
    assert!(String::from_utf8_lossy(&header[..400.min(header.len())]).contains(&comment));
    let listed: Vec<&String> = run["files"].as_object().unwrap().keys().collect();
    assert_eq!(listed, ["config.toml", "merged.ply", "overlap.csv", "trajectory.log"]);

    let tum = place.path().join("tum");
    let readers: [Vec<&str>; 3] = [
        vec!["report", "-o", "page.html"],
        vec!["evaluate", "--truth", scans.to_str().unwrap()],
        vec!["export", "--trajectory", "tum", "-o", tum.to_str().unwrap()],
    ];
    let read = |reader: &[&str]| {
        scanweave().current_dir(place.path()).arg(reader[0]).arg(&one).args(&reader[1..]).assert()
    };
    for reader in &readers {
        read(reader).success();
    }
    for file in ["report.json", "merged.ply", "config.toml"] {
        let kept = std::fs::read(one.join(file)).unwrap();
        std::fs::copy(two.join(file), one.join(file)).unwrap();
        for reader in &readers {
            read(reader).code(3).stderr(contains(file).and(contains("different runs")));
        }
        std::fs::write(one.join(file), kept).unwrap();
    }
    // The pages: `report` makes them anew.
    for file in ["report.html", "registration.html"] {
        let kept = std::fs::read(one.join(file)).unwrap();
        std::fs::copy(two.join(file), one.join(file)).unwrap();
        for reader in &readers[1..] {
            read(reader).code(3).stderr(contains(file).and(contains("different runs")));
        }
        scanweave().arg("report").arg(&one).assert().success();
        read(&readers[2]).success();
        std::fs::write(one.join(file), kept).unwrap();
        read(&readers[2]).success();
    }
    // A poses.json of an older version, which states no run.
    let mut old = json(one.join("poses.json"));
    old.as_object_mut().unwrap().remove("run");
    std::fs::write(one.join("poses.json"), old.to_string()).unwrap();
    read(&readers[2]).code(3).stderr(contains("report.json"));
}

/// The files of a result, but for those that tell the time that it took.
fn content(result: &Path) -> Vec<(String, Vec<u8>)> {
    let files = names(result).into_iter().filter(|n| result.join(n).is_file());
    files.map(|n| (n.clone(), std::fs::read(result.join(n)).unwrap())).collect()
}

#[cfg(unix)]
#[test]
fn a_result_that_cannot_be_replaced_stays_whole() {
    let place = folder();
    let scans = synth(place.path(), 2);
    let out = place.path().join("out");
    assert!(register(&scans, &out, &["--trajectory", "tum"]).status().unwrap().success());
    let old = content(&out);
    let replace = |blocks: &str| {
        Command::new("bash")
            .args(["-c", "ulimit -f \"$3\"; exec \"$0\" register \"$1\" -o \"$2\" -q --force --seed 2"])
            .arg(env!("CARGO_BIN_EXE_scanweave"))
            .args([&scans, &out])
            .arg(blocks)
            .output()
            .unwrap()
    };
    // Features and the merged cloud have room in it, the page has not: it comes late.
    let page_kib = std::fs::metadata(out.join("report.html")).unwrap().len() / 1024;
    let run = replace(&(page_kib * 9 / 10).to_string());
    assert_eq!(code(&run), Some(5), "{run:?}");
    assert!(said(&run).contains("out/report.html: cannot write it"), "{}", said(&run));
    assert!(content(&out) == old, "{:?}", names(&out));
    assert_eq!(litter(&out), Vec::<String>::new());
    // A folder in the way of a late file.
    std::fs::remove_file(out.join("registration.html")).unwrap();
    std::fs::create_dir(out.join("registration.html")).unwrap();
    let old = content(&out);
    let run = replace("unlimited");
    assert_eq!(code(&run), Some(5), "{run:?}");
    assert!(said(&run).contains("out/registration.html: cannot write it"), "{}", said(&run));
    assert!(content(&out) == old, "{:?}", names(&out));
    std::fs::remove_dir(out.join("registration.html")).unwrap();
    // Then it is replaced, and the trajectory of the old one is gone with it.
    assert!(replace("unlimited").status.success());
    assert!(!out.join("trajectory.tum").exists());
    assert_ne!(json(out.join("poses.json"))["run"]["id"], serde_json::Value::Null);
    scanweave().args(["export", "-q", "--trajectory", "tum"]).arg(&out).assert().success();
    // What a killed run leaves between the old and the new one says what it is.
    std::fs::remove_file(out.join("poses.json")).unwrap();
    let mut export = scanweave();
    let unfinished = contains("no poses.json, which is written last").and(contains("register again"));
    export.args(["export", "--trajectory", "tum"]).arg(&out).assert().code(3).stderr(unfinished);
}

#[test]
fn exported_scans_in_a_folder_of_the_result_are_not_taken_for_more_scans() {
    let place = folder();
    let scans = synth(place.path(), 2);
    let out = scans.join("out");
    assert!(register(&scans, &out, &["--recursive"]).status().unwrap().success());
    let export = |format: &str, folder: &str| {
        scanweave()
            .args(["export", "-q", "--format", format, "--export-scans"])
            .args([&out.join(folder), &out])
            .assert()
            .success();
    };
    export("ply", "moved");
    export("las", "moved");
    export("e57", "for others");
    std::fs::write(out.join("for others/trajectory_1.csv"), "scan,x\na,1\n").unwrap();
    // What somebody lays beside them is a scan.
    std::fs::copy(scans.join("cloud_bin_0.ply"), out.join("moved/more.ply")).unwrap();
    let run = register(&scans, &out, &["--recursive", "--force"]).output().unwrap();
    assert!(run.status.success(), "{}", said(&run));
    let registered: Vec<String> = json(out.join("poses.json"))["scans"]
        .as_array()
        .unwrap()
        .iter()
        .map(|scan| {
            Path::new(scan["file"].as_str().unwrap()).file_name().unwrap().to_string_lossy().into_owned()
        })
        .collect();
    assert_eq!(registered, ["cloud_bin_0.ply", "cloud_bin_1.ply", "more.ply"]);
    // Who names their folder wants them.
    let named = register(&out.join("moved"), &place.path().join("again"), &[]).output().unwrap();
    assert!(named.status.success(), "{}", said(&named));
}

#[test]
fn a_result_among_its_scans_is_not_taken_for_one_of_them() {
    let place = folder();
    let scans = synth(place.path(), 3);
    let register = |out: &Path, more: &[&str]| {
        let mut run = scanweave();
        run.arg("register").arg(&scans).arg("-o").arg(out).args(more);
        run.assert()
    };
    register(&scans, &[]).success();
    let poses = std::fs::read(scans.join("poses.json")).unwrap();
    std::fs::rename(scans.join("merged.ply"), scans.join("model.ply")).unwrap();
    register(&scans, &["--force"]).success().stderr(contains("model.ply").and(contains("merged cloud")));
    assert_eq!(std::fs::read(scans.join("poses.json")).unwrap(), poses);

    // In a folder of the scans, with its cache.
    let inside = scans.join("out");
    register(&inside, &["--recursive"]).success();
    register(&inside, &["--recursive", "--force"]).success();
    assert_eq!(json(inside.join("poses.json"))["scans"].as_array().unwrap().len(), 3);

    // A scan that the result would write over.
    std::fs::rename(scans.join("cloud_bin_0.ply"), scans.join("merged.ply")).unwrap();
    let scan = std::fs::read(scans.join("merged.ply")).unwrap();
    register(&scans, &["--force"]).code(3).stderr(contains("merged.ply").and(contains("--output")));
    assert_eq!(std::fs::read(scans.join("merged.ply")).unwrap(), scan);
}

#[test]
fn no_command_writes_over_what_it_reads() {
    let place = folder();
    let scans = synth(place.path(), 2);
    scanweave()
        .arg("fuse")
        .arg(&scans)
        .arg("-o")
        .arg(&scans)
        .arg("--force")
        .assert()
        .code(4)
        .stderr(contains("--output"));
    let out = place.path().join("out");
    assert!(register(&scans, &out, &[]).status().unwrap().success());
    scanweave()
        .args(["export", "--format", "ply", "--force", "--export-scans"])
        .args([&scans, &out])
        .assert()
        .code(3)
        .stderr(contains("--export-scans"));
    let features = place.path().join("features");
    scanweave().arg("describe").arg(&scans).arg("-q").arg("-o").arg(&features).assert().success();
    let before = std::fs::read(features.join("cloud_bin_0.npz")).unwrap();
    let again = |input: &Path| {
        let mut run = scanweave();
        run.arg("describe").arg(input).arg("--force").arg("-o").arg(&features);
        run
    };
    again(&features.join("cloud_bin_0.npz")).assert().code(3).stderr(contains("cloud_bin_0.npz"));
    again(&scans).arg("--features").arg(&features).assert().code(4).stderr(contains("--features"));
    assert_eq!(std::fs::read(features.join("cloud_bin_0.npz")).unwrap(), before);
}

/// Some of the places that `scripts/fault-injection.sh` tries one after the other.
#[cfg(target_os = "linux")]
#[test]
fn failing_and_killed_at_a_system_call_it_leaves_a_whole_result_or_none() {
    if !Command::new("strace").args(["-qq", "-o", "/dev/null", "true"]).status().is_ok_and(|s| s.success()) {
        eprintln!("not tested: strace is not installed or may not trace");
        return;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/scripts/fault-injection.sh");
    let run =
        Command::new(script).args([env!("CARGO_BIN_EXE_scanweave"), "40", "register"]).output().unwrap();
    assert!(run.status.success(), "{}", said(&run));
    assert!(contains("register: ").eval(&String::from_utf8_lossy(&run.stdout)), "{run:?}");
}
