//! The working scale: every length the method needs, read off the scans themselves.
//!
//! The lengths are fixed multiples of one voxel size. The voxel is the one at which the
//! median scan occupies [`ScaleConfig::target_points`] cells, but no finer than the
//! sampling of the scans: at most two thirds of a scan's points may get a cell of their
//! own. A 25 cm object, a kitchen and a 50 m facade thus meet the same algorithm.

use crate::error::{Error, Result};
use crate::geometry::Point;
use crate::geometry::occupancy::{distinct_positions, size_for_occupancy};
use crate::scan::strays::middle_and_size;
use crate::scan::{PointCloud, WorkingScale, length, rounded};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Share of a scan's distinct points that may occupy a voxel of their own. Two thirds make
/// a scan that was thinned by a grid of some size come out at about that size.
const LARGEST_OCCUPANCY: f64 = 2.0 / 3.0;
/// Ratio of a scan's extent to the median one beyond which its unit is in doubt.
const OFF_SCALE_RATIO: f64 = 10.0;

/// Lengths to use instead of those read off the scans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct ScaleConfig {
    /// Voxel size, metres; the other lengths follow it unless given themselves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voxel_m: Option<f64>,
    /// Radius of the neighbourhood for normals, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_radius_m: Option<f64>,
    /// Radius of the neighbourhood of a local descriptor, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feature_radius_m: Option<f64>,
    /// Inlier radius τ, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inlier_radius_m: Option<f64>,
    /// Points that the median scan keeps after thinning.
    pub target_points: usize,
}

impl Default for ScaleConfig {
    fn default() -> Self {
        Self {
            voxel_m: None,
            normal_radius_m: None,
            feature_radius_m: None,
            inlier_radius_m: None,
            target_points: 20_000,
        }
    }
}

impl ScaleConfig {
    /// Checks the given lengths.
    ///
    /// # Errors
    /// [`Error::Setting`] for a length that is not positive and finite, or a target below 100.
    pub fn validate(&self) -> Result<()> {
        let lengths = [
            ("scale.voxel_m", self.voxel_m),
            ("scale.normal_radius_m", self.normal_radius_m),
            ("scale.feature_radius_m", self.feature_radius_m),
            ("scale.inlier_radius_m", self.inlier_radius_m),
        ];
        for (key, value) in lengths {
            if let Some(v) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
                return Err(Error::setting(
                    key,
                    v.to_string(),
                    "a positive length in metres",
                    "correct it or leave it out to have it chosen from the scans",
                ));
            }
        }
        if self.target_points < 100 {
            return Err(Error::setting(
                "scale.target_points",
                self.target_points.to_string(),
                "at least 100",
                "leave it out for the default of 20000",
            ));
        }
        Ok(())
    }
}

/// A scan whose size does not go with the others.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "warning", rename_all = "kebab-case")]
pub enum ScaleWarning {
    /// Its extent is more than ten times off the median one: probably another unit.
    OffScale {
        /// Place in the list of clouds.
        scan: usize,
        /// Median distance of its points from their middle, metres.
        extent_m: f64,
        /// The same for the median scan, metres.
        median_extent_m: f64,
    },
    /// It has no point, or all of its points are at one place.
    NoExtent {
        /// Place in the list of clouds.
        scan: usize,
        /// Its points.
        points: usize,
    },
}

impl std::fmt::Display for ScaleWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ScaleWarning::OffScale { extent_m, median_extent_m, .. } => write!(
                f,
                "its size is about {}, that of the median scan {}; check that its unit is the metre",
                length(2.0 * extent_m),
                length(2.0 * median_extent_m)
            ),
            ScaleWarning::NoExtent { points, .. } => {
                write!(f, "all of its {points} points are at one place; it does not count for the scale")
            }
        }
    }
}

/// The chosen scale and the scans it may not suit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScaleChoice {
    /// The lengths.
    pub scale: WorkingScale,
    /// Scans that stand out, in input order.
    pub warnings: Vec<ScaleWarning>,
}

/// Size of one scan.
#[derive(Debug, Clone, Copy)]
struct OwnScale {
    extent_m: f64,
    voxel_m: f64,
}

