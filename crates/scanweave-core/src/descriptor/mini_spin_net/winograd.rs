//! 3×3 convolution on a cylinder by Winograd's minimal filtering F(4×4, 3×3).
//!
//! Lavin & Gray, "Fast algorithms for convolutional neural networks", CVPR 2016,
//! <https://arxiv.org/abs/1509.09308>: a 4×4 tile of the output is Aᵀ[(G g Gᵀ) ⊙ (Bᵀ d B)]A, with d
//! the 6×6 inputs it depends on and g the filter. Summed over input channels, the products are 36
//! matrix products, and take a quarter of the multiplications of the plain sum.
//!
//! A map is `[elevation][azimuth][channel]`; beyond its first and last elevation it is zero, and in
//! azimuth it goes round.

use super::product::{self, GROUP};
use super::{AZIMUTHS, ELEVATIONS};
use pulp::Simd;

/// Side of an output tile.
const TILE: usize = 4;
/// Side of the input a tile depends on.
const INPUT: usize = TILE + 2;
const PRODUCTS: usize = INPUT * INPUT;
const TILE_ROWS: usize = ELEVATIONS.div_ceil(TILE);
const TILE_COLUMNS: usize = AZIMUTHS / TILE;
/// Tiles of one map.
const TILES: usize = TILE_ROWS * TILE_COLUMNS;
/// Cells of one map.
const CELLS: usize = ELEVATIONS * AZIMUTHS;

/// A convolution with its weights transformed once.
#[derive(Debug, Clone)]
pub struct Convolution {
    inputs: usize,
    outputs: usize,
    rectified: bool,
    /// One packed `[inputs, outputs]` matrix a product.
    weights: Vec<Vec<f32>>,
    bias: Vec<f32>,
}

/// Buffers that convolutions share.
#[derive(Debug, Default)]
pub struct Scratch {
    transformed: Vec<f32>,
    products: Vec<f32>,
}

impl Convolution {
    /// From a filter `[outputs, inputs, 3, 3]` (elevation, azimuth) and a bias `[outputs]`; both
    /// numbers of channels are multiples of [`GROUP`]. `rectified` puts a ReLU behind it.
    pub fn new(filter: &[f32], bias: &[f32], rectified: bool) -> Self {
        let outputs = bias.len();
        let inputs = filter.len() / (9 * outputs).max(1);
        debug_assert!(inputs.is_multiple_of(GROUP) && outputs.is_multiple_of(GROUP));
        let transformed: Vec<[f64; PRODUCTS]> = filter.chunks_exact(9).map(transform_filter).collect();
        let weights = (0..PRODUCTS)
            .map(|at| product::pack(inputs, outputs, |k, o| transformed[o * inputs + k][at] as f32))
            .collect();
        Self { inputs, outputs, rectified, weights, bias: bias.to_vec() }
    }

    /// Channels of the output.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Convolves maps `[n, 7·20, inputs]` into maps `[n, 7·20, outputs]`.
    #[inline(always)]
    pub fn forward<S: Simd>(&self, simd: S, maps: &[f32], scratch: &mut Scratch, result: &mut Vec<f32>) {
        let n = maps.len() / (CELLS * self.inputs);
        let tiles = n * TILES;
        // Grown once; every value that is read was written before.
        scratch.transformed.resize(PRODUCTS * tiles * self.inputs, 0.0);
        scratch.products.resize(PRODUCTS * tiles * self.outputs, 0.0);
        result.resize(n * CELLS * self.outputs, 0.0);
        transform_inputs(simd, maps, self.inputs, &mut scratch.transformed);
        let left = scratch.transformed.chunks_exact(tiles * self.inputs);
        let products = scratch.products.chunks_exact_mut(tiles * self.outputs);
        for ((left, right), product) in left.zip(&self.weights).zip(products) {
            product::multiply(simd, left, right, self.inputs, product);
        }
        self.transform_products(simd, &scratch.products, result);
    }

    /// Aᵀ M A of every tile, plus bias.
    #[inline(always)]
    fn transform_products<S: Simd>(&self, simd: S, products: &[f32], result: &mut [f32]) {
        let vectors = self.outputs / S::F32_LANES;
        let (products, _) = S::as_simd_f32s(products);
        let (result, _) = S::as_mut_simd_f32s(result);
        let (bias, _) = S::as_simd_f32s(&self.bias);
        let tiles = products.len() / (PRODUCTS * vectors);
        let zero = simd.splat_f32s(0.0);
        for tile in 0..tiles {
            let (map, row, column) = place(tile);
            for v in 0..vectors {
                let m = |at: usize| products[(at * tiles + tile) * vectors + v];
                let mut half = [[zero; INPUT]; TILE];
                (0..INPUT).for_each(|x| {
                    let column = output_1d(simd, std::array::from_fn(|y| m(y * INPUT + x)));
                    (0..TILE).for_each(|y| half[y][x] = column[y]);
                });
                for (y, half) in half.iter().enumerate().take(ELEVATIONS - row) {
                    for (x, value) in output_1d(simd, *half).into_iter().enumerate() {
                        let value = simd.add_f32s(value, bias[v]);
                        let value = if self.rectified { simd.max_f32s(value, zero) } else { value };
                        let cell = map * CELLS + (row + y) * AZIMUTHS + column + x;
                        result[cell * vectors + v] = value;
                    }
                }
            }
        }
    }
}

