use super::candidates::label;
use super::*;
use crate::Silent;
use crate::evaluation::pose_error::PoseError;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn kind(name: &str, candidates: Vec<Candidate>) -> KindCandidates {
    KindCandidates { name: name.into(), folders: Vec::new(), candidates }
}

/// Candidates whose labels are drawn from the logistic model of `weights`.
fn simulated(weights: &EvidenceWeights, seed: u64, n: usize, offset: f64) -> Vec<Candidate> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n)
        .map(|_| {
            let predictors: [f64; 10] =
                std::array::from_fn(|j| if j == 0 { 1.0 } else { rng.random_range(-2.0..2.0) });
            let score: f64 = predictors.iter().zip(weights.as_array()).map(|(x, w)| x * w).sum();
            let right = rng.random_range(0.0..1.0) < 1.0 / (1.0 + (-score - offset).exp());
            Candidate { predictors, offset, right }
        })
        .collect()
}

fn weights() -> EvidenceWeights {
    EvidenceWeights::from_array([-0.5, 0.8, 0.6, 1.0, -1.2, 0.5, -0.9, 0.4, -0.7, -0.3])
}

fn largest_difference(a: &EvidenceWeights, b: &EvidenceWeights) -> f64 {
    let pairs = a.as_array().into_iter().zip(b.as_array());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// A weight of predictors of variance 4/3 is known to 1/√(n p(1−p) 4/3), about 0.015 of 40 000 candidates
/// with p(1−p) near 0.1: 0.07 is four to five times that.
#[test]
fn simulated_weights_are_found_again_without_a_ridge() {
    let kinds =
        [kind("a", simulated(&weights(), 1, 20_000, 0.0)), kind("b", simulated(&weights(), 2, 20_000, -1.5))];
    let found = fit(&kinds, &EvidenceWeights::from_array([0.0; 10]), 0.0, None);
    assert!(largest_difference(&found, &weights()) < 0.07, "{found:?}");
    // Where it starts from makes no difference, as the problem is convex.
    let from_elsewhere = fit(&kinds, &weights(), 0.0, None);
    assert!(largest_difference(&found, &from_elsewhere) < 1e-6, "{found:?} {from_elsewhere:?}");
}

/// With the constant alone the minimum is the log odds of the share of right ones, less the offset; of kinds
/// that weigh equally, of the mean of their shares.
#[test]
fn kinds_weigh_equally() {
    let of = |right: usize, wrong: usize| {
        let mut predictors = [0.0; 10];
        predictors[0] = 1.0;
        let labels = (0..right + wrong).map(|k| k < right);
        labels.map(|right| Candidate { predictors, offset: -0.7, right }).collect::<Vec<_>>()
    };
    let kinds = [kind("large", of(200, 800)), kind("small", of(3, 2)), kind("empty", Vec::new())];
    let found = fit(&kinds, &EvidenceWeights::from_array([0.0; 10]), 0.0, None);
    let expected = (0.4f64 / 0.6).ln() + 0.7;
    assert!((found.constant - expected).abs() < 1e-8, "{} {expected}", found.constant);
}

#[test]
fn no_weight_has_the_wrong_sign_whatever_the_candidates_say() {
    let mut contrary = weights();
    (contrary.overlap, contrary.plane_residual) = (-0.5, 1.2);
    let kinds = [kind("a", simulated(&contrary, 3, 20_000, 0.0))];
    let given = EvidenceWeights::from_array([0.0; 10]);
    let found = fit(&kinds, &given, 0.0, None);
    assert_eq!([found.overlap, found.plane_residual], [0.0, 0.0]);
    for ((weight, sign), name) in
        found.as_array().into_iter().zip(EvidenceWeights::SIGNS).zip(EvidenceWeights::NAMES)
    {
        assert!(weight * sign >= 0.0, "{name}: {weight}");
    }
    // The others are where they are without these two predictors at all.
    let without: Vec<Candidate> = kinds[0]
        .candidates
        .iter()
        .cloned()
        .map(|mut c| {
            (c.predictors[4], c.predictors[5]) = (0.0, 0.0);
            c
        })
        .collect();
    let free = fit(&[kind("a", without)], &given, 0.0, None);
    assert!(largest_difference(&found, &free) < 1e-6, "{found:?} {free:?}");
}

/// As if the predictor were not there; a strong ridge keeps the given weights, and what the predictor adds
/// by them in the mean goes into the constant.
#[test]
fn a_predictor_that_is_left_out_has_no_say() {
    let candidates = simulated(&weights(), 5, 5000, 0.0);
    let mean = candidates.iter().map(|c| c.predictors[3]).sum::<f64>() / 5000.0;
    let blind = candidates.iter().cloned().map(|mut c| {
        c.predictors[3] = 0.0;
        c
    });
    let blind = fit(&[kind("a", blind.collect())], &EvidenceWeights::from_array([0.0; 10]), 0.0, None);
    let kinds = [kind("a", candidates)];
    let found = fit(&kinds, &EvidenceWeights::from_array([0.0; 10]), 0.0, Some(3));
    assert_eq!(found.normal_agreement, 0.0);
    assert!(largest_difference(&found, &blind) < 1e-6, "{found:?} {blind:?}");
    let kept = fit(&kinds, &weights(), 1e6, Some(3)).constant;
    assert!((kept - (-0.5 + mean)).abs() < 1e-5, "{kept} {mean}");
}

#[test]
fn a_ridge_draws_to_the_given_weights() {
    let kinds = [kind("a", simulated(&weights(), 4, 2000, 0.0))];
    let given = EvidenceWeights::from_array([0.3, 0.1, 2.0, 0.0, -3.0, 1.0, -0.1, 1.4, 0.0, -2.0]);
    assert_eq!(fit(&kinds, &given, f64::INFINITY, None), given);
    let off = |ridge: f64| largest_difference(&fit(&kinds, &given, ridge, None), &given);
    let offs = [off(0.0), off(0.1), off(1.0), off(1e6)];
    assert!(offs.windows(2).all(|w| w[1] < w[0]) && offs[3] < 1e-5, "{offs:?}");
}

#[test]
fn labels_leave_out_what_is_neither_right_nor_wrong() {
    let of = |rotation_deg: f64, translation_m: f64| label(&PoseError { rotation_deg, translation_m }, 0.1);
    assert_eq!([of(4.9, 0.29), of(0.0, 0.31), of(5.1, 0.0)], [Some(true), None, None]);
    assert_eq!([of(9.9, 0.59), of(10.1, 0.0), of(0.0, 0.61)], [None, Some(false), Some(false)]);
}

#[test]
fn a_recipe_is_read_back_and_bad_ones_name_the_key() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recipe.toml");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        VerifierRecipe::load(&path)
    };
    let good = read("ridge = 2.0\n[[kinds]]\nname = \"a\"\nfolders = [\"x\", \"y/z\"]\n").unwrap();
    assert_eq!((good.ridge, good.kinds[0].folders.len(), good.descriptor.keypoints.count), (2.0, 2, 1500));
    assert_eq!(read(&good.to_toml().unwrap()).unwrap(), good);
    let message = |text: &str| read(text).unwrap_err().to_string();
    let cases = [
        ("rigde = 1.0\n", "nearest is `ridge`"),
        ("ridge = -1.0\n", "ridge: found -1"),
        ("[given]\noverlap = -1.0\n", "given.overlap: found -1"),
        ("[[kinds]]\nname = \"bare-room\"\nfolders = [\"a\"]\n", "kinds[0].name: found `bare-room`"),
        ("[[kinds]]\nname = \"a\"\n", "kinds[0].folders: found no folder"),
        ("[[kinds]]\nname = \"a\"\nfolders = [\"/a\"]\n", "relative to --data-root"),
        ("synthetic_places = [\"bare-room\"]\n", "kinds: found 1 of them"),
    ];
    for (text, expected) in cases {
        let found = message(text);
        assert!(found.contains(expected), "{text}: {found}");
    }
    let missing = read("[[kinds]]\nname = \"a\"\nfolders = [\"not-there\"]\n").unwrap();
    let found = train(&missing, folder.path(), &Silent).unwrap_err().to_string();
    assert!(found.contains("not-there") && found.contains("kinds[0].folders"), "{found}");
}

