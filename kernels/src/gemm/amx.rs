//! Products of bf16 pairs on AMX tiles: the innermost loop of a bf16 matrix product.
//!
//! A tile register holds 16 rows of 64 bytes. `tdpbf16ps` multiplies a tile of 16 rows × 32 values
//! of k by one of 32 values of k × 16 columns and adds the 16 × 16 products to f32 sums: 16,384
//! operations every 16 cycles. Intrinsics for it are not stable, hence assembly; the registers'
//! names are, as clobbers.
//!
//! # Arithmetic
//! Per step of 32 values of k, the even and the odd ones are two chains of fused multiply–adds in
//! f32 that start at zero; their sum is added to the element's running sum. This order depends on
//! `k` alone: rows, columns, threads and cuts of k between calls (at multiples of 32) never change a
//! bit. Rounding is to nearest even whatever MXCSR says. **Subnormal numbers count as zero**, among
//! the operands, the old values of `c` and every result: below 1.2e-38 nothing is left, and a
//! subnormal times ∞ is NaN. NaN and ∞ pass as in IEEE 754, within their row and column.
//!
//! # Traffic
//! The cycles are Intel's optimization manual's for Sapphire Rapids. A block of 2 × 2 tiles loads 4
//! tiles (4 KiB, 8 cycles each from the first-level cache) for 4 products (64 cycles, 65,536
//! operations): 1/16 byte an operation, half of what the load ports give, and 4 sums are in flight
//! while one takes 52 cycles. From the second-level cache (48 bytes a cycle sustained) those 64
//! bytes a cycle would hold the products at 3/4 of their peak. Therefore the loop over rows is
//! outside the one over columns: a block's rows (128 · `k_pairs` bytes) stay in the 48 KiB first
//! level, so a panel of 64 columns takes 32 bytes a cycle for its columns and 16 for the rows'
//! first visit, the 48 that there are. With 192 pairs the rows take 24 KiB; with 384 they fill the
//! first level and nothing stays: callers should cut k near 192 pairs. Sums cross once a
//! call, twice if accumulated: `16 / k_pairs` or `32 / k_pairs` of the operands' bytes. They go
//! straight from the tiles to `c` where its rows are evenly spaced, else through 4 KiB of stack.
//!
//! # State of the thread
//! Tiles stay configured. Releasing them would spare the system 8 KiB to save and restore when it
//! takes the thread off its core, but cost a configuration for each of thousands of calls, which
//! are far more frequent. Idle cores are no concern: Linux releases the tiles itself before a deep
//! sleep. Threads that never come here have no tile state.

use std::arch::asm;
use std::arch::x86_64::{__cpuid, __cpuid_count, _mm512_loadu_ps, _mm512_storeu_ps};
use std::sync::OnceLock;

/// Rows of a tile, columns of a tile of sums, and pairs of k in a tile of operands.
const TILE: usize = 16;
/// Sums of the largest block.
const BLOCK: usize = 4 * TILE * TILE;

/// Whether tiles can be used: the CPU has them, the system saves them, and lets this process use
/// them. Asked once; the permission holds for all threads.
pub(crate) fn available() -> bool {
    static AVAILABLE: OnceLock<bool> = OnceLock::new();
    *AVAILABLE.get_or_init(|| {
        // AVX-512 (which brings XGETBV) copies sums; every CPU with tiles has it.
        is_x86_feature_detected!("avx512f") && cpu_has_tiles() && tiles_enabled() && permitted()
    })
}

#[allow(unused_unsafe)] // CPUID is safe in newer versions of Rust than the oldest supported one.
fn cpu_has_tiles() -> bool {
    const AMX_BF16: u32 = 1 << 22;
    const AMX_TILE: u32 = 1 << 24;
    // SAFETY: every x86-64 CPU has CPUID.
    let features = unsafe { if __cpuid(0).eax < 7 { 0 } else { __cpuid_count(7, 0).edx } };
    features & (AMX_BF16 | AMX_TILE) == AMX_BF16 | AMX_TILE
}

/// Whether the system has turned on both parts of the tile state.
fn tiles_enabled() -> bool {
    const XTILECFG_XTILEDATA: u32 = 0b11 << 17;
    let enabled: u32;
    // SAFETY: only called when AVX-512 is usable, so the system has set CR4.OSXSAVE.
    unsafe {
        asm!("xgetbv", in("ecx") 0, out("eax") enabled, out("edx") _,
            options(nomem, nostack, preserves_flags));
    }
    enabled & XTILECFG_XTILEDATA == XTILECFG_XTILEDATA
}

