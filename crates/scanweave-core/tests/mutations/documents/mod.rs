//! Every kind of file that the core reads, and what must hold once one was read: shared by the mutations and
//! by the targets of `fuzz/`, which mounts this module. It uses nothing but the core and the standard library.

pub mod checksums;
mod place;
mod properties;

pub use place::Place;

use checksums::{page_sums, png_sums, zipped};
use properties::{check_features, check_file, check_pose, finite};
use scanweave_core::descriptor::mini_spin_net;
use scanweave_core::io::{self, ReadOptions, read_file};
use scanweave_core::result::{self, Document as PosesJson, RunReport};
use scanweave_core::scan::Outcome;
use scanweave_core::synchronization::LitsWeights;
use scanweave_core::{Config, PointCloud, config::Layers, retrieval};
use std::path::Path;

/// The settings that kept pairs belong to.
pub const SETTINGS: &str = "settings";

/// Content of a file whose checksums fit.
type Seal = fn(&[u8]) -> Vec<u8>;
/// Whether a file was read.
type Check = fn(&Place, &[u8]) -> bool;

/// A kind of file.
#[derive(Clone, Copy)]
pub struct Document {
    /// What targets and tests call it.
    pub name: &'static str,
    read: Read,
    /// Makes content into a file whose checksums fit, so that what lies behind them is reached.
    sealed: Option<Seal>,
}

#[derive(Clone, Copy)]
enum Read {
    /// As a scan, in a file of this name.
    Scan(&'static str),
    /// Says whether it was read, and panics where something does not hold.
    With(Check),
}

const fn scan(name: &'static str, file: &'static str) -> Document {
    Document { name, read: Read::Scan(file), sealed: None }
}

const fn other(name: &'static str, read: Check) -> Document {
    Document { name, read: Read::With(read), sealed: None }
}

impl Document {
    const fn sealed(self, by: Seal) -> Self {
        Self { sealed: Some(by), ..self }
    }

    /// Whether it is a format of scans.
    pub fn is_scan(&self) -> bool {
        matches!(self.read, Read::Scan(_))
    }

    /// Reads `bytes` as a file of this kind, and again with checksums that fit; says whether either was read.
    ///
    /// # Panics
    /// Where something does not hold that must.
    pub fn read(&self, place: &Place, bytes: &[u8]) -> bool {
        let read = |bytes: &[u8]| match self.read {
            Read::Scan(file) => read_scans(place, file, bytes),
            Read::With(read) => read(place, bytes),
        };
        match self.sealed {
            None => read(bytes),
            Some(sealed) => [bytes, &sealed(bytes)].map(read).contains(&true),
        }
    }
}

/// All kinds. A new reader gets a line here, a seed in `seeds.rs` and a target in `fuzz/Cargo.toml`.
pub const DOCUMENTS: &[Document] = &[
    scan("ply", "scan.ply"),
    other("unit", read_unit),
    scan("pcd", "scan.pcd"),
    scan("las", "scan.las"),
    scan("laz", "scan.laz"),
    scan("e57", "scan.e57").sealed(page_sums),
    scan("ptx", "scan.ptx"),
    scan("pts", "scan.pts"),
    scan("xyz", "scan.xyz"),
    scan("csv", "scan.csv"),
    other("columns", read_columns),
    scan("npy", "scan.npy"),
    scan("npz", "scan.npz"),
    scan("npz-array", "scan.npz").sealed(|array| zipped("points.npy", array)),
    scan("kitti-bin", "scan.bin"),
    scan("obj", "scan.obj"),
    scan("off", "scan.off"),
    scan("stl", "scan.stl"),
    scan("glb", "scan.glb"),
    scan("gzip", "scan.ply.gz"),
    scan("zip", "scan.zip"),
    other("depth-image", read_depth).sealed(png_sums),
    other("color-image", read_color).sealed(png_sums),
    other("intrinsics", read_intrinsics),
    other("frame-lists", read_frame_lists),
    other("frame-pose", read_frame_pose),
    other("initial-poses", read_initial_poses),
    other("pose-names", read_pose_names),
    other("pose-lists", read_pose_lists),
    other("truth", read_truth),
    other("gt-log", read_gt_log),
    other("gt-info", read_gt_info),
    other("poses-json", read_poses_json),
    other("report-json", read_report_json),
    other("overlap-csv", read_overlap_csv),
    other("merged-ply", read_merged),
    other("features", read_features),
    other("features-array", read_keypoint_array),
    other("keypoints-text", read_keypoint_text),
    other("kept-pairs", |place, bytes| io::read_pairs(&place.put("pairs.npz", bytes), SETTINGS).is_ok()),
    other("pair-shard", |place, bytes| io::read_pair_shard(&place.put("pairs-0-of-1.npz", bytes)).is_ok()),
    other("head", |_, bytes| retrieval::Checkpoint::from_bytes(Path::new("head"), bytes).is_ok()),
    other("network", read_network),
    other("lits", |place, bytes| LitsWeights::load(&place.put("lits.safetensors", bytes)).is_ok()),
    other("config", read_config),
];

/// The kind of this name.
pub fn named(name: &str) -> Option<&'static Document> {
    DOCUMENTS.iter().find(|document| document.name == name)
}

