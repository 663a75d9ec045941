//! Estimated poses of one scene, from a registration or from trajectory files of any method.

use super::scene::SceneTruth;
use crate::geometry::RigidMotion;
use crate::io::{read_kitti, read_log, read_tum};
use crate::result::Document;
use crate::scan::{DeclineReason, Outcome, Placement, Reconstruction};
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Estimated poses of the scans of one scene, in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneEstimate {
    /// Component and `world_from_scan`; `None` for a declined scan.
    pub poses: Vec<Option<(usize, RigidMotion)>>,
    /// Why a scan was declined; `None` for a placed one.
    pub reasons: Vec<Option<String>>,
}

impl SceneEstimate {
    /// Poses of a registration.
    pub fn of(reconstruction: &Reconstruction) -> Self {
        let pose = |o: &Outcome| o.placement().map(|p| (p.component, p.world_from_scan));
        let reason = |o: &Outcome| match o {
            Outcome::Placed(_) => None,
            Outcome::Declined(reason) => Some(reason.to_string()),
        };
        let outcomes = &reconstruction.outcomes;
        Self { poses: outcomes.iter().map(pose).collect(), reasons: outcomes.iter().map(reason).collect() }
    }

    /// Estimated `i_from_j` of the scans at places `i` and `j`; `None` where one was declined or
    /// they are in different components.
    pub fn relative(&self, i: usize, j: usize) -> Option<RigidMotion> {
        let (a, b) = ((*self.poses.get(i)?)?, (*self.poses.get(j)?)?);
        (a.0 == b.0).then(|| a.1.inverse() * b.1)
    }

    /// [`Self::relative`], with the component that both are in.
    pub fn relative_in_component(&self, i: usize, j: usize) -> Option<(usize, RigidMotion)> {
        let component = (*self.poses.get(i)?)?.0;
        self.relative(i, j).map(|i_from_j| (component, i_from_j))
    }

    /// Scans with a pose.
    pub fn placed(&self) -> usize {
        self.poses.iter().flatten().count()
    }

    /// Reads the estimate for the scene `truth` from a folder with one result a scene:
    /// `<scene>/poses.json` of `register`, `<scene>/trajectory.log` or `<scene>.log` (Redwood: the
    /// header's first number is the scan's), `<scene>/poses.txt` or `<scene>.txt` (a matrix a line
    /// for each scan in order), `<scene>/trajectory.tum` or `<scene>.tum` (timestamp is the number).
    ///
    /// # Errors
    /// No such file, or one that does not fit the scene.
    pub fn read(results: &Path, truth: &SceneTruth) -> Result<Self> {
        Self::read_file(&Self::file(results, &truth.name)?, truth)
    }

    /// The file that [`SceneEstimate::read`] reads for a scene.
    ///
    /// # Errors
    /// No such file.
    pub fn file(results: &Path, scene: &str) -> Result<PathBuf> {
        let inside = ["poses.json", "trajectory.log", "poses.txt", "trajectory.tum"];
        let beside = ["json", "log", "txt", "tum"].map(|e| results.join(format!("{scene}.{e}")));
        let mut places: Vec<PathBuf> = inside.iter().map(|n| results.join(scene).join(n)).collect();
        places.extend(beside);
        let found = places.into_iter().find(|p| p.is_file());
        if let Some(other) = unfinished(&results.join(scene)).filter(|_| found.is_some()) {
            return Err(Error::file(
                results.join(scene),
                format!("{other} of `register` without poses.json, which is written last"),
                "a finished registration, or a trajectory of another method in a folder of its own",
                "register the scene again, or move the trajectory",
            ));
        }
        found.ok_or_else(|| {
            Error::file(
                results.join(scene),
                "no estimated poses",
                "poses.json, trajectory.log, poses.txt or trajectory.tum in it, or a file of the scene's name beside it",
                "register this scene too, or name the scenes to evaluate with --scene",
            )
        })
    }

    /// The poses alone, as a reconstruction that tells nothing of how it grew.
    pub fn reconstruction(&self) -> Reconstruction {
        let outcome = |(pose, reason): (&Option<(usize, RigidMotion)>, &Option<String>)| match pose {
            Some((component, world_from_scan)) => {
                Outcome::Placed(Placement::at(*world_from_scan, *component))
            }
            None => {
                Outcome::Declined(DeclineReason::Degenerate { detail: reason.clone().unwrap_or_default() })
            }
        };
        Reconstruction::new(self.poses.iter().zip(&self.reasons).map(outcome).collect())
    }

