// Queries and keys that turn with their voxel: `crates/kernels/src/point_rope.rs`.

/// Cosine and sine of each pair, axis after axis; angles in f64. `steps`: `[dim / 6]`, angle of a voxel's step for each
/// pair of an axis. `pairs`: `[N, dim / 2, 2]`
KERNEL(256) rope_rotations(In<i32> cells, In<double> steps, Out<float> pairs, u32 n, u32 dim) {
    u64 i = global_index();
    if (i >= (u64)n * (dim / 2)) return;
    u64 row;
    u32 pair;
    split_index(i, dim / 2, row, pair);
    u32 third = dim / 6;
    double sine, cosine;
    sine_cosine((double)cells[row * 3 + pair / third] * steps[pair % third], sine, cosine);
    pairs[i * 2] = (float)cosine;
    pairs[i * 2 + 1] = (float)sine;
}
ENTRY(rope_rotations)

/// Turns queries and keys in place, `back` for gradients. `qkv`: `[N, 3, heads, dim]`
KERNEL(256) rope_turn(In<float> pairs, Out<float> qkv, u32 n, u32 heads, u32 dim, u32 back) {
    u32 half = dim / 2, third = dim / 6;
    u32 each = 2 * heads * half;
    u64 i = global_index();
    if (i >= (u64)n * each) return;
    u64 row;
    u32 rest;
    split_index(i, each, row, rest);
    u32 head = rest / half, pair = rest % half;
    u64 u = (row * 3 * heads + head) * dim + pair / third * 2 * third + pair % third;
    u64 v = u + third;
    float cosine = pairs[(row * half + pair) * 2], sine = pairs[(row * half + pair) * 2 + 1];
    if (back) sine = -sine;
    float a = qkv[u], b = qkv[v];
    qkv[u] = a * cosine - b * sine;
    qkv[v] = b * cosine + a * sine;
}
ENTRY(rope_turn)
