//! The weights of all pictures, in bounded memory.
//!
//! Pictures bring weights in the order of the Gaussians; features need all weights of one Gaussian
//! together. Between the two, weights are kept by blocks of Gaussians: in memory up to a budget,
//! beyond it in a file without a name, which is gone when the spool is.

use super::LiftError;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// How much of a Gaussian was seen in a segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentWeight {
    /// Row of the Gaussian.
    pub gaussian: u32,
    /// The segment; of one picture or of all, as the list says.
    pub segment: u32,
    /// Sum of blending weights over the segment's pixels, above 0.
    pub weight: f32,
}

const ENTRY_BYTES: usize = 12;
/// Ordering by block takes a second copy.
const BYTES_PER_WAITING: u64 = 2 * ENTRY_BYTES as u64;
/// Fewer would make a file of crumbs.
const LEAST_WEIGHTS: usize = 1024;
/// Bytes turned into numbers, or back, at a time.
const CHUNK_ENTRIES: usize = 1 << 15;

impl SegmentWeight {
    fn to_bytes(self) -> [u8; ENTRY_BYTES] {
        let mut bytes = [0; ENTRY_BYTES];
        bytes[..4].copy_from_slice(&self.gaussian.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.segment.to_le_bytes());
        bytes[8..].copy_from_slice(&self.weight.to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Self {
        let word = |i: usize| [bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]];
        Self {
            gaussian: u32::from_le_bytes(word(0)),
            segment: u32::from_le_bytes(word(4)),
            weight: f32::from_le_bytes(word(8)),
        }
    }
}

/// Weights that came in together, ordered by block.
#[derive(Debug)]
struct Run {
    /// Place of the first in the file, in weights; in memory it is 0.
    start: u64,
    /// Where each block ends, from `start`.
    block_ends: Vec<u64>,
}

impl Run {
    fn block(&self, block: usize) -> Range<u64> {
        let begin = if block == 0 { 0 } else { self.block_ends[block - 1] };
        self.start + begin..self.start + self.block_ends[block]
    }
}

/// Keeps weights until they are asked for, block by block.
///
/// What comes out depends on what went in and its order, never on the budget.
#[derive(Debug)]
pub struct WeightSpool {
    rows: usize,
    block_rows: usize,
    folder: PathBuf,
    /// Largest number of weights that wait in memory.
    capacity: usize,
    waiting: Vec<SegmentWeight>,
    file: Option<File>,
    runs: Vec<Run>,
    /// The waiting weights in order of blocks, once nothing more comes.
    sealed: Option<Run>,
    count: u64,
}

/// The weights of consecutive Gaussians.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BlockWeights {
    /// First Gaussian.
    pub first: usize,
    /// Where each Gaussian's weights start, and where the last one's end.
    pub offsets: Vec<usize>,
    /// By Gaussian, each in the order in which they came in. `gaussian` is set.
    pub weights: Vec<SegmentWeight>,
}

impl BlockWeights {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Whether there is no Gaussian.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The weights of the `i`-th Gaussian of the block.
    pub fn of(&self, i: usize) -> &[SegmentWeight] {
        &self.weights[self.offsets[i]..self.offsets[i + 1]]
    }
}

impl WeightSpool {
    /// Room for 1024 weights.
    pub const LEAST_BUDGET: u64 = LEAST_WEIGHTS as u64 * BYTES_PER_WAITING;

    /// An empty spool for `rows` Gaussians in blocks of `block_rows`; keeps about `budget` bytes in
    /// memory (at least [`LEAST_BUDGET`](Self::LEAST_BUDGET)) and makes its file, if it needs one, in
    /// `folder`.
    pub fn new(rows: usize, block_rows: usize, budget: u64, folder: &Path) -> Self {
        let capacity = usize::try_from(budget / BYTES_PER_WAITING).unwrap_or(usize::MAX);
        Self {
            rows,
            block_rows: block_rows.max(1),
            folder: folder.to_owned(),
            capacity: capacity.max(LEAST_WEIGHTS),
            waiting: Vec::new(),
            file: None,
            runs: Vec::new(),
            sealed: None,
            count: 0,
        }
    }

    /// Number of weights.
    pub fn len(&self) -> u64 {
        self.count
    }

