//! One scale of a batch of point clouds on the device: voxels, curve orders, and what is derived from them.

use super::curves::{self, DeviceOrder};
use super::grouping::{By, Grouping, coarse_cells, coarse_codes, group};
use super::kernel_map::CellTable;
use super::lists;
use super::pool::DeviceGroups;
use super::radix_sort::Keys;
use super::scenes::Scenes;
use crate::error::{Result, shape};
use crate::gpu::{Array, Commands};
use scenesplat_kernels::KernelError;
use scenesplat_kernels::patches::{Patches, cut};
use scenesplat_kernels::serialization::{Curve, MAX_DEPTH, depth_of};
use scenesplat_kernels::serialized_cloud::CurveDepth;
use std::ops::Range;
use std::sync::OnceLock;

/// Voxels of one scale with their space-filling-curve orders: `SerializedCloud` on the device.
///
/// It belongs to the commands that made it until these have run.
#[derive(Debug)]
pub struct DeviceCloud {
    cells: Array<[i32; 3]>,
    scenes: Scenes,
    rule: CurveDepth,
    depth: Vec<u32>,
    /// Largest coordinate of each scene, 0 where it has no rows. `[B]`
    largest: Vec<u32>,
    codes: Vec<Keys>,
    orders: Vec<DeviceOrder>,
    /// Made at first use.
    table: OnceLock<CellTable>,
}

impl DeviceCloud {
    /// Codes and sorts voxels that are on the device already. Runs all commands so far: the largest coordinate of each scene
    /// is read.
    ///
    /// # Shapes
    /// `cells`: `[N, 3]`, 0..2²¹ · `offsets`: `[B + 1]`
    ///
    /// # Errors
    /// If offsets or coordinates are out of range, or the device has no room.
    pub fn new(
        commands: &mut Commands,
        cells: &Array<[i32; 3]>,
        offsets: Vec<usize>,
        curves: &[Curve],
        rule: CurveDepth,
    ) -> Result<Self> {
        let scenes = Scenes::upload(commands.gpu(), offsets, cells.len())?;
        let largest = scenes.largest(commands, cells)?;
        if largest.iter().any(|most| *most >= 1 << MAX_DEPTH) {
            // Which row it is, the CPU's function says.
            largest_of(&commands.read(cells)?, scenes.offsets())?;
        }
        Self::of_parts(commands, cells.clone(), scenes, largest, curves, rule)
    }

