//! Reductions over groups of rows.

use crate::KernelError;
use crate::permute::{prefetch_rows, row_start};
use crate::shape::elements;
use crate::simd::{Vector, dispatch};
use rayon::prelude::*;
use std::ops::Range;

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

/// Which rows belong together: group `g` holds `rows()[offsets()[g]..offsets()[g + 1]]`, and every row
/// is in one group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Groups {
    rows: Vec<u32>,
    offsets: Vec<u32>,
    inverse: Vec<u32>,
}

impl Groups {
    /// Groups listed one after the other.
    ///
    /// # Shapes
    /// `rows`: `[N]`, each of 0..N once · `offsets`: `[G + 1]`, from 0 to N, never falling
    ///
    /// # Errors
    /// If a row is missing, out of range or there twice, or the offsets do not cut the list.
    pub fn new(rows: Vec<u32>, offsets: Vec<u32>) -> Result<Self, KernelError> {
        let n = rows.len();
        let bad = |problem: String| KernelError::Groups { rows: n, problem };
        let ends = (offsets.first().copied(), offsets.last().map(|&o| o as usize));
        if ends != (Some(0), Some(n)) || !offsets.is_sorted() {
            return Err(bad(format!("offsets must rise from 0 to {n}, got {offsets:?}")));
        }
        /// No group yet; there are fewer groups than rows can be numbered.
        const NONE: u32 = u32::MAX;
        let mut inverse = vec![NONE; n];
        for (group, span) in offsets.windows(2).enumerate() {
            for &row in &rows[span[0] as usize..span[1] as usize] {
                match inverse.get_mut(row as usize) {
                    Some(of) if *of == NONE => *of = group as u32,
                    Some(_) => return Err(bad(format!("row {row} is there twice"))),
                    None => return Err(bad(format!("row {row} is out of range"))),
                }
            }
        }
        Ok(Self { rows, offsets, inverse })
    }

    /// Groups whose parts are known to fit each other.
    pub(crate) fn of_parts(rows: Vec<u32>, offsets: Vec<u32>, inverse: Vec<u32>) -> Self {
        Self { rows, offsets, inverse }
    }

    /// Row numbers, group after group. `[N]`
    pub fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// Where each group starts in [`Self::rows`], closed by their number. `[G + 1]`
    pub fn offsets(&self) -> &[u32] {
        &self.offsets
    }

    /// Group of each row. `[N]`
    pub fn inverse(&self) -> &[u32] {
        &self.inverse
    }

    /// Number of groups.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there is no group.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    #[inline(always)]
    fn span(&self, group: usize) -> Range<usize> {
        self.offsets[group] as usize..self.offsets[group + 1] as usize
    }
}

/// Groups of one task at least.
const GROUPS_PER_TASK: usize = 64;
/// Rows that one task of the backward fills.
const ROWS_PER_TASK: usize = 64;

/// Reduces each group of rows; members are taken in the order of [`Groups::rows`].
///
/// # Shapes
/// `x`: `[N, C]` · `out`: `[G, C]`
///
/// # Panics
/// If lengths do not fit the groups (a bug of the caller).
pub fn reduce(x: &[f32], c: usize, groups: &Groups, how: Reduce, out: &mut [f32]) {
    assert_eq!(x.len(), elements([groups.rows.len(), c]), "groups: input length");
    assert_eq!(out.len(), elements([groups.len(), c]), "groups: output length");
    if c == 0 {
        return;
    }
    out.par_chunks_mut(GROUPS_PER_TASK * c).enumerate().for_each(|(task, out)| {
        let first = task * GROUPS_PER_TASK;
        dispatch!((x: &[f32], c: usize, groups: &Groups, first: usize, how: Reduce,
            out: &mut [f32]),
            V => reduce_groups::<V>(x, c, groups, first, how, out));
    });
}

