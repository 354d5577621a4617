//! Groups of rows that follow each other and have something in common.

use super::pool::DeviceGroups;
use super::radix_sort::{Keys, Sorted};
use super::scan::running_sums;
use super::scenes::Scenes;
use super::{groups_of_256, lists, number};
use crate::error::Result;
use crate::gpu::{Array, Bound, Commands};
use bytemuck::{Pod, Zeroable};

const BEGINS: &str = concat!(
    include_str!("../../wgsl/group_begins.wgsl"),
    include_str!("../../wgsl/shift_code.wgsl"),
    include_str!("../../wgsl/scene_of.wgsl")
);
const LIST: &str = include_str!("../../wgsl/group_list.wgsl");
const COARSE: &str = concat!(
    include_str!("../../wgsl/coarse.wgsl"),
    include_str!("../../wgsl/shift_code.wgsl"),
    include_str!("../../wgsl/scene_of.wgsl")
);

/// What rows of a group have in common. Groups never reach over scenes.
pub(super) enum By<'a> {
    /// Their key.
    Keys(&'a Sorted),
    /// Their code without its last 3·shift bits, in an order.
    Codes { codes: &'a Keys, order: &'a Array<u32>, shifts: &'a Array<u32> },
    /// Their cell without its last bits; rows follow each other as they are.
    Cells { cells: &'a Array<[i32; 3]>, shifts: &'a Array<u32> },
}

/// Groups, in the order in which their rows come.
pub(super) struct Grouping {
    pub(super) groups: DeviceGroups,
    /// First row of each group. `[G]`
    pub(super) heads: Array<u32>,
    /// First group of each scene, closed by their number. `[B + 1]`
    pub(super) offsets: Vec<usize>,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    /// Scenes, or items.
    other: u32,
    pad: [u32; 2],
}

/// Finds the groups. Runs all commands so far, to know how many there are.
pub(super) fn group(commands: &mut Commands, scenes: &Scenes, by: &By<'_>) -> Result<Grouping> {
    let rows = scenes.rows();
    let params = |other: usize| -> Result<Params> {
        Ok(Params { rows: number(rows)?, other: number(other)?, pad: [0; 2] })
    };
    let begins = commands.array("beginnings", rows)?;
    let mut arrays: Vec<(u32, &dyn Bound)> = vec![(1, scenes.on_device()), (2, &begins)];
    let (flag, order) = match by {
        By::Keys(sorted) => {
            arrays.extend([(4, &sorted.keys.low as &dyn Bound), (5, &sorted.keys.high)]);
            ("KEYS", Some(&sorted.rows))
        }
        By::Codes { codes, order, shifts } => {
            let of_codes: [(u32, &dyn Bound); 4] =
                [(3, *shifts), (4, &codes.low), (5, &codes.high), (6, *order)];
            arrays.extend(of_codes);
            ("CODES", Some(*order))
        }
        By::Cells { cells, shifts } => {
            arrays.extend([(3, *shifts as &dyn Bound), (4, *cells)]);
            ("CELLS", None)
        }
    };
    let kernel = commands.gpu().kernel("group_begins", BEGINS, &[flag], &[]);
    commands.run(&kernel, &params(scenes.len())?, &arrays, groups_of_256(rows))?;

    let sums = running_sums(commands, &begins)?;
    let items = scenes.len() + 1;
    let first_groups: Array<u32> = commands.array("groups of scenes", items)?;
    let kernel = commands.gpu().kernel("group_list", LIST, &["OFFSETS"], &[]);
    let arrays: [(u32, &dyn Bound); 4] =
        [(1, &sums.before), (2, scenes.on_device()), (3, &sums.total), (4, &first_groups)];
    commands.run(&kernel, &params(items)?, &arrays, groups_of_256(items))?;
    let offsets: Vec<usize> =
        commands.read(&first_groups)?.iter().map(|first| *first as usize).collect();

    let count = offsets[offsets.len() - 1];
    let starts = commands.array("groups", count + 1)?;
    if rows == 0 {
        commands.clear(&starts);
    }
    let heads = commands.array("groups", count)?;
    let inverse = commands.array("groups", rows)?;
    let mut arrays: Vec<(u32, &dyn Bound)> =
        vec![(1, &sums.before), (2, &begins), (3, &starts), (4, &heads), (5, &inverse)];
    let mut flags = vec!["LIST"];
    if let Some(order) = order {
        flags.push("ROWS");
        arrays.push((6, order));
    }
    let kernel = commands.gpu().kernel("group_list", LIST, &flags, &[]);
    commands.run(&kernel, &params(rows)?, &arrays, groups_of_256(rows))?;
    let rows = match order {
        Some(order) => order.clone(),
        None => lists::count_up(commands, rows)?,
    };
    Ok(Grouping { groups: DeviceGroups { rows, starts, inverse }, heads, offsets })
}

/// Cells of chosen rows without the last bits, as many as the scene's shift says. `[N, 3] → [list, 3]`
pub(super) fn coarse_cells(
    commands: &mut Commands,
    scenes: &Scenes,
    shifts: &Array<u32>,
    list: &Array<u32>,
    cells: &Array<[i32; 3]>,
) -> Result<Array<[i32; 3]>> {
    let out = commands.array("cells", list.len())?;
    run_coarse(commands, scenes, shifts, list, &[], [(4, cells), (5, &out)])?;
    Ok(out)
}

/// Codes of chosen rows without the last bits, three times as many as the scene's shift says. `[N] → [list]`
pub(super) fn coarse_codes(
    commands: &mut Commands,
    scenes: &Scenes,
    shifts: &Array<u32>,
    list: &Array<u32>,
    codes: &Keys,
) -> Result<Keys> {
    let out = Keys::new(commands, list.len())?;
    let arrays: [(u32, &dyn Bound); 4] =
        [(4, &codes.low), (5, &codes.high), (6, &out.low), (7, &out.high)];
    run_coarse(commands, scenes, shifts, list, &["CODES"], arrays)?;
    Ok(out)
}

fn run_coarse<const N: usize>(
    commands: &mut Commands,
    scenes: &Scenes,
    shifts: &Array<u32>,
    list: &Array<u32>,
    flags: &[&str],
    values: [(u32, &dyn Bound); N],
) -> Result<()> {
    let kernel = commands.gpu().kernel("coarse", COARSE, flags, &[]);
    let mut arrays: Vec<(u32, &dyn Bound)> = vec![(1, scenes.on_device()), (2, shifts), (3, list)];
    arrays.extend(values);
    let params = Params { rows: number(list.len())?, other: number(scenes.len())?, pad: [0; 2] };
    commands.run(&kernel, &params, &arrays, groups_of_256(list.len()))
}
