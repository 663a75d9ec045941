use super::*;
use crate::scan::{
    DeclineReason, Evidence, NeighbourEvidence, Outcome, PairRegistration, PoseEdge, PoseUncertainty,
};

const NAMES: [&str; 4] = ["a", "b", "c", "d"];
const RADIUS_M: f64 = 0.1;

/// `centre` is in the coordinates of the scan, `variances` those of rotation and displacement.
fn placed(
    pose: RigidMotion,
    parent: Option<usize>,
    uncertainty: Option<(Point3<f64>, [f64; 6])>,
) -> Placement {
    let uncertainty = uncertainty.map(|(centre, variances)| {
        Box::new(PoseUncertainty {
            weakest_edge: None,
            covariance: Some(Matrix6::from_diagonal(&Vector6::from(variances))),
            centre: Some(centre),
        })
    });
    Placement {
        world_from_scan: pose,
        component: 0,
        step: usize::from(parent.is_some()),
        parent: parent.map(ScanId),
        matches: 0,
        inliers: 0,
        residual_m: 0.0,
        evidence: None,
        neighbours: Vec::new(),
        pose_uncertainty: uncertainty,
    }
}

fn graph(placements: Vec<Placement>) -> PoseGraphFile {
    let outcomes = placements.into_iter().map(Outcome::Placed).collect();
    pose_graph_of_component(&NAMES, &Reconstruction { outcomes }, None, 0, RADIUS_M)
}

fn assert_near(found: &Matrix6<f64>, expected: &Matrix6<f64>) {
    let scale = expected.amax();
    assert!((found - expected).amax() < 1e-9 * scale, "{found} {expected}");
}

#[test]
fn an_edge_to_the_pivot_has_the_inverse_covariance_in_the_frame_of_the_source() {
    // A quarter turn about z takes the source's x to the world's y: its variance along x is the world's
    // along y. The pivot is certain.
    let turn = Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
    let pose = RigidMotion::new(Vector3::new(5.0, -3.0, 1.0), turn);
    let pivot = placed(RigidMotion::identity(), None, Some((Point3::origin(), [0.0; 6])));
    let scan = placed(pose, Some(0), Some((Point3::origin(), [0.1, 0.2, 0.4, 0.01, 0.02, 0.04])));
    let graph = graph(vec![pivot, scan]);
    assert_eq!((graph.nodes.len(), graph.pivot, graph.edges.len()), (2, 0, 1));
    let edge = &graph.edges[0];
    assert_eq!((edge.i, edge.j, edge.uncertain), (0, 1, false));
    assert!((edge.i_from_j.to_homogeneous() - pose.to_homogeneous()).amax() < 1e-12);
    let expected = Matrix6::from_diagonal(&Vector6::new(5.0, 10.0, 2.5, 50.0, 100.0, 25.0));
    assert_near(&edge.information, &expected);
}

#[test]
fn covariances_add_and_turns_of_the_target_move_the_source() {
    // Neither is the pivot. The centre of j lies 2 m along x from that of i, so that a turn of i about z
    // by θ moves it along y by 2 θ: var(y) = 0.02 + 0.02 + 4·0.001, cov(θz, y) = 2·0.001.
    let at = |x: f64| RigidMotion::translation(x, 0.0, 0.0);
    let variances = [0.001, 0.001, 0.001, 0.02, 0.02, 0.02];
    let pivot = placed(at(9.0), None, Some((Point3::origin(), [0.0; 6])));
    let i = placed(at(1.0), Some(0), Some((Point3::origin(), variances)));
    let j = placed(at(3.0), Some(1), Some((Point3::origin(), variances)));
    let graph = graph(vec![pivot, i, j]);
    let edge = graph.edges.iter().find(|e| (e.i, e.j) == (1, 2)).unwrap();
    let mut covariance = Matrix6::from_diagonal(&Vector6::new(0.002, 0.002, 0.002, 0.04, 0.044, 0.044));
    // A turn of i about y moves it along −z.
    for (r, c, v) in [(2, 4, 0.002), (1, 5, -0.002)] {
        (covariance[(r, c)], covariance[(c, r)]) = (v, v);
    }
    assert_near(&edge.information, &covariance.try_inverse().unwrap());
}