/// Reduces the groups from `first` on, as many as `out` has rows.
#[inline(always)]
unsafe fn reduce_groups<V: Vector>(
    x: &[f32],
    c: usize,
    groups: &Groups,
    first: usize,
    how: Reduce,
    out: &mut [f32],
) {
    for (i, out) in out.chunks_exact_mut(c).enumerate() {
        let span = groups.span(first + i);
        let rows = &groups.rows[span.clone()];
        prefetch_rows(x, c, &groups.rows, span.end, rows.len());
        let row = |r: u32| &x[row_start(r, c)..][..c];
        let Some((&head, rest)) = rows.split_first() else {
            out.fill(0.0);
            continue;
        };
        out.copy_from_slice(row(head));
        for &r in rest {
            let values = row(r);
            if how == Reduce::Max {
                for j in 0..c {
                    out[j] = if exceeds(values[j], out[j]) { values[j] } else { out[j] };
                }
            } else {
                for j in 0..c {
                    out[j] += values[j];
                }
            }
        }
        if how == Reduce::Mean {
            let count = rows.len() as f32;
            out.iter_mut().for_each(|o| *o /= count);
        }
    }
}

/// Whether a value takes the place of the largest one so far: NaN exceeds all but NaN. Without a
/// branch, for the lanes of a register.
#[inline(always)]
fn exceeds(value: f32, largest: f32) -> bool {
    (value > largest) | (value.is_nan() & !largest.is_nan())
}

/// Gradient of [`reduce`] with respect to `x`; for the maximum it goes to the first largest member.
///
/// # Shapes
/// `x`, `dx`: `[N, C]` · `grad`: `[G, C]`
///
/// # Panics
/// As [`reduce`].
pub fn reduce_backward(
    x: &[f32],
    c: usize,
    groups: &Groups,
    how: Reduce,
    grad: &[f32],
    dx: &mut [f32],
) {
    assert_eq!(x.len(), elements([groups.rows.len(), c]), "groups: input length");
    assert_eq!(grad.len(), elements([groups.len(), c]), "groups: gradient length");
    assert_eq!(dx.len(), x.len(), "groups: result length");
    if c == 0 {
        return;
    }
    if how == Reduce::Max {
        let mut largest = vec![0; grad.len()];
        largest.par_chunks_mut(GROUPS_PER_TASK * c).enumerate().for_each(|(task, largest)| {
            let first = task * GROUPS_PER_TASK;
            dispatch!((x: &[f32], c: usize, groups: &Groups, first: usize, largest: &mut [u32]),
                V => largest_members::<V>(x, c, groups, first, largest));
        });
        let largest = largest.as_slice();
        for_rows(c, groups, dx, |inverse, first, dx| {
            dispatch!((c: usize, inverse: &[u32], first: usize, largest: &[u32], grad: &[f32],
                dx: &mut [f32]),
                V => to_largest::<V>(c, inverse, first, largest, grad, dx));
        });
    } else {
        for_rows(c, groups, dx, |inverse, _, dx| {
            let mean = how == Reduce::Mean;
            dispatch!((c: usize, groups: &Groups, inverse: &[u32], mean: bool, grad: &[f32],
                dx: &mut [f32]),
                V => to_all::<V>(c, groups, inverse, mean, grad, dx));
        });
    }
}

/// Calls `fill` with the groups of some rows, the first of these rows, and their gradients.
fn for_rows(
    c: usize,
    groups: &Groups,
    dx: &mut [f32],
    fill: impl Fn(&[u32], usize, &mut [f32]) + Sync,
) {
    dx.par_chunks_mut(ROWS_PER_TASK * c)
        .zip(groups.inverse.par_chunks(ROWS_PER_TASK))
        .enumerate()
        .for_each(|(task, (dx, inverse))| fill(inverse, task * ROWS_PER_TASK, dx));
}

/// The first largest member of each group from `first` on, per channel.
#[inline(always)]
unsafe fn largest_members<V: Vector>(
    x: &[f32],
    c: usize,
    groups: &Groups,
    first: usize,
    largest: &mut [u32],
) {
    let mut best = vec![0f32; c];
    for (i, largest) in largest.chunks_exact_mut(c).enumerate() {
        let span = groups.span(first + i);
        let rows = &groups.rows[span.clone()];
        prefetch_rows(x, c, &groups.rows, span.end, rows.len());
        let row = |r: u32| &x[row_start(r, c)..][..c];
        let Some((&head, rest)) = rows.split_first() else { continue };
        best.copy_from_slice(row(head));
        largest.fill(head);
        for &r in rest {
            let values = row(r);
            let best = &mut best[..c];
            for j in 0..c {
                let more = exceeds(values[j], best[j]);
                best[j] = if more { values[j] } else { best[j] };
                largest[j] = if more { r } else { largest[j] };
            }
        }
    }
}

