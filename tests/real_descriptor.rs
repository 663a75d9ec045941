//! Scale and descriptors on real scans: run with the data folder in `SCANWEAVE_DATA`.

mod real_common;

use real_common::data;
use scanweave::descriptor::{self, DescriptorConfig};
use scanweave::geometry::Point;
use scanweave::preprocessing::ScaleConfig;
use scanweave::scan::{PointCloud, Scan};
use std::path::PathBuf;
use std::time::Instant;

/// The leading three columns (x y z, 4-byte floats) of rows after the line that starts with `end`.
fn binary(path: PathBuf, end: &str, stride: usize) -> PointCloud {
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let start = bytes.windows(end.len()).position(|w| w == end.as_bytes()).expect("header") + end.len();
    let value = |b: &[u8]| f32::from_le_bytes(b[..4].try_into().expect("4 bytes"));
    let rows = bytes[start..].chunks_exact(stride);
    let points = rows.map(|b| Point::new(value(b), value(&b[4..]), value(&b[8..])));
    PointCloud::from_points(points.filter(|p| p.iter().all(|v| v.is_finite())).collect())
}

fn ascii_ply(path: PathBuf) -> PointCloud {
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    // Some of these files end their lines with a carriage return too.
    let (header, body) = text.split_once("end_header").expect("header");
    let count = header.lines().find_map(|l| l.strip_prefix("element vertex ")).expect("count");
    let row = |line: &str| {
        let v: Vec<f32> = line.split_whitespace().take(3).map(|v| v.parse().expect("number")).collect();
        Point::new(v[0], v[1], v[2])
    };
    PointCloud::from_points(
        body.lines().skip(1).take(count.trim().parse().expect("count")).map(row).collect(),
    )
}

fn voxel_of(clouds: &[PointCloud], what: &str) -> f64 {
    let start = Instant::now();
    let choice =
        scanweave::preprocessing::choose_scale(&ScaleConfig::default(), &clouds.iter().collect::<Vec<_>>())
            .unwrap();
    eprintln!("{what}: {} scans, {} in {:.2?}", clouds.len(), choice.scale, start.elapsed());
    assert!(choice.warnings.is_empty(), "{what}: {:?}", choice.warnings);
    choice.scale.voxel_m
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn objects_rooms_and_buildings_get_their_scale_without_a_flag() {
    let data = data();
    let ply = |p: PathBuf| binary(p, "end_header\n", 12);
    let kitchen = data.join("3dmatch/7-scenes-redkitchen/PointCloud");
    let fragments: Vec<_> =
        (0..60).step_by(6).map(|i| ply(kitchen.join(format!("cloud_bin_{i}.ply")))).collect();
    // They were thinned at 2.5 cm; the same room from its raw points must come out alike.
    let thinned = voxel_of(&fragments, "kitchen fragments");
    assert!((0.022..=0.028).contains(&thinned), "{thinned}");
    let raw: Vec<_> = (0..6).map(|i| ply(data.join(format!("kitchen_raw/cloud_bin_{i}.ply")))).collect();
    let from_raw = voxel_of(&raw, "kitchen, raw");
    assert!((0.02..=0.03).contains(&from_raw), "{from_raw}");
    let names =
        ["bun000", "bun045", "bun090", "bun180", "bun270", "bun315", "chin", "ear_back", "top2", "top3"];
    let bunny: Vec<_> = names.iter().map(|n| ascii_ply(data.join(format!("bunny/{n}.ply")))).collect();
    // Sampled every 0.5 mm; 1.5 mm still resolves ears of 1 cm.
    let bunny = voxel_of(&bunny, "bunny");
    assert!((0.0007..=0.0015).contains(&bunny), "{bunny}");
    let facade: Vec<_> =
        (0..7).map(|i| binary(data.join(format!("facade/s{i}.pcd")), "DATA binary\n", 16)).collect();
    let facade = voxel_of(&facade, "facade");
    assert!((0.1..=0.25).contains(&facade), "{facade}");
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn a_real_fragment_is_described_in_full_and_in_time() {
    let data = data();
    let path = data.join("3dmatch/7-scenes-redkitchen/PointCloud/cloud_bin_0.ply");
    let cloud = binary(path.clone(), "end_header\n", 12);
    let scan = Scan { name: "cloud_bin_0".into(), path: Some(path), cloud, ..Scan::default() };
    let scale = scanweave::scan::WorkingScale::from_voxel(0.025);
    let start = Instant::now();
    let surface = scanweave::preprocessing::thin(&scan.cloud, &scale);
    let thinned = start.elapsed();
    let features = descriptor::describe(&scan, &surface, &scale, &DescriptorConfig::default(), 0).unwrap();
    eprintln!(
        "{} of {} points, {thinned:.2?}, features {:.2?}",
        surface.len(),
        scan.cloud.len(),
        start.elapsed()
    );
    assert_eq!((features.len(), features.descriptors.dim()), (2500, 65));
    let with_normal = surface.normals.iter().filter(|n| n.norm() > 0.5).count();
    assert!(with_normal as f64 > 0.98 * surface.len() as f64, "{with_normal} of {}", surface.len());
}