    fn read_file(file: &Path, truth: &SceneTruth) -> Result<Self> {
        match file.extension().and_then(|e| e.to_str()) {
            Some("json") => Self::of_document(file, truth),
            Some("log") => {
                let entries = read_log(file)?.value;
                Self::numbered(file, entries.into_iter().map(|e| (e.i, e.pose)), truth)
            }
            Some("tum") => {
                let lines = read_tum(file)?.value;
                // A timestamp that is no whole number names no scan.
                let number = |t: f64| if t >= 0.0 && t.fract() == 0.0 { t as usize } else { usize::MAX };
                Self::numbered(file, lines.into_iter().map(|(t, pose)| (number(t), pose)), truth)
            }
            _ => {
                let poses = read_kitti(file)?.value;
                if poses.len() != truth.scans.len() {
                    let found = format!("{} poses", poses.len());
                    let expected = format!("{}, one for each scan of {}", truth.scans.len(), truth.name);
                    return Err(Error::file(file, found, expected, "write a line for every scan, in order"));
                }
                let reasons = vec![None; poses.len()];
                Ok(Self { poses: poses.into_iter().map(|p| Some((0, p))).collect(), reasons })
            }
        }
    }

    fn of_document(file: &Path, truth: &SceneTruth) -> Result<Self> {
        let document = Document::load(file)?;
        let all = Self::of(&document.reconstruction()?);
        let short = |name: &str| name.rsplit('/').next().unwrap_or(name).to_owned();
        let names: Vec<String> = document.scans.iter().map(|e| short(&e.name)).collect();
        let place = |scan: &String| {
            names.iter().position(|n| *n == short(scan)).ok_or_else(|| {
                Error::file(
                    file,
                    format!("{} scans without {scan}", names.len()),
                    format!("the {} scans of {}", truth.scans.len(), truth.name),
                    "register all scans of this scene",
                )
            })
        };
        let places = truth.scans.iter().map(place).collect::<Result<Vec<usize>>>()?;
        Ok(Self {
            poses: places.iter().map(|&k| all.poses[k]).collect(),
            reasons: places.iter().map(|&k| all.reasons[k].clone()).collect(),
        })
    }

    /// Poses by the numbers of scans; a scan without one is declined.
    fn numbered(
        file: &Path,
        entries: impl Iterator<Item = (usize, RigidMotion)>,
        truth: &SceneTruth,
    ) -> Result<Self> {
        let by_number = truth.by_number();
        let mut poses = vec![None; truth.scans.len()];
        for (number, pose) in entries {
            let Some(&index) = by_number.get(&number) else {
                let expected = format!("numbers of the {} scans of {}", truth.scans.len(), truth.name);
                let remedy = "name each pose by the number at the end of its scan's name";
                return Err(Error::file(file, format!("a pose of scan {number}"), expected, remedy));
            };
            poses[index] = Some((0, pose));
        }
        let missing = |p: &Option<_>| p.is_none().then(|| "no pose in the trajectory".to_owned());
        let reasons = poses.iter().map(missing).collect();
        Ok(Self { poses, reasons })
    }
}

/// A file that `register` writes beside a trajectory, in a folder without the poses.json that would come
/// last: the run was stopped, or the folder is only a part of a result.
fn unfinished(folder: &Path) -> Option<&'static str> {
    let written = ["merged.ply", "overlap.csv", "report.json", "report.html"];
    if folder.join("poses.json").exists() {
        return None;
    }
    written.into_iter().find(|name| folder.join(name).exists())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_registration_that_was_stopped_is_no_result() {
        let place = tempfile::tempdir().unwrap();
        let scene = place.path().join("hall");
        std::fs::create_dir(&scene).unwrap();
        std::fs::write(scene.join("trajectory.log"), "").unwrap();
        assert_eq!(SceneEstimate::file(place.path(), "hall").unwrap(), scene.join("trajectory.log"));
        std::fs::write(scene.join("merged.ply"), "").unwrap();
        let message = SceneEstimate::file(place.path(), "hall").unwrap_err().to_string();
        assert!(message.contains("hall: found merged.ply") && message.contains("poses.json"), "{message}");
        std::fs::write(scene.join("poses.json"), "{}").unwrap();
        assert_eq!(SceneEstimate::file(place.path(), "hall").unwrap(), scene.join("poses.json"));
    }
}