#[test]
fn places_are_named_as_recipes_spell_them() {
    for place in Place::ALL {
        assert_eq!(serde_json::to_value(place).unwrap(), place.name());
    }
}

/// The block tells its poses apart, the column does not: of its sides one at most is the right one.
#[test]
fn two_synthetic_kinds_train_a_verifier_the_same_for_any_number_of_threads() {
    let recipe = VerifierRecipe {
        synthetic_seeds: vec![0],
        synthetic_places: vec![Place::LopsidedBlock, Place::SixSidedColumn],
        descriptor: {
            let mut changed = VerifierRecipe::default().descriptor;
            changed.keypoints = KeypointConfig::new(400);
            changed
        },
        ..VerifierRecipe::default()
    };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| train(&recipe, Path::new(""), &Silent)).unwrap()
    };
    let report = with(2);
    assert_eq!(serde_json::to_string(&report).unwrap(), serde_json::to_string(&with(1)).unwrap());
    let [block, column] = &report.kinds[..] else { panic!("{:?}", report.kinds) };
    assert!(block.right > 0 && block.right < block.candidates, "{block:?}");
    assert!(6 * column.right < 3 * column.candidates, "{column:?}");
    assert_eq!(
        report.reliability.iter().map(|b| b.candidates).sum::<usize>(),
        block.candidates + column.candidates
    );
    let folder = tempfile::tempdir().unwrap();
    report.write(folder.path()).unwrap();
    let again = VerifierRecipe::load(&folder.path().join("recipe.toml")).unwrap();
    assert_eq!(again, recipe);
    let json = std::fs::read_to_string(folder.path().join("verifier.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((json["format"].as_str(), json["version"].as_u64()), (Some("scanweave-verifier"), Some(1)));
    for (name, weight) in EvidenceWeights::NAMES.into_iter().zip(report.weights.as_array()) {
        assert_eq!(json["weights"][name].as_f64(), Some(weight), "{name}");
    }
    assert!(report.table().contains("lopsided-block") && report.table().contains("mean, sums"));
}