/// Asks Linux (5.16 or newer) for the tiles; older kernels and sandboxes refuse.
fn permitted() -> bool {
    const ARCH_PRCTL: i64 = 158;
    const ARCH_REQ_XCOMP_PERM: i64 = 0x1023;
    const XTILEDATA: i64 = 18;
    let result: i64;
    // SAFETY: the call takes numbers only and writes none of our memory.
    unsafe {
        asm!("syscall", inlateout("rax") ARCH_PRCTL => result, in("rdi") ARCH_REQ_XCOMP_PERM,
            in("rsi") XTILEDATA, out("rcx") _, out("r11") _, options(nostack));
    }
    result == 0
}

/// The memory image of a tile configuration.
#[repr(C, align(64))]
#[derive(PartialEq)]
struct Configuration([u8; 64]);

/// Eight tiles of 16 rows of 64 bytes.
static FULL_TILES: Configuration = {
    let mut image = [0; 64];
    image[0] = 1; // palette
    let mut tile = 0;
    while tile < 8 {
        image[16 + 2 * tile] = 64; // bytes of a row, 16 bits each
        image[48 + tile] = TILE as u8;
        tile += 1;
    }
    Configuration(image)
};

/// Makes this thread's tiles full-sized unless they are.
///
/// Looks at the registers, not at a flag of ours: other libraries release the tiles when they have
/// used them, and a flag would then be a lie that ends in an illegal instruction.
///
/// # Safety
/// [`available`] must have said yes.
pub(crate) unsafe fn configure() {
    let mut current = Configuration([0; 64]);
    // SAFETY: the instructions exist, by the caller's promise; one writes 64 bytes, the other reads
    // as many.
    unsafe {
        asm!("sttilecfg [{}]", in(reg) &mut current, options(nostack, preserves_flags));
        if current != FULL_TILES {
            asm!("ldtilecfg [{}]", in(reg) &FULL_TILES, options(nostack, preserves_flags),
                out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _);
        }
    }
}

/// Where a block's operands and sums are; strides in bytes.
#[derive(Clone, Copy)]
struct Block {
    a: *const u32,
    a_stride: usize,
    b: *const u32,
    b_stride: usize,
    c: *mut f32,
    c_stride: isize,
    /// Steps of 16 pairs, at least one.
    steps: usize,
    accumulate: bool,
}

/// A function that multiplies one block, from the instructions of its shape.
///
/// Registers: `rsi`, `r8` the rows of `a`, upper and lower tile, stride `rdx` · `rcx` the rows of
/// `b`, stride `r9` · `rdi`, `r10` the rows of `c`, stride `rax`. Sums are in `tmm0`–`tmm3`.
macro_rules! block {
    ($name:ident, clear: $($clear:literal)+, load: $($load:literal)+,
     step: $($step:literal)+, store: $($store:literal)+) => {
        /// # Safety
        /// Tiles are configured; the operands' tiles are readable and the sums' writable.
        unsafe fn $name(block: &Block) {
            let Block { a, a_stride, b, b_stride, c, c_stride, steps, accumulate } = *block;
            // SAFETY: the caller's promise. The lower tiles' addresses are only used by the shapes
            // that have them.
            unsafe {
                asm!(
                    "test r12, r12",
                    "jz 2f",
                    $($load,)+
                    "jmp 3f",
                    "2:",
                    $($clear,)+
                    "3:",
                    $($step,)+
                    "add rsi, 64",
                    "add r8, 64",
                    "add rcx, r11",
                    "dec r13",
                    "jnz 3b",
                    $($store,)+
                    inout("rsi") a => _,
                    inout("r8") a.wrapping_byte_add(TILE * a_stride) => _,
                    in("rdx") a_stride,
                    inout("rcx") b => _,
                    in("r9") b_stride,
                    in("r11") TILE * b_stride,
                    in("rdi") c,
                    in("r10") c.wrapping_byte_offset(TILE as isize * c_stride),
                    in("rax") c_stride,
                    in("r12") usize::from(accumulate),
                    inout("r13") steps => _,
                    out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                    out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                    options(nostack),
                );
            }
        }
    };
}

