//! Joining of components on synthetic interiors, whose true poses are known.

use scanweave::config::Config;
use scanweave::evaluation::PoseError;
use scanweave::geometry::{Point, RigidMotion};
use scanweave::pipeline::{self, Described, FeatureSource, Stopwatch};
use scanweave::registration::Agglomeration;
use scanweave::registration::ScanInput;
use scanweave::registration::ScanModel;
use scanweave::registration::{
    AgglomerativeConfig, RegistrationConfig, Strategy, SurfaceVerification, VerificationConfig,
};

use scanweave::registration::{PairScorer, ScanPair, most_similar_pairs};
use scanweave::registration::{ScoredHypothesis, Verifier};
use scanweave::scan::{Evidence, Reconstruction, Scan, ScanId, SimilarityMatrix};
use scanweave::synthetic::{SynthConfig, generate};
use scanweave::{Monitor, Silent};
use std::sync::{Mutex, OnceLock};

/// Scans of two interiors with nothing in common, the second's after the first's.
struct TwoPlaces {
    config: Config,
    described: Described,
    /// True poses of the files' frames, and of the frames that the scans are worked on in.
    world_from_scan: Vec<RigidMotion>,
    world_from_local: Vec<RigidMotion>,
    first: usize,
}

fn two_places() -> &'static TwoPlaces {
    static PLACES: OnceLock<TwoPlaces> = OnceLock::new();
    PLACES.get_or_init(|| {
        let mut config = Config::default();
        config.descriptor.keypoints.count = 1500;
        let (mut scans, mut world_from_scan): (Vec<Scan>, Vec<RigidMotion>) = (Vec::new(), Vec::new());
        let mut first = 0;
        for seed in [11, 12] {
            let set = generate(&SynthConfig { seed, rooms: 1, scans: 7, ..SynthConfig::default() }, &Silent)
                .unwrap();
            first = if seed == 11 { set.scans.len() } else { first };
            scans.extend(set.scans);
            world_from_scan.extend(set.world_from_scan);
        }
        for (k, scan) in scans.iter_mut().enumerate() {
            (scan.id, scan.name) = (ScanId(k), format!("scan_{k}"));
        }
        let described = pipeline::describe(&scans, &config, &FeatureSource::Computed, &Silent).unwrap();
        let posed = world_from_scan.iter().zip(&described.frames);
        let world_from_local = posed.map(|(pose, frame)| pose * frame).collect();
        TwoPlaces { config, described, world_from_scan, world_from_local, first }
    })
}

/// Settings of the registration.
fn settings() -> &'static RegistrationConfig {
    &two_places().config.registration
}

/// Settings of its verification.
fn verification() -> &'static SurfaceVerification {
    settings().verification.surfaces().unwrap()
}

fn strategy(config: &mut Config) -> &mut AgglomerativeConfig {
    match &mut config.registration.strategy {
        Strategy::Agglomerative(strategy) => strategy,
        _ => unreachable!("the default is agglomerative"),
    }
}

fn surfaces(config: &mut Config) -> &mut SurfaceVerification {
    match &mut config.registration.verification {
        VerificationConfig::Surfaces(settings) => settings,
        _ => unreachable!("the default compares surfaces"),
    }
}

impl TwoPlaces {
    fn keypoints(&self) -> Vec<&[Point]> {
        self.described.features[..self.first].iter().map(|f| f.keypoints.as_slice()).collect()
    }

    fn register(&self, order: &[usize], config: &Config) -> Reconstruction {
        let mut described = self.described.clone();
        described.surfaces = order.iter().map(|&k| self.described.surfaces[k].clone()).collect();
        described.frames = order.iter().map(|&k| self.described.frames[k]).collect();
        described.features = order.iter().map(|&k| self.described.features[k].clone()).collect();
        let mut clock = Stopwatch::default();
        let (similarity, _) = pipeline::predict_overlap(&described, config, &Silent, &mut clock).unwrap();
        pipeline::register_described(&described, &similarity, config, &Silent, &mut clock).unwrap()
    }

    /// Error of the relative pose of two scans, `None` where they are not in one component.
    fn error(&self, r: &Reconstruction, order: &[usize], i: usize, j: usize) -> Option<PoseError> {
        let truth = self.world_from_scan[order[i]].inverse() * self.world_from_scan[order[j]];
        r.relative(ScanId(i), ScanId(j)).map(|found| PoseError::between(&found, &truth))
    }
}

