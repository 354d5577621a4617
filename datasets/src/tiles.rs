//! A network input in spatial pieces that fit into memory.
//!
//! Each voxel is *core* of exactly one tile, and its output counts there; around the core lies a
//! *halo* of voxels that are read for context only.

use crate::error::require;
use crate::files::picked;
use crate::{DataError, NetworkInput};

scenesplat_kernels::settings! {
    /// How pieces are cut.
    #[derive(Eq)]
    pub struct TileSettings {
        /// Most voxels of a tile, core and halo together.
        pub max_voxels: usize = 200_000,
        /// Width of the halo, voxels. 50 is 1 m at 2 cm.
        pub halo: u32 = 50,
        /// Tile origins are multiples of this: `2^p` for a network that pools `p` times by 2, so that
        /// pooling joins the same voxels as in the whole input.
        pub align: u32 = 16,
    }
}

/// One piece of a network input.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tile {
    /// Voxels of the whole input, ascending. `[T]`
    pub voxels: Vec<u32>,
    /// Whether the output of a voxel counts in this tile. `[T]`
    pub is_core: Vec<bool>,
    /// Cell of the whole input that is cell 0 of the tile; a multiple of `align`.
    pub origin: [i32; 3],
    /// Width of this tile's halo, voxels.
    pub halo: u32,
}

/// All pieces of a network input.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tiling {
    /// The pieces; together their cores are all voxels, each once.
    pub tiles: Vec<Tile>,
    /// Tiles whose halo had to shrink because even a small core with the full halo was too large.
    /// Above 0, results near the borders of those tiles differ from the untiled ones: a warning.
    pub num_shrunk: usize,
    /// Narrowest halo of all tiles, voxels; the full one for a single tile.
    pub smallest_halo: u32,
}

/// Cuts a network input into tiles of at most `max_voxels`.
///
/// The voxels are halved at the median of their longest axis until core and halo fit. A core not
/// longer than `2 · halo` (or `align`) is not cut for the sake of its halo any more: its tile would
/// have four times its floor area already. Instead the halo shrinks to what fits. An input that fits is one tile.
///
/// # Errors
/// If `max_voxels` or `align` is 0, or the input's arrays are out of step.
pub fn split_into_tiles(
    input: &NetworkInput,
    settings: &TileSettings,
) -> Result<Tiling, DataError> {
    input.check()?;
    for (setting, value) in
        [("max_voxels", settings.max_voxels), ("align", settings.align as usize)]
    {
        require(value > 0, setting, value, "a number above 0")?;
    }
    let mut cutter = Cutter { cells: &input.grid_coord, settings, tiles: Vec::new() };
    if !input.is_empty() {
        let all: Vec<u32> = (0..input.len() as u32).collect();
        cutter.cut(all.clone(), &all);
    }
    let tiles = cutter.tiles;
    let num_shrunk = tiles.iter().filter(|t| t.halo < settings.halo).count();
    let smallest_halo = tiles.iter().map(|t| t.halo).min().unwrap_or(settings.halo);
    Ok(Tiling { tiles, num_shrunk, smallest_halo })
}

impl Tile {
    /// The tile as an input of its own, its cells counted from [`Self::origin`].
    pub fn input(&self, whole: &NetworkInput) -> NetworkInput {
        let pick = |from: &[u32]| picked(from, 1, &self.voxels);
        let cell =
            |&v: &u32| std::array::from_fn(|a| whole.grid_coord[v as usize][a] - self.origin[a]);
        NetworkInput {
            rows: pick(&whole.rows),
            slots: pick(&whole.slots),
            grid_coord: self.voxels.iter().map(cell).collect(),
            feat: picked(&whole.feat, whole.channels, &self.voxels),
            channels: whole.channels,
        }
    }

    /// Number of voxels whose output counts in this tile.
    pub fn num_core(&self) -> usize {
        self.is_core.iter().filter(|&&c| c).count()
    }
}

struct Bounds {
    low: [i32; 3],
    high: [i32; 3],
}

impl Bounds {
    fn of(cells: &[[i32; 3]], voxels: &[u32]) -> Self {
        let mut bounds = Self { low: [i32::MAX; 3], high: [i32::MIN; 3] };
        for &v in voxels {
            for (axis, at) in cells[v as usize].into_iter().enumerate() {
                bounds.low[axis] = bounds.low[axis].min(at);
                bounds.high[axis] = bounds.high[axis].max(at);
            }
        }
        bounds
    }

    /// The longest axis (the first of equals) and the number of cells along it.
    fn longest(&self) -> (usize, u32) {
        let cells = |axis: usize| self.high[axis].abs_diff(self.low[axis]).saturating_add(1);
        let axis = (1..3).fold(0, |best, axis| if cells(axis) > cells(best) { axis } else { best });
        (axis, cells(axis))
    }

    /// Distance of a cell to the box along its farthest axis; 0 inside.
    fn distance(&self, cell: [i32; 3]) -> u32 {
        let away = |a: usize| cell[a].abs_diff(cell[a].clamp(self.low[a], self.high[a]));
        away(0).max(away(1)).max(away(2))
    }
}