/// The least that a file may unpack to: fast, and what goes beyond it shows.
fn options() -> ReadOptions {
    let mut config = ReadOptions::default();
    config.attributes = true;
    config.unpack_limit_mib = Some(1);
    config
}

fn read_scans(place: &Place, name: &str, bytes: &[u8]) -> bool {
    check_file(&place.put(name, bytes), &options())
}

/// A unit of a kilometre, which takes numbers beyond those of single precision.
fn read_unit(place: &Place, bytes: &[u8]) -> bool {
    check_file(&place.put("scan.ply", bytes), &{
        let mut changed = options();
        changed.unit_m = Some(1e3);
        changed
    })
}

fn read_columns(place: &Place, bytes: &[u8]) -> bool {
    let columns = "x=2,y=3,z=1,i=4".parse().ok();
    let mut options = options();
    options.columns = columns;
    options.unit_m = Some(1e3);
    check_file(&place.put("scan.csv", bytes), &options)
}

fn read_depth(place: &Place, bytes: &[u8]) -> bool {
    place.put("K.txt", b"5 5 4 3");
    let path = place.put("frame-000000.depth.png", bytes);
    if let Ok((frame, _)) = io::read_frame(&path, &options()) {
        assert_eq!(
            frame.depth_m.len(),
            frame.intrinsics.width * frame.intrinsics.height,
            "pixels of a frame"
        );
        assert!(frame.depth_m.iter().all(|d| d.is_finite()), "depth that is not finite");
    }
    check_file(&path, &options())
}

/// A depth image of 4 x 2 pixels, 1 m away.
const DEPTH: &[u8] = b"P5 4 2 65535\n\x03\xe8\x03\xe8\x03\xe8\x03\xe8\x03\xe8\x03\xe8\x03\xe8\x03\xe8";

fn read_color(place: &Place, bytes: &[u8]) -> bool {
    place.put("K.txt", b"5 5 2 1");
    place.put("frame-000000.color.png", bytes);
    let path = place.put("frame-000000.depth.png", DEPTH);
    check_file(&path, &options());
    read_file(&path, &options()).is_ok_and(|file| file.scans.iter().any(|s| s.cloud.colors.is_some()))
}

fn read_intrinsics(place: &Place, bytes: &[u8]) -> bool {
    let read = ["txt", "json", "yaml", "pincam", "csv"].map(|extension| {
        let path = place.put(&format!("camera.{extension}"), bytes);
        let Ok(io::CameraMatrix { fx, fy, cx, cy }) = io::read_intrinsics(&path) else { return false };
        assert!(finite(&[fx, fy, cx, cy]) && fx > 0.0 && fy > 0.0, "intrinsics {fx} {fy} {cx} {cy}");
        let image = place.put("depth.pgm", DEPTH);
        check_file(&image, &{
            let mut changed = options();
            changed.intrinsics = Some(path);
            changed
        })
    });
    read.contains(&true)
}

/// The lists of a TUM folder, and the file of the scale.
fn read_frame_lists(place: &Place, bytes: &[u8]) -> bool {
    for name in ["associations.txt", "rgb.txt", "depth.txt", "groundtruth.txt", "depth_scale.txt"] {
        place.put(name, bytes);
    }
    place.put("K.txt", b"5 5 2 1");
    let path = place.put("depth/1.5.pgm", DEPTH);
    check_file(&path, &options());
    // The file of the scale decides whether that works; the others only add to it.
    std::fs::remove_file(place.path("depth_scale.txt")).ok();
    check_file(&path, &options());
    read_file(&path, &options()).is_ok_and(|file| file.scans.iter().any(|s| s.pose.is_some()))
}