#[test]
fn shuffled_scans_of_two_places_come_out_as_two_components() {
    let places = two_places();
    let n = places.world_from_scan.len();
    // Taken in turn from either place.
    let order: Vec<usize> = (0..n).map(|k| (k * 5) % n).collect();
    let r = places.register(&order, &places.config);
    let placed = r.placed();
    assert!(placed + 2 >= n, "{placed} of {n}");
    for i in 0..n {
        for j in i + 1..n {
            let same = (order[i] < places.first) == (order[j] < places.first);
            if let Some(error) = places.error(&r, &order, i, j) {
                assert!(same, "scans {i} and {j} are of different places");
                assert!(error.translation_m < 0.15 && error.rotation_deg < 4.0, "{i} {j} {error:?}");
            }
        }
    }
    let joined = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
    let joined = joined.filter(|&(i, j)| r.relative(ScanId(i), ScanId(j)).is_some()).count();
    // Two components of all seven would be 42 pairs.
    assert!(joined >= 30, "{joined}");
}

#[test]
fn steps_and_parents_make_a_tree_and_probabilities_are_told() {
    let places = two_places();
    let order: Vec<usize> = (0..places.first).collect();
    let r = places.register(&order, &places.config);
    let mut steps = Vec::new();
    for p in r.outcomes.iter().filter_map(|o| o.placement()).filter(|p| p.component == 0) {
        steps.push(p.step);
        assert_eq!(p.parent.is_none(), p.step == 0);
        if let Some(parent) = p.parent {
            assert!(r.outcomes[parent.0].placement().unwrap().step < p.step);
            let evidence = p.evidence.unwrap();
            assert!(evidence.parent_from_scan.is_some());
            assert!(evidence.probability.is_some_and(|p| (0.5..=1.0).contains(&p)), "{evidence:?}");
        }
    }
    assert!(steps.len() + 1 >= places.first, "{} of {} placed together", steps.len(), places.first);
    steps.sort_unstable();
    assert_eq!(steps, (0..steps.len()).collect::<Vec<_>>());
}

#[test]
fn threads_do_not_change_a_bit() {
    let places = two_places();
    let order: Vec<usize> = (0..places.world_from_scan.len()).collect();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| places.register(&order, &places.config))
    };
    assert_eq!(with(1), with(3));
}

/// Everything an [`Agglomeration`] of the first place needs.
fn with_agglomeration<T>(work: impl FnOnce(&Verifier<'_>, Vec<scanweave::registration::ScanPair>) -> T) -> T {
    let places = two_places();
    let described = &places.described;
    let inputs: Vec<ScanInput<'_>> = described.features[..places.first]
        .iter()
        .zip(&described.surfaces)
        .map(|(features, surface)| ScanInput::new(features, surface))
        .collect();
    let radius_m = described.scale.inlier_radius_m;
    let config = &places.config.registration;
    let mut models: Vec<ScanModel<'_>> =
        inputs.iter().map(|i| ScanModel::new(i.surface, radius_m as f32, config)).collect();
    models.iter_mut().for_each(|model| model.set_borne_out(1.0));
    let verifier = Verifier::new(&models, verification(), radius_m);
    let n = inputs.len();
    let all: Vec<ScanId> = (0..n).map(ScanId).collect();
    let flat = SimilarityMatrix::new(n, vec![0.5; n * n]).unwrap();
    let pairs = PairScorer::new(&inputs, &config.estimator, 0)
        .register(&most_similar_pairs(&flat, &all, n), &verifier, &Silent)
        .unwrap();
    work(&verifier, pairs)
}

/// Two groups of scans of one place, the first with one more scan.
fn beside<'a>(
    verifier: &'a Verifier<'a>,
    pairs: &[ScanPair],
    scan: usize,
    group: &[usize],
    other: &[usize],
) -> Agglomeration<'a> {
    let places = two_places();
    let member = |&k: &usize| (ScanId(k), places.world_from_local[k]);
    let home = group.iter().chain([&scan]).map(member).collect();
    let groups = vec![home, other.iter().map(member).collect()];
    let mut agglomeration = Agglomeration::of_groups(verifier, settings(), places.keypoints(), groups);
    agglomeration.add_pairs(pairs.to_vec());
    agglomeration
}

