//! Rotary embedding of voxel coordinates: queries and keys turn with their place, so that their
//! product depends on how far apart two voxels are along each axis, and on nothing else of their
//! places.
//!
//! A head of `D` channels is `[u_x v_x u_y v_y u_z v_z]`, each `D/6` long. Pair `i` of an axis turns by
//! `p · base^(−i / (D/6))`, `p` being the voxel's number along that axis:
//! `u' = u cos − v sin`, `v' = v cos + u sin`. The gradient turns back.
//!
//! Angles are computed in f64 and rounded as sines and cosines: the first pair turns by a radian a
//! voxel, and at a thousand voxels an f32 angle would be off by 3e-5, one in bf16 by whole turns.
//!
//! # Source
//! "LitePT" (arXiv:2512.13689), `libs/pointrope` of prs-eth/LitePT. Differs: angles in f64 there f32.

use crate::patch_attention::Heads;
use crate::shape::elements;
use crate::simd::compiled;
use rayon::prelude::*;

/// Rows of one task.
const BLOCK: usize = 64;
/// Width of a head in every published network: its loops are unrolled.
const USUAL_DIM: usize = 18;

/// Which way rows turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// By the angles: queries and keys.
    Forward,
    /// Back: the gradients of what was turned forward.
    Back,
}

/// Sines and cosines of the angles of every row.
#[derive(Debug, Clone, PartialEq)]
pub struct Rotations {
    dim: usize,
    /// Cosine and sine of each pair, axis after axis. `[N, D/2]`
    pairs: Vec<[f32; 2]>,
}

impl Rotations {
    /// Angles of heads of `dim` channels at these voxels.
    ///
    /// # Shapes
    /// `grid_coord`: `[N, 3]`, any values
    ///
    /// # Panics
    /// If `dim` is not a multiple of 6 above 0 (configurations are checked before).
    pub fn new(grid_coord: &[[i32; 3]], dim: usize, base: f64) -> Self {
        assert!(dim > 0 && dim.is_multiple_of(6), "rotary embedding: head width {dim}");
        let count = dim / 6;
        let steps: Vec<f64> = (0..count).map(|i| base.powf(-(i as f64) / count as f64)).collect();
        let mut pairs = vec![[0.0; 2]; elements([grid_coord.len(), dim / 2])];
        let rows = pairs.par_chunks_mut(dim / 2).zip(grid_coord).with_min_len(BLOCK);
        rows.for_each(|(row, place)| {
            for (axis, p) in row.chunks_exact_mut(count).zip(place) {
                for (pair, step) in axis.iter_mut().zip(&steps) {
                    let (sin, cos) = (f64::from(*p) * step).sin_cos();
                    *pair = [cos as f32, sin as f32];
                }
            }
        });
        Self { dim, pairs }
    }

    /// Channels of a head.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        2 * self.pairs.len() / self.dim
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Cosine and sine of each pair of channels, axis after axis. `[N, D/2]`
    pub fn pairs(&self) -> &[[f32; 2]] {
        &self.pairs
    }

    /// Turns queries and keys in place and leaves values alone; every row and head for itself.
    ///
    /// # Shapes
    /// `qkv`: `[N, 3·C]`, the channels of a row being q, k, v, each `[heads, dim]`
    ///
    /// # Panics
    /// If heads have another width or lengths do not fit (bugs of the caller).
    pub fn apply(&self, qkv: &mut [f32], heads: Heads, turn: Turn) {
        assert_eq!(heads.dim, self.dim, "rotary embedding: head width");
        let c = heads.channels();
        assert_eq!(qkv.len(), elements([self.len(), 3, c]), "rotary embedding: length");
        if c == 0 {
            return;
        }
        let blocks =
            qkv.par_chunks_mut(BLOCK * 3 * c).zip(self.pairs.par_chunks(BLOCK * self.dim / 2));
        blocks.for_each(|(rows, pairs)| {
            compiled(
                #[inline(always)]
                || turn_rows(rows, pairs, c, self.dim, turn),
            );
        });
    }
}

/// Turns the queries and keys of a block of rows.
#[inline(always)]
fn turn_rows(rows: &mut [f32], pairs: &[[f32; 2]], c: usize, dim: usize, turn: Turn) {
    for (row, pairs) in rows.chunks_exact_mut(3 * c).zip(pairs.chunks_exact(dim / 2)) {
        for head in row[..2 * c].chunks_exact_mut(dim) {
            if dim == USUAL_DIM {
                turn_head(head, pairs, USUAL_DIM, turn);
            } else {
                turn_head(head, pairs, dim, turn);
            }
        }
    }
}