#[test]
fn information_is_about_the_zero_of_the_source_file() {
    // Centre at (0, 0, 10): a turn about x by θ with the zero held moves the centre along −y by 10 θ,
    // which the information of the centre's place resists.
    let pivot = placed(RigidMotion::identity(), None, Some((Point3::origin(), [0.0; 6])));
    let centre = Point3::new(0.0, 0.0, 10.0);
    let scan = placed(RigidMotion::identity(), Some(0), Some((centre, [0.5, 0.5, 0.5, 0.01, 0.01, 0.01])));
    let information = graph(vec![pivot, scan]).edges[0].information;
    let weight = |e: Vector6<f64>| e.dot(&(information * e));
    // θ = (1, 0, 0): 1/0.5 + 10²/0.01. With t = (0, 10, 0) the centre stays where it is.
    assert!((weight(Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)) - 10_002.0).abs() < 1e-6);
    assert!((weight(Vector6::new(1.0, 0.0, 0.0, 0.0, 10.0, 0.0)) - 2.0).abs() < 1e-6);
    assert!((weight(Vector6::new(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)) - 2.0).abs() < 1e-6);
}

#[test]
fn a_measurement_that_the_result_contradicts_counts_less() {
    // Measured 1 m, the result says 1.3 m along x: variance 0.01 + 0.3² along x, 0.01 elsewhere.
    let pivot = placed(RigidMotion::identity(), None, Some((Point3::origin(), [0.0; 6])));
    let mut scan =
        placed(RigidMotion::translation(1.3, 0.0, 0.0), Some(0), Some((Point3::origin(), [0.01; 6])));
    let parent_from_scan = Some(RigidMotion::translation(1.0, 0.0, 0.0));
    scan.evidence = Some(Evidence { parent_from_scan, ..Evidence::default() });
    let graph = graph(vec![pivot, scan]);
    let edge = &graph.edges[0];
    assert_eq!(edge.i_from_j.translation.vector, Vector3::new(1.0, 0.0, 0.0));
    let expected = Matrix6::from_diagonal(&Vector6::new(100.0, 100.0, 100.0, 10.0, 100.0, 100.0));
    assert_near(&edge.information, &expected);
}

#[test]
fn touching_scans_are_joined_once_as_uncertain_and_the_unknown_has_wide_deviations() {
    let at = |x: f64| RigidMotion::translation(x, 0.0, 0.0);
    let touch = |scan: usize| NeighbourEvidence {
        scan: ScanId(scan),
        overlap: 0.5,
        residual_m: 0.01,
        plane_distance_m: None,
    };
    let mut placements =
        vec![placed(at(0.0), None, None), placed(at(1.0), Some(0), None), placed(at(2.0), Some(1), None)];
    placements[0].neighbours = vec![touch(1), touch(2)];
    placements[2].neighbours = vec![touch(0), touch(1)];
    let mut outcomes: Vec<Outcome> = placements.into_iter().map(Outcome::Placed).collect();
    outcomes.insert(1, Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 }));
    // The declined scan takes the number 1, so that the others move up.
    for outcome in &mut outcomes {
        let Outcome::Placed(p) = outcome else { continue };
        let up = |s: ScanId| if s.0 > 0 { ScanId(s.0 + 1) } else { s };
        p.parent = p.parent.map(up);
        p.neighbours.iter_mut().for_each(|n| n.scan = up(n.scan));
    }
    let graph = pose_graph_of_component(&NAMES, &Reconstruction { outcomes }, None, 0, RADIUS_M);
    let ids: Vec<(usize, &str)> = graph.nodes.iter().map(|n| (n.id.0, n.name.as_str())).collect();
    assert_eq!(ids, [(0, "a"), (2, "c"), (3, "d")]);
    let mut edges: Vec<_> = graph.edges.iter().map(|e| (e.i.min(e.j), e.i.max(e.j), e.uncertain)).collect();
    edges.sort_unstable();
    assert_eq!(edges, [(0, 1, false), (0, 2, true), (1, 2, false)]);
    let five = 5.0 * std::f64::consts::PI / 180.0;
    let (turn, place) = (1.0 / (five * five), 1.0 / (RADIUS_M * RADIUS_M));
    let expected = Matrix6::from_diagonal(&Vector6::new(turn, turn, turn, place, place, place));
    graph.edges.iter().for_each(|e| assert_near(&e.information, &expected));
    let closing = graph.edges.iter().find(|e| e.uncertain).unwrap();
    let target_from_source = closing.i_from_j.translation.vector.x;
    assert_eq!(target_from_source, if closing.i < closing.j { 2.0 } else { -2.0 });
}