/// The component that a scan ended in, and the scan's evidence.
fn end_of(agglomeration: Agglomeration<'_>, scan: usize) -> (Vec<(ScanId, RigidMotion)>, Evidence) {
    let found = agglomeration.finish(&Silent).unwrap().into_iter().find_map(|f| {
        let at = f.component.members.iter().position(|m| m.0 == ScanId(scan))?;
        Some((f.component.members, f.member_evidence[at]))
    });
    found.unwrap()
}

#[test]
fn a_scan_that_has_a_better_place_in_another_component_is_stated_to_be_undecided() {
    let places = two_places();
    with_agglomeration(|verifier, pairs| {
        let mut undecided = 0;
        for scan in 0..places.first {
            let others: Vec<usize> = (0..places.first).filter(|&k| k != scan).collect();
            let (a, b) = others.split_at(others.len() / 2);
            let evidence = |group: &[usize], other: &[usize]| {
                end_of(beside(verifier, &pairs, scan, group, other), scan).1
            };
            let [in_a, in_b] = [a, b].map(|group| evidence(group, &[]));
            let (poor, rich, little, much) =
                if in_a.inliers < in_b.inliers { (a, b, in_a, in_b) } else { (b, a, in_b, in_a) };
            // Where either place is one that nobody would doubt without the other.
            if little.probability < Some(0.9) || much.inliers < 2 * little.inliers {
                continue;
            }
            undecided += 1;
            let with_rival = evidence(poor, rich);
            assert!(with_rival.probability <= Some(0.5), "{little:?} {with_rival:?}");
            assert!(
                with_rival.second_best_inliers.abs_diff(much.inliers) * 10 <= much.inliers,
                "{much:?} {with_rival:?}"
            );
            assert_eq!(with_rival.inliers, little.inliers);
            // The other place does not affect the better one, and a lone scan never takes over a scan.
            assert_eq!(evidence(rich, poor), much);
            assert_eq!(evidence(poor, &rich[..1]), little);
        }
        assert!(undecided > 1, "{undecided} scans have a place in either component");
    });
}

#[test]
fn two_halves_join_at_the_true_relative_pose() {
    let places = two_places();
    with_agglomeration(|verifier, pairs| {
        let shifted = RigidMotion::new([2.0, 1.0, -0.5].into(), [0.1, 0.2, 1.0].into());
        let member = |k: usize, frame: &RigidMotion| (ScanId(k), frame * places.world_from_local[k]);
        let half = places.first / 2;
        let a = (0..half).map(|k| member(k, &RigidMotion::identity())).collect();
        let b = (half..places.first).map(|k| member(k, &shifted)).collect();
        let mut agglomeration =
            Agglomeration::of_groups(verifier, settings(), places.keypoints(), vec![a, b]);
        agglomeration.add_pairs(pairs);
        let join = agglomeration.best_join(&Silent).unwrap().unwrap();
        assert!(join.probability() > 0.9, "{}", join.probability());
        agglomeration.join(&join);
        let finished = agglomeration.finish(&Silent).unwrap();
        assert_eq!(finished.len(), 1);
        let members = &finished[0].component.members;
        let frame = members[0].1 * places.world_from_local[members[0].0.0].inverse();
        for (scan, pose) in members {
            let error = PoseError::between(pose, &(frame * places.world_from_local[scan.0]));
            assert!(error.translation_m < 0.05 && error.rotation_deg < 1.0, "{scan} {error:?}");
        }
    });
}

