//! Whole files of every kind, a few kilobytes each, by the project's own writers: what mutations and fuzzing
//! start from.

use crate::documents::{SCANS, SETTINGS, checksums};
use crate::files::{self, gzip, npy, pcd, ply, ptx};
use scanweave_core::descriptor::mini_spin_net;
use scanweave_core::geometry::{Direction, Point, RigidMotion};
use scanweave_core::io::{
    self, E57Scan, Held, PairShard, PairShardHeader, PlyCloud, ShardHypothesis, ShardPair, Summary,
};
use scanweave_core::nalgebra::{Matrix6, Vector3};
use scanweave_core::result::{Component, Document, POSES_FORMAT, POSES_VERSION};
use scanweave_core::result::{Row, RunReport, ScanSize, StageTime};
use scanweave_core::retrieval::{self, DataSummary, DescriptorTag, HeadWeights, NetVladConfig};
use scanweave_core::scan::{
    DeclineReason, Descriptors, Evidence, Features, NeighbourEvidence, Outcome, PairKey, PairRegistration,
    Placement, Scan, ScanId, WorkingScale,
};
use scanweave_core::synchronization::LitsWeights;
use scanweave_core::{Config, PointCloud, Reconstruction};
use std::collections::BTreeMap;
use std::path::Path;

/// A whole file: the name of its kind among the documents, and its bytes.
pub type Seed = (&'static str, Vec<u8>);

/// The kind of the seeds that the document of this name begins with.
pub fn kind_for(document: &str) -> &str {
    match document {
        "unit" => "ply",
        "columns" => "csv",
        "npz-array" => "npy",
        own => own,
    }
}

/// All of them. `folder` takes what the writers write.
pub fn all(folder: &Path) -> Vec<Seed> {
    let mut seeds = Seeds { folder, all: Vec::new() };
    seeds.formats();
    seeds.written_scans();
    seeds.text();
    seeds.images();
    seeds.poses();
    seeds.results();
    seeds.features();
    seeds.networks();
    seeds.all
}

struct Seeds<'a> {
    folder: &'a Path,
    all: Vec<Seed>,
}

const POINTS: usize = 12;

/// A cloud with everything that goes with points, `far` from zero or not.
fn cloud(far: bool) -> PointCloud {
    let at =
        |i: usize| Point::new(0.5 * (7 * i % POINTS) as f32, 0.5 * (i % 3) as f32, 0.25 * (i % 5) as f32);
    PointCloud {
        points: (0..POINTS).map(at).collect(),
        colors: Some((0..POINTS).map(|i| [i as u8, 100, 255]).collect()),
        intensities: Some((0..POINTS).map(|i| i as f32 / 16.0).collect()),
        normals: Some(vec![Direction::z(); POINTS]),
        origin_m: if far { Vector3::new(431_000.0, 5_812_000.0, 100.0) } else { Vector3::zeros() },
        viewpoint: Some(Point::new(0.5, 0.5, 1.5)),
        ..PointCloud::default()
    }
}

fn motion(i: usize) -> RigidMotion {
    let i = i as f64;
    RigidMotion::new(Vector3::new(i, -0.5 * i, 0.25), Vector3::new(0.1 * i, 0.2, -0.3))
}

fn placed() -> Vec<(ScanId, RigidMotion)> {
    (0..SCANS.len()).map(|i| (ScanId(i), motion(i))).collect()
}

