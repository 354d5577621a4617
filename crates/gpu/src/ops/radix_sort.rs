//! Stable sorting of 64-bit keys with the rows that they belong to, eight bits at a time.

use super::scan::running_sums;
use super::{lists, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands, Gpu};
use bytemuck::{Pod, Zeroable};

const COUNT: &str = include_str!("../../wgsl/radix_count.wgsl");
const MOVE: &str = include_str!("../../wgsl/radix_sort.wgsl");
const DIGIT_BITS: u32 = 8;
/// Entries of each thread of a workgroup.
const ROUNDS: u32 = 8;
/// Entries of a workgroup.
const BLOCK: usize = 256 * ROUNDS as usize;

/// Keys of 64 bits as two words each.
#[derive(Debug, Clone)]
pub struct Keys {
    /// Bits 0 to 31. `[N]`
    pub low: Array<u32>,
    /// Bits 32 to 63. `[N]`
    pub high: Array<u32>,
}

impl Keys {
    /// Keys from the host. `[N]`
    ///
    /// # Errors
    /// If the device has no room.
    pub fn upload(gpu: &Gpu, keys: &[u64]) -> Result<Self> {
        let low: Vec<u32> = keys.iter().map(|key| *key as u32).collect();
        let high: Vec<u32> = keys.iter().map(|key| (*key >> 32) as u32).collect();
        Ok(Self { low: gpu.upload("keys", &low)?, high: gpu.upload("keys", &high)? })
    }

    /// Keys for a kernel to fill.
    pub(crate) fn new(commands: &mut Commands, len: usize) -> Result<Self> {
        Ok(Self { low: commands.array("keys", len)?, high: commands.array("keys", len)? })
    }

    /// Runs all commands so far and gives the keys. `[N]`
    ///
    /// # Errors
    /// As [`Commands::read`].
    pub fn read(&self, commands: &mut Commands) -> Result<Vec<u64>> {
        let (low, high) = (commands.read(&self.low)?, commands.read(&self.high)?);
        Ok(low
            .iter()
            .zip(&high)
            .map(|(low, high)| u64::from(*high) << 32 | u64::from(*low))
            .collect())
    }

    /// Number of keys.
    pub fn len(&self) -> usize {
        self.low.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.low.is_empty()
    }
}

/// Keys in ascending order.
#[derive(Debug, Clone)]
pub struct Sorted {
    /// `[N]`
    pub keys: Keys,
    /// Row of each. `[N]`
    pub rows: Array<u32>,
}

/// Sorts keys below 2^`bits`, with their rows; equal keys stay as they are.
///
/// # Shapes
/// `keys`: `[N]` · `rows`: `[N]`, by default 0, 1, 2, …
///
/// # Errors
/// If lengths differ, `bits` is above 64, or the device has no room.
pub fn sort(
    commands: &mut Commands,
    keys: &Keys,
    rows: Option<&Array<u32>>,
    bits: u32,
) -> Result<Sorted> {
    if keys.high.len() != keys.len() || bits > u64::BITS {
        let (low, high) = (keys.low.len(), keys.high.len());
        return shape(format!("sorting by {bits} bits: {low} low words and {high} high ones"));
    }
    if bits <= u32::BITS {
        // The high words are 0, before as after.
        let (low, rows) = sort_words(commands, &keys.low, rows, bits)?;
        return Ok(Sorted { keys: Keys { low, high: keys.high.clone() }, rows });
    }
    let (low, high, rows) = passes(commands, &keys.low, Some(&keys.high), rows, bits)?;
    let high = high.unwrap_or_else(|| keys.high.clone());
    Ok(Sorted { keys: Keys { low, high }, rows })
}

/// The rows of keys below 2^`bits` in ascending order of the keys, those of equal keys ascending. `[N] → [N]`
///
/// # Errors
/// As [`sort`].
pub fn argsort(commands: &mut Commands, keys: &Keys, bits: u32) -> Result<Array<u32>> {
    Ok(sort(commands, keys, None, bits)?.rows)
}

/// As [`sort`] for keys of 32 bits at most.
pub(crate) fn sort_words(
    commands: &mut Commands,
    keys: &Array<u32>,
    rows: Option<&Array<u32>>,
    bits: u32,
) -> Result<(Array<u32>, Array<u32>)> {
    let (low, _, rows) = passes(commands, keys, None, rows, bits)?;
    Ok((low, rows))
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    len: u32,
    shift: u32,
    blocks: u32,
    pad: u32,
}

type Entries = (Array<u32>, Option<Array<u32>>, Array<u32>);

fn passes(
    commands: &mut Commands,
    low: &Array<u32>,
    high: Option<&Array<u32>>,
    rows: Option<&Array<u32>>,
    bits: u32,
) -> Result<Entries> {
    let len = low.len();
    if rows.is_some_and(|rows| rows.len() != len) {
        let rows = rows.map_or(0, Array::len);
        return shape(format!("sorting: {len} keys and {rows} rows"));
    }
    let (mut low, mut high, mut rows) = (low.clone(), high.cloned(), rows.cloned());
    if len < 2 || bits == 0 {
        let rows = match rows {
            Some(rows) => rows,
            None => lists::count_up(commands, len)?,
        };
        return Ok((low, high, rows));
    }
    let blocks = len.div_ceil(BLOCK);
    let constants = [("ROUNDS", ROUNDS)];
    let count = commands.gpu().kernel("radix_count", COUNT, &[], &constants);
    let counts: Array<u32> = commands.array("digits", blocks << DIGIT_BITS)?;
    for first in (0..bits).step_by(DIGIT_BITS as usize) {
        let params =
            Params { len: number(len)?, shift: first % u32::BITS, blocks: number(blocks)?, pad: 0 };
        let of_digit = if first < u32::BITS { &low } else { high.as_ref().unwrap_or(&low) };
        commands.run(&count, &params, &[(1, of_digit), (2, &counts)], blocks as u64)?;
        let starts = running_sums(commands, &counts)?.before;
        let to_low = commands.array("keys", len)?;
        let to_rows = commands.array("rows", len)?;
        let mut flags = vec![];
        let mut arrays: Vec<(u32, &dyn Bound)> =
            vec![(1, &low), (2, &starts), (3, &to_low), (4, &to_rows)];
        let to_high = match &high {
            Some(_) => Some(commands.array("keys", len)?),
            None => None,
        };
        if let (Some(from), Some(to)) = (&high, &to_high) {
            flags.push("WIDE");
            arrays.extend([(5, from as &dyn Bound), (6, to)]);
        }
        if first >= u32::BITS {
            flags.push("HIGH");
        }
        if let Some(rows) = &rows {
            flags.push("ROWS");
            arrays.push((7, rows));
        }
        let kernel = commands.gpu().kernel("radix_sort", MOVE, &flags, &constants);
        commands.run(&kernel, &params, &arrays, blocks as u64)?;
        (low, high, rows) = (to_low, to_high, Some(to_rows));
    }
    match rows {
        Some(rows) => Ok((low, high, rows)),
        None => shape("sorting: no pass"),
    }
}
