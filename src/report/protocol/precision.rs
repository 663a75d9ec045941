//! Standard deviations of a pose along and about the axes, and in words.

use crate::scan::PoseUncertainty;
use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Vector3};

/// Standard deviations of a pose in the frame of its component.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Deviations {
    /// Of the position of the centre along X, Y, Z, metres.
    pub along_m: [f64; 3],
    /// Of the rotation about X, Y, Z, radians.
    pub about_rad: [f64; 3],
    /// The direction along which the centre is held least, a unit vector, and the deviation along it, metres.
    pub least_held: (Vector3<f64>, f64),
}

impl Deviations {
    /// Of a pose whose covariance is known: that of a rotation vector, then of a displacement.
    pub fn of(uncertainty: Option<&PoseUncertainty>) -> Option<Self> {
        let covariance: Matrix6<f64> = uncertainty?.covariance?;
        // An eigenvalue iteration need not end on numbers that are none.
        if covariance.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let deviation = |at: usize| covariance[(at, at)].max(0.0).sqrt();
        Some(Self {
            along_m: [3, 4, 5].map(deviation),
            about_rad: [0, 1, 2].map(deviation),
            least_held: widest(&covariance.fixed_view::<3, 3>(3, 3).into_owned()),
        })
    }

    /// Whether nothing is uncertain, as the pivot is not relative to itself.
    pub fn is_zero(&self) -> bool {
        self.along_m.iter().chain(&self.about_rad).all(|d| *d == 0.0)
    }

    /// How well each of the six is held, along X, Y, Z and then about X, Y, Z.
    pub fn strengths(&self, inlier_radius_m: f64) -> [Strength; 6] {
        let [x, y, z] = self.along_m.map(|d| Strength::of(d, inlier_radius_m));
        let [a, b, c] = self.about_rad.map(|d| Strength::of(d.to_degrees(), LIMIT_DEG));
        [x, y, z, a, b, c]
    }
}

/// The eigenvector of the largest eigenvalue and the square root of that.
fn widest(covariance: &Matrix3<f64>) -> (Vector3<f64>, f64) {
    let eigen = SymmetricEigen::new(*covariance);
    let at = eigen.eigenvalues.imax();
    let direction = eigen.eigenvectors.column(at).into_owned();
    // An eigenvector has no sign of its own: its largest part is positive.
    let sign = if direction[direction.iamax()] < 0.0 { -1.0 } else { 1.0 };
    (direction * sign, eigen.eigenvalues[at].max(0.0).sqrt())
}

/// Deviation of the rotation above which it counts as not held, degrees: that of `poorly-localised`.
pub(super) const LIMIT_DEG: f64 = 5.0;
/// Share of the limit below which something counts as held.
const HELD: f64 = 0.1;

/// How well a degree of freedom is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Strength {
    Held,
    Weak,
    Free,
}

impl Strength {
    fn of(deviation: f64, limit: f64) -> Self {
        match deviation {
            d if d < HELD * limit => Self::Held,
            d if d <= limit => Self::Weak,
            _ => Self::Free,
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Held => "held",
            Self::Weak => "weakly held",
            Self::Free => "not held",
        }
    }
}

/// The six strengths in words, those alike together, the weakest first.
pub(super) fn in_words(strengths: &[Strength; 6]) -> String {
    if strengths.iter().all(|s| *s == strengths[0]) {
        return format!("all six {}", strengths[0].words());
    }
    let kinds = [Strength::Free, Strength::Weak, Strength::Held];
    let axes = |kind: Strength, what: &str, three: &[Strength]| {
        let alike: Vec<&str> =
            three.iter().zip(["X", "Y", "Z"]).filter(|(s, _)| **s == kind).map(|(_, axis)| axis).collect();
        (!alike.is_empty()).then(|| format!("{what} {}", alike.join(", ")))
    };
    let parts = kinds.into_iter().filter_map(|kind| {
        let both = [axes(kind, "along", &strengths[..3]), axes(kind, "about", &strengths[3..])];
        let both: Vec<String> = both.into_iter().flatten().collect();
        (!both.is_empty()).then(|| format!("{} {}", kind.words(), both.join(" and ")))
    });
    parts.collect::<Vec<_>>().join("; ")
}
