//! What the processor and the memory can do at most.

use super::stopwatch::time;
use super::{Measured, Request, Speeds};
use anyhow::Result;
use scenesplat::kernels::bench_peak::{Loop, bf16_loop, f32_loop, int8_loop, sum};
use std::hint::black_box;
use std::time::Instant;

/// What the processor gives at this moment: the best of twelve short runs, as whatever
/// else runs only ever takes from it.
pub fn speeds() -> Speeds {
    let of = |found: Loop| {
        let flop = found.flop * rayon::current_num_threads() as u64;
        let runs = (0..12).map(|_| {
            let began = Instant::now();
            black_box(rayon::broadcast(|_| (found.run)(black_box(0.5))));
            flop as f64 / began.elapsed().as_secs_f64()
        });
        runs.fold(0.0, f64::max)
    };
    Speeds {
        f32_flop_s: of(f32_loop()),
        bf16_flop_s: bf16_loop().map(of),
        int8_op_s: int8_loop().map(of),
    }
}

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
        black_box(sum(&values));
        Ok(())
    })?;
    Ok(Measured { size: words, bytes: 8 * words as u64, ..measured })
}