#[test]
fn registered_pairs_are_the_edges_of_a_global_method() {
    let at = |x: f64| RigidMotion::translation(x, 0.0, 0.0);
    let outcomes =
        [placed(at(0.0), None, None), placed(at(1.0), Some(0), None), placed(at(2.0), Some(1), None)];
    let pair = |i: usize, j: usize, x: f64, inliers: usize| PoseEdge {
        i: ScanId(i),
        j: ScanId(j),
        pair: PairRegistration { target_from_source: at(x), inliers, ..PairRegistration::default() },
        similarity: 0.5,
    };
    let registered = PoseGraph {
        scans: 3,
        inlier_radius_m: RADIUS_M,
        edges: vec![pair(0, 1, 1.0, 9), pair(1, 2, 1.0, 9), pair(0, 2, 2.5, 4), pair(2, 1, 0.0, 0)],
        without_edges: Vec::new(),
        registered_pairs: 4,
        registration_seconds: 0.0,
        reused_seconds: 0.0,
    };
    let reconstruction = Reconstruction { outcomes: outcomes.map(Outcome::Placed).into() };
    let graph = pose_graph_of_component(&NAMES, &reconstruction, Some(&registered), 0, RADIUS_M);
    let edges: Vec<_> =
        graph.edges.iter().map(|e| (e.i, e.j, e.i_from_j.translation.vector.x, e.uncertain)).collect();
    assert_eq!(edges, [(0, 1, 1.0, true), (0, 2, 2.5, true), (1, 2, 1.0, true)]);
    // The pair that is off by half a metre: 1/(0.1² + 0.5²) along x.
    let along = graph.edges[1].information[(3, 3)];
    assert!((along - 1.0 / 0.26).abs() < 1e-9, "{along}");
}

#[test]
fn turned_edges_agree_with_drawn_motions() {
    // First-order propagation against differences of the relative pose itself: with poses moved by small
    // known motions of both scans, the error that the information weighs must be what moved them.
    let turn = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
    let poses = [
        RigidMotion::new(turn(2.0, -1.0, 0.5), turn(0.3, -0.2, 0.9)),
        RigidMotion::new(turn(-4.0, 3.0, 1.5), turn(-0.5, 0.8, 0.1)),
    ];
    let centres = [Point3::new(1.0, 2.0, 3.0), Point3::new(-2.0, 0.5, 1.0)];
    // One direction of motion for each scan, of tiny variance elsewhere: the covariance is nearly v·vᵀ.
    let motions =
        [Vector6::new(0.3, -0.1, 0.2, 0.5, 0.4, -0.2), Vector6::new(-0.2, 0.4, 0.1, -0.3, 0.2, 0.6)];
    let placements = [0, 1].map(|k| {
        let mut p = placed(poses[k], Some(1 - k), Some((centres[k], [0.0; 6])));
        let covariance = motions[k] * motions[k].transpose() + Matrix6::identity() * 1e-9;
        p.pose_uncertainty.as_mut().unwrap().covariance = Some(covariance);
        p
    });
    let found = relative_covariance(&placements[0], &placements[1]).unwrap();
    let step = 1e-6;
    let moved = |k: usize| {
        let (theta, d) = (motions[k].fixed_rows::<3>(0) * step, motions[k].fixed_rows::<3>(3) * step);
        let centre = poses[k] * centres[k];
        let about = RigidMotion::new(d + centre.coords, theta)
            * RigidMotion::translation(-centre.x, -centre.y, -centre.z);
        about * poses[k]
    };
    let relative = poses[0].inverse() * poses[1];
    let mut expected = Matrix6::identity() * 0.0;
    for other in [moved(0).inverse() * poses[1], poses[0].inverse() * moved(1)] {
        let error = relative.inverse() * other;
        let e = stacked(&error.rotation.scaled_axis(), &(error * centres[1] - centres[1])) / step;
        expected += e * e.transpose();
    }
    assert!((found - expected).amax() < 1e-4, "{found} {expected}");
}