fn read_frame_pose(place: &Place, bytes: &[u8]) -> bool {
    place.put("K.txt", b"5 5 2 1");
    place.put("frame-000000.pose.txt", bytes);
    let path = place.put("frame-000000.depth.png", DEPTH);
    check_file(&path, &options());
    read_file(&path, &options()).is_ok_and(|file| file.scans.iter().any(|s| s.pose.is_some()))
}

/// The scans that poses are for.
pub const SCANS: [&str; 4] = ["scan_0", "scan_1", "scan_2", "scan_3"];

fn initial(place: &Place, path: &Path) -> bool {
    let names = SCANS.map(str::to_owned);
    let files = SCANS.map(|name| Some(place.path(&format!("{name}.ply"))));
    let Ok(read) = io::read_initial_poses(path, &names, &files) else { return false };
    assert_eq!(read.len(), SCANS.len(), "poses of scans");
    read.iter().flatten().for_each(check_pose);
    true
}

fn read_initial_poses(place: &Place, bytes: &[u8]) -> bool {
    initial(place, &place.put("poses.txt", bytes))
}

/// The names beside poses in the format of KITTI.
fn read_pose_names(place: &Place, bytes: &[u8]) -> bool {
    let path = place.put("poses.kitti", &b"1 0 0 0 0 1 0 0 0 0 1 0\n".repeat(SCANS.len()));
    let beside = io::trajectory_names_file(&path);
    std::fs::write(beside, bytes).unwrap_or_else(|e| panic!("{e}"));
    initial(place, &path)
}

fn read_pose_lists(place: &Place, bytes: &[u8]) -> bool {
    let path = &place.put("poses.txt", bytes);
    let info = io::read_info(path).inspect(|all| {
        assert!(all.iter().all(|e| finite(e.information.as_slice())), "an information that is not finite");
    });
    let overlaps = io::read_overlaps(path).inspect(|all| {
        assert!(all.values().all(|o| (0.0..=1.0).contains(o)), "an overlap that is no share");
    });
    [
        info.is_ok(),
        overlaps.is_ok(),
        io::read_log(path).map(|all| all.value.iter().for_each(|e| check_pose(&e.pose))).is_ok(),
        io::read_matrix(path).map(|one| check_pose(&one.value)).is_ok(),
        io::read_kitti(path).map(|all| all.value.iter().for_each(check_pose)).is_ok(),
        io::read_tum(path).map(|all| all.value.iter().for_each(|e| check_pose(&e.1))).is_ok(),
        io::read_conf(path).map(|all| all.value.iter().for_each(|e| check_pose(&e.1))).is_ok(),
    ]
    .contains(&true)
}

fn read_truth(place: &Place, bytes: &[u8]) -> bool {
    place.put("truth.json", bytes);
    for name in SCANS {
        place.put(&format!("scans/{name}.ply"), b"ply\n");
    }
    let Ok(scene) = io::read_scene(place.root()) else { return false };
    scene.world_from_scan.iter().flat_map(|poses| &poses.value).for_each(check_pose);
    true
}

const GT_LOG: &[u8] =
    b"0 1 3\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3\n1 0 0 1\n0 1 0 2\n0 0 1 3\n0 0 0 1\n";

fn benchmark(place: &Place) -> bool {
    let Ok(read) = io::read_benchmark(place.root()) else { return false };
    for pair in &read.pairs {
        check_pose(&pair.i_from_j);
        assert!(pair.i.0 < read.scans && pair.j.0 < read.scans, "a pair of scans that are not there");
    }
    true
}

fn read_gt_log(place: &Place, bytes: &[u8]) -> bool {
    place.put("gt.log", bytes);
    benchmark(place)
}

fn read_gt_info(place: &Place, bytes: &[u8]) -> bool {
    place.put("gt.log", GT_LOG);
    place.put("gt.info", bytes);
    benchmark(place)
}

