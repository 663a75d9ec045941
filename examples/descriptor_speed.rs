//! MiniSpinNet descriptors a second, and the floor they are compared with.
//!
//! ```text
//! cargo run --release --example descriptor_speed
//! ```
//!
//! The floor is the time that the multiplications of the network as published (0.12 GFLOP a
//! keypoint) take at the rate of a general matrix product of the size of its largest layer, on as
//! many threads.

use anyhow::Result;
use burn::tensor::{Device, Tensor, TensorData};
use clap::Parser;
use rayon::prelude::*;
use scanweave::Silent;
use scanweave::descriptor::mini_spin_net::{self, Architecture, Network, Weights};
use scanweave::geometry::Point;
use scanweave::scan::WorkingScale;
use scanweave::synthetic::{self, SynthConfig};
use std::path::PathBuf;
use std::time::Instant;

/// Cells of the map that every convolution sees, and its filter taps.
const CELLS: usize = 7 * 20;
const TAPS: usize = 9;

#[derive(Parser)]
struct Arguments {
    /// Threads.
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Keypoints.
    #[arg(long, default_value_t = 5000)]
    keypoints: usize,
    /// Repetitions; the fastest counts.
    #[arg(long, default_value_t = 3)]
    repeat: usize,
    /// Weights; by default random ones of the published size.
    #[arg(long)]
    checkpoint: Option<PathBuf>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    rayon::ThreadPoolBuilder::new().num_threads(arguments.threads).build_global()?;
    let weights = match &arguments.checkpoint {
        Some(path) => mini_spin_net::Checkpoint::load(path)?.weights,
        None => Weights::initial(&Architecture::default(), 0),
    };
    let shapes = weights.architecture.shapes();
    let products: usize = shapes.iter().filter(|s| s.taps == TAPS).map(|s| s.inputs * s.outputs * TAPS).sum();
    let gflop = 2e-9 * (products * CELLS) as f64;

    let rate = product_rate(arguments.threads, arguments.repeat);
    let floor = rate / gflop;
    let config = SynthConfig { rooms: 1, scans: 1, ..SynthConfig::default() };
    let scan = &synthetic::generate(&config, &Silent)?.scans[0];
    let scale = WorkingScale::from_voxel(0.025);
    let surface = scanweave::preprocessing::thin(&scan.cloud, &scale);
    let count = arguments.keypoints;
    let chosen: Vec<Point> = scanweave::descriptor::choose_keypoints(&surface, count, 0)
        .into_iter()
        .map(|i| surface.points[i])
        .collect();
    let network = Network::new(&weights);
    let seconds = fastest(arguments.repeat, || {
        let radius_m = scale.feature_radius_m as f32;
        let viewpoint = &surface.viewpoint;
        std::hint::black_box(mini_spin_net::descriptors(
            &network,
            &surface.points,
            viewpoint,
            &chosen,
            radius_m,
            0,
        ));
    });
    let speed = chosen.len() as f64 / seconds;
    println!("network      channels {:?}, {gflop:.3} GFLOP a keypoint", weights.architecture.channels);
    println!("product      [140, 1152] x [1152, 128]: {rate:.0} GFLOP/s on {} threads", arguments.threads);
    println!("floor        {floor:.0} descriptors a second");
    println!("descriptors  {speed:.0} a second ({} in {seconds:.2} s)", chosen.len());
    println!("time         {:.2} of the floor's", floor / speed);
    Ok(())
}

/// GFLOP/s of the general product (Burn's CPU backend), one a thread.
fn product_rate(threads: usize, repeat: usize) -> f64 {
    const INNER: usize = 128 * TAPS;
    const OUTPUTS: usize = 128;
    const ROUNDS: usize = 20;
    let device = Device::flex();
    let matrix = |rows: usize, columns: usize| {
        let values = (0..rows * columns).map(|i| (i % 7) as f32).collect::<Vec<_>>();
        Tensor::<2>::from_data(TensorData::new(values, [rows, columns]), &device)
    };
    let (left, right) = (matrix(CELLS, INNER), matrix(INNER, OUTPUTS));
    let seconds = fastest(repeat, || {
        (0..threads).into_par_iter().for_each(|_| {
            for _ in 0..ROUNDS {
                std::hint::black_box(left.clone().matmul(right.clone()));
            }
        });
    });
    2e-9 * (threads * ROUNDS * CELLS * INNER * OUTPUTS) as f64 / seconds
}

fn fastest(repeat: usize, work: impl Fn()) -> f64 {
    let run = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    (0..repeat.max(1)).map(run).fold(f64::INFINITY, f64::min)
}
