//! One scale of a batch of point clouds: voxels, curve orders, and what is derived from them once.

use crate::error::{KernelError, check_offsets};
use crate::kernel_map::KernelMap;
use crate::patches::{Patches, cut};
use crate::segment::Groups;
use crate::serialization::{Curve, MAX_DEPTH, codes_into, depth_of, order_and_inverse};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// From which voxels the number of curve bits is taken.
///
/// A Hilbert code depends on the number of bits, so with [`CurveDepth::WholeBatch`], the rule of
/// the original, a scene's features depend on what else is in the batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum CurveDepth {
    /// Each scene for itself: its result never depends on its batch mates.
    #[default]
    PerScene,
    /// Each scene for itself, with room for one voxel more: the bits of its largest coordinate plus
    /// one, at most 21. That is the rule of LitePT, which differs where the coordinate is 2ⁿ − 1.
    PerSceneExtent,
    /// The largest coordinate of the batch, as the original does.
    WholeBatch,
}

/// Voxels of one scale with their space-filling-curve orders.
///
/// Kernel maps and patches are built at first use and shared by all layers of the scale.
#[derive(Debug)]
pub struct SerializedCloud {
    grid_coord: Vec<[i32; 3]>,
    offsets: Vec<usize>,
    depth: Vec<u32>,
    curves: Vec<Vec<u64>>,
    orders: Vec<Order>,
    maps: Mutex<BTreeMap<usize, Arc<KernelMap>>>,
    patches: Mutex<BTreeMap<usize, Arc<Patches>>>,
}

/// A permutation of the rows and its inverse; each scene's rows stay together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Order {
    /// `order[position] = row`
    pub order: Arc<Vec<u32>>,
    /// `inverse[row] = position`
    pub inverse: Arc<Vec<u32>>,
}

impl SerializedCloud {
    /// Codes and sorts the voxels along each curve.
    ///
    /// # Shapes
    /// `grid_coord`: `[N, 3]`, 0..2²¹ · `offsets`: `[B + 1]`
    ///
    /// # Errors
    /// If offsets or coordinates are out of range.
    pub fn new(
        grid_coord: Vec<[i32; 3]>,
        offsets: Vec<usize>,
        curves: &[Curve],
        depth: CurveDepth,
    ) -> Result<Self, KernelError> {
        check_offsets(&offsets, grid_coord.len())?;
        let mut depths = Vec::with_capacity(offsets.len() - 1);
        for scene in offsets.windows(2) {
            depths.push(depth_of(&grid_coord[scene[0]..scene[1]]).map_err(|e| match e {
                KernelError::GridCoord { row, axis, value } => {
                    KernelError::GridCoord { row: row + scene[0], axis, value }
                }
                e => e,
            })?);
        }
        match depth {
            CurveDepth::PerScene => {}
            CurveDepth::PerSceneExtent => {
                for (scene, depth) in offsets.windows(2).zip(&mut depths) {
                    let most = grid_coord[scene[0]..scene[1]].iter().flatten().max();
                    // Checked above: 0..2²¹.
                    let extent = most.map_or(0, |most| most.unsigned_abs() + 1);
                    *depth = (u32::BITS - extent.leading_zeros()).min(MAX_DEPTH);
                }
            }
            CurveDepth::WholeBatch => {
                let most = depths.iter().copied().max().unwrap_or(0);
                depths.fill(most);
            }
        }
        let rows = curves
            .iter()
            .map(|&curve| {
                let mut out = vec![0; grid_coord.len()];
                for (scene, &depth) in offsets.windows(2).zip(&depths) {
                    let scene = scene[0]..scene[1];
                    codes_into(curve, &grid_coord[scene.clone()], depth, &mut out[scene]);
                }
                out
            })
            .collect();
        Ok(Self::from_codes(grid_coord, offsets, depths, rows))
    }

    fn from_codes(
        grid_coord: Vec<[i32; 3]>,
        offsets: Vec<usize>,
        depth: Vec<u32>,
        curves: Vec<Vec<u64>>,
    ) -> Self {
        let mut spare = Vec::new();
        let orders = curves.iter().map(|codes| sort_scenes(codes, &offsets, &mut spare)).collect();
        Self {
            grid_coord,
            offsets,
            depth,
            curves,
            orders,
            maps: Mutex::default(),
            patches: Mutex::default(),
        }
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.grid_coord.len()
    }

    /// Whether there is no voxel.
    pub fn is_empty(&self) -> bool {
        self.grid_coord.is_empty()
    }

    /// Voxel indices. `[N, 3]`
    pub fn grid_coord(&self) -> &[[i32; 3]] {
        &self.grid_coord
    }

    /// Rows of scene `i` are `offsets[i]..offsets[i + 1]`. `[B + 1]`
    pub fn offsets(&self) -> &[usize] {
        &self.offsets
    }