fn read_poses_json(place: &Place, bytes: &[u8]) -> bool {
    let path = place.put("poses.json", bytes);
    initial(place, &path);
    let Ok(document) = PosesJson::load(&path) else { return false };
    if let Ok(reconstruction) = document.reconstruction() {
        assert_eq!(reconstruction.outcomes.len(), document.scans.len(), "outcomes of scans");
        let placed = reconstruction.outcomes.iter().filter_map(Outcome::placement);
        placed.for_each(|placement| check_pose(&placement.world_from_scan));
        let _ = (reconstruction.components(), reconstruction.placed());
    }
    let again = place.put("again.json", document.to_json().as_bytes());
    PosesJson::load(&again).unwrap_or_else(|e| panic!("what was read cannot be read again: {e}"));
    true
}

fn read_report_json(place: &Place, bytes: &[u8]) -> bool {
    let Ok(report) = RunReport::load(&place.put("report.json", bytes)) else { return false };
    let again = place.put("again.json", report.to_json().as_bytes());
    RunReport::load(&again).unwrap_or_else(|e| panic!("what was read cannot be read again: {e}"));
    true
}

fn read_overlap_csv(place: &Place, bytes: &[u8]) -> bool {
    let n = SCANS.len();
    let Ok(matrix) = result::read_predicted_overlaps(&place.put("overlap.csv", bytes), n) else {
        return false;
    };
    assert_eq!(matrix.len(), n, "scans of a similarity");
    assert!((0..n).all(|i| matrix.row(i).iter().all(|v| v.is_finite())), "a similarity that is not finite");
    true
}

fn read_merged(place: &Place, bytes: &[u8]) -> bool {
    let path = place.put("merged.ply", bytes);
    let _ = io::merged_run(&path);
    let Ok((cloud, numbers)) = io::read_merged(&path) else { return false };
    properties::check_cloud(&cloud);
    assert_eq!(numbers.len(), cloud.len(), "numbers of scans");
    true
}

fn read_features(place: &Place, bytes: &[u8]) -> bool {
    let path = place.put("features.npz", bytes);
    let _ = io::holds_features(&path);
    io::read_features(&path).map(|read| check_features(&read)).is_ok()
}

/// One array of NumPy as keypoints and as descriptors, in an archive and in the folders of SGHR.
fn read_keypoint_array(place: &Place, bytes: &[u8]) -> bool {
    let archive = checksums::archive(&[("keypoints.npy", bytes), ("descriptors.npy", bytes)]);
    let archived = read_features(place, &archive);
    place.put("Keypoints/cloud_bin_0Keypoints.npy", bytes);
    place.put("a_desc/0.npy", bytes);
    let read = io::read_sghr_features(place.root(), "a", 0, &a_cloud());
    read.map(|read| check_features(&read)).is_ok() || archived
}

fn read_keypoint_text(place: &Place, bytes: &[u8]) -> bool {
    place.put("Keypoints/cloud_bin_0Keypoints.txt", bytes);
    let array = b"\x93NUMPY\x01\0\x3c\0{'descr': '<f4', 'fortran_order': False, 'shape': (3, 1), }";
    place.put("a_desc/0.npy", &[&array[..], b"\n", &1f32.to_le_bytes().repeat(3)].concat());
    io::read_sghr_features(place.root(), "a", 0, &a_cloud()).map(|read| check_features(&read)).is_ok()
}

fn a_cloud() -> PointCloud {
    let point = |i: i32| scanweave_core::geometry::Point::new(i as f32, (i % 3) as f32, (i % 5) as f32);
    PointCloud::from_points((0..12).map(point).collect())
}

fn read_network(_: &Place, bytes: &[u8]) -> bool {
    let Ok(read) = mini_spin_net::Checkpoint::from_bytes(Path::new("network"), bytes) else { return false };
    mini_spin_net::LoadedNetwork::new(&read.weights);
    true
}

fn read_config(place: &Place, bytes: &[u8]) -> bool {
    let path = place.put("config.toml", bytes);
    let mut layers = Layers::new::<Config>();
    let read = layers.add_file(&path).and_then(|()| Config::from_layers(&layers)).is_ok();
    // Every line as an assignment of the command line, up to the first that is refused.
    let mut layers = Layers::new::<Config>();
    let text = String::from_utf8_lossy(bytes);
    if text.lines().take(8).all(|line| layers.add_assignment(line).is_ok()) {
        let _ = Config::from_layers(&layers);
    }
    read
}