block!(two_by_two,
    clear: "tilezero tmm0" "tilezero tmm1" "tilezero tmm2" "tilezero tmm3",
    load:
        "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm1, [rdi + rax*1 + 64]"
        "tileloadd tmm2, [r10 + rax*1]" "tileloadd tmm3, [r10 + rax*1 + 64]",
    step:
        "tileloadd tmm4, [rsi + rdx*1]" "tileloadd tmm6, [rcx + r9*1]"
        "tdpbf16ps tmm0, tmm4, tmm6"
        "tileloadd tmm7, [rcx + r9*1 + 64]"
        "tdpbf16ps tmm1, tmm4, tmm7"
        "tileloadd tmm5, [r8 + rdx*1]"
        "tdpbf16ps tmm2, tmm5, tmm6" "tdpbf16ps tmm3, tmm5, tmm7",
    store:
        "tilestored [rdi + rax*1], tmm0" "tilestored [rdi + rax*1 + 64], tmm1"
        "tilestored [r10 + rax*1], tmm2" "tilestored [r10 + rax*1 + 64], tmm3");

block!(two_by_one,
    clear: "tilezero tmm0" "tilezero tmm2",
    load: "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm2, [r10 + rax*1]",
    step:
        "tileloadd tmm4, [rsi + rdx*1]" "tileloadd tmm6, [rcx + r9*1]"
        "tdpbf16ps tmm0, tmm4, tmm6"
        "tileloadd tmm5, [r8 + rdx*1]"
        "tdpbf16ps tmm2, tmm5, tmm6",
    store: "tilestored [rdi + rax*1], tmm0" "tilestored [r10 + rax*1], tmm2");

// A single row of tiles takes all columns at once: fewer products than four in flight would wait
// for each other.
block!(one_by_four,
    clear: "tilezero tmm0" "tilezero tmm1" "tilezero tmm2" "tilezero tmm3",
    load:
        "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm1, [rdi + rax*1 + 64]"
        "tileloadd tmm2, [rdi + rax*1 + 128]" "tileloadd tmm3, [rdi + rax*1 + 192]",
    step:
        "tileloadd tmm4, [rsi + rdx*1]" "tileloadd tmm5, [rcx + r9*1]"
        "tdpbf16ps tmm0, tmm4, tmm5"
        "tileloadd tmm6, [rcx + r9*1 + 64]"
        "tdpbf16ps tmm1, tmm4, tmm6"
        "tileloadd tmm7, [rcx + r9*1 + 128]"
        "tdpbf16ps tmm2, tmm4, tmm7"
        "tileloadd tmm5, [rcx + r9*1 + 192]"
        "tdpbf16ps tmm3, tmm4, tmm5",
    store:
        "tilestored [rdi + rax*1], tmm0" "tilestored [rdi + rax*1 + 64], tmm1"
        "tilestored [rdi + rax*1 + 128], tmm2" "tilestored [rdi + rax*1 + 192], tmm3");

block!(one_by_three,
    clear: "tilezero tmm0" "tilezero tmm1" "tilezero tmm2",
    load:
        "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm1, [rdi + rax*1 + 64]"
        "tileloadd tmm2, [rdi + rax*1 + 128]",
    step:
        "tileloadd tmm4, [rsi + rdx*1]" "tileloadd tmm5, [rcx + r9*1]"
        "tdpbf16ps tmm0, tmm4, tmm5"
        "tileloadd tmm6, [rcx + r9*1 + 64]"
        "tdpbf16ps tmm1, tmm4, tmm6"
        "tileloadd tmm7, [rcx + r9*1 + 128]"
        "tdpbf16ps tmm2, tmm4, tmm7",
    store:
        "tilestored [rdi + rax*1], tmm0" "tilestored [rdi + rax*1 + 64], tmm1"
        "tilestored [rdi + rax*1 + 128], tmm2");

block!(one_by_two,
    clear: "tilezero tmm0" "tilezero tmm1",
    load: "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm1, [rdi + rax*1 + 64]",
    step:
        "tileloadd tmm4, [rsi + rdx*1]" "tileloadd tmm5, [rcx + r9*1]"
        "tdpbf16ps tmm0, tmm4, tmm5"
        "tileloadd tmm6, [rcx + r9*1 + 64]"
        "tdpbf16ps tmm1, tmm4, tmm6",
    store: "tilestored [rdi + rax*1], tmm0" "tilestored [rdi + rax*1 + 64], tmm1");

