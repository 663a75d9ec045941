//! How well presumed viewpoints go with scans whose poses are known: do the normals of overlapping
//! scans turn to the same side, and does what one shows lie in space that the other saw to be empty?
//!
//! `cargo run --release --example viewpoints -- SCENE…`, scenes as `read_scene` takes them.

use scanweave::config::Config;
use scanweave::geometry::{PointMover, RigidMotion};
use scanweave::preprocessing::{ViewpointStudy, choose_scale, file_zero, localize, normals};
use scanweave::registration::{Posed, ScanModel, surface_fit};
use scanweave::scan::{PointCloud, Surface};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!(
        "scene, viewpoints, pairs, normals agree (mean), pairs below .8, violation (median), above .125, confidence (median)"
    );
    for folder in std::env::args().skip(1) {
        let scene = scanweave::io::read_scene(&folder)?;
        let truth = scene.world_from_scan.ok_or(format!("{folder}: no true poses"))?.value;
        let scans = scanweave::io::read_scans(&scene.scans, &scanweave::Silent)?;
        let config = Config::default();
        let (local, frames) = localize(&scans);
        let clouds: Vec<&PointCloud> = local.iter().map(|s| &s.cloud).collect();
        let scale = choose_scale(&config.scale, &clouds)?.scale;
        for (name, zero) in [("file zero", Some(true)), ("presumed or found", None), ("found", Some(false))] {
            let mut surfaces = scanweave::pipeline::thin(&local, &frames, &scale, &scanweave::Silent)?;
            for (surface, frame) in surfaces.iter_mut().zip(&frames) {
                let at_zero = file_zero(frame);
                let study = || ViewpointStudy::new(&surface.points, &surface.normals, None, at_zero).found();
                let (viewpoint, confidence) = match zero {
                    None => continue,
                    Some(true) => (at_zero, 1.0),
                    Some(false) => (study().viewpoint, study().confidence),
                };
                surface.normals = normals(&surface.points, &viewpoint, scale.normal_radius_m as f32);
                (surface.viewpoint, surface.viewpoint_confidence) = (viewpoint, confidence);
            }
            report(&scene.name, name, &surfaces, &truth, &frames, scale.inlier_radius_m as f32, &config);
        }
    }
    Ok(())
}

fn report(
    scene: &str,
    name: &str,
    surfaces: &[Surface],
    truth: &[RigidMotion],
    frames: &[RigidMotion],
    radius_m: f32,
    config: &Config,
) {
    let mut models: Vec<ScanModel<'_>> =
        surfaces.iter().map(|s| ScanModel::new(s, radius_m, &config.registration)).collect();
    // Whatever the shape says of its viewpoint: that is what is to be seen.
    models.iter_mut().for_each(|model| model.viewpoint_reliability = 1.0);
    let posed = |model| [Posed { model, group_from_scan: RigidMotion::identity() }];
    let mut fits = Vec::new();
    let mut of_scan = vec![(0.0, 0usize); surfaces.len()];
    for i in 0..surfaces.len() {
        for j in i + 1..surfaces.len() {
            let i_from_j = (truth[i] * frames[i]).inverse() * truth[j] * frames[j];
            let fit = surface_fit(&posed(&models[i]), &posed(&models[j]), &i_from_j, 1);
            if fit.overlap > 0.2 {
                // Same side as far as the planes are parallel.
                let mover = PointMover::new(&i_from_j);
                let (mut same, mut other) = (0, 0);
                for &p in &models[j].sample {
                    let place = mover.point(&surfaces[j].points[p as usize]);
                    if let Some(q) = models[i].near(&place, radius_m) {
                        let dot =
                            surfaces[i].normals[q].dot(&mover.direction(&surfaces[j].normals[p as usize]));
                        if dot > 0.7 {
                            same += 1
                        }
                        if dot < -0.7 {
                            other += 1
                        }
                    }
                }
                let share = f64::from(same) / f64::from((same + other).max(1));
                fits.push((share, fit.free_space_violation));
                for s in [i, j] {
                    of_scan[s].0 += share;
                    of_scan[s].1 += 1;
                }
            }
        }
    }
    let median = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let n = fits.len().max(1) as f64;
    println!(
        "{scene}, {name}, {}, {:.3}, {:.1} %, {:.3}, {:.1} %, {:.3}",
        fits.len(),
        fits.iter().map(|f| f.0).sum::<f64>() / n,
        100.0 * fits.iter().filter(|f| f.0 < 0.8).count() as f64 / n,
        median(fits.iter().map(|f| f.1).collect()),
        100.0 * fits.iter().filter(|f| f.1 > 0.125).count() as f64 / n,
        median(surfaces.iter().map(|s| f64::from(s.viewpoint_confidence)).collect()),
    );
    if std::env::var("WORST").is_ok() {
        for (s, (sum, count)) in
            of_scan.iter().enumerate().filter(|(_, x)| x.1 > 0 && x.0 / (x.1 as f64) < 0.7)
        {
            println!(
                "  scan {s}: {:.2} over {count} pairs, confidence {:.3}",
                sum / *count as f64,
                surfaces[s].viewpoint_confidence
            );
        }
    }
}
