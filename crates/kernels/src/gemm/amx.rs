//! Products of bf16 pairs, or of four bytes, on AMX tiles: the innermost loop of a matrix product.
//!
//! A tile register holds 16 rows of 64 bytes. `tdpbf16ps` multiplies a tile of 16 rows × 32 values
//! of k by one of 32 values of k × 16 columns and adds the 16 × 16 products to f32 sums: 16,384
//! operations every 16 cycles. Intrinsics for it are not stable, hence assembly; the registers'
//! names are, as clobbers.
//!
//! `tdpbusd` does the same with four bytes, unsigned rows and signed columns, in place of a pair, and
//! adds to i32 sums, exactly: twice the operations. Everything else is the same for both.
//!
//! # Arithmetic of bf16
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

fn cpu_has_tiles() -> bool {
    const AMX_BF16: u32 = 1 << 22;
    const AMX_TILE: u32 = 1 << 24;
    features() & (AMX_BF16 | AMX_TILE) == AMX_BF16 | AMX_TILE
}

/// Whether the CPU's tiles also multiply bytes; asked where [`available`] says yes.
pub(crate) fn has_bytes() -> bool {
    const AMX_INT8: u32 = 1 << 25;
    static HAS: OnceLock<bool> = OnceLock::new();
    *HAS.get_or_init(|| features() & AMX_INT8 != 0)
}

#[allow(unused_unsafe)] // CPUID is safe in newer versions of Rust than the oldest supported one.
fn features() -> u32 {
    // SAFETY: every x86-64 CPU has CPUID.
    unsafe { if __cpuid(0).eax < 7 { 0 } else { __cpuid_count(7, 0).edx } }
}

