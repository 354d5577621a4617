// Which voxel feeds which in a submanifold convolution: `crates/kernels/src/kernel_map`.
//
// Each scene has its own stretch of one hash table, from packed cell to the first row there. Which slot a cell
// gets hangs on the order of threads; which row is found for it does not.

#define NO_CELL 0xffffffffffffffffull

/// x, y, z of 21 bits each in one word.
DEVICE u64 packed_cell(u32 x, u32 y, u32 z) { return (u64)x << 42 | (u64)y << 21 | z; }

/// First slot of a cell in a table of `size` slots, a power of two.
DEVICE u32 slot_of(u64 cell, u32 size) {
    // The odd constant is 2⁶⁴ divided by the golden ratio.
    return (u32)((cell * 0x9e3779b97f4a7c15ull) >> 32) & (size - 1);
}

/// Scene of a row: `offsets` is `[scenes + 1]`.
DEVICE u32 scene_of(In<u32> offsets, u32 scenes, u32 row) {
    u32 low = 0, high = scenes;
    while (high - low > 1) {
        u32 middle = (low + high) / 2;
        if (offsets[middle] <= row) low = middle;
        else high = middle;
    }
    return low;
}

/// Puts every row into its scene's table; where rows share a cell, the first stands for it. `table_rows` begins
/// with NONE, `table_cells` with NO_CELL. `tables`: `[scenes + 1]`, where each table begins.
KERNEL(256) table_insert(In<i32> cells, In<u32> offsets, In<u64> tables, Out<u64> table_cells,
                         Out<u32> table_rows, Out<u32> slots, u32 n, u32 scenes) {
    u64 i = global_index();
    if (i >= n) return;
    u32 scene = scene_of(offsets, scenes, (u32)i);
    u64 begin = tables[scene];
    u32 size = (u32)(tables[scene + 1] - begin);
    u64 cell = packed_cell((u32)cells[3 * i], (u32)cells[3 * i + 1], (u32)cells[3 * i + 2]);
    u32 slot = slot_of(cell, size);
    for (;;) {
        u64 there = exchange_atomically(table_cells[begin + slot], NO_CELL, cell);
        if (there == NO_CELL || there == cell) break;
        slot = (slot + 1) & (size - 1);
    }
    minimum_atomically(table_rows[begin + slot], (u32)i);
    slots[i] = slot;
}
ENTRY(table_insert)

/// Whether a row is not the first of its cell.
KERNEL(256) table_repeats(In<u32> offsets, In<u64> tables, In<u32> table_rows, In<u32> slots, Out<u32> repeats, u32 n,
                          u32 scenes) {
    u64 i = global_index();
    if (i >= n) return;
    u32 scene = scene_of(offsets, scenes, (u32)i);
    repeats[i] = table_rows[tables[scene] + slots[i]] != (u32)i;
}
ENTRY(table_repeats)

/// Input row of each output row and tap, or NONE. `neighbors`: `[taps, N]`, `found` the same as 0 and 1.
KERNEL(256) table_neighbors(In<i32> cells, In<u32> offsets, In<u64> tables, In<u64> table_cells,
                            In<u32> table_rows, Out<u32> neighbors, Out<u32> found, u32 n, u32 scenes, u32 kernel_size) {
    u64 i = global_index();
    u32 taps = kernel_size * kernel_size * kernel_size;
    if (i >= (u64)n * taps) return;
    u64 tap_wide;
    u32 row;
    split_index(i, n, tap_wide, row);
    u32 tap = (u32)tap_wide, k = kernel_size, half = kernel_size / 2;
    u32 neighbor = NONE;
    if (tap == taps / 2) {
        // Every row is its own centre.
        neighbor = row;
    } else {
        // Below 0 wraps to more than 21 bits.
        u32 x = (u32)cells[3ull * row] + tap / (k * k) - half;
        u32 y = (u32)cells[3ull * row + 1] + tap / k % k - half;
        u32 z = (u32)cells[3ull * row + 2] + tap % k - half;
        if ((x | y | z) >> 21 == 0) {
            u32 scene = scene_of(offsets, scenes, row);
            u64 begin = tables[scene];
            u32 size = (u32)(tables[scene + 1] - begin);
            u64 cell = packed_cell(x, y, z);
            u32 slot = slot_of(cell, size);
            for (;;) {
                u64 there = table_cells[begin + slot];
                if (there == cell) neighbor = table_rows[begin + slot];
                if (there == cell || there == NO_CELL) break;
                slot = (slot + 1) & (size - 1);
            }
        }
    }
    neighbors[i] = neighbor;
    found[i] = neighbor != NONE;
}
ENTRY(table_neighbors)

/// Pairs of input and output rows, tap after tap, output rows ascending. `before`: running sums of what was found.
KERNEL(256) list_pairs(In<u32> neighbors, In<u32> before, Out<u32> input, Out<u32> output, u32 n, u32 taps) {
    u64 i = global_index();
    if (i >= (u64)n * taps || neighbors[i] == NONE) return;
    u64 tap;
    u32 row;
    split_index(i, n, tap, row);
    input[before[i]] = neighbors[i];
    output[before[i]] = row;
}
ENTRY(list_pairs)

/// First pair of each tap, closed by the number of pairs. `starts`: `[taps + 1]`
KERNEL(256) pair_starts(In<u32> before, In<u32> total, Out<u32> starts, u32 n, u32 taps) {
    u64 tap = global_index();
    if (tap < taps) starts[tap] = before[tap * n];
    if (tap == taps) starts[tap] = total[0];
}
ENTRY(pair_starts)

/// Tap and input row of each pair as one number, by which they are sorted to exchange input and output.
KERNEL(256) pair_keys(In<u32> starts, In<u32> input, Out<u64> keys, u32 pairs, u32 taps) {
    u64 i = global_index();
    if (i >= pairs) return;
    u32 low = 0, high = taps;
    while (high - low > 1) {
        u32 middle = (low + high) / 2;
        if (starts[middle] <= i) low = middle;
        else high = middle;
    }
    keys[i] = (u64)low << 32 | input[i];
}
ENTRY(pair_keys)
