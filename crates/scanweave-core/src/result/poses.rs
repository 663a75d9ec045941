//! `poses.json`: the outcome on every scan, for other programs (docs/poses-json.md).

use super::check;
use super::identity::RunIdentity;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::geometry::rigid::motion_from_matrix;
use crate::scan::{
    DeclineReason, Doubt, Evidence, NeighbourEvidence, Outcome, Placement, PoseUncertainty, Reconstruction,
    Scan, ScanId,
};
use nalgebra::Matrix4;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Value of the `format` field.
pub const POSES_FORMAT: &str = "scanweave-poses";
/// Version of the layout; raised whenever a reader of the old one would go wrong.
pub const POSES_VERSION: u32 = 3;

/// The whole document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Document {
    /// Always [`POSES_FORMAT`].
    pub format: String,
    /// [`POSES_VERSION`] of the layout.
    pub version: u32,
    /// Program and version that wrote it.
    pub generator: String,
    /// The run, and what belongs to it; none where a document stands alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<RunIdentity>,
    /// Components, largest first; poses of different components are unrelated.
    pub components: Vec<Component>,
    /// One entry a scan, in the order of the input.
    pub scans: Vec<Entry>,
}

/// Scans with poses in one common frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Component {
    /// The scan whose frame is the component's frame.
    pub pivot: Option<usize>,
    /// Its scans.
    pub scans: Vec<usize>,
}

/// One scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Place in the naturally sorted input, from zero.
    pub id: usize,
    /// Short unique name.
    pub name: String,
    /// The file, as it was named on the command line.
    pub file: Option<String>,
    /// Which scan of the file it is, from zero, where the file holds several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<usize>,
    /// Placed or declined.
    #[serde(flatten)]
    pub outcome: EntryOutcome,
}

/// What became of a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "outcome", rename_all = "lowercase")]
pub enum EntryOutcome {
    /// It has a pose.
    Placed(Box<Pose>),
    /// It has none.
    Declined {
        /// Why, for programs.
        decline: DeclineReason,
        /// Why, for people.
        explanation: String,
    },
}

/// A pose and what speaks for it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Index into `components`.
    pub component: usize,
    /// Growth step at which the scan joined; 0 for the pivot.
    pub step: usize,
    /// 4×4, row by row: takes coordinates of the file to those of
    /// its component, see docs/poses-json.md.
    pub world_from_scan: [[f64; 4]; 4],
    /// The rotation again, as a unit quaternion x, y, z, w with w ≥ 0.
    pub quaternion_xyzw: [f64; 4],
    /// The placed scan it shares most inliers with; null for a pivot.
    pub parent: Option<usize>,
    /// Mutual descriptor matches with the model at that step.
    pub matches: usize,
    /// Matches within the inlier radius.
    pub inliers: usize,
    /// Inliers over matches.
    pub inlier_ratio: f64,
    /// Root mean square distance of the inliers, metres.
    pub residual_m: f64,
    /// What speaks for the pose; null for a pivot that nothing was compared with.
    pub evidence: Option<Evidence>,
    /// Agreement with every placed scan it touches, at the final poses.
    pub neighbours: Vec<NeighbourEvidence>,
    /// How firmly it is held; null where that was not assessed.
    #[serde(default)]
    pub pose_uncertainty: Option<Box<PoseUncertainty>>,
    /// What is doubtful about it: `ambiguous`, `poorly-localised`.
    #[serde(default)]
    pub doubts: Vec<Doubt>,
}

impl Document {
    /// The document of a registration with an inlier radius of `inlier_radius_m` (τ, metres);
    /// `scans[i]` belongs to `outcomes[i]`.
    pub fn new(scans: &[Scan], reconstruction: &Reconstruction, inlier_radius_m: f64) -> Self {
        let entries = scans.iter().zip(&reconstruction.outcomes).map(|(scan, outcome)| Entry {
            id: scan.id.0,
            name: scan.name.clone(),
            file: scan.path.as_ref().map(|p| p.display().to_string()),
            part: scan.part,
            outcome: EntryOutcome::of(outcome, inlier_radius_m),
        });
        Self {
            format: POSES_FORMAT.to_owned(),
            version: POSES_VERSION,
            generator: concat!("scanweave ", env!("CARGO_PKG_VERSION")).to_owned(),
            run: None,
            components: components(reconstruction),
            scans: entries.collect(),
        }
    }

