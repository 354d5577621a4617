//! Codes of curves bit by bit, for tests and for the checks of `scenesplat bench`.

/// Skilling's Hilbert code of one cell, bit by bit.
pub fn hilbert_code(cell: [u32; 3], bits: u32) -> u64 {
    let mut x = cell;
    for level in (0..bits).rev() {
        let q = 1u32 << level;
        let p = q - 1;
        for d in 0..3 {
            if x[d] & q != 0 {
                x[0] ^= p;
            } else {
                let t = (x[0] ^ x[d]) & p;
                x[0] ^= t;
                x[d] ^= t;
            }
        }
    }
    let mut code = 0u64;
    let mut parity = 0u64;
    for level in (0..bits).rev() {
        for v in x {
            parity ^= u64::from(v >> level & 1);
            code = code << 1 | parity;
        }
    }
    code
}

/// Morton code of one cell, bit by bit.
pub fn morton_code(cell: [u32; 3], bits: u32) -> u64 {
    let mut code = 0u64;
    for level in (0..bits).rev() {
        for v in cell {
            code = code << 1 | u64::from(v >> level & 1);
        }
    }
    code
}
