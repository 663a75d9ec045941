//! Reliability of stated probabilities: placed scans by stated probability, and the share of them
//! that is right.

use serde::Serialize;

/// Bins of equal width that probabilities are sorted into.
pub const BINS: usize = 10;

/// Placed scans of a method whose probability was stated, with the truth about them.
///
/// A scan is wrongly placed when it went wrong itself ([`crate::evaluation::diagnosis`]); one that
/// was carried along by another stands right beside its neighbours.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reliability {
    /// Placed scans, all scenes and seeds.
    pub placed: usize,
    /// Those that went wrong themselves.
    pub wrong: usize,
    /// Expected calibration error: the difference between stated probability and share of right
    /// ones in each bin, averaged over the scans (Naeini, Cooper & Hauskrecht 2015).
    pub calibration_error: f64,
    /// By bins of equal width from 0 to 1.
    pub bins: Vec<Bin>,
}

/// Scans whose stated probability lies in one bin.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Bin {
    /// How many.
    pub scans: usize,
    /// Their mean stated probability.
    pub stated: f64,
    /// Share of them that is right.
    pub right: f64,
}

impl Reliability {
    /// Of stated probabilities, each with whether it came true; `None` without any.
    pub fn new(judged: impl Iterator<Item = (f64, bool)>) -> Option<Self> {
        let mut sums = vec![(0usize, 0.0f64, 0usize); BINS];
        for (stated, right) in judged {
            let bin = ((stated * BINS as f64) as usize).min(BINS - 1);
            sums[bin].0 += 1;
            sums[bin].1 += stated;
            sums[bin].2 += usize::from(right);
        }
        let placed: usize = sums.iter().map(|s| s.0).sum();
        if placed == 0 {
            return None;
        }
        let right: usize = sums.iter().map(|s| s.2).sum();
        let apart: f64 = sums.iter().map(|&(_, stated, right)| (stated - right as f64).abs()).sum();
        let bin = |&(scans, stated, right): &(usize, f64, usize)| {
            let n = scans.max(1) as f64;
            Bin { scans, stated: stated / n, right: right as f64 / n }
        };
        Some(Self {
            placed,
            wrong: placed - right,
            calibration_error: apart / placed as f64,
            bins: sums.iter().map(bin).collect(),
        })
    }

    /// Share of the placed scans that went wrong themselves.
    pub fn wrong_share(&self) -> f64 {
        self.wrong as f64 / self.placed as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn the_calibration_error_is_its_closed_form() {
        // Eight scans at 0.95, six of them right; two at 0.6, both right; one at 1, right.
        let judged = [(0.95, 8, 6), (0.6, 2, 2), (1.0, 1, 1)];
        let all = judged.iter().flat_map(|&(p, n, right)| (0..n).map(move |k| (p, k < right)));
        let r = Reliability::new(all).unwrap();
        assert_eq!((r.placed, r.wrong), (11, 2));
        // 0.95 and 1 share the last bin: |7.6 + 1 − 7|; 0.6 is |1.2 − 2|.
        assert_relative_eq!(r.calibration_error, (1.6 + 0.8) / 11.0, epsilon = 1e-12);
        assert_relative_eq!(r.bins[9].stated, 8.6 / 9.0, epsilon = 1e-12);
        assert_relative_eq!(r.bins[9].right, 7.0 / 9.0, epsilon = 1e-12);
        assert_eq!((r.bins[6].scans, r.bins[0].scans), (2, 0));
        assert_relative_eq!(r.wrong_share(), 2.0 / 11.0, epsilon = 1e-12);
        assert_eq!(Reliability::new(std::iter::empty()), None);
    }
}
