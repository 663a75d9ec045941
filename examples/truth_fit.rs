//! How well scans fit each other at their published poses: a bound on the evidence of surfaces.
//!
//! Usage: `cargo run --release --example truth_fit -- [--pairs] SCENE…`
//!
//! Each SCENE is a folder of scans with true poses. For the pairs of either benchmark (true overlap over
//! 0.3, and over 0.1 up to 0.3) it prints the median share of touching points whose normals agree, the
//! median distance to tangent planes in units of τ, the median share of points in space that the other
//! scan saw to be empty, and how many pairs exceed the limit of free-space violation: more than an eighth
//! of their points in such space, which the registration takes as proof that a pose is wrong. `--pairs`
//! lists every pair.

use rayon::prelude::*;
use scanweave::Silent;
use scanweave::config::Config;
use scanweave::evaluation::{LO_MATCH_OVERLAP, MATCH_OVERLAP, benchmark_pairs, overlap_matrix};
use scanweave::geometry::{Point, RigidMotion};
use scanweave::registration::MOST_VIOLATION_OF_CORRECT;
use scanweave::registration::ScanModel;
use scanweave::registration::{Posed, SurfaceFit, surface_fit};
use scanweave::scan::{PointCloud, Surface};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let (mut list, mut folders) = (false, Vec::new());
    for argument in std::env::args().skip(1) {
        match argument.as_str() {
            "--pairs" => list = true,
            _ => folders.push(argument),
        }
    }
    println!(
        "| scene | overlap | pairs | normals that agree | off the planes, τ | in empty space | contradictory |"
    );
    println!("|---|---|--:|--:|--:|--:|--:|");
    folders.iter().try_for_each(|folder| scene(folder, list))
}

fn scene(folder: &str, list: bool) -> Result<(), Failure> {
    let scene = scanweave::io::read_scene(folder)?;
    let truth = scene.world_from_scan.ok_or_else(|| format!("{folder}: no true poses"))?.value;
    let scans = scanweave::io::read_scans(&scene.scans, &Silent)?;
    let config = Config::default();
    let clouds: Vec<&PointCloud> = scans.iter().map(|s| &s.cloud).collect();
    let lengths = scanweave::preprocessing::choose_scale(&config.scale, &clouds)?.scale;
    let surfaces: Vec<Surface> =
        clouds.par_iter().map(|c| scanweave::preprocessing::thin(c, &lengths)).collect();
    let radius_m = lengths.inlier_radius_m as f32;
    let mut models: Vec<ScanModel<'_>> =
        surfaces.par_iter().map(|s| ScanModel::new(s, radius_m, &config.registration)).collect();
    models.iter_mut().for_each(|model| model.set_borne_out(1.0));
    let points: Vec<&[Point]> = surfaces.iter().map(|s| s.points.as_slice()).collect();
    let overlap = overlap_matrix(&points, &truth, radius_m)?;
    for (name, range) in [("over 0.3", MATCH_OVERLAP), ("0.1 to 0.3", LO_MATCH_OVERLAP)] {
        let pairs = benchmark_pairs(&overlap, &range);
        let fit = |&(i, j): &(scanweave::scan::ScanId, scanweave::scan::ScanId)| {
            let still = RigidMotion::identity();
            let [a, b] = [i, j].map(|s| [Posed { model: &models[s.0], group_from_scan: still }]);
            surface_fit(&a, &b, &(truth[i.0].inverse() * truth[j.0]), 1)
        };
        let fits: Vec<SurfaceFit> = pairs.par_iter().map(fit).collect();
        let median = |of: fn(&SurfaceFit) -> f64| {
            let mut values: Vec<f64> = fits.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
        };
        println!(
            "| {} | {name} | {} | {:.2} | {:.2} | {:.3} | {} |",
            scene.name,
            pairs.len(),
            median(|f| f.normal_agreement),
            median(|f| f.plane_residual),
            median(|f| f.free_space_violation),
            fits.iter().filter(|f| f.free_space_violation > MOST_VIOLATION_OF_CORRECT).count()
        );
        for ((i, j), f) in pairs.iter().zip(&fits).filter(|_| list) {
            println!(
                "|   {i}, {j} | {:.2} | | {:.2} | {:.2} | {:.3} | |",
                overlap.get(i.0, j.0),
                f.normal_agreement,
                f.plane_residual,
                f.free_space_violation
            );
        }
    }
    Ok(())
}
