use super::*;
use crate::registration::config::{
    AgglomerativeConfig, EstimatorConfig, IncrementalConfig, RansacConfig, SpatialCompatibilityConfig,
    Strategy,
};

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
        "seed = 4\n[registration.strategy]\nneighbours = 7\n[registration.estimator]\nhypotheses = 9\n",
        &["registration.strategy.neighbours=3", "registration.strategy.trials=false", "scale.voxel_m=1"],
    )
    .unwrap();
    let default = Config::default();
    assert_eq!(config.seed, 4);
    let strategy = AgglomerativeConfig { neighbours: 3, trials: false, ..AgglomerativeConfig::default() };
    assert_eq!(config.registration.strategy, Strategy::Agglomerative(strategy));
    let estimator = SpatialCompatibilityConfig { hypotheses: 9, ..SpatialCompatibilityConfig::default() };
    assert_eq!(config.registration.estimator, EstimatorConfig::SpatialCompatibility(estimator));
    assert_eq!(config.scale.voxel_m, Some(1.0));
    assert_eq!(config.registration.multiview_icp, default.registration.multiview_icp);
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
            "[registration.strategy]\nshortlits = 3",
            &[],
            ["my.toml: registration.strategy.shortlits:", "`registration.strategy.shortlist`"],
        ),
        (
            "[registration.multiview_icp]\nround = 3",
            &[],
            ["registration.multiview_icp.round:", "`registration.multiview_icp.rounds`"],
        ),
        // Right key, wrong table.
        ("max_draws = 3", &[], ["my.toml: max_draws:", "`registration.estimator.max_draws`"]),
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
        (
            "",
            &["registration.strategy.merge=avarage"],
            ["--set: registration.strategy.merge:", "avarage", "\"reservoir\""],
        ),
        (
            "",
            &["registration.strategy.neighbours=0"],
            ["--set: registration.strategy.neighbours:", "0", "positive"],
        ),
        (
            "[registration.multiview_icp]\nmin_overlap = 1.5",
            &[],
            ["my.toml: registration.multiview_icp.min_overlap:", "1.5", "between 0 and 1"],
        ),
        (
            "[registration.multiview_icp]\nradii = [1, \"2\"]",
            &[],
            ["my.toml: registration.multiview_icp.radii:", "\"2\"", "number"],
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

#[test]
fn a_setting_without_effect_is_refused_and_says_what_would_give_it_one() {
    for (file, assignments, parts) in [
        (
            "[registration.strategy]\nshortlist = 5",
            &[][..],
            ["my.toml: registration.strategy.shortlist:", "no effect", "\"incremental\""],
        ),
        (
            "",
            &["registration.strategy.kind=incremental", "registration.strategy.trials=false"],
            ["--set: registration.strategy.trials:", "no effect", "\"agglomerative\""],
        ),
        (
            "",
            &["registration.estimator.edge_ratio=0.8"],
            ["--set: registration.estimator.edge_ratio:", "no effect", "\"ransac\""],
        ),
        (
            "[registration.verification]\nkind = \"inlier-count\"\naccept = 0.7",
            &["registration.strategy.kind=incremental"],
            ["my.toml: registration.verification.accept:", "no effect", "\"surfaces\""],
        ),
        ("", &["synchronization.graph=full"], ["--set: synchronization.graph:", "no effect", "sghr"]),
    ] {
        let text = message(file, assignments);
        for part in parts {
            assert!(text.contains(part), "{part:?} is not in: {text}");
        }
    }
    assert!(read("", &["method=sghr", "synchronization.graph=full"]).is_ok());
}

#[test]
fn another_kind_drops_what_only_the_former_one_had_and_keeps_the_rest() {
    let config = read(
        "[registration.strategy]\nneighbours = 7\n[registration.estimator]\nhypotheses = 9",
        &["registration.strategy.kind=incremental", "registration.estimator.kind=ransac"],
    )
    .unwrap();
    assert_eq!(config.registration.strategy, Strategy::Incremental(IncrementalConfig::default()));
    let ransac = RansacConfig { hypotheses: 9, ..RansacConfig::default() };
    assert_eq!(config.registration.estimator, EstimatorConfig::Ransac(ransac));
}

#[test]
fn settings_that_would_silently_do_nothing_or_contradict_each_other_are_refused() {
    let refused = |assignment: &str| message("", &[assignment]);
    assert!(refused("registration.multiview_icp.radii=[]").contains("one or more positive multiples"));
    let text = refused("registration.verification.accept=0.99");
    assert!(text.contains("registration.verification.confident, 0.95"), "{text}");
    let text = refused("registration.verification.kind=inlier-count");
    assert!(text.contains("registration.strategy.kind") && text.contains("surfaces"), "{text}");
}
