//! Hilbert codes by a state machine.
//!
//! Skilling's transform flips and exchanges the *lower* bits of the coordinates level by level.
//! What has happened so far is always one of a few signed axis permutations, so one table lookup a
//! level replaces the transform: state × octant → three bits of the code and the next state.
//! The table is derived at first use from the transform itself.

use std::sync::OnceLock;

/// Signed axis permutation: new axis `a` reads old axis `axis[a]`, flipped if `flip[a]`; plus the
/// parity that the Gray code carries on.
#[derive(Clone, Copy, PartialEq, Eq)]
struct State {
    axis: [u8; 3],
    flip: [bool; 3],
    parity: bool,
}

struct Table {
    /// `[state][octant] = next state << 3 | three code bits`
    next: Vec<[u16; 8]>,
}

fn table() -> &'static Table {
    static TABLE: OnceLock<Table> = OnceLock::new();
    TABLE.get_or_init(|| {
        let start = State { axis: [0, 1, 2], flip: [false; 3], parity: false };
        let mut states = vec![start];
        let mut next = Vec::new();
        let mut done = 0;
        while done < states.len() {
            let state = states[done];
            let mut row = [0u16; 8];
            for (octant, entry) in row.iter_mut().enumerate() {
                let (bits, after) = step(state, octant as u8);
                let id = states.iter().position(|s| *s == after).unwrap_or_else(|| {
                    states.push(after);
                    states.len() - 1
                });
                *entry = (id as u16) << 3 | u16::from(bits);
            }
            next.push(row);
            done += 1;
        }
        Table { next }
    })
}

/// One level of the transform. `octant` holds the original bits x, y, z (x most significant).
fn step(state: State, octant: u8) -> (u8, State) {
    let original = [octant >> 2 & 1 == 1, octant >> 1 & 1 == 1, octant & 1 == 1];
    // The level's own bits after all that the higher levels did.
    let bit: [bool; 3] = std::array::from_fn(|a| original[state.axis[a] as usize] ^ state.flip[a]);
    let mut after = state;
    for d in 0..3 {
        if bit[d] {
            after.flip[0] = !after.flip[0];
        } else {
            after.axis.swap(0, d);
            after.flip.swap(0, d);
        }
    }
    let mut code = 0;
    for b in bit {
        after.parity ^= b;
        code = code << 1 | u8::from(after.parity);
    }
    (code, after)
}

/// Hilbert code of one cell with `bits` bits an axis (at most 21).
pub fn hilbert_code(cell: [u32; 3], bits: u32) -> u64 {
    let table = &table().next;
    let [x, y, z] = cell;
    let mut state = 0usize;
    let mut code = 0u64;
    for level in (0..bits).rev() {
        let octant = (x >> level & 1) << 2 | (y >> level & 1) << 1 | (z >> level & 1);
        let entry = table[state][octant as usize];
        code = code << 3 | u64::from(entry & 7);
        state = usize::from(entry >> 3);
    }
    code
}
