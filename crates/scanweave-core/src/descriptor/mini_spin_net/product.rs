//! Matrix product in registers: the inner loop of every convolution.
//!
//! Safe code on the vectors of [`pulp`]: a tile of the result stays in registers while the
//! inner dimension runs, in the same order for every tile, so that a row's result does not
//! depend on the rows beside it.

use pulp::Simd;

/// Channels that lie side by side: one AVX-512 vector, two of AVX.
pub const GROUP: usize = 16;

/// `[inner, columns]` laid out as `[columns / 16][inner][16]`; missing columns are zero.
pub fn pack(inner: usize, columns: usize, value: impl Fn(usize, usize) -> f32) -> Vec<f32> {
    let mut packed = vec![0.0; columns.div_ceil(GROUP) * inner * GROUP];
    for column in 0..columns {
        for k in 0..inner {
            packed[(column / GROUP * inner + k) * GROUP + column % GROUP] = value(k, column);
        }
    }
    packed
}

/// `result[rows, columns] = left[rows, inner] · right`, all row-major but `right`, which is
/// [`pack`]ed; `columns` is a multiple of [`GROUP`].
#[inline(always)]
pub fn multiply<S: Simd>(simd: S, left: &[f32], right: &[f32], inner: usize, result: &mut [f32]) {
    // Rows and vectors of a tile: as many as the registers hold beside the operands.
    match (S::REGISTER_COUNT >= 32, S::F32_LANES) {
        (true, 16) => match right.len() / (inner * GROUP) {
            groups if groups % 4 == 0 => tiles::<S, 5, 4>(simd, left, right, inner, result),
            groups if groups % 2 == 0 => tiles::<S, 10, 2>(simd, left, right, inner, result),
            _ => tiles::<S, 10, 1>(simd, left, right, inner, result),
        },
        (_, 16) => tiles::<S, 5, 1>(simd, left, right, inner, result),
        (_, 8) => tiles::<S, 5, 2>(simd, left, right, inner, result),
        (true, 4) => tiles::<S, 5, 4>(simd, left, right, inner, result),
        (_, 4) => tiles::<S, 2, 4>(simd, left, right, inner, result),
        (_, 2) => tiles::<S, 1, 8>(simd, left, right, inner, result),
        _ => tiles::<S, 1, 16>(simd, left, right, inner, result),
    }
}

/// The whole product by tiles of `R` rows and `V` vectors.
#[inline(always)]
fn tiles<S: Simd, const R: usize, const V: usize>(
    simd: S,
    left: &[f32],
    right: &[f32],
    inner: usize,
    result: &mut [f32],
) {
    let columns = right.len() / inner;
    let lanes = S::F32_LANES;
    let width = V * lanes;
    let groups = width.div_ceil(GROUP).max(1);
    let (right, _) = S::as_simd_f32s(right);
    let per_group = GROUP / lanes;
    for (block, columns_at) in (0..columns).step_by(groups * GROUP).enumerate() {
        // Every vector of the tile has a stream of its own in the packed operand.
        let streams: [&[S::f32s]; V] = std::array::from_fn(|v| {
            let group = block * groups + v / per_group;
            &right[group * inner * per_group + v % per_group..]
        });
        let mut row = 0;
        let rows = left.len() / inner;
        while row + R <= rows {
            tile::<S, R, V>(simd, left, &streams, inner, columns, columns_at, row, result);
            row += R;
        }
        while row < rows {
            tile::<S, 1, V>(simd, left, &streams, inner, columns, columns_at, row, result);
            row += 1;
        }
    }
}

#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "one inner loop, inlined")]
fn tile<S: Simd, const R: usize, const V: usize>(
    simd: S,
    left: &[f32],
    right: &[&[S::f32s]; V],
    inner: usize,
    columns: usize,
    column: usize,
    row: usize,
    result: &mut [f32],
) {
    let per_group = GROUP / S::F32_LANES;
    let rows: [&[f32]; R] = std::array::from_fn(|r| &left[(row + r) * inner..][..inner]);
    let streams: [&[S::f32s]; V] = std::array::from_fn(|v| &right[v][..(inner - 1) * per_group + 1]);
    let mut sums = [[simd.splat_f32s(0.0); V]; R];
    for k in 0..inner {
        let b: [S::f32s; V] = std::array::from_fn(|v| streams[v][k * per_group]);
        for r in 0..R {
            let a = simd.splat_f32s(rows[r][k]);
            for v in 0..V {
                sums[r][v] = simd.mul_add_f32s(a, b[v], sums[r][v]);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        let (out, _) = S::as_mut_simd_f32s(&mut result[(row + r) * columns + column..][..V * S::F32_LANES]);
        out.iter_mut().zip(sums).for_each(|(out, sum)| *out = *sum);
    }
}