impl Seeds<'_> {
    fn add(&mut self, document: &'static str, bytes: impl Into<Vec<u8>>) {
        self.all.push((document, bytes.into()));
    }

    /// What `write` makes of a path.
    fn written(&mut self, document: &'static str, write: impl FnOnce(&Path) -> scanweave_core::Result<()>) {
        let path = self.folder.join("written");
        write(&path).unwrap_or_else(|e| panic!("{document}: {e}"));
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{document}: {e}"));
        self.add(document, bytes);
    }

    /// The files that the tests of memory begin with.
    fn formats(&mut self) {
        for (name, bytes) in files::whole(self.folder) {
            let document = match name.rsplit('.').next().unwrap_or_default() {
                "bin" => "kitti-bin",
                "png" | "pgm" => "depth-image",
                "gz" => "gzip",
                extension => {
                    let known = crate::documents::named(extension);
                    known.unwrap_or_else(|| panic!("{name} is of no kind")).name
                }
            };
            self.add(document, bytes);
        }
    }

    /// Scans with colours, normals and intensities.
    fn written_scans(&mut self) {
        for far in [false, true] {
            let cloud = cloud(far);
            let summary = || Summary::of(&mut Held(cloud.clone()), &RigidMotion::identity(), &mut |_| Ok(()));
            let summary = summary().unwrap_or_else(|e| panic!("{e}"));
            let blocks = || Held(cloud.clone());
            let numbers: Vec<i32> = (0..POINTS as i32).map(|i| i % 3).collect();
            let whole = PlyCloud {
                points: &cloud.points,
                origin_m: cloud.origin_m,
                normals: cloud.normals.as_deref(),
                colors: cloud.colors.as_deref(),
                intensities: cloud.intensities.as_deref(),
                ..PlyCloud::default()
            };
            self.written("ply", |path| io::write_ply(path, &whole));
            let merged = PlyCloud { scans: Some(&numbers), run: Some("0123abcd"), ..whole };
            self.written("merged-ply", |path| io::write_ply(path, &merged));
            self.written("pcd", |path| io::write_pcd(path, &summary, &mut blocks()));
            self.written("las", |path| io::write_las(path, &summary, &mut blocks(), false));
            self.written("laz", |path| io::write_las(path, &summary, &mut blocks(), true));
            self.written("e57", |path| {
                let scan = |i: usize| E57Scan {
                    name: format!("scan {i}"),
                    world_from_scan: motion(i),
                    summary: summary.clone(),
                    blocks: Box::new(blocks()),
                };
                io::write_e57(path, "a collection", (0..2).map(|i| Ok(scan(i))))
            });
        }
        let list = "element face 1\nproperty list uchar int vertex_indices\n";
        let rows = "0 0 0\n1 0 0\n0 1 0.5\n3 0 1 2\n";
        self.add("ply", ply("ascii", "3", &format!("{}{list}", files::PLY_XYZ), rows.as_bytes()));
        let big: Vec<u8> = (0..9).flat_map(|i| (i as f32).to_be_bytes()).collect();
        self.add("ply", ply("binary_big_endian", "3", files::PLY_XYZ, &big));
        self.add("pcd", pcd("ascii", "3", b"0 0 0\n1 0 0\nnan 1 0.5\n"));
        for (kind, bytes) in [("'<f8'", 8), ("'<i2'", 2), ("'|u1'", 1)] {
            self.add("npy", npy(kind, "True", "(4, 3)", &vec![0; 12 * bytes]));
        }
        let fields = "[('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4')]";
        let rows: Vec<u8> = (0..16).flat_map(|i| (i as f32).to_le_bytes()).collect();
        self.add("npy", npy(fields, "False", "(4,)", &rows));
    }

    fn text(&mut self) {
        self.add("ptx", ptx("2", "6").repeat(2));
        // Files of fewer rows are taken for other tables.
        let row = |i: usize| {
            let [x, y, z] = [7 * i % POINTS, 5 * i % POINTS, i * i % 11].map(|k| k as f64);
            [0.5 + 0.5 * x, 1.0 + 0.25 * y, 0.125 * z]
        };
        let lines = |line: &dyn Fn([f64; 3], usize) -> String| -> String {
            (0..POINTS).map(|i| line(row(i), i)).collect()
        };
        let far = |[x, y, z]: [f64; 3], _| format!("{:.3} {:.3} {z:e}\r\n", x + 431_000.0, y + 5_812_000.0);
        self.add("xyz", format!("# exported\r\n{}", lines(&far)));
        self.add("xyz", lines(&|[x, y, z], _| format!("{x:.2} {y:.2} {z:.2}\n")).replace('.', ","));
        let pts = |[x, y, z]: [f64; 3], i: usize| format!("{x} {y} {z} {} 255 {i} 0\n", -100 * i as i32);
        self.add("pts", format!("{POINTS}\n{}", lines(&pts)));
        let csv = |[x, y, z]: [f64; 3], i: usize| format!("{x};{y};{z};0.25;255;0;{i}\n");
        self.add("csv", format!("X;Y;Z;Intensity;R;G;B\n{}", lines(&csv)));
        self.add("csv", lines(&|[x, y, z], i| format!("{x}, {y}, {z}, {}\n", i * 3 % 7)));
        self.add(
            "csv",
            format!("//X,Y,Z,Nx,Ny,Nz\n{}", lines(&|[x, y, z], _| format!("{x},{y},{z},0,0,1\n"))),
        );
        let mm = |xyz: [f64; 3], _| format!("{}\t{}\t{}\n", 1e3 * xyz[0], 1e3 * xyz[1], 1e3 * xyz[2]);
        self.add("csv", format!("\u{feff}x [mm]\ty [mm]\tz [mm]\n{}", lines(&mm)));
        self.add(
            "obj",
            "o cube\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0.5 0 0 1\nvn 0 0 1\nf 1//1 2//1 3//1\n",
        );
        self.add("off", "COFF\n3 1 0\n0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0.5 0 0 255\n3 0 1 2\n");
        let triangle =
            "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0.5\nendloop\nendfacet\n";
        self.add("stl", format!("solid a\n{triangle}{triangle}endsolid a\n"));
        self.add("gzip", gzip(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n", 0, 0));
    }

    fn images(&mut self) {
        self.add("color-image", rgb_png(4, 2));
        self.add("color-image", rgb_png(8, 4));
        self.add("color-image", files::jpeg(4));
        for text in [
            "525 525 319.5 239.5\n",
            "525 0 319.5\n0 525 239.5\n0 0 1\n",
            "640 480 525 525 319.5 239.5\n",
            "{\"width\": 640, \"height\": 480, \"intrinsic_matrix\": [525, 0, 0, 0, 525, 0, 319.5, 239.5, 1]}",
            "{\"camera\": {\"w\": 640, \"h\": 480, \"fx\": 525, \"fy\": 525, \"cx\": 319.5, \"cy\": 239.5, \"scale\": 1000}}",
            "image_width: 640\nimage_height: 480\ndistortion_model: plumb_bob\nD: [0.1, 0, 0, 0, 0]\nK: [525, 0, 319.5, 0, 525, 239.5, 0, 0, 1]\n",
            "fx = 525\nfy = 525\ncx = 319.5\ncy = 239.5\n",
        ] {
            self.add("intrinsics", text);
        }
        let truth = "1.50 0.1 0.2 0.3 0 0 0 1\n1.52 0.1 0.2 0.4 0 0 0.6 0.8\n";
        self.add("frame-lists", truth);
        self.add("frame-lists", "1.5 depth/1.5.pgm 1.51 rgb/1.51.png\n2.5 depth/2.5.pgm 2.51 rgb/2.51.png\n");
        self.add("frame-lists", "# timestamp filename\n1.51 rgb/1.51.png\n2.51 rgb/2.51.png\n");
        self.add("frame-lists", "depth_scale: 5000\n");
    }

    /// Poses in every format, each of which every reader of poses may be given.
    fn poses(&mut self) {
        let first = self.all.len();
        self.written("initial-poses", |path| io::write_log_trajectory(path, &placed()));
        self.written("initial-poses", |path| io::write_tum(path, &placed()));
        self.written("initial-poses", |path| io::write_kitti(path, &SCANS.map(|_| motion(1))));
        let scans: Vec<io::PlacedScan> = placed().into_iter().map(placed_scan).collect();
        self.written("initial-poses", |path| io::write_csv_trajectory(path, &scans));
        self.written("initial-poses", |path| io::write_images_trajectory(path, &scans));
        self.written("initial-poses", |path| io::write_tum_trajectory(path, &scans, &SCANS));
        let node = |scan: &io::PlacedScan| io::GraphNode {
            id: scan.id,
            name: scan.name.clone(),
            world_from_scan: scan.world_from_scan,
        };
        let edge = io::GraphEdge {
            i: 0,
            j: 1,
            i_from_j: motion(1),
            information: Matrix6::identity() * 400.0,
            uncertain: true,
        };
        let graph =
            io::PoseGraphFile { nodes: scans.iter().map(node).collect(), pivot: 0, edges: vec![edge] };
        self.written("initial-poses", |path| io::write_g2o(path, &graph));
        let matrices = || placed().into_iter().map(|(ScanId(i), pose)| (SCANS[i], rows(&pose)));
        let map: Vec<String> = matrices().map(|(name, rows)| format!("\"{name}.ply\": {rows:?}")).collect();
        self.add("initial-poses", format!("{{{}}}", map.join(",\n")));
        self.add("truth", format!("{{{}}}", map.join(",\n")));
        let lists: Vec<Seed> =
            self.all[first..].iter().map(|(_, bytes)| ("pose-lists", bytes.clone())).collect();
        self.all.extend(lists);
        let info = |i: usize, j: usize| io::InfoEntry { i, j, n: 3, information: Matrix6::identity() };
        for document in ["pose-lists", "gt-info"] {
            self.written(document, |path| io::write_info(path, &[info(0, 1), info(1, 2)]));
        }
        let log = |i: usize, j: usize| io::LogEntry { i, j, n: 3, pose: motion(i) };
        self.written("gt-log", |path| io::write_log(path, &[log(0, 1), log(1, 2)]));
        let matrix = "1 0 0 0.5\n0 0 -1 2\n0 1 0 3\n0 0 0 1\n";
        self.add("frame-pose", matrix);
        self.add("pose-lists", format!("0 0 1\n{matrix}"));
        self.add("pose-lists", "bmesh a.ply 0.1 0.2 0.3 0 0 0 1\nbmesh b.ply 1 2 3 0 0 0.6 0.8\n");
        self.add("pose-lists", "0,1,0.8017\n0 2 0\n3,12,1\n");
        self.add("pose-names", SCANS.join("\n"));
    }

    fn results(&mut self) {
        let document = document();
        self.add("poses-json", document.to_json());
        let bare = Document {
            format: POSES_FORMAT.to_owned(),
            version: POSES_VERSION,
            components: vec![Component { pivot: Some(0), scans: vec![0, 1, 2] }],
            ..document
        };
        self.add("initial-poses", bare.to_json());
        self.add("report-json", report().to_json());
        let pairs = (0..SCANS.len()).flat_map(|i| (i + 1..SCANS.len()).map(move |j| (i, j)));
        let lines: String = pairs.map(|(i, j)| format!("{i},{j},0.2500,\n")).collect();
        self.add("overlap-csv", format!("scan_a,scan_b,predicted,verified\n{lines}"));
        let config = Config::default();
        self.add("config", "seed = 7\n[scale]\nvoxel_m = 0.05\n[input]\nunit_m = 0.001\n");
        self.add("config", "seed = 7\nscale.voxel_m = 0.05\nregistration.strategy = \"incremental\"\n");
        self.add("config", toml::to_string(&config).unwrap_or_else(|e| panic!("{e}")));
    }

    fn features(&mut self) {
        let values = |n: usize| (0..n).map(|i| 1.0 + (i % 7) as f32).collect::<Vec<f32>>();
        let points: Vec<Point> = values(4 * 3).chunks_exact(3).map(Point::from_slice).collect();
        let descriptors = Descriptors::new(5, values(4 * 5)).unwrap_or_else(|e| panic!("{e}"));
        let features = Features { keypoints: points, normals: Some(vec![Direction::z(); 4]), descriptors };
        self.written("features", |path| io::write_features(path, &features));
        let bytes: Vec<u8> = values(12).into_iter().flat_map(f32::to_le_bytes).collect();
        let array = npy("'<f4'", "False", "(4, 3)", &bytes);
        self.add("features", checksums::archive(&[("keypoints.npy", &array), ("descriptors.npy", &array)]));
        self.add("features-array", array);
        self.add("keypoints-text", "0\n5\n11\n");
        self.add("keypoints-text", "0.5 1 2\n1.5 2 3\n2.5 3 4\n");
        let key = |a: u8, b: u8| PairKey { target: [a; 16], source: [b; 16] };
        let pairs = BTreeMap::from([
            (
                key(3, 255),
                (PairRegistration { target_from_source: motion(2), ..PairRegistration::default() }, 0.5),
            ),
            (key(0, 1), (PairRegistration::default(), 0.0)),
        ]);
        self.written("kept-pairs", |path| io::write_pairs(path, SETTINGS, &pairs));
        let hypothesis = |k: usize| ShardHypothesis {
            first_from_second: motion(k),
            evidence: Evidence::default(),
            seen_through: [0.1, 0.2],
        };
        let pair = |scans: (usize, usize), hypotheses: usize| ShardPair {
            scans,
            matches: (0..3 * hypotheses as u32).map(|k| (k, 2 * k)).collect(),
            hypotheses: (0..hypotheses).map(hypothesis).collect(),
        };
        let header = PairShardHeader {
            program: "0.1.0".to_owned(),
            shard: 0,
            shards: 1,
            settings: BTreeMap::from([("seed".to_owned(), "0".to_owned())]),
            scans: 3,
            content: "ab12".to_owned(),
            planned: 3,
        };
        let shard = PairShard { header, pairs: vec![pair((0, 1), 2), pair((0, 2), 0), pair((1, 2), 1)] };
        self.written("pair-shard", |path| io::write_pair_shard(path, &shard));
    }

    fn networks(&mut self) {
        let layer =
            NetVladConfig { clusters: 2, dim: 3, alpha: 1.0, bias: Default::default(), seed: 1 }.init();
        let heads =
            [HeadWeights::NetVlad(layer), HeadWeights::Gem { layer: retrieval::Gem::default(), dim: 3 }];
        for weights in heads {
            let meta = retrieval::CheckpointMeta {
                format_version: 1,
                name: "a head".to_owned(),
                architecture: retrieval::Checkpoint::architecture_of(&weights),
                descriptor: DescriptorTag { name: "fpfh".to_owned(), dim: 3, settings_hash: String::new() },
                recipe: serde_json::json!({"epochs": 3}),
                data: DataSummary::default(),
                metrics: BTreeMap::from([("recall".to_owned(), 0.5)]),
                epoch: 3,
            };
            let moments = |values: &[f32]| (values.to_vec(), values.to_vec());
            let moments = weights.parameters().into_iter().map(moments).collect();
            let optimizer = Some(retrieval::OptimizerState { steps: 5, moments });
            let checkpoint = retrieval::Checkpoint { meta, weights, optimizer };
            self.written("head", |path| checkpoint.save(path));
        }
        let architecture = mini_spin_net::Architecture {
            point_channels: mini_spin_net::GROUP,
            channels: vec![mini_spin_net::GROUP],
            attention_channels: mini_spin_net::GROUP,
        };
        let network = mini_spin_net::Checkpoint {
            meta: mini_spin_net::Meta {
                format_version: mini_spin_net::FORMAT_VERSION,
                descriptor: mini_spin_net::DESCRIPTOR.to_owned(),
                name: "a network".to_owned(),
                architecture: architecture.clone(),
                source: "a seed".to_owned(),
                licence: "MIT".to_owned(),
                recipe: serde_json::Value::Null,
                metrics: BTreeMap::new(),
                steps: 1,
            },
            weights: mini_spin_net::Weights::initial(&architecture, 1),
        };
        self.written("network", |path| network.save(path));
        self.add("lits", lits());
        let array = scanweave_core::files::Array::new(&[2], vec![0.5, 1.0]);
        let arrays = scanweave_core::files::Arrays::from([("weight".to_owned(), array)]);
        self.written("network", |path| scanweave_core::files::save_arrays(path, &network.meta, &arrays));
    }
}

fn rows(pose: &RigidMotion) -> [[f64; 4]; 4] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
}

