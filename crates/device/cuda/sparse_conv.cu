// Submanifold sparse convolution: `crates/kernels/src/sparse_conv.rs`.
//
// A block computes 64 output rows and 64 output channels, tap after tap, from tiles in shared memory; a thread has
// 4×4 of them in registers. An output's sum has one order, and nothing is added atomically. Weights are read with
// strides, so that the gradient of the input is the same kernel.

#define TILE 64
#define DEPTH 16
/// Columns of a tile in shared memory; one more than there are, so that lanes fall into different banks.
#define PITCH (TILE + 1)

/// Multiplies a tile of gathered rows by a tile of weights: `acc[4][4] += left[DEPTH][64] · right[DEPTH][64]`.
template <class S> DEVICE void multiply_tiles(S& left, S& right, float (&acc)[4][4]) {
    u32 row = thread_index() / 16 * 4, column = thread_index() % 16 * 4;
    for (u32 k = 0; k < DEPTH; k++) {
        float a[4], b[4];
        UNROLL
        for (u32 i = 0; i < 4; i++) {
            a[i] = left[k * PITCH + row + i];
            b[i] = right[k * PITCH + column + i];
        }
        UNROLL
        for (u32 i = 0; i < 4; i++) {
            UNROLL
            for (u32 j = 0; j < 4; j++) acc[i][j] = fused(a[i], b[j], acc[i][j]);
        }
    }
}

/// Loads `DEPTH` channels from `first` on of the rows in `source`, and of the weights of a tap.
template <class S, class R>
DEVICE void load_tiles(In<float> x, In<float> weight, R& source, S& left, S& right, u32 first, u32 column, u32 cin,
                       u32 cout, u64 tap_offset, u64 stride_out, u64 stride_in) {
    for (u32 i = thread_index(); i < TILE * DEPTH; i += block_threads()) {
        u32 row = i / DEPTH, k = i % DEPTH;
        bool there = source[row] != NONE && first + k < cin;
        left[k * PITCH + row] = there ? x[(u64)source[row] * cin + first + k] : 0.0f;
        u32 o = column + row;
        bool used = o < cout && first + k < cin;
        right[k * PITCH + row] = used ? weight[tap_offset + o * stride_out + (first + k) * stride_in] : 0.0f;
    }
}

/// All taps in one launch. `x`: `[N, cin]`, `neighbors`: `[taps, N]`, `out`: `[N, cout]`. With `mirrored` a
/// tap's rows meet the weights of the opposite tap. `bias` counts if `has_bias`.
KERNEL(256) conv_fused(In<float> x, In<u32> neighbors, In<float> weight, In<float> bias, Out<float> out, u32 n,
                       u32 taps, u32 cin, u32 cout, u64 stride_out, u64 stride_tap, u64 stride_in, u32 mirrored,
                       u32 has_bias) {
    SHARED(float, left, DEPTH * PITCH);
    SHARED(float, right, DEPTH * PITCH);
    SHARED(u32, source, TILE);
    SHARED(u32, any, TILE / WARP);
    u32 t = thread_index();
    u32 columns = (cout + TILE - 1) / TILE;
    u64 first_row = (u64)(block_index() / columns) * TILE;
    u32 first_column = block_index() % columns * TILE;
    float acc[4][4];
    UNROLL
    for (u32 i = 0; i < 4; i++) {
        UNROLL
        for (u32 j = 0; j < 4; j++) acc[i][j] = 0.0f;
    }
    for (u32 tap = 0; tap < taps; tap++) {
        // Nobody reads the rows of the tap before any more.
        BARRIER();
        if (t < TILE) {
            u64 row = first_row + t;
            u32 from = row < n ? neighbors[(u64)tap * n + row] : NONE;
            source[t] = from;
            u32 votes = warp_votes(from != NONE);
            if (lane_index() == 0) any[warp_index()] = votes;
        }
        BARRIER();
        if ((any[0] | any[1]) == 0) continue;
        u64 tap_offset = (mirrored ? taps - 1 - tap : tap) * stride_tap;
        for (u32 first = 0; first < cin; first += DEPTH) {
            load_tiles(x, weight, source, left, right, first, first_column, cin, cout, tap_offset, stride_out, stride_in);
            BARRIER();
            multiply_tiles(left, right, acc);
            BARRIER();
        }
    }
    for (u32 i = 0; i < 4; i++) {
        u64 row = first_row + t / 16 * 4 + i;
        for (u32 j = 0; j < 4; j++) {
            u32 o = first_column + t % 16 * 4 + j;
            if (row < n && o < cout) out[row * cout + o] = acc[i][j] + (has_bias ? bias[o] : 0.0f);
        }
    }
}
ENTRY(conv_fused)

