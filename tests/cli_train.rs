//! Training an overlap head at the prompt, on a small synthetic set.

mod cli_common;

use cli_common::{folder, json, names, scanweave, synth, text};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A recipe over the set in `place/set`; `more` is laid into `[train]`.
fn recipe(place: &Path, name: &str, more: &str) -> PathBuf {
    let text = format!(
        "[train]\nclusters = 8\nlearning_rate = 0.02\ndropout = 0.1\ncrop_min = 120\ncrop_max = 220\n\
         validate_every = 2\n{more}\n[descriptor.keypoints]\ncount = 250\n\
         [[scenes]]\nfolders = [\"set\"]\n\
         [[synth]]\nsplit = \"valid\"\nseeds = [9]\nrooms = 1\nscans = 5\nframes_per_scan = 1\n"
    );
    let path = place.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn train(config: &Path, output: &Path) -> assert_cmd::Command {
    let mut command = scanweave();
    command.arg("train").arg("--config").arg(config).arg("-o").arg(output);
    // Shared by the runs of a test, as a user would.
    command.arg("--cache").arg(config.with_file_name("cache"));
    command
}

fn losses(run: &Path) -> Vec<f64> {
    let log = text(run.join("metrics.jsonl"));
    let records = log.lines().map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap());
    records.filter_map(|r| r["loss"].as_f64()).collect()
}

#[test]
fn a_head_is_trained_and_registration_uses_it() {
    let place = folder();
    let scans = synth(place.path(), 8);
    let (config, run) = (recipe(place.path(), "a.toml", "epochs = 12"), place.path().join("run"));
    train(&config, &run)
        .assert()
        .success()
        .stdout(contains("mean pooling").and(contains("k-means NetVLAD")).and(contains("trained, epoch")))
        .stdout(contains("outside the network"));
    let files = ["best.safetensors", "curves.svg", "last.safetensors", "metrics.jsonl", "recipe.toml"];
    assert_eq!(names(&run), files);
    let losses = losses(&run);
    assert_eq!(losses.len(), 12);
    assert!(losses[11] < 0.7 * losses[0], "{losses:?}");

    train(&config, &run).assert().code(5).stderr(contains("--force"));
    train(&config, &place.path().join("none"))
        .arg("--resume")
        .assert()
        .code(3)
        .stderr(contains("no such file"));

    let register = |checkpoint: &Path, more: &[&str]| {
        let mut command = scanweave();
        command.arg("register").arg(&scans).arg("-o").arg(place.path().join("result")).args(more);
        command.args(["--force", "--set", "descriptor.keypoints.count=600", "--checkpoint"]).arg(checkpoint);
        command
    };
    let best = run.join("best.safetensors");
    register(&best, &[]).assert().success();
    let report = json(place.path().join("result/report.json"));
    assert_eq!(report["overlap_head"], "trained checkpoint netvlad-mini-spin-net-fpfh");
    // Descriptors of another radius mean something else.
    register(&best, &["--set", "scale.feature_radius_m=0.5"])
        .assert()
        .code(3)
        .stderr(contains("best.safetensors: found a head for `mini-spin-net-fpfh` with settings"));
    register(&best, &["--set", "retrieval.head=untrained"])
        .assert()
        .code(4)
        .stderr(contains("retrieval.head: found untrained, with the checkpoint"));
}

/// However a run ends, what follows is as if it had never been stopped.
#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    let place = folder();
    synth(place.path(), 6);
    let config = recipe(place.path(), "a.toml", "epochs = 30\ncentroids = \"uniform\"");
    let (straight, stopped) = (place.path().join("straight"), place.path().join("stopped"));
    train(&config, &straight).assert().success();
    let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin!("scanweave"))
        .arg("train")
        .arg("--config")
        .arg(&config)
        .arg("-o")
        .arg(&stopped)
        .arg("--cache")
        .arg(place.path().join("cache"))
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let patience = Instant::now();
    while !stopped.join("last.safetensors").exists() && patience.elapsed() < Duration::from_secs(120) {
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    train(&config, &stopped).arg("--resume").assert().success();
    for file in ["best.safetensors", "last.safetensors"] {
        assert!(std::fs::read(straight.join(file)).unwrap() == std::fs::read(stopped.join(file)).unwrap());
    }
    assert_eq!(losses(&straight), losses(&stopped));
    // A bit of the best weights turned over is noticed before it is shipped.
    let best = stopped.join("best.safetensors");
    let whole = std::fs::read(&best).unwrap();
    let mut flipped = whole.clone();
    *flipped.last_mut().unwrap() ^= 1;
    std::fs::write(&best, flipped).unwrap();
    let resume = || train(&config, &stopped).arg("--resume").assert();
    resume().code(3).stderr(contains("best.safetensors").and(contains("checksum")));
    std::fs::remove_file(&best).unwrap();
    resume().code(3).stderr(contains("best.safetensors"));
    std::fs::write(&best, whole).unwrap();
    resume().success();
    // Other settings are not the same run.
    let other = recipe(place.path(), "b.toml", "epochs = 31\ncentroids = \"uniform\"");
    train(&other, &stopped).arg("--resume").assert().code(3).stderr(contains("epochs"));
}

/// A run that was stopped while features were computed, or in its first epoch.
#[test]
fn a_run_that_was_stopped_before_its_first_checkpoint_starts_anew() {
    let place = folder();
    synth(place.path(), 6);
    let (config, run) = (recipe(place.path(), "a.toml", "epochs = 2"), place.path().join("run"));
    std::fs::create_dir(&run).unwrap();
    let anew = contains("no checkpoint to go on from").and(contains("anew"));
    train(&config, &run).arg("--resume").assert().success().stderr(anew);
    assert_eq!(losses(&run).len(), 2);
    // A best checkpoint alone is not thrown away.
    std::fs::remove_file(run.join("last.safetensors")).unwrap();
    train(&config, &run).arg("--resume").assert().code(3).stderr(contains("last.safetensors"));
    assert!(run.join("best.safetensors").exists());
}

