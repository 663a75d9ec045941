//! One generator of random numbers for every item of every purpose.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Counter-based generator for one item of one purpose: the same whatever else was drawn before,
/// so that neither the number of threads nor resuming changes a result.
pub fn generator(seed: u64, purpose: &str, item: u64) -> ChaCha8Rng {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes()).update(purpose.as_bytes());
    let mut rng = ChaCha8Rng::from_seed(*hasher.finalize().as_bytes());
    rng.set_stream(item);
    rng
}