    /// Whether no weight came in.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Bytes in the file.
    pub fn bytes_on_disk(&self) -> u64 {
        self.runs.last().map_or(0, |r| r.start + r.block_ends.last().copied().unwrap_or(0))
            * ENTRY_BYTES as u64
    }

    /// Blocks of Gaussians.
    pub fn num_blocks(&self) -> usize {
        self.rows.div_ceil(self.block_rows)
    }

    /// Adds weights; `segment` counts over all pictures.
    ///
    /// # Errors
    /// If a Gaussian is beyond the last row, or the file cannot be written.
    pub fn push(
        &mut self,
        weights: impl IntoIterator<Item = SegmentWeight>,
    ) -> Result<(), LiftError> {
        // What waits may be in order of blocks by now; within a block it still is as it came in.
        self.sealed = None;
        for weight in weights {
            if weight.gaussian as usize >= self.rows {
                let problem = format!("{} of {} Gaussians", weight.gaussian, self.rows);
                return Err(LiftError::argument("gaussian", problem));
            }
            if self.waiting.len() >= self.capacity {
                self.spill()?;
            }
            self.waiting.push(weight);
            self.count += 1;
        }
        Ok(())
    }

    /// Orders the waiting weights by block, in place of themselves.
    fn order_by_block(&mut self) -> Run {
        let blocks = self.num_blocks();
        let block = |w: &SegmentWeight| w.gaussian as usize / self.block_rows;
        let mut ends = vec![0u64; blocks];
        for weight in &self.waiting {
            ends[block(weight)] += 1;
        }
        let mut total = 0;
        for end in &mut ends {
            total += std::mem::replace(end, total);
        }
        let mut ordered =
            vec![SegmentWeight { gaussian: 0, segment: 0, weight: 0.0 }; self.waiting.len()];
        for weight in &self.waiting {
            let end = &mut ends[block(weight)];
            ordered[*end as usize] = *weight;
            *end += 1;
        }
        self.waiting = ordered;
        Run { start: 0, block_ends: ends }
    }

    fn spill(&mut self) -> Result<(), LiftError> {
        let mut run = self.order_by_block();
        run.start = self.bytes_on_disk() / ENTRY_BYTES as u64;
        let file = match &mut self.file {
            Some(file) => file,
            none => {
                let made = tempfile::tempfile_in(&self.folder).map_err(LiftError::spool(
                    &self.folder,
                    "cannot make a file for weights that do not fit into memory",
                ))?;
                none.insert(made)
            }
        };
        let write = |file: &mut File| -> std::io::Result<()> {
            file.seek(SeekFrom::Start(run.start * ENTRY_BYTES as u64))?;
            let mut bytes = Vec::with_capacity(CHUNK_ENTRIES * ENTRY_BYTES);
            for part in self.waiting.chunks(CHUNK_ENTRIES) {
                bytes.clear();
                part.iter().for_each(|w| bytes.extend_from_slice(&w.to_bytes()));
                file.write_all(&bytes)?;
            }
            Ok(())
        };
        write(file).map_err(LiftError::spool(
            &self.folder,
            "cannot write weights that do not fit into memory",
        ))?;
        self.runs.push(run);
        self.waiting.clear();
        Ok(())
    }

    /// All weights of one block.
    ///
    /// # Errors
    /// If the file cannot be read.
    ///
    /// # Panics
    /// If there is no such block.
    pub fn block(&mut self, block: usize) -> Result<BlockWeights, LiftError> {
        assert!(block < self.num_blocks(), "a block of the spool");
        if self.sealed.is_none() {
            self.sealed = Some(self.order_by_block());
        }
        let mut all = Vec::new();
        for run in &self.runs {
            let Some(file) = &mut self.file else { continue };
            read(file, run.block(block), &mut all).map_err(LiftError::spool(
                &self.folder,
                "cannot read back weights that did not fit into memory",
            ))?;
        }
        if let Some(run) = &self.sealed {
            let range = run.block(block);
            all.extend_from_slice(&self.waiting[range.start as usize..range.end as usize]);
        }
        let first = block * self.block_rows;
        let rows = self.block_rows.min(self.rows - first);
        Ok(by_gaussian(&all, first, rows))
    }
}

