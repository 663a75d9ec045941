//! Speed of the retrieval stage; run with `--ignored --nocapture` on an idle machine.

use rand::{RngExt, SeedableRng};
use scanweave::Silent;
use scanweave::geometry::Point;
use scanweave::retrieval::{RetrievalConfig, similarity_of};
use scanweave::scan::{Descriptors, Features};
use std::time::Instant;

#[test]
#[ignore = "a measurement"]
fn sixty_scans_take_well_under_two_seconds() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let features: Vec<Features> = (0..60)
        .map(|_| {
            let values = (0..5000 * 33).map(|_| rng.random_range(0.0f32..1.0)).collect();
            let descriptors = Descriptors::new(33, values).unwrap().normalized();
            Features::new(vec![Point::origin(); 5000], None, descriptors).unwrap()
        })
        .collect();
    let start = Instant::now();
    let (s, _) = similarity_of(&features, &RetrievalConfig::default(), None, 1, &Silent).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    println!("60 scans x 5000 x 33, k-means and NetVLAD: {seconds:.2} s");
    assert_eq!(s.len(), 60);
    assert!(seconds < 2.0);
}