/// Fills the rows with the bias, or zeros.
KERNEL(256) conv_begin(In<float> bias, Out<float> out, u32 n, u32 cout, u32 has_bias) {
    u64 i = global_index();
    if (i < (u64)n * cout) out[i] = has_bias ? bias[i % cout] : 0.0f;
}
ENTRY(conv_begin)

/// The pairs of one tap, without gaps: `out[output[p]] += x[input[p]] · W[tap]`. No output row occurs twice in a
/// tap. `starts`: `[taps + 1]`
KERNEL(256) conv_tap(In<float> x, In<u32> starts, In<u32> input, In<u32> output, In<float> weight, Out<float> out,
                     u32 tap, u32 weight_tap, u32 cin, u32 cout, u64 stride_out, u64 stride_tap, u64 stride_in) {
    SHARED(float, left, DEPTH * PITCH);
    SHARED(float, right, DEPTH * PITCH);
    SHARED(u32, source, TILE);
    SHARED(u32, target, TILE);
    u32 t = thread_index();
    u32 columns = (cout + TILE - 1) / TILE;
    u64 begin = starts[tap], end = starts[tap + 1];
    u64 first_pair = begin + (u64)(block_index() / columns) * TILE;
    u32 first_column = block_index() % columns * TILE;
    // The grid is sized for the longest tap.
    if (first_pair >= end) return;
    if (t < TILE) {
        u64 pair = first_pair + t;
        source[t] = pair < end ? input[pair] : NONE;
        target[t] = pair < end ? output[pair] : NONE;
    }
    float acc[4][4];
    UNROLL
    for (u32 i = 0; i < 4; i++) {
        UNROLL
        for (u32 j = 0; j < 4; j++) acc[i][j] = 0.0f;
    }
    BARRIER();
    for (u32 first = 0; first < cin; first += DEPTH) {
        load_tiles(x, weight, source, left, right, first, first_column, cin, cout, weight_tap * stride_tap, stride_out,
                   stride_in);
        BARRIER();
        multiply_tiles(left, right, acc);
        BARRIER();
    }
    for (u32 i = 0; i < 4; i++) {
        u32 row = target[t / 16 * 4 + i];
        for (u32 j = 0; j < 4; j++) {
            u32 o = first_column + t % 16 * 4 + j;
            if (row != NONE && o < cout) out[(u64)row * cout + o] += acc[i][j];
        }
    }
}
ENTRY(conv_tap)

/// Gradient of the input where rows share voxels: pairs sorted by tap and input row, each row's in their order.
/// `keys`: `tap · 2³² + row`, ascending.
KERNEL(256) conv_exchanged(In<float> grad, In<u64> keys, In<u32> output, In<float> weight, Out<float> dx, u32 n,
                           u32 pairs, u32 taps, u32 cin, u32 cout) {
    u64 i = global_index();
    if (i >= (u64)n * cin) return;
    u64 row;
    u32 channel;
    split_index(i, cin, row, channel);
    float sum = 0.0f;
    for (u32 tap = 0; tap < taps; tap++) {
        u64 key = (u64)tap << 32 | row;
        u32 low = 0, high = pairs;
        while (low < high) {
            u32 middle = low + (high - low) / 2;
            if (keys[middle] < key) low = middle + 1;
            else high = middle;
        }
        for (; low < pairs && keys[low] == key; low++) {
            u64 from = (u64)output[low] * cout;
            for (u32 o = 0; o < cout; o++)
                sum = fused(grad[from + o], weight[((u64)o * taps + tap) * cin + channel], sum);
        }
    }
    dx[i] = sum;
}
ENTRY(conv_exchanged)

