//! Reductions over groups of rows.

use rayon::prelude::*;

/// How the rows of a group become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reduce {
    /// Arithmetic mean.
    Mean,
    /// Largest value per channel; NaN counts as larger than anything.
    Max,
    /// Sum.
    Sum,
}

/// Which rows belong together: group `g` holds `rows[offsets[g]..offsets[g + 1]]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Groups {
    /// Row numbers, group after group. `[N]`
    pub rows: Vec<u32>,
    /// `[G + 1]`
    pub offsets: Vec<u32>,
    /// Group of each row. `[N]`
    pub inverse: Vec<u32>,
}

impl Groups {
    /// Number of groups.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there is no group.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn members(&self, group: usize) -> &[u32] {
        &self.rows[self.offsets[group] as usize..self.offsets[group + 1] as usize]
    }
}

/// Reduces each group of rows; members are taken in the order of `groups.rows`.
///
/// # Shapes
/// `x`: `[N, C]` · `out`: `[G, C]`
pub fn reduce(x: &[f32], c: usize, groups: &Groups, how: Reduce, out: &mut [f32]) {
    if c == 0 {
        return;
    }
    out.par_chunks_mut(c).enumerate().with_min_len(256).for_each(|(g, out)| {
        let rows = groups.members(g);
        let row = |r: u32| &x[r as usize * c..(r as usize + 1) * c];
        let Some((&first, rest)) = rows.split_first() else {
            out.fill(0.0);
            return;
        };
        out.copy_from_slice(row(first));
        for &r in rest {
            for (o, v) in out.iter_mut().zip(row(r)) {
                match how {
                    Reduce::Max => {
                        if *v > *o || v.is_nan() {
                            *o = *v;
                        }
                    }
                    Reduce::Mean | Reduce::Sum => *o += v,
                }
            }
        }
        if how == Reduce::Mean {
            let count = rows.len() as f32;
            out.iter_mut().for_each(|o| *o /= count);
        }
    });
}

/// Gradient of [`reduce`] with respect to `x`; for the maximum it goes to the first largest member.
///
/// # Shapes
/// `x`, `dx`: `[N, C]` · `grad`: `[G, C]`
pub fn reduce_backward(
    x: &[f32],
    c: usize,
    groups: &Groups,
    how: Reduce,
    grad: &[f32],
    dx: &mut [f32],
) {
    if c == 0 {
        return;
    }
    if how == Reduce::Max {
        dx.fill(0.0);
        for g in 0..groups.len() {
            let rows = groups.members(g);
            for j in 0..c {
                let value = |r: u32| x[r as usize * c + j];
                let mut best = None;
                for &r in rows {
                    match best {
                        Some(b) if value(r) <= value(b) || value(b).is_nan() => {}
                        _ => best = Some(r),
                    }
                }
                if let Some(best) = best {
                    dx[best as usize * c + j] = grad[g * c + j];
                }
            }
        }
        return;
    }
    dx.par_chunks_mut(c).zip(&groups.inverse).with_min_len(256).for_each(|(dx, &g)| {
        let g = g as usize;
        let count = (groups.offsets[g + 1] - groups.offsets[g]) as f32;
        for (d, v) in dx.iter_mut().zip(&grad[g * c..(g + 1) * c]) {
            *d = if how == Reduce::Mean { v / count } else { *v };
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn groups() -> Groups {
        Groups { rows: vec![1, 2, 0], offsets: vec![0, 2, 3], inverse: vec![1, 0, 0] }
    }

    #[test]
    fn reduces_by_hand() {
        let x = [1.0, 2.0, 3.0, 4.0, 5.0, -6.0];
        let run = |how| {
            let mut out = [0.0; 4];
            reduce(&x, 2, &groups(), how, &mut out);
            out
        };
        assert_eq!(run(Reduce::Mean), [4.0, -1.0, 1.0, 2.0]);
        assert_eq!(run(Reduce::Sum), [8.0, -2.0, 1.0, 2.0]);
        assert_eq!(run(Reduce::Max), [5.0, 4.0, 1.0, 2.0]);
    }

    #[test]
    fn agrees_with_f64_on_uneven_groups() {
        let (n, c, groups) = (5000usize, 7, 640);
        let inverse: Vec<u32> = (0..n).map(|i| (i * i % groups) as u32).collect();
        // Only groups that have rows, renumbered.
        let mut used: Vec<u32> = inverse.clone();
        used.sort_unstable();
        used.dedup();
        let inverse: Vec<u32> =
            inverse.iter().map(|g| used.binary_search(g).unwrap() as u32).collect();
        let mut rows: Vec<u32> = (0..n as u32).collect();
        rows.sort_by_key(|&r| inverse[r as usize]);
        let mut offsets = vec![0u32; used.len() + 1];
        inverse.iter().for_each(|&g| offsets[g as usize + 1] += 1);
        (0..used.len()).for_each(|g| offsets[g + 1] += offsets[g]);
        let x: Vec<f32> = (0..n * c).map(|i| (i * 31 % 1009) as f32 - 500.0).collect();
        let want = [false, true].map(|m| crate::reference::pool(&x, c, &inverse, used.len(), m));
        let all = Groups { rows, offsets, inverse };
        for (how, want) in [(Reduce::Mean, &want[0]), (Reduce::Max, &want[1])] {
            let mut out = vec![0.0; used.len() * c];
            reduce(&x, c, &all, how, &mut out);
            for (g, w) in out.iter().zip(want) {
                assert!((f64::from(*g) - w).abs() < 1e-4, "{how:?}: {g} {w}");
            }
        }
    }

    #[test]
    fn gradients_by_hand() {
        let x = [1.0, 2.0, 3.0, 4.0, 3.0, -6.0];
        let grad = [10.0, 20.0, 30.0, 40.0];
        let run = |how| {
            let mut dx = [f32::NAN; 6];
            reduce_backward(&x, 2, &groups(), how, &grad, &mut dx);
            dx
        };
        assert_eq!(run(Reduce::Mean), [30.0, 40.0, 5.0, 10.0, 5.0, 10.0]);
        assert_eq!(run(Reduce::Sum), [30.0, 40.0, 10.0, 20.0, 10.0, 20.0]);
        assert_eq!(run(Reduce::Max), [30.0, 40.0, 10.0, 20.0, 0.0, 0.0], "ties go to the first");
    }
}
