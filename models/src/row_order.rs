//! In which order networks of several scales hold their rows, and which curve their blocks take.

use crate::{Forward, Orders, PointCloud, ops};
use candle_core::{Result, Tensor, bail};
use rand::Rng;
use scenesplat_kernels::serialization::{Curve, MAX_DEPTH, argsort, codes, depth_of, invert};
use scenesplat_kernels::serialized_cloud::SerializedCloud;
use std::sync::Arc;

/// From the caller's rows to those of a network and back.
#[derive(Debug)]
pub(crate) struct SortedRows {
    order: Arc<Vec<u32>>,
    inverse: Arc<Vec<u32>>,
}

impl SortedRows {
    /// The caller's row at each place.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// The network's row of each of the caller's.
    #[cfg(feature = "wgpu")]
    pub fn inverse(&self) -> &[u32] {
        &self.inverse
    }

    /// The caller's rows in the network's order. `[N, C]`
    pub fn enter(&self, x: &Tensor) -> Result<Tensor> {
        ops::permute_rows(x, self.order.clone(), self.inverse.clone())
    }

    /// The network's rows in the caller's order. `[N, C]`
    pub fn leave(&self, x: &Tensor) -> Result<Tensor> {
        ops::permute_rows(x, self.inverse.clone(), self.order.clone())
    }

    /// Of the caller's row at each place.
    pub fn new(order: Vec<u32>) -> Self {
        let inverse = Arc::new(invert(&order));
        Self { order: Arc::new(order), inverse }
    }
}

/// [`SortedRows::enter`], where rows are sorted at all.
pub(crate) fn enter(sorted: Option<&SortedRows>, x: &Tensor) -> Result<Tensor> {
    sorted.map_or_else(|| Ok(x.clone()), |sorted| sorted.enter(x))
}

/// [`SortedRows::leave`], where rows are sorted at all.
pub(crate) fn leave(sorted: Option<&SortedRows>, x: Tensor) -> Result<Tensor> {
    match sorted {
        Some(sorted) => sorted.leave(&x),
        None => Ok(x),
    }
}

/// The voxels with the rows of each scene in Morton order, and the permutation unless they are
/// there already.
///
/// Sorted rows make convolutions read memory in order; the result is brought back at the end.
///
/// # Errors
/// If offsets or coordinates are out of range; the message names the caller's row.
pub(crate) fn morton_rows(points: &PointCloud) -> Result<(Vec<[i32; 3]>, Option<SortedRows>)> {
    let cells = &points.grid_coord;
    let order = order_by(points, |cells| codes(Curve::Z, cells, MAX_DEPTH))?;
    if order.is_sorted() {
        return Ok((cells.to_vec(), None));
    }
    Ok((order.iter().map(|&i| cells[i as usize]).collect(), Some(SortedRows::new(order))))
}

/// The rows of each scene in the order of the keys of their voxels.
///
/// # Errors
/// If offsets or coordinates are out of range; the message names the caller's row.
pub(crate) fn order_by(
    points: &PointCloud,
    keys: impl Fn(&[[i32; 3]]) -> Vec<u64>,
) -> Result<Vec<u32>> {
    let (cells, offsets) = (&points.grid_coord, &points.offsets);
    scenesplat_kernels::check_offsets(offsets, cells.len()).map_err(candle_core::Error::wrap)?;
    depth_of(cells).map_err(candle_core::Error::wrap)?;
    let mut order = Vec::with_capacity(cells.len());
    for scene in offsets.windows(2) {
        let keys = keys(&cells[scene[0]..scene[1]]);
        order.extend(argsort(&keys).into_iter().map(|i| i + scene[0] as u32));
    }
    Ok(order)
}

/// Permutes the curve orders of one scale after the other as [`Forward::orders`] says.
pub(crate) struct OrderShuffle(Option<std::vec::IntoIter<Vec<usize>>>);

impl OrderShuffle {
    pub fn new(orders: &Orders) -> Self {
        Self(match orders {
            Orders::Given(p) => Some(p.clone().into_iter()),
            Orders::Listed | Orders::Shuffled => None,
        })
    }

    /// Permutes the next scale's orders.
    ///
    /// # Errors
    /// As [`Self::next`].
    pub fn apply(&mut self, cloud: &mut SerializedCloud, cx: &mut Forward<'_>) -> Result<()> {
        if let Some(permutation) = self.next(cloud.num_orders(), cx)? {
            cloud.permute_orders(&permutation);
        }
        Ok(())
    }

    /// The permutation of the next scale, which has so many orders; none if they stay as listed.
    ///
    /// # Errors
    /// If a given permutation is missing or is none of the scale's orders.
    pub fn next(&mut self, orders: usize, cx: &mut Forward<'_>) -> Result<Option<Vec<usize>>> {
        let permutation = match (&cx.orders, &mut self.0) {
            (Orders::Shuffled, _) => random_permutation(orders, cx.rng),
            (_, Some(given)) => match given.next() {
                Some(p) => p,
                None => bail!("orders: fewer permutations given than the network has scales"),
            },
            _ => return Ok(None),
        };
        let mut seen = permutation.clone();
        seen.sort_unstable();
        if seen != (0..orders).collect::<Vec<_>>() {
            bail!("orders: {permutation:?} is not a permutation of 0..{orders}");
        }
        Ok(Some(permutation))
    }
}

fn random_permutation(n: usize, rng: &mut impl Rng) -> Vec<usize> {
    let mut p: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        p.swap(i, rng.random_range(0..=i));
    }
    p
}