/// Everything that a run leaves is as readable as any new file.
#[cfg(unix)]
#[test]
fn files_of_a_run_follow_the_umask() {
    use std::os::unix::fs::PermissionsExt;
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let place = folder();
    let plain = place.path().join("plain");
    std::fs::write(&plain, "").unwrap();
    std::fs::create_dir(place.path().join("plain_folder")).unwrap();
    synth(place.path(), 6);
    let config = recipe(place.path(), "a.toml", "epochs = 1");
    train(&config, &place.path().join("run")).assert().success();
    let mut folders = vec![place.path().join("run"), place.path().join("cache"), place.path().join("set")];
    let mut files = 0;
    while let Some(folder) = folders.pop() {
        assert_eq!(mode(&folder), mode(&place.path().join("plain_folder")), "{}", folder.display());
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            assert_eq!(mode(&path), mode(&plain), "{}", path.display());
            files += 1;
        }
    }
    assert!(files > 15, "{files}");
}

#[test]
fn bad_recipes_and_weights_are_refused() {
    let place = folder();
    let config = recipe(place.path(), "a.toml", "epoch = 3");
    let run = place.path().join("run");
    train(&config, &run).assert().code(4).stderr(contains("nearest is `train.epochs`"));
    let config = recipe(place.path(), "b.toml", "epochs = 3");
    train(&config, &run).assert().code(3).stderr(contains("set"));
    let file = place.path().join("head.pth");
    std::fs::write(&file, b"not a checkpoint").unwrap();
    let import = |input: &Path, output: &Path| {
        let mut command = scanweave();
        command.args(["import-weights", "--from", "sghr", "-o"]).arg(output).arg(input);
        command
    };
    let output = place.path().join("head.safetensors");
    import(&file, &output).assert().code(3).stderr(contains("head.pth").and(contains("PyTorch")));
    assert!(!output.exists());
    import(&file, &file).assert().code(5);

    let Some(data) = std::env::var_os("SCANWEAVE_DATA") else {
        eprintln!("SCANWEAVE_DATA is not set: published weights are not imported");
        return;
    };
    let weights = Path::new(&data).join("../weights/sghr/netvlad_yoho.pth");
    if weights.exists() {
        import(&weights, &output).assert().success().stdout(contains("`yoho` with 32 dimensions"));
        let head = scanweave::retrieval::Checkpoint::load(&output).unwrap();
        assert_eq!((head.weights.dim(), head.meta.name.as_str()), (32, "netvlad-yoho-sghr"));
    }
}

#[test]
fn ways_to_predict_overlap_are_compared() {
    let place = folder();
    synth(place.path(), 6);
    let rows = scanweave()
        .args(["evaluate-retrieval", "--json", "--set", "descriptor.keypoints.count=400"])
        .arg(place.path().join("set"))
        .output()
        .unwrap();
    let rows: serde_json::Value = serde_json::from_slice(&rows.stdout).unwrap();
    let ways: Vec<&str> = rows.as_array().unwrap().iter().map(|r| r["way"].as_str().unwrap()).collect();
    let expected = [
        "random order",
        "mean pooling",
        "GeM",
        "k-means NetVLAD",
        "trained checkpoint netvlad-mini-spin-net-fpfh",
    ];
    assert_eq!(ways, expected);
    // Ten of the other five scans are all of them.
    assert!(rows.as_array().unwrap().iter().all(|r| r["recall_overlap_10"] == 1.0));
}

/// A recipe for a tiny network, on two tiny buildings.
#[test]
fn a_descriptor_is_trained_and_describes() {
    let place = folder();
    let recipe = place.path().join("d.toml");
    let building = "rooms = 1\nscans = 4\nframes_per_scan = 1\n";
    let text = format!(
        "[train]\nchannels = [16]\npairs_per_scene = 60\nsteps = 4\npairs_per_step = 8\ncheckpoint_every = 2\n\
         validate_every = 2\n[[synth]]\nseeds = [3]\n{building}[[synth]]\nsplit = \"valid\"\nseeds = [4]\n{building}"
    );
    std::fs::write(&recipe, text).unwrap();
    let run = place.path().join("run");
    let train = |more: &[&str]| {
        let mut command = scanweave();
        command.args(["train", "descriptor", "--config"]).arg(&recipe).arg("-o").arg(&run).args(more);
        command
    };
    train(&[]).assert().success().stdout(contains("step      4").and(contains("accuracy")));
    let files = "best.safetensors curves.svg final.safetensors last.safetensors metrics.jsonl recipe.toml";
    assert_eq!(names(&run).join(" "), files);
    // Two records (steps 2 and 4) with a loss and an accuracy each: four points.
    assert_eq!(std::fs::read_to_string(run.join("curves.svg")).unwrap().matches("<circle").count(), 4);
    train(&[]).assert().code(5).stderr(contains("--force"));
    train(&["--resume"]).assert().success();

    let scans = synth(place.path(), 2);
    let checkpoint = format!("descriptor.checkpoint={}", run.join("best.safetensors").display());
    let mut describe = scanweave();
    describe.arg("describe").arg(scans).arg("-o").arg(place.path().join("features"));
    describe.args(["--set", "descriptor.kind=mini-spin-net", "--set", &checkpoint]);
    describe.args(["--set", "descriptor.keypoints.count=200"]);
    describe.assert().success().stdout(contains("400 keypoints with 16 values"));
    // Either a recipe for a head, or a subcommand.
    scanweave().arg("train").assert().code(2).stderr(contains("--config"));
}