fn placed_scan((id, world_from_scan): (ScanId, RigidMotion)) -> io::PlacedScan {
    let name = SCANS[id.0].to_owned();
    io::PlacedScan {
        id,
        file: Some(format!("{name}.ply")),
        name,
        component: 0,
        world_from_scan,
        probability: Some(0.99),
        sigma_t_m: Some(0.01),
        sigma_r_deg: None,
    }
}

fn document() -> Document {
    let scan = |i: usize| Scan { id: ScanId(i), name: SCANS[i].to_owned(), ..Scan::default() };
    let outcome = |i: usize| match i {
        3 => Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 }),
        _ => {
            let mut placement = Placement::at(if i == 0 { RigidMotion::identity() } else { motion(i) }, 0);
            placement.step = i;
            placement.parent = (i > 0).then_some(ScanId(0));
            placement.matches = 40 * i;
            placement.inliers = 30 * i;
            placement.residual_m = 0.01;
            placement.neighbours = vec![NeighbourEvidence::new(ScanId(usize::from(i == 0)), 0.5, 0.01)];
            placement.neighbours[0].plane_distance_m = Some(0.002);
            Outcome::Placed(placement)
        }
    };
    let scans: Vec<Scan> = (0..SCANS.len()).map(scan).collect();
    Document::new(&scans, &Reconstruction::new((0..SCANS.len()).map(outcome).collect()), 0.07)
}