/// Chooses the working scale of a set of scans.
///
/// The voxel is the lower median of the scans' own voxels, rounded to two digits: a scan
/// in another unit, or one of no extent, does not move it. Given lengths are taken as they
/// are, and a given voxel size carries the lengths that are not given with it.
///
/// # Errors
/// [`Error::Setting`] when `config` is unusable; [`Error::Input`] when no scan has an extent.
pub fn choose(config: &ScaleConfig, clouds: &[&PointCloud]) -> Result<ScaleChoice> {
    config.validate()?;
    let own: Vec<Option<OwnScale>> =
        clouds.par_iter().map(|c| own_scale(&c.points, config.target_points)).collect();
    let voxel_m = match (config.voxel_m, lower_median(own.iter().flatten().map(|o| o.voxel_m))) {
        (Some(given), _) => given,
        (None, Some(median)) => rounded(median, 2),
        (None, None) => return Err(no_extent(clouds)),
    };
    let default = WorkingScale::from_voxel(voxel_m);
    let scale = WorkingScale {
        voxel_m,
        normal_radius_m: config.normal_radius_m.unwrap_or(default.normal_radius_m),
        feature_radius_m: config.feature_radius_m.unwrap_or(default.feature_radius_m),
        inlier_radius_m: config.inlier_radius_m.unwrap_or(default.inlier_radius_m),
    };
    Ok(ScaleChoice { scale, warnings: warnings(clouds, &own) })
}

fn no_extent(clouds: &[&PointCloud]) -> Error {
    let points: usize = clouds.iter().map(|c| c.len()).sum();
    Error::input(
        "scans",
        format!("{points} points in {} scans, in every scan all at one place", clouds.len()),
        "at least one scan whose points spread over some distance",
        "check that the files hold coordinates, or set scale.voxel_m",
    )
}

fn warnings(clouds: &[&PointCloud], own: &[Option<OwnScale>]) -> Vec<ScaleWarning> {
    let median = lower_median(own.iter().flatten().map(|o| o.extent_m));
    let mut found = Vec::new();
    for (scan, own) in own.iter().enumerate() {
        match (own, median) {
            (None, _) => found.push(ScaleWarning::NoExtent { scan, points: clouds[scan].len() }),
            (Some(o), Some(median_extent_m)) => {
                let ratio = o.extent_m / median_extent_m;
                if !(1.0 / OFF_SCALE_RATIO..=OFF_SCALE_RATIO).contains(&ratio) {
                    found.push(ScaleWarning::OffScale { scan, extent_m: o.extent_m, median_extent_m });
                }
            }
            (Some(_), None) => {}
        }
    }
    found
}

/// Extent and voxel size of one scan alone; `None` when its points are all at one place.
fn own_scale(points: &[Point], target: usize) -> Option<OwnScale> {
    // A size that stray points do not move.
    let (_, extent_m) = middle_and_size(points)?;
    let most = LARGEST_OCCUPANCY * distinct_positions(points) as f64;
    let cells = (target as f64).min(most).max(1.0);
    // A flat patch of that extent filled by that many cells is a fair first guess.
    let voxel_m = size_for_occupancy(points, cells as usize, 2.0 * extent_m / cells.sqrt());
    Some(OwnScale { extent_m, voxel_m })
}

