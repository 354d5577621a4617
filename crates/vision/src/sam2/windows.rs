//! How a square of tokens is cut into windows.

use rayon::prelude::*;
use scenesplat_kernels::patches::{Patches, cut};

/// Windows of a square of tokens in raster order. Where the side of the windows does not divide that of the square, rows
/// for the tokens beyond it follow behind the real ones.
pub(super) struct Windows {
    side: usize,
    window: usize,
    /// Row at each position: window after window, each in raster order.
    order: Vec<u32>,
    patches: Patches,
}

impl Windows {
    pub fn new(side: usize, window: usize) -> Self {
        let across = side.div_ceil(window);
        let mut order = Vec::with_capacity((across * window).pow(2));
        let mut beyond = (side * side) as u32;
        for cell in 0..across * across {
            let (top, left) = (cell / across * window, cell % across * window);
            for token in 0..window * window {
                let (y, x) = (top + token / window, left + token % window);
                if y < side && x < side {
                    order.push((y * side + x) as u32);
                } else {
                    order.push(beyond);
                    beyond += 1;
                }
            }
        }
        let patches = cut(&[0, order.len()], window * window);
        Self { side, window, order, patches }
    }

    /// Rows, those beyond the square included.
    pub fn rows(&self) -> usize {
        self.order.len()
    }

    pub fn order(&self) -> &[u32] {
        &self.order
    }

    pub fn patches(&self) -> &Patches {
        &self.patches
    }

    /// Replaces the queries of the first quarter of each window by the largest of each 2 × 2 queries of it.
    ///
    /// The attention answers the other queries too, which nobody reads: three blocks of a network do this, and what is
    /// wasted is below a hundredth of its work.
    ///
    /// `qkv`: `[rows, 3 dim]`
    pub fn pool_queries(&self, qkv: &mut [f32], dim: usize) {
        let (window, half) = (self.window, self.window / 2);
        let mut pooled = vec![0.0; half * half * dim];
        for rows in self.order.chunks_exact(window * window) {
            for (token, out) in pooled.chunks_exact_mut(dim).enumerate() {
                let (y, x) = (2 * (token / half), 2 * (token % half));
                let at = |dy: usize, dx: usize| {
                    &qkv[rows[(y + dy) * window + x + dx] as usize * 3 * dim..][..dim]
                };
                let four = [at(0, 0), at(0, 1), at(1, 0), at(1, 1)];
                for (c, out) in out.iter_mut().enumerate() {
                    *out = four[0][c].max(four[1][c]).max(four[2][c].max(four[3][c]));
                }
            }
            for (row, query) in rows.iter().zip(pooled.chunks_exact(dim)) {
                qkv[*row as usize * 3 * dim..][..dim].copy_from_slice(query);
            }
        }
    }

    /// The answers to the queries that [`pool_queries`](Self::pool_queries) made, in raster order.
    ///
    /// `[rows, dim] → [(side / 2)², dim]`
    pub fn pooled(&self, attended: &[f32], dim: usize) -> Vec<f32> {
        let (side, half) = (self.side / 2, self.window / 2);
        let across = self.side.div_ceil(self.window);
        let mut out = vec![0.0; side * side * dim];
        out.par_chunks_mut(dim).enumerate().for_each(|(token, out)| {
            let (y, x) = (token / side, token % side);
            let cell = y / half * across + x / half;
            let slot = cell * self.window.pow(2) + y % half * half + x % half;
            out.copy_from_slice(&attended[self.order[slot] as usize * dim..][..dim]);
        });
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_by_hand() {
        let w = Windows::new(3, 2);
        assert_eq!(w.order, [0, 1, 3, 4, 2, 9, 5, 10, 6, 7, 11, 12, 8, 13, 14, 15]);
        assert_eq!(w.patches.patches().len(), 4);
        assert!(w.patches.patches().iter().all(|p| p.len == 4 && p.own == 4));
    }

    #[test]
    fn pooled_queries_come_back_in_raster_order() {
        // Queries are their row numbers; an attention that answers with the query itself.
        let (side, dim) = (6, 1);
        let w = Windows::new(side, 4);
        let mut qkv: Vec<f32> = (0..w.rows()).flat_map(|row| [row as f32, -1.0, -1.0]).collect();
        for row in 36..w.rows() {
            qkv[3 * row] = -1.0;
        }
        w.pool_queries(&mut qkv, dim);
        let answers: Vec<f32> = qkv.chunks_exact(3).map(|row| row[0]).collect();
        let got = w.pooled(&answers, dim);
        let want: Vec<f32> =
            (0..9).map(|t| ((2 * (t / 3) + 1) * side + 2 * (t % 3) + 1) as f32).collect();
        assert_eq!(got, want);
    }
}