block!(one_by_one,
    clear: "tilezero tmm0",
    load: "tileloadd tmm0, [rdi + rax*1]",
    step:
        "tileloadd tmm4, [rsi + rdx*1]" "tileloadd tmm5, [rcx + r9*1]"
        "tdpbf16ps tmm0, tmm4, tmm5",
    store: "tilestored [rdi + rax*1], tmm0");

/// # Safety
/// As of the blocks; `tiles` is `(1, 1..=4)` or `(2, 1..=2)`.
#[inline(always)]
unsafe fn multiply(tiles: (usize, usize), block: &Block) {
    // SAFETY: the caller's promise.
    unsafe {
        match tiles {
            (2, 2) => two_by_two(block),
            (2, _) => two_by_one(block),
            (_, 4) => one_by_four(block),
            (_, 3) => one_by_three(block),
            (_, 2) => one_by_two(block),
            _ => one_by_one(block),
        }
    }
}

/// Sums of a block whose rows of `c` are scattered or too few.
#[repr(align(64))]
struct Sums([f32; BLOCK]);

/// Bytes from each row to the next if they are the same for all (two or more) rows.
fn spacing(c: &[*mut f32]) -> Option<isize> {
    // Exposed, because the block's stores reach every row from the first one's pointer.
    let address = |row: &*mut f32| row.expose_provenance().cast_signed();
    let bytes = address(&c[1]).wrapping_sub(address(&c[0]));
    let even = c.windows(2).all(|w| address(&w[1]).wrapping_sub(address(&w[0])) == bytes);
    even.then_some(bytes)
}

/// `c[i][0..width] (+)= Σ_p a[i][p] · b[p]` for `rows` rows and one panel of columns, where the
/// product of two pairs is the sum of the products of their halves.
///
/// - `a`: rows of pairs of bf16 (low half even k, high half odd k), `a_stride` pairs apart
/// - `b`: `[k_pairs, width]` pairs of the same kind, one pair of k of one column each
/// - `c`: a pointer to each row of `width` sums
///
/// Without `accumulate` the old values of `c` are not read.
///
/// # Safety
/// [`configure`] has been called on this thread. `width` is 16, 32, 48 or 64, `k_pairs` a multiple
/// of 16. The rows of `a` are readable up to the next multiple of 16 of `rows` (the surplus may hold
/// anything), the first `rows` pointers of `c` are to distinct writable rows that no other thread
/// touches meanwhile.
#[allow(clippy::too_many_arguments)] // As the f32 micro-kernel's, and `a` is not row pointers.
#[target_feature(enable = "avx512f")]
pub(crate) unsafe fn panel(
    rows: usize,
    a: *const u32,
    a_stride: usize,
    b: *const u32,
    width: usize,
    c: &[*mut f32],
    k_pairs: usize,
    accumulate: bool,
) {
    debug_assert!(c.len() >= rows && k_pairs.is_multiple_of(TILE));
    debug_assert!(width.is_multiple_of(TILE) && (TILE..=4 * TILE).contains(&width));
    let steps = k_pairs / TILE;
    let mut sums = Sums([0.0; BLOCK]);
    let mut row = 0;
    while row < rows {
        let tall = if rows - row > TILE { 2 } else { 1 };
        let at = &c[row..rows.min(row + tall * TILE)];
        let c_stride = if at.len() == tall * TILE { spacing(at) } else { None };
        let mut start = 0;
        while start < width {
            let wide = ((width - start) / TILE).min(4 / tall);
            // SAFETY: the caller's promise: `a` is readable in whole tiles; a block reads and
            // writes `c` itself only when all its rows are there, else `sums`, of the block's size.
            unsafe {
                let a = a.add(row * a_stride);
                let block = Block {
                    a,
                    a_stride: 4 * a_stride,
                    b: b.add(start),
                    b_stride: 4 * width,
                    c: at[0].add(start),
                    c_stride: c_stride.unwrap_or_default(),
                    steps,
                    accumulate,
                };
                if steps == 0 {
                    if !accumulate {
                        at.iter().for_each(|to| to.add(start).write_bytes(0, wide * TILE));
                    }
                } else if c_stride.is_some() {
                    multiply((tall, wide), &block);
                } else {
                    let sums = sums.0.as_mut_ptr();
                    let columns = wide * TILE;
                    if accumulate {
                        for (i, from) in at.iter().enumerate() {
                            copy(from.add(start), sums.add(i * columns), columns);
                        }
                    }
                    let c_stride = 4 * columns as isize;
                    multiply((tall, wide), &Block { c: sums, c_stride, ..block });
                    for (i, to) in at.iter().enumerate() {
                        copy(sums.add(i * columns), to.add(start), columns);
                    }
                }
            }
            start += wide * TILE;
        }
        row += tall * TILE;
    }
}