    /// As [`Self::new`] for voxels on the host; nothing is read.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn upload(
        commands: &mut Commands,
        cells: &[[i32; 3]],
        offsets: Vec<usize>,
        curves: &[Curve],
        rule: CurveDepth,
    ) -> Result<Self> {
        let scenes = Scenes::upload(commands.gpu(), offsets, cells.len())?;
        let largest = largest_of(cells, scenes.offsets())?;
        let cells = commands.gpu().upload("cells", cells)?;
        Self::of_parts(commands, cells, scenes, largest, curves, rule)
    }

    fn of_parts(
        commands: &mut Commands,
        cells: Array<[i32; 3]>,
        scenes: Scenes,
        largest: Vec<u32>,
        curves: &[Curve],
        rule: CurveDepth,
    ) -> Result<Self> {
        let depth = depths(rule, &largest, scenes.offsets());
        let bits = 3 * depth.iter().copied().max().unwrap_or(0);
        let (mut codes, mut orders) = (Vec::new(), Vec::new());
        for &curve in curves {
            let keys = curves::codes(commands, curve, &cells, &scenes, &depth)?;
            orders.push(curves::order(commands, &keys, &scenes, bits)?);
            codes.push(keys);
        }
        let table = OnceLock::new();
        Ok(Self { cells, scenes, rule, depth, largest, codes, orders, table })
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether there is no voxel.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Voxel indices. `[N, 3]`
    pub fn cells(&self) -> &Array<[i32; 3]> {
        &self.cells
    }

    /// Which rows belong to which scene.
    pub fn scenes(&self) -> &Scenes {
        &self.scenes
    }

    /// Rows of scene `i` are `offsets[i]..offsets[i + 1]`. `[B + 1]`
    pub fn offsets(&self) -> &[usize] {
        self.scenes.offsets()
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
    pub fn codes(&self, order: usize) -> &Keys {
        &self.codes[order]
    }

    /// One order.
    pub fn order(&self, order: usize) -> &DeviceOrder {
        &self.orders[order]
    }

    /// Rearranges the orders: the new order `i` is the old order `permutation[i]`.
    ///
    /// # Errors
    /// If it is not a permutation of the orders.
    pub fn permute_orders(&mut self, permutation: &[usize]) -> Result<()> {
        let mut sorted = permutation.to_vec();
        sorted.sort_unstable();
        if !sorted.iter().copied().eq(0..self.orders.len()) {
            return shape(format!("{permutation:?} does not permute {} orders", self.orders.len()));
        }
        self.codes = permutation.iter().map(|&i| self.codes[i].clone()).collect();
        self.orders = permutation.iter().map(|&i| self.orders[i].clone()).collect();
        Ok(())
    }

    /// The next coarser scale and which row falls into which of its voxels: those that fall together after `shift` bits are
    /// cut off. Runs all commands so far, to know how many there are.
    ///
    /// Coarse rows ascend by the code of the first order, scene by scene. A scene with fewer than `shift` bits is left as it
    /// is.
    ///
    /// # Errors
    /// If there is no order, or the device has no room.
    pub fn pool(&self, commands: &mut Commands, shift: u32) -> Result<(Self, DeviceGroups)> {
        let (Some(codes), Some(first)) = (self.codes.first(), self.orders.first()) else {
            return shape("pooling: voxels without an order");
        };
        let shifts: Vec<u32> =
            self.depth.iter().map(|depth| if shift > *depth { 0 } else { shift }).collect();
        let on_device = commands.gpu().upload("shifts", &shifts)?;
        let by = By::Codes { codes, order: &first.order, shifts: &on_device };
        let Grouping { groups, heads, offsets } = group(commands, &self.scenes, &by)?;

        let scenes = Scenes::upload(commands.gpu(), offsets, heads.len())?;
        let cells = coarse_cells(commands, &self.scenes, &on_device, &heads, &self.cells)?;
        let depth: Vec<u32> = self.depth.iter().zip(&shifts).map(|(d, s)| d - s).collect();
        let largest = self.largest.iter().zip(&shifts).map(|(most, s)| most >> s).collect();
        let bits = 3 * depth.iter().copied().max().unwrap_or(0);
        let (mut of_curves, mut orders) = (Vec::new(), Vec::new());
        for codes in &self.codes {
            let codes = coarse_codes(commands, &self.scenes, &on_device, &heads, codes)?;
            orders.push(if orders.is_empty() {
                // Rows ascend by this one.
                let order = lists::count_up(commands, heads.len())?;
                DeviceOrder { inverse: order.clone(), order }
            } else {
                curves::order(commands, &codes, &scenes, bits)?
            });
            of_curves.push(codes);
        }
        let (rule, table) = (self.rule, OnceLock::new());
        let coarse = Self { cells, scenes, rule, depth, largest, codes: of_curves, orders, table };
        Ok((coarse, groups))
    }

    /// The next coarser scale by LitePT's rule, with these curves, and which row falls into which of its voxels: rows that
    /// follow each other and whose coordinates agree without their last `shift` bits. Rows in Morton order stay so. Runs all
    /// commands so far, to know how many there are.
    ///
    /// # Errors
    /// If the shift is above [`MAX_DEPTH`], or the device has no room.
    pub fn coarser(
        &self,
        commands: &mut Commands,
        shift: u32,
        curves: &[Curve],
    ) -> Result<(Self, DeviceGroups)> {
        if shift > MAX_DEPTH {
            return shape(format!("coarser by {shift} bits, at most {MAX_DEPTH}"));
        }
        let shifts = commands.gpu().upload("shifts", &vec![shift; self.scenes.len()])?;
        let by = By::Cells { cells: &self.cells, shifts: &shifts };
        let Grouping { groups, heads, offsets } = group(commands, &self.scenes, &by)?;
        let scenes = Scenes::upload(commands.gpu(), offsets, heads.len())?;
        let cells = coarse_cells(commands, &self.scenes, &shifts, &heads, &self.cells)?;
        let largest = self.largest.iter().map(|most| most >> shift).collect();
        let coarse = Self::of_parts(commands, cells, scenes, largest, curves, self.rule)?;
        Ok((coarse, groups))
    }

    /// Source row of each tap and row of a range, or [`NONE`](super::product::NONE). `→ [k³, range]`
    ///
    /// # Errors
    /// As [`CellTable::sources`].
    pub fn table(
        &self,
        commands: &mut Commands,
        kernel_size: usize,
        range: Range<usize>,
    ) -> Result<Array<u32>> {
        if let Some(table) = self.table.get() {
            return table.sources(commands, kernel_size, range);
        }
        let made = CellTable::new(commands, &self.cells, &self.scenes)?;
        self.table.get_or_init(|| made).sources(commands, kernel_size, range)
    }

    /// The attention patches of a patch size, cut on the host.
    ///
    /// # Errors
    /// If the patch size is 0, or the device has no room.
    pub fn patches(&self, commands: &Commands, patch_size: usize) -> Result<DevicePatches> {
        if patch_size == 0 {
            return shape("patches of no slots");
        }
        let patches = cut(self.offsets(), patch_size);
        let positions = commands.gpu().upload("positions of slots", patches.pad())?;
        let slots = commands.gpu().upload("slots of positions", patches.unpad())?;
        Ok(DevicePatches { patches, positions, slots })
    }
}

/// How an order is cut into attention patches.
#[derive(Debug)]
pub struct DevicePatches {
    patches: Patches,
    positions: Array<u32>,
    slots: Array<u32>,
}

impl DevicePatches {
    /// The patches.
    pub fn patches(&self) -> &Patches {
        &self.patches
    }

    /// Slot of each position of the sequence. `[N]`
    pub fn slots_of_positions(&self) -> &Array<u32> {
        &self.slots
    }

    /// Row that each slot shows. `[slots]`
    ///
    /// # Errors
    /// If the order has another number of rows, or the device has no room.
    pub fn rows_of_slots(
        &self,
        commands: &mut Commands,
        order: &DeviceOrder,
    ) -> Result<Array<u32>> {
        self.check(order)?;
        lists::compose(commands, &order.order, &self.positions)
    }

    /// Slot of each row. `[N]`
    ///
    /// # Errors
    /// As [`Self::rows_of_slots`].
    pub fn slots_of_rows(
        &self,
        commands: &mut Commands,
        order: &DeviceOrder,
    ) -> Result<Array<u32>> {
        self.check(order)?;
        lists::compose(commands, &self.slots, &order.inverse)
    }

    fn check(&self, order: &DeviceOrder) -> Result<()> {
        let (rows, positions) = (order.order.len(), self.patches.num_positions());
        if rows == positions {
            return Ok(());
        }
        shape(format!("patches of {positions} positions, an order of {rows} rows"))
    }
}

/// Largest coordinate of each scene, 0 where it has no rows.
fn largest_of(cells: &[[i32; 3]], offsets: &[usize]) -> Result<Vec<u32>> {
    let mut largest = Vec::with_capacity(offsets.len() - 1);
    for scene in offsets.windows(2) {
        let cells = &cells[scene[0]..scene[1]];
        if let Err(error) = depth_of(cells) {
            let error = match error {
                KernelError::GridCoord { row, axis, value } => {
                    KernelError::GridCoord { row: row + scene[0], axis, value }
                }
                error => error,
            };
            return shape(error.to_string());
        }
        largest.push(cells.iter().flatten().max().map_or(0, |most| most.unsigned_abs()));
    }
    Ok(largest)
}

/// Curve bits an axis of each scene.
fn depths(rule: CurveDepth, largest: &[u32], offsets: &[usize]) -> Vec<u32> {
    let bits = |value: u32| u32::BITS - value.leading_zeros();
    let of_scenes = largest.iter().zip(offsets.windows(2));
    match rule {
        CurveDepth::PerScene => largest.iter().map(|most| bits(*most)).collect(),
        CurveDepth::PerSceneExtent => of_scenes
            .map(
                |(most, scene)| {
                    if scene[0] == scene[1] { 0 } else { bits(most + 1).min(MAX_DEPTH) }
                },
            )
            .collect(),
        CurveDepth::WholeBatch => {
            let most = largest.iter().copied().max().unwrap_or(0);
            vec![bits(most); largest.len()]
        }
    }
}