fn read(file: &mut File, range: Range<u64>, out: &mut Vec<SegmentWeight>) -> std::io::Result<()> {
    file.seek(SeekFrom::Start(range.start * ENTRY_BYTES as u64))?;
    let mut left = (range.end - range.start) as usize;
    out.reserve(left);
    let mut bytes = vec![0; left.min(CHUNK_ENTRIES) * ENTRY_BYTES];
    while left > 0 {
        let part = left.min(CHUNK_ENTRIES);
        let bytes = &mut bytes[..part * ENTRY_BYTES];
        file.read_exact(bytes)?;
        out.extend(bytes.chunks_exact(ENTRY_BYTES).map(SegmentWeight::from_bytes));
        left -= part;
    }
    Ok(())
}

/// A stable counting sort.
fn by_gaussian(all: &[SegmentWeight], first: usize, rows: usize) -> BlockWeights {
    let mut offsets = vec![0usize; rows + 1];
    for weight in all {
        offsets[weight.gaussian as usize - first + 1] += 1;
    }
    for i in 0..rows {
        offsets[i + 1] += offsets[i];
    }
    let mut next = offsets.clone();
    let mut weights = vec![SegmentWeight { gaussian: 0, segment: 0, weight: 0.0 }; all.len()];
    for weight in all {
        let place = &mut next[weight.gaussian as usize - first];
        weights[*place] = *weight;
        *place += 1;
    }
    BlockWeights { first, offsets, weights }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn a_tiny_budget_gives_the_same_blocks() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let folder = std::env::temp_dir();
        let rows = 1000;
        let pictures: Vec<Vec<SegmentWeight>> = (0..40)
            .map(|view| {
                let count = rng.random_range(0..900);
                let weight = |_| SegmentWeight {
                    gaussian: rng.random_range(0..rows as u32),
                    segment: view * 10 + rng.random_range(0..10),
                    weight: rng.random(),
                };
                (0..count).map(weight).collect()
            })
            .collect();
        let total: usize = pictures.iter().map(Vec::len).sum();
        let blocks = |budget, block_rows| -> (Vec<BlockWeights>, u64) {
            let mut spool = WeightSpool::new(rows, block_rows, budget, &folder);
            for picture in &pictures {
                spool.push(picture.iter().copied()).unwrap();
            }
            assert_eq!(spool.len(), total as u64);
            let blocks = (0..spool.num_blocks()).map(|b| spool.block(b).unwrap()).collect();
            (blocks, spool.bytes_on_disk())
        };
        for block_rows in [1, 64, 999, 5000] {
            let (large, none) = blocks(u64::MAX, block_rows);
            let (tiny, some) = blocks(0, block_rows);
            assert_eq!(none, 0);
            assert!(some >= (total as u64 - 1024) * 12, "{some} bytes of {total} weights");
            assert_eq!(large, tiny);
            let mut slow: Vec<SegmentWeight> = pictures.concat();
            slow.sort_by_key(|w| w.gaussian);
            let fast: Vec<_> = large.iter().flat_map(|b| b.weights.clone()).collect();
            assert_eq!(fast, slow);
            assert_eq!(large.iter().map(BlockWeights::len).sum::<usize>(), rows);
        }
    }

    #[test]
    fn weights_may_come_after_a_block_was_read() {
        let weight = |gaussian, segment| SegmentWeight { gaussian, segment, weight: 1.0 };
        let mut spool = WeightSpool::new(3, 2, 0, &std::env::temp_dir());
        assert_eq!(spool.block(1).unwrap().offsets, [0, 0]);
        spool.push([weight(2, 0), weight(0, 1)]).unwrap();
        assert_eq!(spool.block(0).unwrap().of(0), [weight(0, 1)]);
        spool.push([weight(0, 2)]).unwrap();
        assert_eq!(spool.block(0).unwrap().of(0), [weight(0, 1), weight(0, 2)]);
        assert!(spool.push([weight(3, 0)]).is_err());
        assert_eq!(WeightSpool::new(0, 2, 0, &std::env::temp_dir()).num_blocks(), 0);
    }

    #[test]
    fn a_folder_that_is_not_there_is_named() {
        let mut spool = WeightSpool::new(2000, 64, 0, Path::new("/no/such/folder"));
        let many = (0..2000).map(|gaussian| SegmentWeight { gaussian, segment: 0, weight: 1.0 });
        let error = spool.push(many).unwrap_err().to_string();
        assert!(error.contains("/no/such/folder"), "{error}");
    }
}
