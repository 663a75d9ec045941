use super::*;

fn read(file: &str, assignments: &[&str]) -> Result<Config> {
    let mut layers = Layers::new::<Config>();
    layers.add_preset(DEFAULT_PRESET)?;
    layers.add_text("my.toml", file)?;
    for assignment in assignments {
        layers.add_assignment(assignment)?;
    }
    Config::from_layers(&layers)
}

fn message(file: &str, assignments: &[&str]) -> String {
    read(file, assignments).unwrap_err().to_string()
}

#[test]
fn the_default_preset_says_what_the_code_says() {
    assert_eq!(Config::preset("default").unwrap(), Config::default());
    assert!(Config::preset("paper").unwrap() != Config::default());
}

#[test]
fn later_layers_win_key_by_key() {
    let config = read(
        "seed = 4\n[registration]\nshortlist = 7\n[registration.estimator]\nhypotheses = 9\n",
        &["registration.shortlist=3", "registration.merge=mean", "scale.voxel_m=1"],
    )
    .unwrap();
    let default = Config::default();
    assert_eq!(config.seed, 4);
    assert_eq!(config.registration.shortlist, 3);
    assert_eq!(config.registration.estimator.hypotheses, 9);
    assert_eq!(config.registration.estimator.edge_ratio, default.registration.estimator.edge_ratio);
    assert_eq!(config.registration.merge, crate::registration::config::MergeRule::Mean);
    assert_eq!(config.scale.voxel_m, Some(1.0));
    assert_eq!(config.registration.joint, default.registration.joint);
}

#[test]
fn an_effective_configuration_reads_back_as_itself() {
    for (name, _) in PRESETS {
        let config = Config::preset(name).unwrap();
        let mut layers = Layers::new::<Config>();
        layers.add_text("written", &config.to_toml().unwrap()).unwrap();
        assert_eq!(Config::from_layers(&layers).unwrap(), config);
    }
}

#[test]
fn an_unknown_key_is_named_with_its_place_and_the_nearest_known_one() {
    for (file, assignments, parts) in [
        ("sed = 3", &[][..], ["my.toml: sed:", "`seed`"]),
        (
            "[registration]\nshortlits = 3",
            &[],
            ["my.toml: registration.shortlits:", "`registration.shortlist`"],
        ),
        (
            "[registration.joint]\nround = 3",
            &[],
            ["registration.joint.round:", "`registration.joint.rounds`"],
        ),
        // Right key, wrong table.
        ("hypotheses = 3", &[], ["my.toml: hypotheses:", "`registration.estimator.hypotheses`"]),
        ("", &["scale.voxel=3"], ["--set: scale.voxel:", "`scale.voxel_m`"]),
        ("", &["retreival.clusters=3"], ["--set: retreival:", "`retrieval"]),
    ] {
        let text = message(file, assignments);
        assert!(text.contains("unknown key"), "{text}");
        for part in parts {
            assert!(text.contains(part), "{part:?} is not in: {text}");
        }
    }
}

#[test]
fn a_wrong_type_or_range_names_key_found_and_expected() {
    for (file, assignments, parts) in [
        ("seed = \"one\"", &[][..], ["my.toml: seed:", "the text \"one\"", "a whole number of at least 0"]),
        ("seed = 1.5", &[], ["my.toml: seed:", "the number 1.5", "a whole number"]),
        ("registration = 3", &[], ["my.toml: registration:", "the whole number 3", "a table"]),
        ("", &["registration.merge=avarage"], ["--set: registration.merge:", "avarage", "\"reservoir\""]),
        ("", &["registration.shortlist=0"], ["--set: registration.shortlist:", "0", "positive"]),
        (
            "[registration.averaging]\nmin_overlap = 1.5",
            &[],
            ["my.toml: registration.averaging.min_overlap:", "1.5", "between 0 and 1"],
        ),
        (
            "[registration.joint]\nradii = [1, \"2\"]",
            &[],
            ["my.toml: registration.joint.radii:", "\"2\"", "number"],
        ),
        ("", &["seed"], ["--set:", "`seed`", "key=value"]),
    ] {
        let text = message(file, assignments);
        for part in parts {
            assert!(text.contains(part), "{part:?} is not in: {text}");
        }
    }
}

#[test]
fn bad_syntax_names_file_and_line() {
    let text = message("seed = 1\n[registration\n", &[]);
    assert!(text.starts_with("my.toml: found bad syntax in line 2"), "{text}");
}