fn lower_median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ErrorKind;

    /// A flat square of `n × n` points.
    fn sheet(n: usize, spacing: f32, shift: f32) -> PointCloud {
        let at = |i: usize| shift + (i as f32 + 0.5) * spacing;
        PointCloud::from_points((0..n * n).map(|i| Point::new(at(i % n), at(i / n), shift)).collect())
    }

    fn chosen(clouds: &[PointCloud]) -> ScaleChoice {
        choose(&ScaleConfig::default(), &clouds.iter().collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn a_dense_sheet_is_thinned_to_the_target() {
        // 500 × 500 points over 5 m × 5 m in 20000 cells: 5/√20000 = 3.5 cm.
        let choice = chosen(&[sheet(500, 0.01, 0.0)]);
        assert!((choice.scale.voxel_m - 0.0354).abs() < 0.0015, "{}", choice.scale);
        assert!((choice.scale.inlier_radius_m - 2.8 * choice.scale.voxel_m).abs() < 1e-12);
        assert!(choice.warnings.is_empty());
    }

    #[test]
    fn a_sparse_sheet_keeps_about_its_own_sampling() {
        // 60 × 60 points 1 cm apart, at most 2400 cells: 60 cm / √2400 = 1.22 cm.
        let choice = chosen(&[sheet(60, 0.01, 0.0)]);
        assert!((choice.scale.voxel_m - 0.0122).abs() < 0.001, "{}", choice.scale);
    }

    #[test]
    fn the_scale_follows_the_unit() {
        for factor in [1e-3, 1.0, 200.0] {
            let choice = chosen(&[sheet(500, 0.01 * factor, 0.0)]);
            assert!((choice.scale.voxel_m / f64::from(factor) / 0.0354 - 1.0).abs() < 0.05);
        }
    }

    #[test]
    fn stray_points_and_repeated_points_do_not_move_it() {
        let clean = chosen(&[sheet(300, 0.01, 0.0)]).scale;
        let mut dirty = sheet(300, 0.01, 0.0);
        dirty.points.extend((1..20).map(|i| Point::new(1e5 * i as f32, -3e6, 7.0)));
        assert_eq!(chosen(&[dirty]).scale, clean);
        // A cloud that holds every point twice is not sampled any finer.
        let once = sheet(60, 0.01, 0.0);
        let mut twice = once.clone();
        twice.points.extend(once.points.clone());
        assert_eq!(chosen(&[twice]).scale, chosen(&[once]).scale);
        // More than half of the rows are "no reading" at the origin.
        let mut zeros = sheet(300, 0.01, 0.0);
        zeros.points.extend(vec![Point::origin(); 100_000]);
        let ratio = chosen(&[zeros]).scale.voxel_m / clean.voxel_m;
        assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
    }

    #[test]
    fn a_scan_in_another_unit_is_reported_and_outvoted() {
        let clouds =
            [sheet(300, 0.01, 0.0), sheet(300, 10.0, 0.0), sheet(310, 0.01, 2.0), sheet(290, 0.01, -1.0)];
        let choice = chosen(&clouds);
        assert!((choice.scale.voxel_m - 0.0212).abs() < 0.002, "{}", choice.scale);
        let [ScaleWarning::OffScale { scan: 1, extent_m, median_extent_m }] = choice.warnings[..] else {
            panic!("{:?}", choice.warnings)
        };
        assert!((extent_m / median_extent_m - 1000.0).abs() < 50.0);
        assert!(choice.warnings[0].to_string().contains("unit is the metre"));
    }

    #[test]
    fn points_at_one_place_are_no_scale() {
        let dot = PointCloud::from_points(vec![Point::new(1.0, 2.0, 3.0); 1000]);
        let error = choose(&ScaleConfig::default(), &[&dot, &dot]).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains("2000 points in 2 scans"), "{error}");
        let choice = chosen(&[dot, sheet(100, 0.01, 0.0), PointCloud::default()]);
        let expected =
            [ScaleWarning::NoExtent { scan: 0, points: 1000 }, ScaleWarning::NoExtent { scan: 2, points: 0 }];
        assert_eq!(choice.warnings, expected);
        assert!(choose(&ScaleConfig::default(), &[]).is_err());
    }

    #[test]
    fn given_lengths_are_kept_and_carry_the_others() {
        let config = ScaleConfig { voxel_m: Some(0.5), inlier_radius_m: Some(0.9), ..ScaleConfig::default() };
        let scale = choose(&config, &[&sheet(100, 0.01, 0.0)]).unwrap().scale;
        assert_eq!((scale.voxel_m, scale.inlier_radius_m), (0.5, 0.9));
        assert_eq!(scale.normal_radius_m, 5.0 * 0.5);
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let config = ScaleConfig { feature_radius_m: Some(bad), ..ScaleConfig::default() };
            let error = choose(&config, &[&sheet(100, 0.01, 0.0)]).unwrap_err();
            assert!(error.to_string().starts_with("scale.feature_radius_m: found"), "{error}");
        }
    }

    #[test]
    fn lengths_are_printed_with_their_units() {
        let scale = WorkingScale {
            voxel_m: 0.025,
            normal_radius_m: 0.0012345,
            feature_radius_m: 12.0,
            inlier_radius_m: 0.07,
        };
        assert_eq!(
            scale.to_string(),
            "voxel 2.5 cm, normal radius 1.23 mm, feature radius 12 m, inlier radius 7 cm"
        );
    }
}
