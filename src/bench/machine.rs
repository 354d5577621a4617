//! What the processor and the memory can do at most.

use super::multiply_add::Loop;
use super::stopwatch::time;
use super::{Measured, Request};
use anyhow::Result;
use rayon::prelude::*;
use std::hint::black_box;

/// Words that one task sums.
const CHUNK: usize = 1 << 17;

/// Operations a second of all threads, in registers.
pub(super) fn peak(found: Loop, request: &Request) -> Result<Measured> {
    let measured = time(request, || {
        black_box(rayon::broadcast(|_| (found.run)(black_box(0.5))));
        Ok(())
    })?;
    let flop = found.flop * rayon::current_num_threads() as u64;
    Ok(Measured { flop, ..measured })
}

/// Bytes a second: all threads sum an array far larger than any cache.
pub(super) fn bandwidth(words: usize, request: &Request) -> Result<Measured> {
    let values = vec![1_u64; words];
    let measured = time(request, || {
        let sum = values.par_chunks(CHUNK).map(|part| part.iter().sum::<u64>()).sum::<u64>();
        black_box(sum);
        Ok(())
    })?;
    Ok(Measured { size: words, bytes: 8 * words as u64, ..measured })
}
