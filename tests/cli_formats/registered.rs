//! Runs of `scanweave register`, and how their poses compare with the truth.

use super::cli_common::{folder, scanweave};
use super::place::View;
use nalgebra::{Matrix4, Point3};
use scanweave::geometry::RigidMotion;
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Two centimetres and half a degree.
pub const CLOSE: (f64, f64) = (0.02, 0.5);

/// Settings with which a run takes a fraction of a second.
const QUICK: [&str; 4] = ["--set", "descriptor.kind=fpfh", "--set", "descriptor.keypoints.count=1000"];

/// A folder with scans, and place for a result.
pub struct Desk {
    place: TempDir,
}

/// What a run wrote and said.
pub struct Registered {
    pub output: PathBuf,
    pub poses: Value,
    pub stderr: String,
}

impl Desk {
    pub fn new() -> Self {
        let place = folder();
        std::fs::create_dir(place.path().join("scans")).unwrap();
        Self { place }
    }

    /// A path in the folder of the scans.
    pub fn path(&self, name: &str) -> PathBuf {
        self.place.path().join("scans").join(name)
    }

    /// A path outside of the folder of the scans.
    pub fn beside(&self, name: &str) -> PathBuf {
        self.place.path().join(name)
    }

    /// Writes a file into the folder of the scans.
    pub fn file(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        path
    }

    /// The command on the folder of the scans.
    pub fn command(&self, flags: &[&str]) -> assert_cmd::Command {
        self.command_on(&self.path(""), flags)
    }

    fn command_on(&self, input: &Path, flags: &[&str]) -> assert_cmd::Command {
        let mut command = scanweave();
        command.arg("register").arg(input).args(["--json", "--force", "--threads", "2"]).args(QUICK);
        command.arg("-o").arg(self.beside("result")).args(flags);
        command
    }

    /// Registers the folder of the scans.
    pub fn register(&self, flags: &[&str]) -> Registered {
        self.register_on(&self.path(""), flags)
    }

    /// Registers one input.
    pub fn register_on(&self, input: &Path, flags: &[&str]) -> Registered {
        let done = self.command_on(input, flags).assert().success();
        self.read(done.get_output())
    }

    /// Registers the folder of the scans, none of which may be placed: that is said by the exit code.
    pub fn register_or_decline(&self, flags: &[&str]) -> Registered {
        let done = self.command(flags).assert();
        let code = done.get_output().status.code();
        assert!(code == Some(0) || code == Some(6), "{code:?}");
        self.read(done.get_output())
    }

    fn read(&self, out: &std::process::Output) -> Registered {
        let document: Value = serde_json::from_slice(&out.stdout).unwrap();
        Registered {
            output: self.beside("result"),
            poses: document["poses"].clone(),
            stderr: String::from_utf8(out.stderr.clone()).unwrap(),
        }
    }
}

/// A motion from a 4×4 matrix as JSON has it.
fn motion(rows: &Value) -> RigidMotion {
    let matrix = Matrix4::from_fn(|r, c| rows[r][c].as_f64().unwrap());
    rigid(&matrix)
}

/// A motion from a matrix that is one.
pub fn rigid(matrix: &Matrix4<f64>) -> RigidMotion {
    let rotation = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    assert!((rotation * rotation.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-6, "{matrix}");
    let translation = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    let rotation = nalgebra::UnitQuaternion::from_matrix(&rotation);
    RigidMotion::from_parts(translation.into(), rotation)
}

/// By how much two poses of a view differ: the root mean square distance of its points, metres, and the
/// angle in degrees.
pub fn difference(view: &View, a: &RigidMotion, b: &RigidMotion) -> (f64, f64) {
    let apart = |p: &[f64; 3]| (a * Point3::from(*p) - b * Point3::from(*p)).norm_squared();
    let sum: f64 = view.points.iter().map(apart).sum();
    ((sum / view.points.len() as f64).sqrt(), a.rotation.angle_to(&b.rotation).to_degrees())
}

impl Registered {
    fn entry(&self, name: &str) -> &Value {
        let scans = self.poses["scans"].as_array().unwrap();
        scans.iter().find(|s| s["name"] == name).unwrap_or_else(|| panic!("no scan {name}: {scans:?}"))
    }

    /// Names of all scans.
    pub fn names(&self) -> Vec<String> {
        let scans = self.poses["scans"].as_array().unwrap();
        scans.iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect()
    }

    /// The pose of a scan in component 0, if it was placed there.
    pub fn pose(&self, name: &str) -> Option<RigidMotion> {
        let entry = self.entry(name);
        (entry["component"] == 0).then(|| motion(&entry["world_from_scan"]))
    }

    /// A field of a scan's evidence.
    pub fn evidence(&self, name: &str, field: &str) -> Option<f64> {
        self.entry(name)["evidence"][field].as_f64()
    }

    /// The message says this.
    pub fn says(&self, parts: &[&str]) {
        for part in parts {
            assert!(self.stderr.contains(part), "{part:?} is not in: {}", self.stderr);
        }
    }

    /// All views are placed, and lie to each other as they do in truth: the first one's pose is taken as
    /// right, and the points of the others are to be where the truth has them.
    pub fn agrees(&self, names: &[&str], views: &[View], (metres, degrees): (f64, f64)) {
        assert_eq!(self.names(), names, "{}", self.stderr);
        let poses = names.iter().map(|n| self.pose(n).unwrap_or_else(|| panic!("{n} is not placed")));
        let poses: Vec<RigidMotion> = poses.collect();
        let world_from_result = views[0].world_from_file * poses[0].inverse();
        for ((name, view), pose) in names.iter().zip(views).zip(&poses) {
            let (far, turned) = difference(view, &(world_from_result * pose), &view.world_from_file);
            assert!(far < metres && turned < degrees, "{name} is off by {far} m, {turned}°");
        }
    }

    /// A placed scan has this very pose, within tolerances.
    pub fn is_at(&self, name: &str, view: &View, expected: &RigidMotion, (metres, degrees): (f64, f64)) {
        let pose = self.pose(name).unwrap_or_else(|| panic!("{name} is not placed"));
        let (far, turned) = difference(view, &pose, expected);
        assert!(far < metres && turned < degrees, "{name} is off by {far} m, {turned}°: {pose}");
    }
}
