//! Reductions over groups of rows.

use super::kernels;
use crate::launch::{Items::PerThread, Launcher, Scalar::U32};

kernels! { "segment":
    /// One value for each group and channel.
    REDUCE = segment_reduce, 256, PerThread;
    /// The gradient of a sum or a mean.
    REDUCE_BACKWARD = segment_reduce_backward, 256, PerThread;
    /// The first largest member of each group and channel.
    LARGEST = segment_largest, 256, PerThread;
    /// The gradient of a maximum.
    LARGEST_BACKWARD = segment_largest_backward, 256, PerThread;
}

/// How the rows of a group become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reduce {
    /// Sum.
    Sum,
    /// Arithmetic mean.
    Mean,
    /// Largest value per channel; NaN counts as larger than anything.
    Max,
}

impl Reduce {
    fn number(self) -> u32 {
        match self {
            Self::Sum => 0,
            Self::Mean => 1,
            Self::Max => 2,
        }
    }
}

/// Groups of rows on the device: group `g` holds `rows[offsets[g]..offsets[g + 1]]`, and row `r` is in
/// group `inverse[r]`.
#[derive(Debug)]
pub struct Groups<'a, B> {
    /// `[N]` of `u32`
    pub rows: &'a B,
    /// `[G + 1]` of `u32`
    pub offsets: &'a B,
    /// `[N]` of `u32`
    pub inverse: &'a B,
    /// Rows, N.
    pub num_rows: u32,
    /// Groups, G.
    pub num_groups: u32,
}

impl<B> Clone for Groups<'_, B> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<B> Copy for Groups<'_, B> {}

impl<B> Groups<'_, B> {
    fn check<L: Launcher<Buffer = B>>(&self, l: &L) {
        l.expect::<u32>("rows of the groups", self.rows, self.num_rows.into());
        l.expect::<u32>("offsets of the groups", self.offsets, u64::from(self.num_groups) + 1);
        l.expect::<u32>("groups of the rows", self.inverse, self.num_rows.into());
    }
}

/// Reduces each group of rows; members are taken in the order of the groups' rows, an empty group gives 0.
///
/// # Shapes
/// `x`: `[N, C]` · `out`: `[G, C]`
///
/// # Errors
/// Those of the launcher.
pub fn reduce<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    channels: u32,
    groups: Groups<'_, L::Buffer>,
    how: Reduce,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    let count = u64::from(groups.num_groups) * u64::from(channels);
    groups.check(l);
    l.expect::<f32>("grouped rows", x, u64::from(groups.num_rows) * u64::from(channels));
    l.expect::<f32>("reduced rows", out, count);
    l.run(
        &REDUCE,
        count,
        &[x, groups.rows, groups.offsets],
        &mut [out],
        &[U32(groups.num_groups), U32(channels), U32(how.number())],
    )
}

/// Gradient of [`reduce`] with respect to `x`; for the maximum it goes to the first largest member.
///
/// # Shapes
/// `x`, `dx`: `[N, C]` · `grad`: `[G, C]`
///
/// # Errors
/// Those of the launcher.
pub fn reduce_backward<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    channels: u32,
    groups: Groups<'_, L::Buffer>,
    how: Reduce,
    grad: &L::Buffer,
    dx: &mut L::Buffer,
) -> Result<(), L::Error> {
    let (n, g) = (groups.num_rows, groups.num_groups);
    let rows = u64::from(n) * u64::from(channels);
    let means = u64::from(g) * u64::from(channels);
    groups.check(l);
    l.expect::<f32>("gradient of the reduced rows", grad, means);
    l.expect::<f32>("gradient of the grouped rows", dx, rows);
    if how != Reduce::Max {
        return l.run(
            &REDUCE_BACKWARD,
            rows,
            &[grad, groups.inverse, groups.offsets],
            &mut [dx],
            &[U32(n), U32(channels), U32(how.number())],
        );
    }
    l.expect::<f32>("grouped rows", x, rows);
    let mut largest = l.alloc_values::<u32>(g as usize * channels as usize)?;
    l.run(
        &LARGEST,
        means,
        &[x, groups.rows, groups.offsets],
        &mut [&mut largest],
        &[U32(g), U32(channels)],
    )?;
    l.run(
        &LARGEST_BACKWARD,
        rows,
        &[grad, groups.inverse, &largest],
        &mut [dx],
        &[U32(n), U32(channels)],
    )
}
