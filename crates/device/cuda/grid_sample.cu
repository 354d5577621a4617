// Which points share a voxel: `crates/kernels/src/grid_sample`. Divisions are made in f64, as there.

#define BOUNDS_THREADS 256
/// Rows of a block.
#define BOUNDS_ROWS 4096

/// Smallest and largest coordinate of a block's rows, and whether one is not finite. `coord`: `[N, 3]`,
/// `bounds`: `[blocks, 7]`
KERNEL(256) coordinate_bounds(In<float> coord, Out<float> bounds, u32 n) {
    SHARED(float, low, BOUNDS_THREADS * 3);
    SHARED(float, high, BOUNDS_THREADS * 3);
    SHARED(u32, bad, BOUNDS_THREADS);
    u32 t = thread_index();
    float least[3], most[3];
    bool not_finite = false;
    for (u32 a = 0; a < 3; a++) {
        least[a] = infinity();
        most[a] = -infinity();
    }
    u64 first = (u64)block_index() * BOUNDS_ROWS;
    for (u64 row = first + t; row < first + BOUNDS_ROWS && row < n; row += BOUNDS_THREADS) {
        for (u32 a = 0; a < 3; a++) {
            float v = coord[row * 3 + a];
            not_finite |= !is_finite(v);
            least[a] = smaller(v, least[a]);
            most[a] = larger(v, most[a]);
        }
    }
    for (u32 a = 0; a < 3; a++) {
        low[t * 3 + a] = least[a];
        high[t * 3 + a] = most[a];
    }
    bad[t] = not_finite;
    BARRIER();
    for (u32 step = BOUNDS_THREADS / 2; step > 0; step /= 2) {
        if (t < step) {
            for (u32 a = 0; a < 3; a++) {
                low[t * 3 + a] = smaller(low[t * 3 + a], low[(t + step) * 3 + a]);
                high[t * 3 + a] = larger(high[t * 3 + a], high[(t + step) * 3 + a]);
            }
            bad[t] |= bad[t + step];
        }
        BARRIER();
    }
    if (t == 0) {
        u64 to = (u64)block_index() * 7;
        for (u32 a = 0; a < 3; a++) {
            bounds[to + a] = low[a];
            bounds[to + 3 + a] = high[a];
        }
        bounds[to + 6] = bad[0] ? 1.0f : 0.0f;
    }
}
ENTRY(coordinate_bounds)

DEVICE u64 spread_cell(u64 v) {
    v = (v | v << 32) & 0x001f00000000ffffull;
    v = (v | v << 16) & 0x001f0000ff0000ffull;
    v = (v | v << 8) & 0x100f00f00f00f00full;
    v = (v | v << 4) & 0x10c30c30c30c30c3ull;
    return (v | v << 2) & 0x1249249249249249ull;
}

DEVICE u32 gather_cell(u64 v) {
    v &= 0x1249249249249249ull;
    v = (v | v >> 2) & 0x10c30c30c30c30c3ull;
    v = (v | v >> 4) & 0x100f00f00f00f00full;
    v = (v | v >> 8) & 0x001f0000ff0000ffull;
    v = (v | v >> 16) & 0x001f00000000ffffull;
    return (u32)(v | v >> 32) & 0x1fffffu;
}

/// Code of each row's cell, one to one: along a z-order curve, or ascending by x, y, z with as many bits for y and
/// z as given.
KERNEL(256) cell_codes(In<float> coord, Out<u64> codes, u32 n, double grid_size, double x0, double y0, double z0,
                       u32 along_curve, u32 y_bits, u32 z_bits) {
    u64 i = global_index();
    if (i >= n) return;
    u64 x = (u32)(i32)(floor_of((double)coord[3 * i] / grid_size) - x0);
    u64 y = (u32)(i32)(floor_of((double)coord[3 * i + 1] / grid_size) - y0);
    u64 z = (u32)(i32)(floor_of((double)coord[3 * i + 2] / grid_size) - z0);
    codes[i] = along_curve ? spread_cell(x) << 2 | spread_cell(y) << 1 | spread_cell(z)
                           : (x << y_bits | y) << z_bits | z;
}
ENTRY(cell_codes)

/// Whether a new cell begins at each sorted entry.
KERNEL(256) cell_begins(In<u64> codes, Out<u32> begins, u32 n) {
    u64 i = global_index();
    if (i < n) begins[i] = i == 0 || codes[i - 1] != codes[i];
}
ENTRY(cell_begins)

/// From the running sums of the beginnings: where each voxel begins, its cell, and the voxel of each row.
KERNEL(256) list_cells(In<u64> codes, In<u32> rows, In<u32> begins, In<u32> before, Out<u32> offsets,
                       Out<i32> cells, Out<u32> inverse, u32 n, u32 along_curve, u32 y_bits, u32 z_bits) {
    u64 i = global_index();
    if (i >= n) return;
    u32 voxel = before[i] + begins[i] - 1;
    inverse[rows[i]] = voxel;
    if (i + 1 == n) offsets[voxel + 1] = n;
    if (!begins[i]) return;
    u64 code = codes[i], to = (u64)voxel * 3;
    offsets[voxel] = (u32)i;
    if (along_curve) {
        cells[to] = (i32)gather_cell(code >> 2);
        cells[to + 1] = (i32)gather_cell(code >> 1);
        cells[to + 2] = (i32)gather_cell(code);
    } else {
        cells[to] = (i32)(code >> (y_bits + z_bits));
        cells[to + 1] = (i32)(code >> z_bits & ((1ull << y_bits) - 1));
        cells[to + 2] = (i32)(code & ((1ull << z_bits) - 1));
    }
}
ENTRY(list_cells)

/// The hash by which the original system orders voxels.
KERNEL(256) hash_cells(In<i32> cells, Out<u64> hashes, u32 voxels) {
    u64 i = global_index();
    if (i >= voxels) return;
    u64 hash = 14695981039346656037ull;
    for (u32 a = 0; a < 3; a++) hash = (hash * 1099511628211ull) ^ (u64)(u32)cells[3 * i + a];
    hashes[i] = hash;
}
ENTRY(hash_cells)

/// Number of rows of each voxel in a new order of voxels.
KERNEL(256) moved_counts(In<u32> order, In<u32> offsets, Out<u32> counts, u32 voxels) {
    u64 i = global_index();
    if (i < voxels) counts[i] = offsets[order[i] + 1] - offsets[order[i]];
}
ENTRY(moved_counts)

/// Lists the voxels in their new order. `place[v]` is where voxel v goes, `before` the running sums of the counts.
KERNEL(256) move_cells(In<u32> rows, In<u32> inverse, In<u32> place, In<u32> offsets, In<u32> before, In<i32> cells,
                       Out<u32> to_rows, Out<u32> to_inverse, Out<u32> to_offsets, Out<i32> to_cells, u32 n) {
    u64 i = global_index();
    if (i >= n) return;
    u32 row = rows[i], voxel = inverse[row], to = place[voxel];
    u32 inside = (u32)i - offsets[voxel];
    to_rows[before[to] + inside] = row;
    to_inverse[row] = to;
    if (inside != 0) return;
    to_offsets[to] = before[to];
    for (u32 a = 0; a < 3; a++) to_cells[(u64)to * 3 + a] = cells[(u64)voxel * 3 + a];
}
ENTRY(move_cells)