    /// As JSON text, ending in a line break.
    pub fn to_json(&self) -> String {
        // Serialising these types cannot fail: every map key is a string.
        serde_json::to_string_pretty(self).map(|text| text + "\n").unwrap_or_default()
    }
}

impl Document {
    /// Reads a `poses.json` whose parts fit each other: every scan and component that is named is there.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::File`] when the file is of another kind or version, or a part of it
    /// does not fit the others.
    pub fn load(path: &Path) -> Result<Self> {
        let text = crate::files::read_text(path)?;
        let expected =
            format!("{POSES_FORMAT} of version {POSES_VERSION}, as `scanweave register` writes it");
        let remedy = "name the output folder of a finished registration";
        let document: Self = serde_json::from_str(&text)
            .map_err(|e| Error::file(path, format!("text that does not fit ({e})"), &expected, remedy))?;
        if document.format != POSES_FORMAT || document.version != POSES_VERSION {
            let found = format!("{} of version {}", document.format, document.version);
            return Err(Error::file(path, found, expected, remedy));
        }
        if let Some((found, expected)) = check::misfit(&document) {
            let remedy = "take the file as it was written, or register the scans again";
            return Err(Error::file(path, found, expected, remedy));
        }
        Ok(document)
    }

    /// The reconstruction it describes; evidence that the document leaves out stays empty.
    ///
    /// # Errors
    /// [`Error::Input`] when a pose is no rigid motion.
    pub fn reconstruction(&self) -> Result<Reconstruction> {
        let outcomes = self.scans.iter().map(|entry| match &entry.outcome {
            EntryOutcome::Placed(pose) => pose.placement(&entry.name).map(Outcome::Placed),
            EntryOutcome::Declined { decline, .. } => Ok(Outcome::Declined(decline.clone())),
        });
        Ok(Reconstruction { outcomes: outcomes.collect::<Result<_>>()? })
    }
}

impl EntryOutcome {
    fn of(outcome: &Outcome, inlier_radius_m: f64) -> Self {
        match outcome {
            Outcome::Placed(placement) => {
                EntryOutcome::Placed(Box::new(Pose::of(placement, inlier_radius_m)))
            }
            Outcome::Declined(reason) => {
                EntryOutcome::Declined { decline: reason.clone(), explanation: reason.to_string() }
            }
        }
    }
}

impl Pose {
    fn of(placement: &Placement, inlier_radius_m: f64) -> Self {
        Self {
            component: placement.component,
            step: placement.step,
            world_from_scan: rows(&placement.world_from_scan),
            quaternion_xyzw: quaternion(&placement.world_from_scan),
            parent: placement.parent.map(|p| p.0),
            matches: placement.matches,
            inliers: placement.inliers,
            inlier_ratio: placement.inlier_ratio(),
            residual_m: placement.residual_m,
            evidence: placement.evidence,
            neighbours: placement.neighbours.clone(),
            pose_uncertainty: placement.pose_uncertainty.clone(),
            doubts: placement.doubts(inlier_radius_m),
        }
    }

    fn placement(&self, name: &str) -> Result<Placement> {
        let matrix = Matrix4::from_fn(|r, c| self.world_from_scan[r][c]);
        let Some((world_from_scan, _)) = motion_from_matrix(&matrix, check::ORTHONORMAL) else {
            return Err(Error::input(
                format!("world_from_scan of {name}"),
                "a matrix that is no rigid motion",
                "a rotation and a translation",
                "register the scans again",
            ));
        };
        Ok(Placement {
            world_from_scan,
            component: self.component,
            step: self.step,
            parent: self.parent.map(ScanId),
            matches: self.matches,
            inliers: self.inliers,
            residual_m: self.residual_m,
            evidence: self.evidence,
            neighbours: self.neighbours.clone(),
            pose_uncertainty: self.pose_uncertainty.clone(),
        })
    }
}

/// Scans of every component, in the order of the component numbers.
fn components(reconstruction: &Reconstruction) -> Vec<Component> {
    let mut all = vec![Component { pivot: None, scans: Vec::new() }; reconstruction.components()];
    for (scan, outcome) in reconstruction.outcomes.iter().enumerate() {
        let Some(placement) = outcome.placement() else { continue };
        let component = &mut all[placement.component];
        component.scans.push(scan);
        if placement.parent.is_none() {
            component.pivot.get_or_insert(scan);
        }
    }
    all
}