/// What tiles hold, and so which products are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Operands {
    /// Pairs of bf16; sums are f32.
    Pairs,
    /// Four bytes, without sign in rows and with sign in columns; sums are i32, whose bits stand in
    /// place of f32.
    Bytes,
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
     step: $($step:expr),+; store: $($store:literal)+) => {
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

/// All shapes, with one instruction for the products.
macro_rules! shapes {
    ($module:ident, $dot:literal) => {
        mod $module {
            use super::{Block, TILE};
            use std::arch::asm;

        block!(two_by_two,
            clear: "tilezero tmm0" "tilezero tmm1" "tilezero tmm2" "tilezero tmm3",
            load:
            "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm1, [rdi + rax*1 + 64]"
            "tileloadd tmm2, [r10 + rax*1]" "tileloadd tmm3, [r10 + rax*1 + 64]",
            step:
                "tileloadd tmm4, [rsi + rdx*1]",
                "tileloadd tmm6, [rcx + r9*1]",
                concat!($dot, " tmm0, tmm4, tmm6"),
                "tileloadd tmm7, [rcx + r9*1 + 64]",
                concat!($dot, " tmm1, tmm4, tmm7"),
                "tileloadd tmm5, [r8 + rdx*1]",
                concat!($dot, " tmm2, tmm5, tmm6"),
                concat!($dot, " tmm3, tmm5, tmm7");
            store:
            "tilestored [rdi + rax*1], tmm0" "tilestored [rdi + rax*1 + 64], tmm1"
            "tilestored [r10 + rax*1], tmm2" "tilestored [r10 + rax*1 + 64], tmm3");

        block!(two_by_one,
            clear: "tilezero tmm0" "tilezero tmm2",
            load: "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm2, [r10 + rax*1]",
            step:
                "tileloadd tmm4, [rsi + rdx*1]",
                "tileloadd tmm6, [rcx + r9*1]",
                concat!($dot, " tmm0, tmm4, tmm6"),
                "tileloadd tmm5, [r8 + rdx*1]",
                concat!($dot, " tmm2, tmm5, tmm6");
            store: "tilestored [rdi + rax*1], tmm0" "tilestored [r10 + rax*1], tmm2");

        // A single row of tiles takes all columns at once: fewer products than four in flight would wait
        // for each other.
        block!(one_by_four,
            clear: "tilezero tmm0" "tilezero tmm1" "tilezero tmm2" "tilezero tmm3",
            load:
            "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm1, [rdi + rax*1 + 64]"
            "tileloadd tmm2, [rdi + rax*1 + 128]" "tileloadd tmm3, [rdi + rax*1 + 192]",
            step:
                "tileloadd tmm4, [rsi + rdx*1]",
                "tileloadd tmm5, [rcx + r9*1]",
                concat!($dot, " tmm0, tmm4, tmm5"),
                "tileloadd tmm6, [rcx + r9*1 + 64]",
                concat!($dot, " tmm1, tmm4, tmm6"),
                "tileloadd tmm7, [rcx + r9*1 + 128]",
                concat!($dot, " tmm2, tmm4, tmm7"),
                "tileloadd tmm5, [rcx + r9*1 + 192]",
                concat!($dot, " tmm3, tmm4, tmm5");
            store:
            "tilestored [rdi + rax*1], tmm0" "tilestored [rdi + rax*1 + 64], tmm1"
            "tilestored [rdi + rax*1 + 128], tmm2" "tilestored [rdi + rax*1 + 192], tmm3");

        block!(one_by_three,
            clear: "tilezero tmm0" "tilezero tmm1" "tilezero tmm2",
            load:
            "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm1, [rdi + rax*1 + 64]"
            "tileloadd tmm2, [rdi + rax*1 + 128]",
            step:
                "tileloadd tmm4, [rsi + rdx*1]",
                "tileloadd tmm5, [rcx + r9*1]",
                concat!($dot, " tmm0, tmm4, tmm5"),
                "tileloadd tmm6, [rcx + r9*1 + 64]",
                concat!($dot, " tmm1, tmm4, tmm6"),
                "tileloadd tmm7, [rcx + r9*1 + 128]",
                concat!($dot, " tmm2, tmm4, tmm7");
            store:
            "tilestored [rdi + rax*1], tmm0" "tilestored [rdi + rax*1 + 64], tmm1"
            "tilestored [rdi + rax*1 + 128], tmm2");

        block!(one_by_two,
            clear: "tilezero tmm0" "tilezero tmm1",
            load: "tileloadd tmm0, [rdi + rax*1]" "tileloadd tmm1, [rdi + rax*1 + 64]",
            step:
                "tileloadd tmm4, [rsi + rdx*1]",
                "tileloadd tmm5, [rcx + r9*1]",
                concat!($dot, " tmm0, tmm4, tmm5"),
                "tileloadd tmm6, [rcx + r9*1 + 64]",
                concat!($dot, " tmm1, tmm4, tmm6");
            store: "tilestored [rdi + rax*1], tmm0" "tilestored [rdi + rax*1 + 64], tmm1");

        block!(one_by_one,
            clear: "tilezero tmm0",
            load: "tileloadd tmm0, [rdi + rax*1]",
            step:
                "tileloadd tmm4, [rsi + rdx*1]",
                "tileloadd tmm5, [rcx + r9*1]",
                concat!($dot, " tmm0, tmm4, tmm5");
            store: "tilestored [rdi + rax*1], tmm0");

            /// # Safety
            /// As of the blocks; `tiles` is `(1, 1..=4)` or `(2, 1..=2)`.
            #[inline(always)]
            pub(super) unsafe fn multiply(tiles: (usize, usize), block: &Block) {
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
        }
    };
}

shapes!(pairs, "tdpbf16ps");
shapes!(bytes, "tdpbusd");

/// # Safety
/// As of the blocks.
#[inline(always)]
unsafe fn multiply(operands: Operands, tiles: (usize, usize), block: &Block) {
    // SAFETY: the caller's promise.
    unsafe {
        match operands {
            Operands::Pairs => pairs::multiply(tiles, block),
            Operands::Bytes => bytes::multiply(tiles, block),
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

/// As [`multiply`] for rows of `c` that are scattered or too few, by way of `sums`: `c` are the rows and the first
/// column.
///
/// # Safety
/// As of the blocks; the columns of the rows of `c` are readable and writable.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn multiply_in(
    sums: &mut Sums,
    operands: Operands,
    tiles: (usize, usize),
    block: Block,
    (rows, start): (&[*mut f32], usize),
) {
    let sums = sums.0.as_mut_ptr();
    let columns = tiles.1 * TILE;
    // SAFETY: the caller's promise; `sums` is of the block's size.
    unsafe {
        if block.accumulate {
            for (i, from) in rows.iter().enumerate() {
                copy(from.add(start), sums.add(i * columns), columns);
            }
        }
        multiply(operands, tiles, &Block { c: sums, c_stride: 4 * columns as isize, ..block });
        for (i, to) in rows.iter().enumerate() {
            copy(sums.add(i * columns), to.add(start), columns);
        }
    }
}

/// `c[i][0..width] (+)= Σ_p a[i][p] · b[p]` for `rows` rows and one panel of columns, where the
/// product of two pairs is the sum of the products of their halves.
///
/// - `a`: rows of pairs of bf16 (low half even k, high half odd k), `a_stride` pairs apart
/// - `b`: `[k_pairs, width]` pairs of the same kind, one pair of k of one column each
/// - `c`: a pointer to each row of `width` sums
///
/// [`Operands::Bytes`] have four bytes in place of each pair, and i32 in place of the sums.
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
    operands: Operands,
    rows: usize,
    a: *const u32,
    a_stride: usize,
    b: *const u32,
    width: usize,
    c: &[*mut f32],
    k_pairs: usize,
    accumulate: bool,
) {
    // A few comparisons for thousands of products.
    assert!(c.len() >= rows && k_pairs.is_multiple_of(TILE));
    assert!(width.is_multiple_of(TILE) && (TILE..=4 * TILE).contains(&width));
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
                    multiply(operands, (tall, wide), &block);
                } else {
                    multiply_in(&mut sums, operands, (tall, wide), block, (at, start));
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
mod tests;