#[test]
fn a_cancelled_assembly_says_where_it_stopped() {
    struct Stop;
    impl Monitor for Stop {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let places = two_places();
    let n = places.world_from_scan.len();
    let similarity = SimilarityMatrix::new(n, vec![0.5; n * n]).unwrap();
    let clock = &mut Stopwatch::default();
    let stopped = pipeline::register_described(&places.described, &similarity, &places.config, &Stop, clock);
    assert!(stopped.unwrap_err().to_string().starts_with("interrupted during registration"));
}

#[test]
fn a_trial_refutes_a_rival_with_more_matches_that_nothing_makes_fit() {
    let places = two_places();
    with_agglomeration(|verifier, mut pairs| {
        let half = places.first / 2;
        // One pair connects the halves, by forty right matches; more agree on a pose 1.2 m off, as in
        // two rooms furnished alike.
        let crossing = |p: &ScanPair| p.i.0 < half && p.j.0 >= half;
        let best = |p: &&ScanPair| p.hypotheses.first().map_or(0, |h| h.evidence.inliers);
        let mut link = pairs.iter().filter(|p| crossing(p)).max_by_key(best).unwrap().clone();
        let right = link.hypotheses[0];
        let wrong = RigidMotion::translation(1.0, 0.6, 0.3) * right.a_from_b;
        let moved = |motion: &RigidMotion, p: &Point| (motion * p.cast::<f64>()).cast::<f32>();
        let [of_i, of_j] = [link.i, link.j].map(|s| &places.described.features[s.0].keypoints);
        let near = |m: &&(u32, u32)| {
            (moved(&right.a_from_b, &of_j[m.1 as usize]) - of_i[m.0 as usize]).norm() < 0.05
        };
        let kept: Vec<(u32, u32)> = link.matches.iter().filter(near).step_by(5).take(40).copied().collect();
        assert_eq!(kept.len(), 40);
        let decoys: Vec<u32> = (0..of_j.len() as u32).step_by(16).take(70).collect();
        let counterparts = decoys.iter().map(|&k| moved(&wrong, &of_j[k as usize]));
        let of_i_and_decoys: Vec<Point> = of_i.iter().copied().chain(counterparts).collect();
        let mut keypoints = places.keypoints();
        keypoints[link.i.0] = &of_i_and_decoys;
        let decoys = (of_i.len() as u32..).zip(decoys);
        link.matches = kept.into_iter().chain(decoys).collect();
        link.hypotheses = vec![ScoredHypothesis { a_from_b: wrong, ..right }, right];
        pairs.retain(|p| !crossing(p));
        pairs.push(link);
        // Errors add up inside the second half, so that the right pose does not fit well either.
        let bent = |k: usize| {
            let k = (k - half) as f64;
            RigidMotion::new([0.14 * k, -0.1 * k, 0.12 * k].into(), [0.0, 0.0, 0.036 * k].into())
        };
        let a = (0..half).map(|k| (ScanId(k), places.world_from_local[k])).collect();
        let b = (half..places.first).map(|k| (ScanId(k), bent(k) * places.world_from_local[k])).collect();
        let mut agglomeration = Agglomeration::of_groups(verifier, settings(), keypoints, vec![a, b]);
        agglomeration.add_pairs(pairs);
        let at_once = agglomeration.best_join(&Silent).unwrap().unwrap();
        assert!(at_once.probability() < 0.95, "{}", agglomeration.describe(&at_once));
        assert!(agglomeration.join_by_trial(&Silent).unwrap());
        let finished = agglomeration.finish(&Silent).unwrap();
        assert_eq!(finished.len(), 1);
        let members = &finished[0].component.members;
        let frame = members[0].1 * places.world_from_local[members[0].0.0].inverse();
        for (scan, pose) in members {
            let error = PoseError::between(pose, &(frame * places.world_from_local[scan.0]));
            assert!(error.translation_m < 0.1 && error.rotation_deg < 2.0, "{scan} {error:?}");
        }
    });
}

#[test]
fn all_trials_that_suffice_are_made_unless_they_share_a_component() {
    let places = two_places();
    with_agglomeration(|verifier, mut pairs| {
        let group = |k: ScanId| k.0 / 2;
        let groups = (0..places.first.div_ceil(2)).map(|g| {
            let scans = (0..places.first).filter(|&k| group(ScanId(k)) == g);
            scans.map(|k| (ScanId(k), places.world_from_local[k])).collect()
        });
        let mut agglomeration =
            Agglomeration::of_groups(verifier, settings(), places.keypoints(), groups.collect());
        // Two independent edges: between groups 0 and 1, and between 2 and 3.
        pairs.retain(|p| group(p.i) / 2 == group(p.j) / 2);
        agglomeration.add_pairs(pairs);
        let best = agglomeration.best_join(&Silent).unwrap().unwrap();
        assert!(agglomeration.join_by_trial(&Silent).unwrap(), "{}", agglomeration.describe(&best));
        assert!(!agglomeration.join_by_trial(&Silent).unwrap());
        let mut sizes: Vec<usize> =
            agglomeration.finish(&Silent).unwrap().iter().map(|f| f.component.members.len()).collect();
        sizes.sort_unstable();
        assert_eq!(sizes, [places.first - 4, 4]);
    });
}

#[test]
fn a_pose_that_reliable_viewpoints_see_through_is_left_undecided_whatever_matches_say() {
    with_agglomeration(|verifier, pairs| {
        let member_evidence = pairs.iter().flat_map(|p| &p.hypotheses).map(|h| h.evidence);
        let best = member_evidence.max_by_key(|s| s.inliers).unwrap();
        let seen_through = |free_space_violation: f64| {
            let mut changed = best;
            changed.inliers = 5000;
            changed.free_space_violation = free_space_violation;
            changed
        };
        let settings = verifier.settings;
        assert!(verifier.probability(&seen_through(0.12)) > 0.95);
        // Matches outweigh the free-space violation by far: only the limit lowers the probability.
        assert!(
            scanweave::registration::probability(
                &seen_through(0.13),
                settings,
                &scanweave::registration::NoiseLevel::USUAL
            ) > 0.95
        );
        assert_eq!(verifier.probability(&seen_through(0.13)), 0.5);
    });
}

/// Joins scan 1 to scan 0 at a certain pose, where scan 2 was compared with scan 0 only; the best
/// evidence between 2 and the two, that between 2 and 0, and that between 2 and the two
/// as measured anew.
fn after_a_newcomer(
    verifier: &Verifier<'_>,
    pairs: &[ScanPair],
    zero_from_one: RigidMotion,
) -> [Option<Evidence>; 3] {
    let places = two_places();
    let pair = |i: usize, j: usize| {
        let found = pairs.iter().find(|p| (p.i.0, p.j.0) == (i, j)).unwrap();
        assert!(!found.hypotheses.is_empty(), "{i} and {j}");
        found.clone()
    };
    let mut joining = pair(0, 1);
    let mut evidence = joining.hypotheses[0].evidence;
    evidence.probability = Some(1.0);
    joining.hypotheses = vec![ScoredHypothesis { a_from_b: zero_from_one, evidence, seen_through: [0.0; 2] }];
    let other = pair(0, 2);
    let alone = |k: usize| vec![(ScanId(k), RigidMotion::identity())];
    let groups = [2, 0, 1].map(alone).to_vec();
    let mut agglomeration = Agglomeration::of_groups(verifier, settings(), places.keypoints(), groups);
    agglomeration.add_pairs(vec![joining, other.clone()]);
    let join = agglomeration.best_join(&Silent).unwrap().unwrap();
    agglomeration.join(&join);
    let best = |agglomeration: &mut Agglomeration<'_>| {
        let found = agglomeration.best_join(&Silent).unwrap();
        found.map(|p| p.evidence())
    };
    let groups = vec![alone(2), vec![(ScanId(0), RigidMotion::identity()), (ScanId(1), zero_from_one)]];
    let mut anew = Agglomeration::of_groups(verifier, settings(), places.keypoints(), groups);
    anew.add_pairs(vec![other.clone()]);
    [best(&mut agglomeration), Some(other.hypotheses[0].evidence), best(&mut anew)]
}

