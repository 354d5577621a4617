//! One scale of a batch on a graphics processor: its voxels, and what its layers read of them.

use super::wrap;
use candle_core::Result;
use scenesplat_gpu::ops::cloud::DeviceCloud;
use scenesplat_gpu::ops::patch_attention::{Item, items};
use scenesplat_gpu::ops::point_rope::DeviceRotations;
use scenesplat_gpu::ops::pool::DeviceGroups;
use scenesplat_gpu::{Array, Commands, Gpu};
use scenesplat_kernels::patches::Patch;
use scenesplat_kernels::point_rope::Rotations;
use scenesplat_kernels::segment::Groups;
use std::ops::Range;
use std::rc::Rc;

/// Bytes of the arrays that a layer fills piece by piece.
const PIECE: u64 = 256 << 20;
/// Taps along an axis of the convolutions of blocks, which share their tables.
pub(super) const KERNEL: usize = 3;

/// Bytes of a piece on this device, half of its largest array at most.
pub(super) fn piece_bytes(gpu: &Gpu) -> u64 {
    PIECE.min(gpu.largest_array() / 2)
}

/// Rows with the source rows of their taps, piece by piece.
pub(super) type Tables = Vec<(Range<usize>, Array<u32>)>;

/// How attention of a block reads the rows of its scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SlotShape {
    pub order: usize,
    pub patch_size: usize,
    /// Bytes of the widest row that attention makes of a slot.
    pub bytes: usize,
}

/// The slots of an order that is cut into patches.
#[derive(Debug)]
pub(super) struct Slots {
    /// Row in each slot.
    pub rows: Array<u32>,
    /// Row at each position of the order.
    pub order: Array<u32>,
    /// Slot of each position.
    pub of_positions: Array<u32>,
    pub parts: Vec<SlotPart>,
}

/// Patches that are computed together.
#[derive(Debug)]
pub(super) struct SlotPart {
    pub slots: Range<usize>,
    /// Positions whose results these patches make.
    pub positions: Range<usize>,
    pub items: Array<Item>,
}

/// Voxels of a scale, and what its layers need of them, made at first use.
#[derive(Debug)]
pub(super) struct Scale {
    pub cloud: DeviceCloud,
    /// Of kernels of [`KERNEL`] taps.
    tables: Option<Rc<Tables>>,
    slots: Vec<(SlotShape, Rc<Slots>)>,
    rotations: Vec<((usize, u64), DeviceRotations)>,
}

impl Scale {
    pub fn new(cloud: DeviceCloud) -> Self {
        Self { cloud, tables: None, slots: Vec::new(), rotations: Vec::new() }
    }

    /// The rows of each piece of the neighbor table of a kernel size.
    pub fn table_ranges(
        &self,
        gpu: &Gpu,
        kernel_size: usize,
    ) -> impl Iterator<Item = Range<usize>> {
        let n = self.cloud.len();
        let row = kernel_size.pow(3) * size_of::<u32>();
        let step = (piece_bytes(gpu) as usize / row).max(1);
        (0..n).step_by(step).map(move |first| first..(first + step).min(n))
    }

    /// The neighbor tables of blocks' convolutions, in pieces.
    pub fn tables(&mut self, commands: &mut Commands) -> Result<Rc<Tables>> {
        if let Some(tables) = &self.tables {
            return Ok(Rc::clone(tables));
        }
        let (gpu, mut tables) = (commands.gpu().clone(), Vec::new());
        for range in self.table_ranges(&gpu, KERNEL) {
            let table = self.cloud.table(commands, KERNEL, range.clone()).map_err(wrap)?;
            tables.push((range, table));
        }
        let tables = Rc::new(tables);
        self.tables = Some(Rc::clone(&tables));
        Ok(tables)
    }

    /// The slots of a shape of attention.
    pub fn slots(&mut self, commands: &mut Commands, shape: SlotShape) -> Result<Rc<Slots>> {
        if let Some((_, slots)) = self.slots.iter().find(|(known, _)| *known == shape) {
            return Ok(Rc::clone(slots));
        }
        let slots = Rc::new(slots(commands, &self.cloud, shape)?);
        self.slots.push((shape, Rc::clone(&slots)));
        Ok(slots)
    }

    /// Angles of heads of this width. The CPU computes them in f64, of voxels that are read.
    pub fn rotations(
        &mut self,
        commands: &mut Commands,
        dim: usize,
        base: f64,
    ) -> Result<DeviceRotations> {
        let key = (dim, base.to_bits());
        if let Some((_, known)) = self.rotations.iter().find(|(k, _)| *k == key) {
            return Ok(known.clone());
        }
        let cells = commands.read(self.cloud.cells()).map_err(wrap)?;
        let made = Rotations::new(&cells, dim, base);
        let made = DeviceRotations::upload(commands.gpu(), &made).map_err(wrap)?;
        self.rotations.push((key, made.clone()));
        Ok(made)
    }
}

/// Groups on the host.
pub(super) fn host_groups(commands: &mut Commands, groups: &DeviceGroups) -> Result<Groups> {
    let rows = commands.read(&groups.rows).map_err(wrap)?;
    let starts = commands.read(&groups.starts).map_err(wrap)?;
    Groups::new(rows, starts).map_err(candle_core::Error::wrap)
}

fn slots(commands: &mut Commands, cloud: &DeviceCloud, shape: SlotShape) -> Result<Slots> {
    let patches = cloud.patches(commands, shape.patch_size).map_err(wrap)?;
    let order = cloud.order(shape.order);
    let rows = patches.rows_of_slots(commands, order).map_err(wrap)?;
    let most = (piece_bytes(commands.gpu()) as usize / shape.bytes.max(1)).max(1);
    let mut parts = Vec::new();
    let mut positions = 0..0;
    let mut rest: &[Patch] = patches.patches().patches();
    while let Some(first) = rest.first() {
        // At least one patch, then as many as fit.
        let fits = |patch: &&Patch| patch.start + patch.len - first.start <= most;
        let count = rest.iter().take_while(fits).count().max(1);
        let (here, behind) = rest.split_at(count);
        rest = behind;
        let end = here.last().map_or(first.start, |last| last.start + last.len);
        let own: usize = here.iter().map(|patch| patch.own).sum();
        positions = positions.end..positions.end + own;
        let items = items(here, first.start).map_err(wrap)?;
        let items = commands.gpu().upload("patches", &items).map_err(wrap)?;
        parts.push(SlotPart { slots: first.start..end, positions: positions.clone(), items });
    }
    let of_positions = patches.slots_of_positions().clone();
    Ok(Slots { rows, order: order.order.clone(), of_positions, parts })
}