fn report() -> RunReport {
    let row = |i: usize| Row {
        scan: SCANS[i].to_owned(),
        outcome: if i < 3 { "placed" } else { "declined" }.to_owned(),
        component: (i < 3).then_some(0),
        step: Some(i),
        parent: None,
        matches: Some(40),
        inliers: Some(30),
        inlier_ratio: Some(0.75),
        overlap: Some(0.5),
        residual_m: Some(0.01),
        probability: Some(0.99),
        doubts: Vec::new(),
        reason: None,
    };
    let size = ScanSize {
        points: 1000,
        dropped_rows: 1,
        stray_points: 2,
        surface_points: 500,
        keypoints: 100,
        features_reused: false,
    };
    RunReport {
        generator: "scanweave".to_owned(),
        run_id: Some("0123abcd".to_owned()),
        seed: 0,
        preset: "default".to_owned(),
        threads: 2,
        scale: WorkingScale::from_voxel(0.05),
        overlap_head: "built in".to_owned(),
        method: "agglomerative".to_owned(),
        registered_pairs: Some(6),
        pair_seconds: Some(1.5),
        edges: Some(3),
        placed: 3,
        declined: 1,
        components: 1,
        evidence: (0..SCANS.len()).map(row).collect(),
        sizes: vec![size; SCANS.len()],
        timings: vec![StageTime { stage: "reading".to_owned(), seconds: 0.5 }],
        total_seconds: 0.5,
        peak_memory_bytes: Some(1 << 20),
    }
}

