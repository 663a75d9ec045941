//! The weights of the verifier that come with the program.

use super::config::EvidenceWeights;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// What `scanweave train verifier` wrote, in the repository's `checkpoints/`.
const FILE: &str = include_str!("../../../../../checkpoints/verifier.json");

/// What a program needs of the file. Not [`EvidenceWeights`], whose defaults come from here.
#[derive(Deserialize)]
struct Verifier {
    format: String,
    version: u32,
    weights: BTreeMap<String, f64>,
}

/// The weights in the text of a verifier of version 1; `None` where it is none.
fn parse(text: &str) -> Option<EvidenceWeights> {
    let verifier: Verifier = serde_json::from_str(text).ok()?;
    if (verifier.format.as_str(), verifier.version) != ("scanweave-verifier", 1) {
        return None;
    }
    let mut weights = [0.0; EvidenceWeights::NAMES.len()];
    for (weight, name) in weights.iter_mut().zip(EvidenceWeights::NAMES) {
        *weight = *verifier.weights.get(name)?;
    }
    (verifier.weights.len() == weights.len()).then(|| EvidenceWeights::from_array(weights))
}

/// The shipped weights. A program that was built from a whole file has them; otherwise every pose would
/// be undecided.
pub fn weights() -> EvidenceWeights {
    static WEIGHTS: LazyLock<EvidenceWeights> = LazyLock::new(|| {
        parse(FILE).unwrap_or_else(|| EvidenceWeights::from_array([0.0; EvidenceWeights::NAMES.len()]))
    });
    WEIGHTS.clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_weights_are_read_and_have_the_signs_of_their_meaning() {
        let weights = parse(FILE).unwrap();
        assert_eq!(weights, EvidenceWeights::default());
        for ((weight, sign), name) in
            weights.as_array().into_iter().zip(EvidenceWeights::SIGNS).zip(EvidenceWeights::NAMES)
        {
            assert!(weight.is_finite() && (sign == 0.0 || weight * sign > 0.0), "{name}: {weight}");
        }
        // Names are those of the settings.
        let by_name = serde_json::to_value(&weights).unwrap();
        for (name, weight) in EvidenceWeights::NAMES.into_iter().zip(weights.as_array()) {
            assert_eq!(by_name[name].as_f64(), Some(weight), "{name}");
        }
    }

    #[test]
    fn what_is_not_a_verifier_of_this_version_is_refused() {
        let text = |format: &str, version: u32, names: &[&str]| {
            let weights: BTreeMap<&str, f64> = names.iter().map(|n| (*n, 0.5)).collect();
            serde_json::json!({ "format": format, "version": version, "weights": weights }).to_string()
        };
        let names = EvidenceWeights::NAMES;
        let read = parse(&text("scanweave-verifier", 1, &names));
        assert_eq!(read, Some(EvidenceWeights::from_array([0.5; 10])));
        assert_eq!(parse(&text("scanweave-verifier", 2, &names)), None);
        assert_eq!(parse(&text("another", 1, &names)), None);
        assert_eq!(parse(&text("scanweave-verifier", 1, &names[1..])), None);
        assert_eq!(parse(&text("scanweave-verifier", 1, &[&names[..], &["more"]].concat())), None);
    }
}