/// Copies `len` values, a multiple of 16; a call of memcpy a row would cost as much as the block.
///
/// # Safety
/// `len` values are readable and writable.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn copy(from: *const f32, to: *mut f32, len: usize) {
    for j in (0..len).step_by(16) {
        // SAFETY: below `len`.
        unsafe { _mm512_storeu_ps(to.add(j), _mm512_loadu_ps(from.add(j))) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gemm::tests::random;

    /// Nearest bf16, ties to even, as its 16 bits.
    fn to_bf16(x: f32) -> u32 {
        let bits = x.to_bits();
        if x.is_nan() { bits >> 16 | 0x40 } else { (bits + 0x7fff + (bits >> 16 & 1)) >> 16 }
    }

    fn from_bf16(bits: u32) -> f32 {
        f32::from_bits(bits << 16)
    }

    fn rounded(x: f32) -> f32 {
        from_bf16(to_bf16(x))
    }

    fn tiles_or_say_so(test: &str) -> bool {
        let there = available();
        if !there {
            println!("{test}: not run, no AMX on this CPU or from this system");
        }
        there
    }

    /// Row-major `[rows, k]` values as pairs; a gap after each row and the rows up to a whole tile
    /// are NaN. Returns the stride too.
    fn pack_a(a: &[f32], rows: usize, k: usize) -> (Vec<u32>, usize) {
        let stride = k / 2 + 5;
        let mut pairs = vec![u32::MAX; rows.next_multiple_of(TILE) * stride];
        for i in 0..rows {
            for p in 0..k / 2 {
                let at = i * k + 2 * p;
                pairs[i * stride + p] = to_bf16(a[at]) | to_bf16(a[at + 1]) << 16;
            }
        }
        (pairs, stride)
    }

    /// Row-major `[k, width]` values as pairs.
    fn pack_b(b: &[f32], width: usize) -> Vec<u32> {
        let pair = |rows: &[f32]| -> Vec<u32> {
            (0..width).map(|j| to_bf16(rows[j]) | to_bf16(rows[width + j]) << 16).collect()
        };
        b.chunks_exact(2 * width).flat_map(pair).collect()
    }

    #[derive(Clone, Copy, PartialEq, Debug)]
    enum Rows {
        /// One after another.
        Dense,
        /// From the last to the first, with gaps of one value.
        Reversed,
        /// At places of no order.
        Scattered,
    }

    /// The product by [`panel`]; `old` are the values of `c` before it, to be added to.
    fn product(
        (a, b): (&[f32], &[f32]),
        (rows, k, width): (usize, usize, usize),
        old: Option<&[f32]>,
        layout: Rows,
    ) -> Vec<f32> {
        const UNTOUCHED: f32 = -77.25;
        let (pairs, a_stride) = pack_a(a, rows, k);
        let b = pack_b(b, width);
        let place = |i: usize| match layout {
            Rows::Dense => i * width,
            Rows::Reversed => (rows - 1 - i) * (width + 1),
            // 7 and 193 have no common factor; more rows than 193 are not asked for.
            Rows::Scattered => i * 7 % 193 * (width + 3),
        };
        let len = (0..rows).map(|i| place(i) + width).max().unwrap_or(0) + 3;
        let mut c = vec![UNTOUCHED; len];
        for i in 0..rows {
            let at = place(i);
            match old {
                Some(old) => {
                    c[at..at + width].copy_from_slice(&old[i * width..(i + 1) * width]);
                }
                // Must not be read.
                None => c[at..at + width].fill(f32::NAN),
            }
        }
        let base = c.as_mut_ptr();
        // SAFETY: places are inside `c` and apart; `a` has its surplus rows; tiles are available, as
        // every caller has checked.
        unsafe {
            let to: Vec<*mut f32> = (0..rows).map(|i| base.add(place(i))).collect();
            configure();
            let a = pairs.as_ptr();
            panel(rows, a, a_stride, b.as_ptr(), width, &to, k / 2, old.is_some());
        }
        let mut out = Vec::new();
        for i in 0..rows {
            out.extend_from_slice(&c[place(i)..place(i) + width]);
            c[place(i)..place(i) + width].fill(UNTOUCHED);
        }
        assert!(c.iter().all(|&x| x == UNTOUCHED), "written beside the rows");
        out
    }

    /// `Σ a·b` and `Σ |a·b|` over the bf16-rounded operands, in f64.
    fn reference(
        (a, b): (&[f32], &[f32]),
        (rows, k, width): (usize, usize, usize),
    ) -> Vec<(f64, f64)> {
        let a: Vec<f64> = a.iter().map(|&x| rounded(x).into()).collect();
        let b: Vec<f64> = b.iter().map(|&x| rounded(x).into()).collect();
        let mut out = vec![(0.0, 0.0); rows * width];
        for i in 0..rows {
            for p in 0..k {
                for j in 0..width {
                    let term = a[i * k + p] * b[p * width + j];
                    let (sum, size) = &mut out[i * width + j];
                    *sum += term;
                    *size += term.abs();
                }
            }
        }
        out
    }

    /// A sum passes through at most so many roundings, each of half a unit in the last place of
    /// something no larger than the sum of sizes.
    fn tolerance(k: usize) -> f64 {
        (k / 32 + TILE + 2) as f64 * 0.5 * f64::from(f32::EPSILON)
    }

    #[test]
    fn agrees_with_f64_of_rounded_operands() {
        if !tiles_or_say_so("agrees_with_f64_of_rounded_operands") {
            return;
        }
        for rows in [1, 2, 15, 16, 17, 31, 32, 33, 48, 192] {
            for width in [16, 32, 48, 64] {
                for k in [32, 64, 768] {
                    let shape = (rows, k, width);
                    let (a, b) = (random(rows * k, 1), random(k * width, 2));
                    let old = random(rows * width, 3);
                    let want = reference((&a, &b), shape);
                    let plain = product((&a, &b), shape, None, Rows::Dense);
                    let added = product((&a, &b), shape, Some(&old), Rows::Dense);
                    for (i, &(sum, size)) in want.iter().enumerate() {
                        let error = (f64::from(plain[i]) - sum).abs();
                        assert!(error <= tolerance(k) * size, "{shape:?} at {i}: {error}");
                        let old = f64::from(old[i]);
                        let error = (f64::from(added[i]) - sum - old).abs();
                        let size = size + old.abs();
                        assert!(error <= tolerance(k) * size, "{shape:?} added at {i}: {error}");
                    }
                    for layout in [Rows::Reversed, Rows::Scattered] {
                        let again = product((&a, &b), shape, None, layout);
                        assert!(bits(&again) == bits(&plain), "{shape:?} {layout:?}");
                        let again = product((&a, &b), shape, Some(&old), layout);
                        assert!(bits(&again) == bits(&added), "{shape:?} {layout:?} added");
                    }
                }
            }
        }
    }

    fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|x| x.to_bits()).collect()
    }

    /// Sums of small whole numbers have no rounding: each of the products must be there, once.
    #[test]
    fn whole_numbers_are_exact() {
        if !tiles_or_say_so("whole_numbers_are_exact") {
            return;
        }
        let whole = |len, seed| -> Vec<f32> {
            random(len, seed).iter().map(|x| (x * 100.0).round()).collect()
        };
        for shape in [(1, 32, 16), (50, 96, 48), (64, 768, 64), (33, 32, 32)] {
            let (rows, k, width) = shape;
            let (a, b) = (whole(rows * k, 4), whole(k * width, 5));
            let want: Vec<f32> =
                reference((&a, &b), shape).iter().map(|&(sum, _)| sum as f32).collect();
            assert_eq!(product((&a, &b), shape, None, Rows::Dense), want, "{shape:?}");
        }
    }

    #[test]
    fn rows_and_cuts_of_k_never_change_a_bit() {
        if !tiles_or_say_so("rows_and_cuts_of_k_never_change_a_bit") {
            return;
        }
        let (rows, k, width) = (70, 192, 64);
        let (a, b) = (random(rows * k, 6), random(k * width, 7));
        let all = product((&a, &b), (rows, k, width), None, Rows::Dense);
        for row in [0, 15, 16, 31, 63, 69] {
            let one = product((&a[row * k..][..k], &b), (1, k, width), None, Rows::Dense);
            assert_eq!(bits(&one), bits(&all[row * width..][..width]), "row {row}");
        }
        for cut in [32, 96, 160] {
            let part = |from: usize, to: usize| -> Vec<f32> {
                a.chunks_exact(k).flat_map(|row| row[from..to].to_vec()).collect()
            };
            let (head, tail) = b.split_at(cut * width);
            let first = product((&part(0, cut), head), (rows, cut, width), None, Rows::Dense);
            let shape = (rows, k - cut, width);
            let both = product((&part(cut, k), tail), shape, Some(&first), Rows::Scattered);
            assert_eq!(bits(&both), bits(&all), "cut at {cut}");
        }
        let none = product((&[], &[]), (rows, 0, width), None, Rows::Scattered);
        assert!(none.iter().all(|&x| x == 0.0));
        assert_eq!(product((&[], &[]), (rows, 0, width), Some(&all), Rows::Dense), all);
    }

    /// The system saves the tiles of threads that take turns on a core, and each thread's first
    /// use configures its own.
    #[test]
    fn threads_do_not_disturb_each_other() {
        if !tiles_or_say_so("threads_do_not_disturb_each_other") {
            return;
        }
        let shape = (48, 320, 64);
        let operands = |seed| (random(48 * 320, seed), random(320 * 64, seed + 100));
        let alone: Vec<Vec<u32>> = (0..4)
            .map(|seed| {
                let (a, b) = operands(seed);
                bits(&product((&a, &b), shape, None, Rows::Dense))
            })
            .collect();
        std::thread::scope(|scope| {
            for (seed, want) in (0..4).zip(&alone) {
                scope.spawn(move || {
                    let (a, b) = operands(seed);
                    for _ in 0..5 {
                        let got = product((&a, &b), shape, None, Rows::Scattered);
                        assert!(bits(&got) == *want, "thread {seed}");
                    }
                });
            }
        });
    }

    #[test]
    fn configuring_again_after_a_release() {
        if !tiles_or_say_so("configuring_again_after_a_release") {
            return;
        }
        let (a, b) = (random(20 * 64, 8), random(64 * 32, 9));
        let want = product((&a, &b), (20, 64, 32), None, Rows::Dense);
        // SAFETY: tiles are available, and nothing is in them between products.
        unsafe { asm!("tilerelease", options(nostack, preserves_flags)) };
        assert_eq!(product((&a, &b), (20, 64, 32), None, Rows::Dense), want);
    }

    #[test]
    fn infinities_and_nan_stay_in_their_row_and_column() {
        if !tiles_or_say_so("infinities_and_nan_stay_in_their_row_and_column") {
            return;
        }
        let shape @ (rows, k, width) = (35, 64, 48);
        let positive =
            |len, seed| -> Vec<f32> { random(len, seed).iter().map(|x| x.abs() + 0.5).collect() };
        let (mut a, mut b) = (positive(rows * k, 10), positive(k * width, 11));
        a[3 * k + 7] = f32::NAN;
        a[20 * k + 60] = f32::INFINITY;
        a[34 * k + 1] = f32::NEG_INFINITY;
        a[5 * k + 31] = 1e30;
        b[31 * width + 40] = 1e30;
        b[9 * width + 17] = f32::NAN;
        let out = product((&a, &b), shape, None, Rows::Dense);
        for i in 0..rows {
            for j in 0..width {
                let x = out[i * width + j];
                let right = match (i, j) {
                    (3, _) | (_, 17) => x.is_nan(),
                    (20, _) => x == f32::INFINITY,
                    (34, _) => x == f32::NEG_INFINITY,
                    (5, 40) => x == f32::INFINITY,
                    _ => x.is_finite(),
                };
                assert!(right, "{i}, {j}: {x}");
            }
        }
        a[20 * k + 61] = f32::NEG_INFINITY;
        b[60 * width + 2] = 0.0;
        let out = product((&a, &b), shape, None, Rows::Dense);
        assert!(out[20 * width + 30].is_nan(), "∞ − ∞");
        b[61 * width + 2] = 1.0;
        a[20 * k + 61] = 1.0;
        let out = product((&a, &b), shape, None, Rows::Dense);
        assert!(out[20 * width + 2].is_nan(), "∞ · 0");
        let old = vec![f32::INFINITY; rows * width];
        let out = product((&a, &b), shape, Some(&old), Rows::Dense);
        assert_eq!(out[0], f32::INFINITY);
    }

    #[test]
    fn subnormal_numbers_count_as_zero() {
        if !tiles_or_say_so("subnormal_numbers_count_as_zero") {
            return;
        }
        let shape = (1, 32, 16);
        let one_product = |x: f32, y: f32, old: f32| {
            let (mut a, mut b) = (vec![0.0; 32], vec![0.0; 32 * 16]);
            a[4] = x;
            b[4 * 16 + 3] = y;
            product((&a, &b), shape, Some(&[old; 16]), Rows::Dense)[3]
        };
        let least = f32::MIN_POSITIVE;
        assert_eq!(one_product(least, 1.0, 0.0), least);
        assert_eq!(one_product(least / 2.0, 4.0, 0.0), 0.0, "operand");
        assert_eq!(one_product(4.0, least / 2.0, 0.0), 0.0, "operand");
        assert_eq!(one_product(least, 0.5, 0.0), 0.0, "result");
        assert_eq!(one_product(1.0, 0.0, least / 2.0), 0.0, "old value");
        assert!(one_product(least / 2.0, f32::INFINITY, 0.0).is_nan());
    }

    /// One element as the instruction adds it up.
    fn model(a: &[f32], b: &[f32]) -> f32 {
        let mut sum = 0f32;
        for (a, b) in a.chunks(32).zip(b.chunks(32)) {
            let mut chains = [0f32; 2];
            for (p, (a, b)) in a.iter().zip(b).enumerate() {
                chains[p % 2] = a.mul_add(*b, chains[p % 2]);
            }
            sum += chains[0] + chains[1];
        }
        sum
    }

    /// The nearest bf16 and the nearest one to what is left.
    fn split(x: f32) -> (f32, f32) {
        let high = rounded(x);
        (high, rounded(x - high))
    }

    /// f32 products from three bf16 ones, `[A_hi, A_hi, A_lo] · [B_hi; B_lo; B_hi]`: the error as a
    /// share of the sum of the products' sizes.
    ///
    /// A low half is at most 2⁻⁸ of its number, and both together are wrong by 2⁻¹⁷. What lacks is
    /// low · low and each number's rest: 2⁻¹⁶ + 2 · 2⁻¹⁷ = 2⁻¹⁵ at worst, in one product or if all
    /// err alike; in sums of many of a size it averages out.
    fn split_error(a: &[f32], b: &[f32]) -> f64 {
        let halves = |x: &[f32]| -> (Vec<f32>, Vec<f32>) { x.iter().map(|&x| split(x)).unzip() };
        let ((ah, al), (bh, bl)) = (halves(a), halves(b));
        let got = model(&[&ah[..], &ah, &al].concat(), &[&bh[..], &bl, &bh].concat());
        let terms = a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b));
        let size: f64 = terms.clone().map(f64::abs).sum();
        (f64::from(got) - terms.sum::<f64>()).abs() / size
    }

    #[test]
    fn three_products_of_halves_keep_15_bits() {
        const WORST: f64 = 1.0 / 32768.0;
        let k = 768;
        let scaled = |seed: u64, exponent: f32| -> Vec<f32> {
            let scale = random(k, seed + 1000);
            random(k, seed).iter().zip(scale).map(|(x, s)| x * (exponent * s).exp2()).collect()
        };
        // Up to 2^±50 each: products from 1e-30 to 1e30 side by side, where one decides alone.
        for (exponent, allowed) in [(0.0, 2e-6), (8.0, 2e-5), (50.0, WORST + tolerance(3 * k))] {
            let errors = (0..200)
                .map(|seed| split_error(&scaled(seed, exponent), &scaled(seed + 500, exponent)));
            let worst = errors.fold(0.0, f64::max);
            println!("numbers scaled by 2^±{exponent}: {worst:.2e}");
            assert!(worst <= allowed, "2^±{exponent}: {worst:e}");
        }
        // Both halves round down as far as they can.
        let least = 1.0 + 1.0 / 256.0 - 1.0 / 131_072.0 - 1.0 / 8_388_608.0;
        let error = split_error(&[least], &[least]);
        assert!((0.98 * WORST..WORST).contains(&error), "{error:e}");
        // What rounds to infinity becomes NaN (its rest is −∞, and ∞ meets the other's rest of 0).
        assert!(split_error(&[f32::MAX], &[1.0]).is_nan());
    }
}