/// Turns the channels of one head.
#[inline(always)]
fn turn_head(head: &mut [f32], pairs: &[[f32; 2]], dim: usize, turn: Turn) {
    let count = dim / 6;
    for axis in 0..3 {
        let (u, v) = head[2 * axis * count..2 * (axis + 1) * count].split_at_mut(count);
        let pairs = &pairs[axis * count..(axis + 1) * count];
        for i in 0..count {
            let [cos, sin] = pairs[i];
            let sin = if turn == Turn::Back { -sin } else { sin };
            (u[i], v[i]) = (u[i] * cos - v[i] * sin, v[i] * cos + u[i] * sin);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::random;
    use scenesplat_test_support::reference;

    fn voxels(n: usize) -> Vec<[i32; 3]> {
        let n = n as i32;
        (0..n).map(|i| [i * 37 % 211, i * 11 % 97, i]).collect()
    }

    fn check(n: usize, heads: Heads, base: f64, far: i32) {
        let places: Vec<[i32; 3]> =
            voxels(n).into_iter().map(|p| [p[0] + far, p[1], p[2] - far]).collect();
        let c = heads.channels();
        let qkv = random(n * 3 * c, 9);
        let rotations = Rotations::new(&places, heads.dim, base);
        assert_eq!((rotations.len(), rotations.dim()), (n, heads.dim));
        let mut turned = qkv.clone();
        rotations.apply(&mut turned, heads, Turn::Forward);
        let want = reference::point_rope(&qkv, &places, heads.count, heads.dim, base);
        for (i, (got, want)) in turned.iter().zip(&want).enumerate() {
            // Both factors are rounded, and each product and the sum: below three units.
            assert!((f64::from(*got) - want).abs() < 1e-6, "{heads:?} {i}: {got} {want}");
        }
        for (row, before) in turned.chunks_exact(3 * c).zip(qkv.chunks_exact(3 * c)) {
            assert_eq!(row[2 * c..], before[2 * c..], "values do not turn");
        }
        // What turns back is what it was.
        rotations.apply(&mut turned, heads, Turn::Back);
        for (got, want) in turned.iter().zip(&qkv) {
            assert!((got - want).abs() < 2e-6, "{got} {want}");
        }
    }

    #[test]
    fn turns_as_the_formula_says() {
        for (n, count, dim) in [(0, 2, 18), (1, 1, 6), (130, 3, 18), (65, 2, 12), (70, 1, 48)] {
            check(n, Heads { count, dim }, 100.0, 0);
        }
        check(40, Heads { count: 2, dim: 18 }, 10_000.0, 1 << 20);
        Rotations::new(&voxels(5), 18, 100.0).apply(
            &mut [],
            Heads { count: 0, dim: 18 },
            Turn::Forward,
        );
    }

    #[test]
    fn products_see_differences_of_places_only() {
        let heads = Heads { count: 1, dim: 18 };
        let places = [[3, 7, 1], [5, 2, 900]];
        let qkv = random(2 * 3 * 18, 9);
        let product = |by: i32| {
            let places = places.map(|p| p.map(|v| v + by));
            let mut turned = qkv.clone();
            Rotations::new(&places, 18, 100.0).apply(&mut turned, heads, Turn::Forward);
            (0..18).map(|d| turned[d] * turned[54 + 18 + d]).sum::<f32>()
        };
        for by in [1, 1000, 1 << 20] {
            assert!(
                (product(by) - product(0)).abs() < 5e-6,
                "{by}: {} {}",
                product(by),
                product(0)
            );
        }
        // A voxel further away along one axis is another product.
        assert!(
            (product(0) - (0..18).map(|d| qkv[d] * qkv[54 + 18 + d]).sum::<f32>()).abs() > 1e-3
        );
    }

    #[test]
    fn one_bad_row_spoils_no_other() {
        let heads = Heads { count: 2, dim: 18 };
        let places = voxels(3);
        let mut qkv = random(3 * 3 * 36, 9);
        let rotations = Rotations::new(&places, 18, 100.0);
        let mut want = qkv.clone();
        rotations.apply(&mut want, heads, Turn::Forward);
        qkv[108 + 2] = f32::NAN;
        rotations.apply(&mut qkv, heads, Turn::Forward);
        for (i, (got, want)) in qkv.iter().zip(&want).enumerate() {
            // Its partner of the pair too, nothing else.
            let spoiled = i == 108 + 2 || i == 108 + 5;
            assert_eq!(got.is_nan(), spoiled, "{i}");
            assert!(spoiled || got.to_bits() == want.to_bits(), "{i}");
        }
    }
}