#[inline(always)]
unsafe fn to_largest<V: Vector>(
    c: usize,
    inverse: &[u32],
    first: usize,
    largest: &[u32],
    grad: &[f32],
    dx: &mut [f32],
) {
    for (i, (dx, &g)) in dx.chunks_exact_mut(c).zip(inverse).enumerate() {
        let start = row_start(g, c);
        let (largest, grad) = (&largest[start..][..c], &grad[start..][..c]);
        let row = (first + i) as u32;
        for j in 0..c {
            dx[j] = if largest[j] == row { grad[j] } else { 0.0 };
        }
    }
}

#[inline(always)]
unsafe fn to_all<V: Vector>(
    c: usize,
    groups: &Groups,
    inverse: &[u32],
    mean: bool,
    grad: &[f32],
    dx: &mut [f32],
) {
    for (dx, &g) in dx.chunks_exact_mut(c).zip(inverse) {
        let grad = &grad[row_start(g, c)..][..c];
        if mean {
            let count = groups.span(g as usize).len() as f32;
            for j in 0..c {
                dx[j] = grad[j] / count;
            }
        } else {
            dx.copy_from_slice(grad);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn groups() -> Groups {
        Groups::new(vec![1, 2, 0], vec![0, 2, 3]).unwrap()
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
        let want = [false, true]
            .map(|m| scenesplat_test_support::reference::pool(&x, c, &inverse, used.len(), m));
        let all = Groups::new(rows, offsets).unwrap();
        assert_eq!(all.inverse, inverse);
        for (how, want) in [(Reduce::Mean, &want[0]), (Reduce::Max, &want[1])] {
            let mut out = vec![0.0; used.len() * c];
            reduce(&x, c, &all, how, &mut out);
            for (g, w) in out.iter().zip(want) {
                assert!((f64::from(*g) - w).abs() < 1e-4, "{how:?}: {g} {w}");
            }
        }
    }

    /// NaN is the largest, the first of equals takes the gradient, in vector lanes and in the rest.
    #[test]
    fn maximum_of_nan_infinities_and_equals() {
        let (n, c) = (3 * 200, 21);
        let pick = [1.0, f32::NAN, -1.0, f32::INFINITY, 1.0, f32::NEG_INFINITY, 0.0];
        let x: Vec<f32> = (0..n * c).map(|i| pick[i * i % 31 % pick.len()]).collect();
        let rows: Vec<u32> = (0..n as u32).map(|i| i * 7 % n as u32).collect();
        let mut inverse = vec![0; n];
        rows.iter().enumerate().for_each(|(i, &r)| inverse[r as usize] = i as u32 / 3);
        let all = Groups::new(rows, (0..=n as u32).step_by(3).collect()).unwrap();
        assert_eq!(all.inverse, inverse);
        let mut out = vec![0.0; all.len() * c];
        reduce(&x, c, &all, Reduce::Max, &mut out);
        let grad: Vec<f32> = (1..=out.len()).map(|i| i as f32).collect();
        let (mut dx, mut want) = (vec![f32::NAN; n * c], vec![0.0; n * c]);
        reduce_backward(&x, c, &all, Reduce::Max, &grad, &mut dx);
        for g in 0..all.len() {
            for j in 0..c {
                let members = &all.rows[all.span(g)];
                let value = |r: &&u32| x[**r as usize * c + j];
                let top = members.iter().map(|r| value(&r)).fold(f32::NEG_INFINITY, f32::max);
                let first = members.iter().find(|r| value(r).is_nan());
                let first = first.or_else(|| members.iter().find(|r| value(r) == top)).unwrap();
                assert_eq!(out[g * c + j].to_bits(), value(&first).to_bits());
                want[*first as usize * c + j] = grad[g * c + j];
            }
        }
        assert_eq!(dx, want);
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