/// The smallest network of LITS: the shapes of its layers are fixed.
fn lits() -> Vec<u8> {
    const LAYERS: [(&str, usize, usize); 10] = [
        ("global_model.global_mlp.0", 20, 256),
        ("global_model.global_mlp.2", 256, 4),
        ("node_model.node_mlp_1.0", 44, 256),
        ("node_model.node_mlp_1.2", 256, 256),
        ("node_model.node_mlp_2.0", 276, 256),
        ("node_model.node_mlp_2.2", 256, 22),
        ("node_model.weights_mlp_1.0", 44, 256),
        ("node_model.weights_mlp_1.2", 256, 128),
        ("node_model.weights_mlp_2.0", 256, 256),
        ("node_model.weights_mlp_2.2", 256, 1),
    ];
    let tensors = LAYERS.into_iter().flat_map(|(layer, inputs, outputs)| {
        [
            (format!("{layer}.weight"), (vec![outputs, inputs], vec![0.25; inputs * outputs])),
            (format!("{layer}.bias"), (vec![outputs], vec![0.5; outputs])),
        ]
    });
    let weights = LitsWeights::from_tensors(tensors.collect()).unwrap_or_else(|e| panic!("{e}"));
    weights.to_bytes().unwrap_or_else(|e| panic!("{e}"))
}

/// A colour image of 8 bits a channel.
fn rgb_png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(::png::ColorType::Rgb);
    let pixels: Vec<u8> = (0..3 * width * height).map(|i| i as u8).collect();
    let written = encoder.write_header().and_then(|mut file| file.write_image_data(&pixels));
    written.unwrap_or_else(|e| panic!("{e}"));
    bytes
}