/// Map, first elevation and first azimuth of a tile.
#[inline(always)]
fn place(tile: usize) -> (usize, usize, usize) {
    let (map, at) = (tile / TILES, tile % TILES);
    (map, at / TILE_COLUMNS * TILE, at % TILE_COLUMNS * TILE)
}

/// Bᵀ d B of every tile, as `[36][tile][channel]`.
#[inline(always)]
fn transform_inputs<S: Simd>(simd: S, maps: &[f32], channels: usize, transformed: &mut [f32]) {
    let vectors = channels / S::F32_LANES;
    let (maps, _) = S::as_simd_f32s(maps);
    let (transformed, _) = S::as_mut_simd_f32s(transformed);
    let tiles = transformed.len() / (PRODUCTS * vectors);
    let zero = simd.splat_f32s(0.0);
    for tile in 0..tiles {
        let (map, row, column) = place(tile);
        let columns: [usize; INPUT] = std::array::from_fn(|x| (column + x + AZIMUTHS - 1) % AZIMUTHS);
        for v in 0..vectors {
            let mut half = [[zero; INPUT]; INPUT];
            for (x, &from) in columns.iter().enumerate() {
                let d = std::array::from_fn(|y| match (row + y).checked_sub(1) {
                    Some(y) if y < ELEVATIONS => maps[(map * CELLS + y * AZIMUTHS + from) * vectors + v],
                    _ => zero,
                });
                let column = input_1d(simd, d);
                (0..INPUT).for_each(|y| half[y][x] = column[y]);
            }
            for (y, half) in half.iter().enumerate() {
                for (x, value) in input_1d(simd, *half).into_iter().enumerate() {
                    transformed[((y * INPUT + x) * tiles + tile) * vectors + v] = value;
                }
            }
        }
    }
}

/// Bᵀ d.
#[inline(always)]
fn input_1d<S: Simd>(simd: S, d: [S::f32s; INPUT]) -> [S::f32s; INPUT] {
    let times = |factor: f32, x, y| simd.mul_add_f32s(simd.splat_f32s(factor), x, y);
    let even = times(-4.0, d[2], d[4]);
    let odd = times(-4.0, d[1], d[3]);
    let even2 = simd.sub_f32s(d[4], d[2]);
    let odd2 = simd.mul_f32s(simd.splat_f32s(2.0), simd.sub_f32s(d[3], d[1]));
    [
        times(4.0, d[0], times(-5.0, d[2], d[4])),
        simd.add_f32s(even, odd),
        simd.sub_f32s(even, odd),
        simd.add_f32s(even2, odd2),
        simd.sub_f32s(even2, odd2),
        times(4.0, d[1], times(-5.0, d[3], d[5])),
    ]
}

/// Aᵀ m.
#[inline(always)]
fn output_1d<S: Simd>(simd: S, m: [S::f32s; INPUT]) -> [S::f32s; TILE] {
    let times = |factor: f32, x, y| simd.mul_add_f32s(simd.splat_f32s(factor), x, y);
    let (sum, difference) = (simd.add_f32s(m[1], m[2]), simd.sub_f32s(m[1], m[2]));
    let (sum2, difference2) = (simd.add_f32s(m[3], m[4]), simd.sub_f32s(m[3], m[4]));
    [
        simd.add_f32s(m[0], simd.add_f32s(sum, sum2)),
        times(2.0, difference2, difference),
        times(4.0, sum2, sum),
        times(8.0, difference2, simd.add_f32s(difference, m[5])),
    ]
}

/// G g Gᵀ of a 3×3 filter.
fn transform_filter(g: &[f32]) -> [f64; PRODUCTS] {
    const G: [[f64; 3]; INPUT] = [
        [0.25, 0.0, 0.0],
        [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
        [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
        [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
        [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
        [0.0, 0.0, 1.0],
    ];
    std::array::from_fn(|at| {
        let (y, x) = (at / INPUT, at % INPUT);
        (0..9).map(|i| G[y][i / 3] * f64::from(g[i]) * G[x][i % 3]).sum()
    })
}