    /// Curve bits an axis of each scene. `[B]`
    pub fn depth(&self) -> &[u32] {
        &self.depth
    }

    /// Number of orders.
    pub fn num_orders(&self) -> usize {
        self.orders.len()
    }

    /// Curve codes of each row, without the scene number. `[N]`
    pub fn codes(&self, order: usize) -> &[u64] {
        &self.curves[order]
    }

    /// One order.
    pub fn order(&self, order: usize) -> &Order {
        &self.orders[order]
    }

    /// Scene of each row. `[N]`
    pub fn scene_of_rows(&self) -> Vec<u32> {
        let scenes = self.offsets.windows(2).enumerate();
        scenes.flat_map(|(i, s)| std::iter::repeat_n(i as u32, s[1] - s[0])).collect()
    }

    /// Rearranges the orders: the new order `i` is the old order `permutation[i]`.
    ///
    /// # Panics
    /// If it is not a permutation of the orders (a bug of the caller).
    pub fn permute_orders(&mut self, permutation: &[usize]) {
        let mut sorted = permutation.to_vec();
        sorted.sort_unstable();
        assert!(
            sorted.iter().copied().eq(0..self.orders.len()),
            "order permutation {permutation:?}"
        );
        self.curves = permutation.iter().map(|&i| std::mem::take(&mut self.curves[i])).collect();
        self.orders = permutation.iter().map(|&i| self.orders[i].clone()).collect();
    }

    /// The next coarser scale: voxels that fall together after `shift` bits are cut off.
    ///
    /// Coarse rows ascend by the code of the first order, scene by scene. A scene with fewer than
    /// `shift` bits is left as it is (the rule of the original).
    pub fn pool(&self, shift: u32) -> (Self, Groups) {
        let shifts: Vec<u32> =
            self.depth.iter().map(|&d| if shift > d { 0 } else { shift }).collect();
        let rows: Vec<u32> = self.orders[0].order.as_ref().clone();
        let mut group_starts = Vec::new();
        let mut offsets = vec![0];
        let mut inverse = vec![0u32; self.len()];
        for (scene, &shift) in self.offsets.windows(2).zip(&shifts) {
            let mut last = None;
            for position in scene[0]..scene[1] {
                let row = rows[position] as usize;
                let code = self.curves[0][row] >> (3 * shift);
                if last != Some(code) {
                    last = Some(code);
                    group_starts.push(position as u32);
                }
                inverse[row] = group_starts.len() as u32 - 1;
            }
            offsets.push(group_starts.len());
        }
        let heads: Vec<u32> = group_starts.iter().map(|&p| rows[p as usize]).collect();
        let mut scene_shift = Vec::with_capacity(heads.len());
        for (scene, &shift) in offsets.windows(2).zip(&shifts) {
            scene_shift.extend(std::iter::repeat_n(shift, scene[1] - scene[0]));
        }
        let pick = |values: &[u64]| -> Vec<u64> {
            heads.iter().zip(&scene_shift).map(|(&h, &s)| values[h as usize] >> (3 * s)).collect()
        };
        let grid_coord = heads
            .iter()
            .zip(&scene_shift)
            .map(|(&h, &s)| self.grid_coord[h as usize].map(|v| v >> s))
            .collect();
        let curves = self.curves.iter().map(|c| pick(c)).collect();
        let depth = self.depth.iter().zip(&shifts).map(|(d, s)| d - s).collect();
        group_starts.push(self.len() as u32);
        let groups = Groups::of_parts(rows, group_starts, inverse);
        (Self::from_codes(grid_coord, offsets, depth, curves), groups)
    }

    /// The kernel map of a kernel size, built at first use.
    ///
    /// # Errors
    /// As [`KernelMap::build`].
    pub fn kernel_map(&self, kernel_size: usize) -> Result<Arc<KernelMap>, KernelError> {
        let mut maps = self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(map) = maps.get(&kernel_size) {
            return Ok(map.clone());
        }
        let map = Arc::new(KernelMap::build(&self.grid_coord, &self.offsets, kernel_size)?);
        maps.insert(kernel_size, map.clone());
        Ok(map)
    }

    /// Drops the kernel map of a size that no later layer uses.
    pub fn forget_kernel_map(&self, kernel_size: usize) {
        self.maps.lock().unwrap_or_else(PoisonError::into_inner).remove(&kernel_size);
    }

    /// The attention patches of a patch size, cut at first use.
    pub fn patches(&self, patch_size: usize) -> Arc<Patches> {
        let mut patches = self.patches.lock().unwrap_or_else(PoisonError::into_inner);
        patches
            .entry(patch_size)
            .or_insert_with(|| Arc::new(cut(&self.offsets, patch_size)))
            .clone()
    }
}

