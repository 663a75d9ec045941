//! The network as it runs: normalisation folded in, all convolutions by [`Convolution`].

use super::patch::Patch;
use super::product::{self, GROUP};
use super::sphere::{CELLS, NEIGHBOURS, Sphere};
use super::weights::Weights;
use super::winograd::{Convolution, Scratch};
use super::{AZIMUTHS, ELEVATIONS, RADII};
use pulp::{Arch, Simd, WithSimd};

/// Cells of one shell: the map that convolutions see.
const MAP: usize = ELEVATIONS * AZIMUTHS;
/// Floor of a norm before it divides, as in PyTorch's `normalize`.
const NORM_FLOOR: f32 = 1e-12;

/// A network ready to run.
#[derive(Debug, Clone)]
pub struct Network {
    sphere: Sphere,
    point_channels: usize,
    /// `[3][channels]` and `[channels]`.
    point: (Vec<f32>, Vec<f32>),
    convolutions: Vec<Convolution>,
    /// Packed `[D, hidden]`, and `[hidden]`.
    attention: (Vec<f32>, Vec<f32>),
    /// `[hidden]`, and the bias.
    attention_out: (Vec<f32>, f32),
}

/// Buffers of one thread.
#[derive(Debug, Default)]
pub struct Workspace {
    maps: Vec<f32>,
    next: Vec<f32>,
    hidden: Vec<f32>,
    scratch: Scratch,
}

impl Network {
    /// Folds normalisations and transforms filters.
    pub fn new(weights: &Weights) -> Self {
        let shapes = weights.architecture.shapes();
        let folded: Vec<(Vec<f32>, Vec<f32>)> = weights.layers.iter().map(|l| l.folded()).collect();
        let last = weights.architecture.channels.len();
        let convolutions = (1..=last).map(|at| Convolution::new(&folded[at].0, &folded[at].1, at < last));
        let (point, hidden, out) = (&folded[0], &folded[last + 1], &folded[last + 2]);
        let (dim, width) = (shapes[last + 1].inputs, shapes[last + 1].outputs);
        let channels = weights.architecture.point_channels;
        let by_axis = (0..3 * channels).map(|at| point.0[at % channels * 3 + at / channels]).collect();
        Self {
            sphere: Sphere::default(),
            point_channels: channels,
            point: (by_axis, point.1.clone()),
            convolutions: convolutions.collect(),
            attention: (product::pack(dim, width, |k, o| hidden.0[o * dim + k]), hidden.1.clone()),
            attention_out: (out.0.clone(), out.1.first().copied().unwrap_or(0.0)),
        }
    }

    /// Descriptor dimension D.
    pub fn dim(&self) -> usize {
        self.convolutions.last().map_or(0, Convolution::outputs)
    }

    /// Unit descriptors `[n, D]` of patches, written to `descriptors` `[n · D]`. The result of a
    /// patch does not depend on those beside it.
    pub fn describe(&self, patches: &[Patch], workspace: &mut Workspace, descriptors: &mut [f32]) {
        Arch::new().dispatch(Pass { network: self, patches, workspace, descriptors });
    }

    /// First layer: for every cell the maximum over its points, as maps
    /// `[n][elevation][azimuth][radius · channels]`.
    #[inline(always)]
    fn point_layer<S: Simd>(&self, simd: S, patches: &[Patch], maps: &mut Vec<f32>) {
        let channels = self.point_channels;
        maps.resize(patches.len() * CELLS * channels, 0.0);
        let (weights, _) = S::as_simd_f32s(&self.point.0);
        let (bias, _) = S::as_simd_f32s(&self.point.1);
        let vectors = bias.len();
        let (wx, rest) = weights.split_at(vectors);
        let (wy, wz) = rest.split_at(vectors);
        let zero = simd.splat_f32s(0.0);
        for (patch, map) in patches.iter().zip(maps.chunks_exact_mut(CELLS * channels)) {
            for cell in 0..CELLS {
                let (points, count) = self.sphere.neighbours(patch, cell);
                let to = (cell % MAP * RADII + cell / MAP) * channels;
                let (out, _) = S::as_mut_simd_f32s(&mut map[to..to + channels]);
                for (v, out) in out.iter_mut().enumerate() {
                    // A missing neighbour is the zero vector, of which only the bias is left.
                    let least = if count < NEIGHBOURS { zero } else { simd.splat_f32s(f32::NEG_INFINITY) };
                    let most = points[..count].iter().fold(least, |most, &[x, y, z]| {
                        let value = simd.mul_f32s(simd.splat_f32s(x), wx[v]);
                        let value = simd.mul_add_f32s(simd.splat_f32s(y), wy[v], value);
                        simd.max_f32s(most, simd.mul_add_f32s(simd.splat_f32s(z), wz[v], value))
                    });
                    *out = simd.max_f32s(simd.add_f32s(most, bias[v]), zero);
                }
            }
        }
    }

    /// Mean over the cells of feature × attention, scaled to unit length.
    #[inline(always)]
    fn pool<S: Simd>(&self, simd: S, maps: &[f32], hidden: &mut Vec<f32>, descriptors: &mut [f32]) {
        let (dim, width) = (self.dim(), self.attention.1.len());
        let padded = width.next_multiple_of(GROUP);
        hidden.resize(maps.len() / dim * padded, 0.0);
        product::multiply(simd, maps, &self.attention.0, dim, hidden);
        let cells = maps.chunks_exact(MAP * dim).zip(hidden.chunks_exact(MAP * padded));
        for ((map, hidden), out) in cells.zip(descriptors.chunks_exact_mut(dim)) {
            out.fill(0.0);
            for (feature, hidden) in map.chunks_exact(dim).zip(hidden.chunks_exact(padded)) {
                let terms = hidden.iter().zip(&self.attention.1).zip(&self.attention_out.0);
                let sum: f32 = terms.map(|((h, b), w)| (h + b).max(0.0) * w).sum();
                let attention = (sum + self.attention_out.1).max(0.0);
                out.iter_mut().zip(feature).for_each(|(o, f)| *o += attention * f);
            }
            out.iter_mut().for_each(|v| *v /= MAP as f32);
            let norm = out.iter().map(|v| v * v).sum::<f32>().sqrt().max(NORM_FLOOR);
            out.iter_mut().for_each(|v| *v /= norm);
        }
    }
}

struct Pass<'a> {
    network: &'a Network,
    patches: &'a [Patch],
    workspace: &'a mut Workspace,
    descriptors: &'a mut [f32],
}

impl WithSimd for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Workspace { maps, next, hidden, scratch } = self.workspace;
        self.network.point_layer(simd, self.patches, maps);
        for convolution in &self.network.convolutions {
            convolution.forward(simd, maps, scratch, next);
            std::mem::swap(maps, next);
        }
        self.network.pool(simd, maps, hidden, self.descriptors);
    }
}
