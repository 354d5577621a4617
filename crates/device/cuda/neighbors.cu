// The points nearest to a point, exact and with ties settled by row, and votes among them:
// `crates/kernels/src/neighbors.rs`, `crates/metrics/src/voting.rs`.
//
// Points are sorted by the cell of a coarse grid, x before y before z. A query looks at its cell, then at the shells
// around it, until what lies outside is farther than the farthest of its neighbours. Distances are f64.

/// Most neighbours of a query.
#define MOST_NEIGHBORS 32

/// The coarse grid: where it begins, the side of its cells, cells along each axis.
struct CoarseGrid {
    double low[3], side;
    i32 cells[3];
};

DEVICE i32 cell_along(double v, double low, double side, i32 cells) {
    double cell = floor_of((v - low) / side);
    return cell < 0.0 ? 0 : cell >= (double)cells ? cells - 1 : (i32)cell;
}

KERNEL(256) neighbor_cells(In<float> points, Out<u64> codes, u32 n, double x0, double y0, double z0, double side,
                           i32 nx, i32 ny, i32 nz) {
    u64 i = global_index();
    if (i >= n) return;
    u64 x = (u64)cell_along((double)points[3 * i], x0, side, nx);
    u64 y = (u64)cell_along((double)points[3 * i + 1], y0, side, ny);
    u64 z = (u64)cell_along((double)points[3 * i + 2], z0, side, nz);
    codes[i] = (x * (u64)ny + y) * (u64)nz + z;
}
ENTRY(neighbor_cells)

/// First entry whose code is not below `code`.
DEVICE u32 first_from(In<u64> codes, u32 n, u64 code) {
    u32 low = 0, high = n;
    while (low < high) {
        u32 middle = low + (high - low) / 2;
        if (codes[middle] < code) low = middle + 1;
        else high = middle;
    }
    return low;
}

/// The nearest so far, in order.
struct Nearest {
    double distance[MOST_NEIGHBORS];
    u32 row[MOST_NEIGHBORS];
    u32 count;
};

DEVICE void add_neighbor(Nearest& near, u32 k, double distance, u32 row) {
    u32 at = near.count;
    if (at == k) {
        double worst = near.distance[k - 1];
        if (distance > worst || (distance == worst && row > near.row[k - 1])) return;
        at--;
    } else {
        near.count++;
    }
    for (; at > 0; at--) {
        double before = near.distance[at - 1];
        if (before < distance || (before == distance && near.row[at - 1] < row)) break;
        near.distance[at] = before;
        near.row[at] = near.row[at - 1];
    }
    near.distance[at] = distance;
    near.row[at] = row;
}

/// Looks at the points of the cells `code .. code + cells`.
DEVICE void visit(In<float> points, In<u64> codes, In<u32> rows, u32 n, u64 code, u32 cells, const double (&query)[3],
                  u32 k, Nearest& near) {
    u32 end = n;
    for (u32 i = first_from(codes, n, code); i < end && codes[i] < code + cells; i++) {
        u64 row = rows[i];
        double x = query[0] - (double)points[3 * row], y = query[1] - (double)points[3 * row + 1],
               z = query[2] - (double)points[3 * row + 2];
        add_neighbor(near, k, x * x + y * y + z * z, (u32)row);
    }
}

/// The `k` nearest points of each query, nearest first; NONE where there are fewer, and for queries that are not
/// finite. `codes`, `rows`: `[N]`, sorted · `found`: `[M, k]`
KERNEL(128) nearest_points(In<float> points, In<u64> codes, In<u32> rows, In<float> queries, Out<u32> found, u32 n,
                           u32 num_queries, u32 k, double x0, double y0, double z0, double side, i32 nx, i32 ny,
                           i32 nz) {
    u64 i = global_index();
    if (i >= num_queries) return;
    CoarseGrid grid = {{x0, y0, z0}, side, {nx, ny, nz}};
    double query[3];
    i32 at[3];
    bool usable = n > 0;
    for (u32 a = 0; a < 3; a++) {
        float v = queries[3 * i + a];
        usable &= is_finite(v);
        query[a] = (double)v;
        at[a] = cell_along(query[a], grid.low[a], grid.side, grid.cells[a]);
    }
    Nearest near;
    near.count = 0;
    for (i32 r = 0; usable; r++) {
        for (i32 x = at[0] - r; x <= at[0] + r; x++) {
            if (x < 0 || x >= nx) continue;
            for (i32 y = at[1] - r; y <= at[1] + r; y++) {
                if (y < 0 || y >= ny) continue;
                u64 column = ((u64)x * (u64)ny + (u64)y) * (u64)nz;
                bool side_of_shell = x == at[0] - r || x == at[0] + r || y == at[1] - r || y == at[1] + r;
                i32 low = at[2] - r, high = at[2] + r;
                if (side_of_shell) {
                    low = low < 0 ? 0 : low;
                    high = high >= nz ? nz - 1 : high;
                    if (low <= high) visit(points, codes, rows, n, column + (u64)low, (u32)(high - low + 1), query, k, near);
                } else {
                    if (low >= 0) visit(points, codes, rows, n, column + (u64)low, 1, query, k, near);
                    if (high < nz) visit(points, codes, rows, n, column + (u64)high, 1, query, k, near);
                }
            }
        }
        // How near a point outside of what was visited can be; a little less, for what was rounded.
        double bound = -1.0;
        for (u32 a = 0; a < 3; a++) {
            double slack = 1e-9 * (grid.side * (double)grid.cells[a]);
            if (at[a] - r > 0) {
                double to = query[a] - (grid.low[a] + (double)(at[a] - r) * grid.side) - slack;
                to = to < 0.0 ? 0.0 : to;
                bound = bound < 0.0 || to < bound ? to : bound;
            }
            if (at[a] + r + 1 < grid.cells[a]) {
                double to = grid.low[a] + (double)(at[a] + r + 1) * grid.side - query[a] - slack;
                to = to < 0.0 ? 0.0 : to;
                bound = bound < 0.0 || to < bound ? to : bound;
            }
        }
        if (bound < 0.0) break;
        // A point as far as the last neighbour may still have a smaller row.
        if (near.count == k && near.distance[k - 1] < bound * bound) break;
    }
    for (u32 j = 0; j < k; j++) found[i * k + j] = j < near.count ? near.row[j] : NONE;
}
ENTRY(nearest_points)

/// The most frequent label among the neighbours, the smaller one of equally frequent ones; −1 where none has one.
KERNEL(128) vote_labels(In<u32> found, In<i32> labels, Out<i32> winners, u32 num_queries, u32 k) {
    u64 i = global_index();
    if (i >= num_queries) return;
    i32 winner = -1;
    u32 votes = 0;
    for (u32 a = 0; a < k; a++) {
        u32 row = found[i * k + a];
        if (row == NONE) break;
        i32 label = labels[row];
        if (label < 0) continue;
        u32 count = 0;
        for (u32 b = 0; b < k; b++) {
            u32 other = found[i * k + b];
            if (other == NONE) break;
            count += labels[other] == label;
        }
        if (count > votes || (count == votes && label < winner)) {
            votes = count;
            winner = label;
        }
    }
    winners[i] = winner;
}
ENTRY(vote_labels)