#define WEIGHT_TILE 32

/// Sums of `grad[output] · x[input]` over a stretch of a tap's pairs. `parts`: `[stretches, cout, taps, cin]`
KERNEL(256) conv_weight(In<float> x, In<float> grad, In<u32> starts, In<u32> input, In<u32> output,
                        Out<float> parts, u32 taps, u32 cin, u32 cout, u32 stretches) {
    SHARED(float, left, DEPTH*(WEIGHT_TILE + 1));
    SHARED(float, right, DEPTH*(WEIGHT_TILE + 1));
    u32 t = thread_index(), b = block_index();
    u32 in_tiles = (cin + WEIGHT_TILE - 1) / WEIGHT_TILE, out_tiles = (cout + WEIGHT_TILE - 1) / WEIGHT_TILE;
    u32 first_in = b % in_tiles * WEIGHT_TILE;
    b /= in_tiles;
    u32 first_out = b % out_tiles * WEIGHT_TILE;
    b /= out_tiles;
    u32 tap = b % taps, stretch = b / taps;
    u64 count = starts[tap + 1] - starts[tap];
    u64 begin = starts[tap] + count * stretch / stretches, end = starts[tap] + count * (stretch + 1) / stretches;
    u32 o = t / 16 * 2, i = t % 16 * 2;
    float acc[2][2] = {{0.0f, 0.0f}, {0.0f, 0.0f}};
    for (u64 first = begin; first < end; first += DEPTH) {
        for (u32 at = t; at < DEPTH * WEIGHT_TILE; at += block_threads()) {
            u32 k = at / WEIGHT_TILE, c = at % WEIGHT_TILE;
            bool there = first + k < end;
            left[k * (WEIGHT_TILE + 1) + c] =
                there && first_out + c < cout ? grad[(u64)output[first + k] * cout + first_out + c] : 0.0f;
            right[k * (WEIGHT_TILE + 1) + c] =
                there && first_in + c < cin ? x[(u64)input[first + k] * cin + first_in + c] : 0.0f;
        }
        BARRIER();
        for (u32 k = 0; k < DEPTH; k++) {
            // Beyond the end lie zeros, which an infinity would turn to NaN.
            if (first + k >= end) break;
            UNROLL
            for (u32 p = 0; p < 2; p++) {
                UNROLL
                for (u32 q = 0; q < 2; q++)
                    acc[p][q] = fused(left[k * (WEIGHT_TILE + 1) + o + p], right[k * (WEIGHT_TILE + 1) + i + q],
                                      acc[p][q]);
            }
        }
        BARRIER();
    }
    for (u32 p = 0; p < 2; p++) {
        for (u32 q = 0; q < 2; q++) {
            u64 oc = first_out + o + p, ic = first_in + i + q;
            if (oc < cout && ic < cin) parts[((stretch * (u64)cout + oc) * taps + tap) * cin + ic] = acc[p][q];
        }
    }
}
ENTRY(conv_weight)

/// Adds up the parts of each weight, in their order.
KERNEL(256) conv_weight_sum(In<float> parts, Out<float> dw, u64 weights, u32 stretches) {
    u64 i = global_index();
    if (i >= weights) return;
    float sum = 0.0f;
    for (u32 s = 0; s < stretches; s++) sum += parts[s * weights + i];
    dw[i] = sum;
}
ENTRY(conv_weight_sum)