fn rows(pose: &RigidMotion) -> [[f64; 4]; 4] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
}

fn quaternion(pose: &RigidMotion) -> [f64; 4] {
    let q = pose.rotation.quaternion();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [q.i * sign, q.j * sign, q.k * sign, q.w * sign]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    fn scan(id: usize) -> Scan {
        Scan { id: ScanId(id), name: format!("s{id}"), ..Scan::default() }
    }

    fn placed(component: usize, parent: Option<usize>) -> Outcome {
        // A quarter turn about z: x → y.
        let turn = Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        Outcome::Placed(Placement {
            world_from_scan: RigidMotion::new(Vector3::new(1.0, 2.0, 3.0), turn),
            component,
            step: usize::from(parent.is_some()),
            parent: parent.map(ScanId),
            matches: 8,
            inliers: 2,
            residual_m: 0.01,
            evidence: None,
            neighbours: vec![NeighbourEvidence {
                scan: ScanId(1),
                overlap: 0.5,
                residual_m: 0.02,
                plane_distance_m: None,
            }],
            pose_uncertainty: None,
        })
    }

    #[test]
    fn the_document_says_for_every_scan_where_it_is_or_why_not() {
        let reason = DeclineReason::TooFewInliers { inliers: 3, needed: 12, matches: 40 };
        let outcomes = vec![placed(0, Some(1)), placed(0, None), Outcome::Declined(reason)];
        let scans: Vec<Scan> = (0..3).map(scan).collect();
        let text = Document::new(&scans, &Reconstruction { outcomes }, 0.07).to_json();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["format"], "scanweave-poses");
        assert_eq!(json["version"], 3);
        assert_eq!(json["components"][0]["pivot"], 1);
        assert_eq!(json["components"][0]["scans"], serde_json::json!([0, 1]));
        let first = &json["scans"][0];
        assert_eq!(first["outcome"], "placed");
        assert_eq!(first["inlier_ratio"], 0.25);
        assert_eq!(first["parent"], 1);
        // Rows of R = [[0,-1,0],[1,0,0],[0,0,1]] with t = (1,2,3) as the last column.
        assert!((first["world_from_scan"][0][1].as_f64().unwrap() + 1.0).abs() < 1e-12);
        assert!((first["world_from_scan"][1][0].as_f64().unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(first["world_from_scan"][2][3], 3.0);
        assert!((first["quaternion_xyzw"][2].as_f64().unwrap() - 0.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(json["scans"][2]["outcome"], "declined");
        assert_eq!(json["scans"][2]["decline"]["reason"], "too-few-inliers");
        assert_eq!(json["scans"][2]["decline"]["needed"], 12);
        let back: Document = serde_json::from_str(&text).unwrap();
        assert_eq!(back.to_json(), text);
    }

    #[test]
    fn the_centre_is_three_numbers_and_files_without_it_are_read() {
        let mut outcome = placed(0, None);
        let Outcome::Placed(placement) = &mut outcome else { panic!() };
        let centre = Some(Point3::new(1.5, -2.0, 500_000.25));
        let uncertainty = PoseUncertainty { centre, ..PoseUncertainty::default() };
        placement.pose_uncertainty = Some(Box::new(uncertainty));
        let document = Document::new(&[scan(0)], &Reconstruction { outcomes: vec![outcome] }, 0.07);
        let mut json: serde_json::Value = serde_json::from_str(&document.to_json()).unwrap();
        let stated = json["scans"][0]["pose_uncertainty"].as_object_mut().unwrap();
        assert_eq!(stated["centre"], serde_json::json!([1.5, -2.0, 500_000.25]));
        let uncertainty = |json: &serde_json::Value| {
            let document: Document = serde_json::from_value(json.clone()).unwrap();
            let read = document.reconstruction().unwrap();
            read.outcomes[0].placement().unwrap().pose_uncertainty.clone().unwrap()
        };
        stated.remove("centre");
        assert_eq!(*uncertainty(&json), PoseUncertainty::default());
        assert_eq!(uncertainty(&serde_json::from_str(&document.to_json()).unwrap()).centre, centre);
    }
}