#[test]
fn evidence_is_measured_again_where_a_newcomer_touches_it_and_kept_where_it_cannot() {
    let places = two_places();
    with_agglomeration(|verifier, pairs| {
        let truth = places.world_from_local[0].inverse() * places.world_from_local[1];
        let [known, alone, anew] = after_a_newcomer(verifier, &pairs, truth);
        assert_eq!(known, anew);
        assert_ne!(known, alone);
        // Half a kilometre away nothing that the newcomer brings can touch scan 2.
        let far = RigidMotion::translation(500.0, 0.0, 0.0);
        let [known, alone, _] = after_a_newcomer(verifier, &pairs, far);
        assert_eq!(known, alone);
    });
}

/// Scans alone, of which nothing but pairs is known: `pairs` of two of them each.
fn of_unrelated<T>(scans: usize, pairs: Vec<ScanPair>, work: impl FnOnce(&mut Agglomeration<'_>) -> T) -> T {
    let places = two_places();
    let config = &places.config.registration;
    let surface = &places.described.surfaces[0];
    let models: Vec<ScanModel<'_>> = (0..scans).map(|_| ScanModel::new(surface, 0.07, config)).collect();
    let verifier = Verifier::new(&models, verification(), 0.07);
    let usable: Vec<ScanId> = (0..scans).map(ScanId).collect();
    let mut agglomeration = Agglomeration::new(&verifier, settings(), vec![&[]; scans], &usable);
    agglomeration.add_pairs(pairs);
    work(&mut agglomeration)
}

/// A similarity that says nothing, and the same for both orders of two scans.
fn arbitrary(i: usize, j: usize) -> f32 {
    ((i * j * 7919 + (i + j) * 104_729) % 100_003) as f32 / 100_003.0
}

#[test]
fn a_retrieval_round_takes_the_most_similar_pairs_and_at_no_more_than_were_seen() {
    const N: usize = 30;
    let similarity = SimilarityMatrix::new(N, (0..N * N).map(|k| arbitrary(k / N, k % N)).collect()).unwrap();
    let unrelated = |i: usize, j: usize| ScanPair {
        i: ScanId(i),
        j: ScanId(j),
        matches: Box::default(),
        hypotheses: Vec::new(),
    };
    let seen: Vec<(usize, usize)> = (1..N).flat_map(|j| [(0, j), (j - 1, j)]).skip(1).collect();
    let pairs = || seen.iter().map(|&(i, j)| unrelated(i, j)).collect();
    let unseen = of_unrelated(N, pairs(), |agglomeration| agglomeration.unseen_pairs(&similarity));
    // By how many others that were not seen a scan is more like the one than like the other.
    let rank = |i: usize, j: usize| {
        let others = (0..N).filter(|&k| k != i && !seen.contains(&(i.min(k), i.max(k))));
        others.filter(|&k| arbitrary(i, k) > arbitrary(i, j)).count()
    };
    let of_rank = |most: usize| {
        let all = (0..N).flat_map(|i| (i + 1..N).map(move |j| (i, j))).filter(|p| !seen.contains(p));
        // The first scan is the largest component's, for want of a larger one: it does not choose.
        all.filter(|&(i, j)| (i > 0 && rank(i, j) < most) || rank(j, i) < most).collect::<Vec<_>>()
    };
    let most = (0..N).rev().find(|&most| of_rank(most).len() <= seen.len()).unwrap();
    assert!(most > 0);
    let expected: Vec<(ScanId, ScanId)> =
        of_rank(most).into_iter().map(|(i, j)| (ScanId(i), ScanId(j))).collect();
    assert_eq!(unseen, expected);
}

/// How many pairs of scans were registered at a time.
#[derive(Default)]
struct Rounds(Mutex<Vec<usize>>);

impl Monitor for Rounds {
    fn begin(&self, stage: &str, total: usize) {
        if stage == "pairs" {
            self.0.lock().unwrap().push(total);
        }
    }
}

/// Both places with the `similarity` of two scans; the result and the pairs registered in every round.
fn examined(config: &Config, similarity: impl Fn(usize, usize) -> f32) -> (Reconstruction, Vec<usize>) {
    let places = two_places();
    let n = places.world_from_scan.len();
    let values = (0..n * n).map(|k| similarity(k / n, k % n)).collect();
    let similarity = SimilarityMatrix::new(n, values).unwrap();
    let rounds = Rounds::default();
    let mut clock = Stopwatch::default();
    let r =
        pipeline::register_described(&places.described, &similarity, config, &rounds, &mut clock).unwrap();
    (r, rounds.0.into_inner().unwrap())
}

#[test]
fn a_scan_whose_place_similarity_does_not_know_is_found_by_retrieval_rounds() {
    let places = two_places();
    let (n, lost) = (places.world_from_scan.len(), places.first / 2);
    let order: Vec<usize> = (0..n).collect();
    let same_place = |i: usize, j: usize| (i < places.first) == (j < places.first);
    // The lost scan is like every scan of the other place rather than like one of its own.
    let like = |i: usize, j: usize| match () {
        () if i == j => 1.0,
        () if (i == lost || j == lost) && same_place(i, j) => 0.1,
        () if i == lost || j == lost => 0.2,
        () if same_place(i, j) => 0.9,
        () => 0.3,
    };
    let with = |retrieval_rounds: usize| {
        let mut config = places.config.clone();
        strategy(&mut config).neighbours = 3;
        strategy(&mut config).retrieval_rounds = retrieval_rounds;
        let (r, rounds) = examined(&config, like);
        let own = (0..places.first).filter(|&k| k != lost);
        let errors: Vec<PoseError> = own.filter_map(|k| places.error(&r, &order, k, lost)).collect();
        (errors, rounds)
    };
    let (errors, rounds) = with(0);
    assert!(errors.is_empty() && rounds.len() == 1, "{errors:?} {rounds:?}");
    let (errors, rounds) = with(2);
    assert!(errors.len() + 2 >= places.first, "{errors:?} {rounds:?}");
    assert!(errors.iter().all(|e| e.translation_m < 0.15 && e.rotation_deg < 4.0), "{errors:?}");
    assert!(rounds.len() == 3 && rounds[1] <= rounds[0] && rounds[2] <= rounds[0] + rounds[1], "{rounds:?}");
}

#[test]
fn before_a_retrieval_round_certain_joins_are_made_and_no_others() {
    let places = two_places();
    let n = places.world_from_scan.len();
    let with = |confident: f64| {
        let mut config = places.config.clone();
        strategy(&mut config).neighbours = 6;
        strategy(&mut config).retrieval_rounds = 1;
        surfaces(&mut config).confident = confident;
        examined(&config, arbitrary).1
    };
    let all = n * (n - 1) / 2;
    // Where nothing is certain enough every scan is alone, and compared with all others.
    let rounds = with(1.0);
    assert_eq!(rounds.iter().sum::<usize>(), all, "{rounds:?}");
    // Scans that were joined are compared with those of other components only.
    let rounds = with(0.95);
    let seen = rounds.iter().sum::<usize>();
    assert!(seen + 5 < all, "{rounds:?}, of {all}");
}

#[test]
fn what_no_pair_gives_a_chance_is_not_offered() {
    let places = two_places();
    with_agglomeration(|_, pairs| {
        let most = |p: &&ScanPair| p.hypotheses.first().map_or(0, |h| h.evidence.inliers);
        let pair = pairs.iter().max_by_key(most).unwrap();
        let offered = |probability: f64| {
            let mut evidence = pair.hypotheses[0].evidence;
            evidence.probability = Some(probability);
            let hypotheses = vec![ScoredHypothesis { evidence, ..pair.hypotheses[0] }];
            let doubtful = ScanPair { hypotheses, ..pair.clone() };
            of_unrelated(places.first, vec![doubtful], |agglomeration| {
                agglomeration.best_join(&Silent).unwrap().map(|p| p.probability())
            })
        };
        assert_eq!(offered(0.002), Some(0.002));
        assert_eq!(offered(0.0005), None);
    });
}

#[test]
fn evidence_is_measured_again_where_a_refinement_moved_scans() {
    let places = two_places();
    with_agglomeration(|verifier, pairs| {
        // The last scan alone; the others slightly bent, until they are refined.
        let last = places.first - 1;
        let bent = |k: usize| {
            let k = k as f64;
            RigidMotion::new([0.02 * k, -0.015 * k, 0.02 * k].into(), [0.0, 0.0, 0.006 * k].into())
        };
        let group = (0..last).map(|k| (ScanId(k), bent(k) * places.world_from_local[k])).collect();
        let alone = vec![(ScanId(last), RigidMotion::identity())];
        let with = |groups: Vec<Vec<(ScanId, RigidMotion)>>| {
            let mut agglomeration =
                Agglomeration::of_groups(verifier, settings(), places.keypoints(), groups);
            agglomeration.add_pairs(pairs.clone());
            agglomeration
        };
        let best = |agglomeration: &mut Agglomeration<'_>| {
            agglomeration.best_join(&Silent).unwrap().unwrap().evidence()
        };
        let mut agglomeration = with(vec![group, alone]);
        let before = best(&mut agglomeration);
        agglomeration.refine_all(&Silent).unwrap();
        let after = best(&mut agglomeration);
        let refined =
            agglomeration.finish(&Silent).unwrap().into_iter().map(|f| f.component.members).collect();
        assert_ne!(before, after);
        assert_eq!(after, best(&mut with(refined)));
    });
}