/// Sorts the rows of each scene by code.
fn sort_scenes(codes: &[u64], offsets: &[usize], spare: &mut Vec<u64>) -> Order {
    let mut order = vec![0; codes.len()];
    let mut inverse = vec![0; codes.len()];
    for scene in offsets.windows(2) {
        let rows = scene[0]..scene[1];
        // Below 2³² by the row count that sorting checks.
        let first = scene[0] as u32;
        order_and_inverse(
            &codes[rows.clone()],
            first,
            &mut order[rows.clone()],
            &mut inverse[rows],
            spare,
        );
    }
    Order { order: Arc::new(order), inverse: Arc::new(inverse) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The worked example of two scenes of 4 and 3 voxels.
    fn example(depth: CurveDepth) -> SerializedCloud {
        let grid =
            vec![[0, 0, 0], [5, 1, 2], [1, 1, 0], [4, 0, 3], [0, 1, 1], [2, 2, 2], [5, 1, 3]];
        SerializedCloud::new(grid, vec![0, 4, 7], &Curve::ALL, depth).unwrap()
    }

    #[test]
    fn pools_the_worked_example() {
        let cloud = example(CurveDepth::WholeBatch);
        assert_eq!(cloud.depth(), [3, 3]);
        assert_eq!(cloud.codes(0), [0, 270, 6, 265, 3, 56, 271]);
        let (coarse, groups) = cloud.pool(1);
        assert_eq!(groups.inverse(), [0, 1, 0, 1, 2, 3, 4]);
        assert_eq!(groups.offsets(), [0, 2, 4, 5, 6, 7]);
        assert_eq!(coarse.grid_coord(), [[0, 0, 0], [2, 0, 1], [0, 0, 0], [1, 1, 1], [2, 0, 1]]);
        assert_eq!(coarse.offsets(), [0, 2, 5]);
        assert_eq!(coarse.depth(), [2, 2]);
        assert_eq!(coarse.codes(0), [0, 33, 0, 7, 33]);
        assert_eq!(coarse.codes(1), [0, 17, 0, 7, 17]);
        assert_eq!(coarse.codes(2), [0, 59, 0, 5, 59]);
        assert_eq!(coarse.codes(3), [0, 25, 0, 5, 25]);
    }

    #[test]
    fn what_is_kept_is_kept_by_size() {
        let cloud = example(CurveDepth::PerScene);
        for size in [2, 3, 1024, 2] {
            assert_eq!(*cloud.patches(size), cut(&[0, 4, 7], size), "patches of {size}");
        }
        assert!(Arc::ptr_eq(&cloud.patches(3), &cloud.patches(3)), "cut once");
        for size in [3, 5, 3] {
            assert_eq!(cloud.kernel_map(size).unwrap().kernel_size(), size);
        }
    }

    #[test]
    fn a_scene_is_coded_alike_alone_and_in_a_batch() {
        let grid = vec![[0, 1, 1], [2, 2, 2], [1, 1, 3]];
        let alone =
            SerializedCloud::new(grid.clone(), vec![0, 3], &Curve::ALL, CurveDepth::PerScene)
                .unwrap();
        let mut both = vec![[700, 3, 9]];
        both.extend(grid);
        let both =
            SerializedCloud::new(both, vec![0, 1, 4], &Curve::ALL, CurveDepth::PerScene).unwrap();
        for c in 0..4 {
            assert_eq!(alone.codes(c), &both.codes(c)[1..]);
            let shifted: Vec<u32> = alone.order(c).order.iter().map(|i| i + 1).collect();
            assert_eq!(shifted, both.order(c).order[1..]);
        }
    }

    #[test]
    fn an_extent_has_room_for_one_voxel_more() {
        let depth = |cells: &[[i32; 3]]| {
            let (n, curves) = (cells.len(), [Curve::Hilbert]);
            let offsets = vec![0, n, n];
            SerializedCloud::new(cells.to_vec(), offsets, &curves, CurveDepth::PerSceneExtent)
                .map(|cloud| cloud.depth().to_vec())
        };
        for (most, bits) in [(0, 1), (1, 2), (2, 2), (3, 3), (7, 4), (8, 4), (1 << 20, 21)] {
            assert_eq!(depth(&[[0, most, 0], [0, 0, 0]]).unwrap(), [bits, 0], "{most}");
        }
        // Codes have no more bits than that.
        assert_eq!(depth(&[[(1 << 21) - 1, 0, 0]]).unwrap(), [21, 0]);
        assert!(depth(&[[1 << 21, 0, 0]]).is_err());
    }

    #[test]
    fn all_at_the_origin_has_depth_zero() {
        let cloud =
            SerializedCloud::new(vec![[0; 3]; 3], vec![0, 3], &Curve::ALL, CurveDepth::PerScene)
                .unwrap();
        assert_eq!(cloud.depth(), [0]);
        let (coarse, groups) = cloud.pool(1);
        assert_eq!((coarse.len(), groups.inverse()), (1, &[0, 0, 0][..]));
    }
}