struct Cutter<'a> {
    cells: &'a [[i32; 3]],
    settings: &'a TileSettings,
    tiles: Vec<Tile>,
}

impl Cutter<'_> {
    /// Tiles for `core`, whose halo lies within `around` (which includes `core`); both ascending.
    fn cut(&mut self, core: Vec<u32>, around: &[u32]) {
        let bounds = Bounds::of(self.cells, &core);
        let near: Vec<u32> = around
            .iter()
            .copied()
            .filter(|&v| self.distance(&bounds, v) <= self.settings.halo)
            .collect();
        let (axis, length) = bounds.longest();
        if near.len() <= self.settings.max_voxels {
            self.keep(&core, near, self.settings.halo);
        } else if length > self.settings.halo.saturating_mul(2).max(self.settings.align)
            || core.len() > self.settings.max_voxels
        {
            let (left, right) = self.halves(core, axis);
            self.cut(left, &near);
            self.cut(right, &near);
        } else {
            // The nearest voxel that does not fit decides the width of the halo.
            let mut distances: Vec<u32> = near.iter().map(|&v| self.distance(&bounds, v)).collect();
            let first_out = *distances.select_nth_unstable(self.settings.max_voxels).1;
            match first_out.checked_sub(1) {
                Some(halo) => {
                    let kept =
                        near.into_iter().filter(|&v| self.distance(&bounds, v) <= halo).collect();
                    self.keep(&core, kept, halo);
                }
                // Voxels of other tiles share the box: possible only when cells repeat.
                None => self.keep(&core, core.clone(), 0),
            }
        }
    }

    fn distance(&self, bounds: &Bounds, voxel: u32) -> u32 {
        bounds.distance(self.cells[voxel as usize])
    }

    /// Both halves of a core, neither empty, cut where the axis allows it nearest to the median.
    fn halves(&self, core: Vec<u32>, axis: usize) -> (Vec<u32>, Vec<u32>) {
        let at = |v: u32| self.cells[v as usize][axis];
        let mut values: Vec<i32> = core.iter().map(|&v| at(v)).collect();
        let middle = values.len() / 2;
        let median = *values.select_nth_unstable(middle).1;
        // Cells below `border` go left: either the median starts the right half or ends the left.
        let below = values.iter().filter(|&&v| v < median).count();
        let up_to = values.iter().filter(|&&v| v <= median).count();
        let border = if middle.abs_diff(below) <= middle.abs_diff(up_to) && below > 0 {
            median
        } else if up_to < values.len() {
            median.saturating_add(1)
        } else if below > 0 {
            median
        } else {
            // All in one cell of the axis, which is the longest: cells repeat, any halves do.
            let (left, right) = core.split_at(middle);
            return (left.to_vec(), right.to_vec());
        };
        core.into_iter().partition(|&v| at(v) < border)
    }

    fn keep(&mut self, core: &[u32], voxels: Vec<u32>, halo: u32) {
        let align = i64::from(self.settings.align);
        let low = Bounds::of(self.cells, &voxels).low;
        // Rounded down; a cell near `i32::MIN` has no multiple below it and keeps the least value.
        let origin = low.map(|l| {
            let down = i64::from(l).div_euclid(align) * align;
            i32::try_from(down).unwrap_or(i32::MIN)
        });
        let mut own = core.iter().copied().peekable();
        let is_core = voxels.iter().map(|&v| own.next_if_eq(&v).is_some()).collect();
        self.tiles.push(Tile { voxels, is_core, origin, halo });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{below, sample_rng};

    fn input(cells: Vec<[i32; 3]>) -> NetworkInput {
        let n = cells.len() as u32;
        NetworkInput {
            rows: (0..n).map(|v| v + 100).collect(),
            slots: (0..n).collect(),
            feat: (0..n).map(|v| v as f32).collect(),
            grid_coord: cells,
            channels: 1,
        }
    }

    /// Distinct random cells.
    fn random_cells(seed: u64, n: usize, extent: [u32; 3]) -> Vec<[i32; 3]> {
        let mut rng = sample_rng(seed, 0, 0);
        let mut cells: Vec<[i32; 3]> =
            (0..n).map(|_| extent.map(|e| below(&mut rng, e) as i32)).collect();
        cells.sort_unstable();
        cells.dedup();
        cells
    }

    fn check(input: &NetworkInput, settings: &TileSettings) -> Tiling {
        let tiling = split_into_tiles(input, settings).unwrap();
        let mut owners = vec![0; input.len()];
        for tile in &tiling.tiles {
            assert!(tile.voxels.len() <= settings.max_voxels, "{}", tile.voxels.len());
            assert!(tile.num_core() > 0);
            assert!(tile.voxels.is_sorted_by(|a, b| a < b));
            assert!(tile.origin.iter().all(|o| o % settings.align as i32 == 0));
            assert!(tile.halo <= settings.halo);
            let core: Vec<u32> = tile
                .voxels
                .iter()
                .zip(&tile.is_core)
                .filter_map(|(&v, &is_core)| is_core.then_some(v))
                .collect();
            for &v in &core {
                owners[v as usize] += 1;
            }
            // Everything within the halo of the core is there.
            let bounds = Bounds::of(&input.grid_coord, &core);
            let within = (0..input.len() as u32)
                .filter(|&v| bounds.distance(input.grid_coord[v as usize]) <= tile.halo);
            if tile.halo > 0 {
                assert!(within.eq(tile.voxels.iter().copied()));
            }
            let piece = tile.input(input);
            piece.check().unwrap();
            for (i, &v) in tile.voxels.iter().enumerate() {
                let whole = input.grid_coord[v as usize];
                for (axis, whole) in whole.iter().enumerate() {
                    let cell = piece.grid_coord[i][axis];
                    assert!(cell >= 0);
                    // Pooling joins the same voxels as in the whole input.
                    let align = settings.align as i32;
                    let pooled = cell.div_euclid(align) + tile.origin[axis] / align;
                    assert_eq!(pooled, whole.div_euclid(align));
                }
                assert_eq!((piece.rows[i], piece.feat[i]), (v + 100, v as f32));
            }
        }
        assert!(owners.iter().all(|&o| o == 1), "every voxel is core once");
        assert_eq!(tiling, split_into_tiles(input, settings).unwrap());
        tiling
    }

    #[test]
    fn an_input_that_fits_is_one_tile() {
        let input = input(random_cells(1, 500, [300, 200, 100]));
        let settings = TileSettings { max_voxels: input.len(), ..TileSettings::default() };
        let tiling = check(&input, &settings);
        assert_eq!((tiling.tiles.len(), tiling.num_shrunk, tiling.smallest_halo), (1, 0, 50));
        assert_eq!(tiling.tiles[0].origin, [0; 3]);
    }

    #[test]
    fn nothing_and_one_voxel() {
        assert!(check(&input(vec![]), &TileSettings::default()).tiles.is_empty());
        for max_voxels in [1, 10] {
            let settings = TileSettings { max_voxels, ..TileSettings::default() };
            let tiling = check(&input(vec![[37, 5, 16]]), &settings);
            assert_eq!(tiling.tiles[0].origin, [32, 0, 16]);
        }
    }

    #[test]
    fn a_long_room_is_cut_with_its_full_halo() {
        let input = input(random_cells(2, 20_000, [2000, 60, 60]));
        let settings = TileSettings { max_voxels: 5000, halo: 20, align: 8 };
        let tiling = check(&input, &settings);
        assert!((5..=16).contains(&tiling.tiles.len()), "{}", tiling.tiles.len());
        assert_eq!((tiling.num_shrunk, tiling.smallest_halo), (0, 20));
    }

    #[test]
    fn a_dense_cluster_shrinks_the_halo() {
        let mut cells = Vec::new();
        for x in 0..16 {
            for y in 0..16 {
                cells.extend((0..16).map(|z| [x, y, z]));
            }
        }
        for max_voxels in [3, 40, 600] {
            let settings = TileSettings { max_voxels, halo: 6, align: 4 };
            let tiling = check(&input(cells.clone()), &settings);
            assert!(tiling.num_shrunk > 0 && tiling.smallest_halo < 6);
        }
    }

    #[test]
    fn a_far_outlier_only_costs_its_tile() {
        let mut cells = random_cells(3, 5000, [100, 100, 60]);
        cells.push([50_000, 50_000, 3]);
        let settings = TileSettings { max_voxels: 3000, halo: 10, align: 16 };
        let tiling = check(&input(cells), &settings);
        assert!(tiling.tiles.len() <= 8, "{}", tiling.tiles.len());
    }

    #[test]
    fn uneven_medians_still_split() {
        // Nearly all cells share each coordinate of the longest axis.
        for few in [0, 900] {
            let cells: Vec<[i32; 3]> =
                (0..1000).map(|i| [if i < 3 { 900 - few } else { few }, i % 32, i / 32]).collect();
            check(&input(cells), &TileSettings { max_voxels: 100, halo: 2, align: 2 });
        }
    }

    #[test]
    fn repeated_cells_are_split_by_number() {
        let settings = TileSettings { max_voxels: 10, halo: 3, align: 2 };
        let tiling = split_into_tiles(&input(vec![[5; 3]; 95]), &settings).unwrap();
        assert!(tiling.tiles.iter().all(|t| t.voxels.len() <= 10));
        assert_eq!(tiling.tiles.iter().map(Tile::num_core).sum::<usize>(), 95);
    }

    #[test]
    fn extreme_cells_do_not_overflow() {
        let cells = vec![[i32::MIN, 0, 0], [i32::MAX, 0, 0], [0, i32::MAX, i32::MIN], [1, 2, 3]];
        let settings = TileSettings { max_voxels: 2, halo: u32::MAX, align: 16 };
        assert!(split_into_tiles(&input(cells), &settings).is_ok());
    }

    #[test]
    fn bad_settings_are_refused() {
        for settings in [
            TileSettings { max_voxels: 0, ..TileSettings::default() },
            TileSettings { align: 0, ..TileSettings::default() },
        ] {
            assert!(split_into_tiles(&input(vec![]), &settings).is_err());
        }
    }
}
