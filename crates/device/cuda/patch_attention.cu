// Softmax attention inside patches of an order, in f32: `crates/kernels/src/patch_attention`.
//
// A block takes 64 queries (or keys) of one patch and head, one for each thread; keys (or queries) pass by in tiles
// of 64 in shared memory. The softmax is computed while they pass: what was summed is scaled down when a larger
// score comes. The largest score and the sum of each query are kept for the gradients, which compute scores again.
//
// WIDE is defined before this text: the width of a head rounded up, with zeros beyond it; loops over it are unrolled. `patches` is `[P, 4]`: first slot,
// slots, own slots (the first ones, whose outputs count), borrowed slots of the patches before. `pad` is the position
// of each slot, `order` the row of each position.

#define QUERIES 64
#define KEYS 64
/// Scores of a query that are in registers at a time.
#define SCORES 8

/// One block's patch, head and stretch of slots.
struct Place {
    u32 start, slots, own, borrowed, head, first;
};

DEVICE Place place_of(In<u32> patches, u32 heads, u32 stretches) {
    u32 b = block_index();
    u64 patch = b / stretches / heads * 4ull;
    return {patches[patch], patches[patch + 1], patches[patch + 2], patches[patch + 3], b / stretches % heads,
            b % stretches * QUERIES};
}

struct Channels {
    float at[WIDE];
};

/// The channels of a head from `from` on.
DEVICE Channels load_channels(In<float> x, u64 from, u32 dim, float scale) {
    Channels c;
    UNROLL
    for (u32 d = 0; d < WIDE; d++) c.at[d] = d < dim ? x[from + d] * scale : 0.0f;
    return c;
}

DEVICE void clear(Channels& c) {
    UNROLL
    for (u32 d = 0; d < WIDE; d++) c.at[d] = 0.0f;
}

/// `Σ a[d] · tile[row][d]`
template <class S> DEVICE float product(const Channels& a, S& tile, u32 row) {
    float sum = 0.0f;
    UNROLL
    for (u32 d = 0; d < WIDE; d++) sum = fused(a.at[d], tile[row * WIDE + d], sum);
    return sum;
}

/// `acc += weight · tile[row]`
template <class S> DEVICE void add_scaled(Channels& acc, float weight, S& tile, u32 row) {
    UNROLL
    for (u32 d = 0; d < WIDE; d++) acc.at[d] = fused(weight, tile[row * WIDE + d], acc.at[d]);
}

/// Copies one head's channels of `count` slots to a tile. `offset`: the head's first channel in a row of `width`.
template <class S>
DEVICE void load_tile(In<float> x, In<u32> pad, In<u32> order, u32 first_slot, u32 count, u32 width, u32 offset, u32 dim,
                      S& tile) {
    for (u32 i = thread_index(); i < KEYS * WIDE; i += block_threads()) {
        u32 slot = i / WIDE, d = i % WIDE;
        bool there = slot < count && d < dim;
        tile[i] = there ? x[(u64)order[pad[first_slot + slot]] * width + offset + d] : 0.0f;
    }
}

/// `statistics`: `[N, heads, 2]`, the largest score and one over the sum of the weights.
KERNEL(64) attention_forward(In<float> qkv, In<u32> patches, In<u32> pad, In<u32> order, Out<float> out,
                             Out<float> statistics, u32 heads, u32 dim, float scale, u32 stretches) {
    SHARED(float, keys, KEYS * WIDE);
    SHARED(float, values, KEYS * WIDE);
    Place p = place_of(patches, heads, stretches);
    if (p.first >= p.own) return;
    u32 channels = heads * dim, offset = p.head * dim;
    u32 slot = p.first + thread_index();
    bool counts = slot < p.own;
    u32 row = counts ? order[pad[p.start + slot]] : 0;
    Channels query, sum;
    clear(query);
    clear(sum);
    if (counts) query = load_channels(qkv, (u64)row * 3 * channels + offset, dim, scale);
    float largest = -infinity(), total = 0.0f;
    for (u32 first = 0; first < p.slots; first += KEYS) {
        u32 count = smaller(KEYS, p.slots - first);
        // Nobody reads the tile before any more.
        BARRIER();
        load_tile(qkv, pad, order, p.start + first, count, 3 * channels, channels + offset, dim, keys);
        load_tile(qkv, pad, order, p.start + first, count, 3 * channels, 2 * channels + offset, dim, values);
        BARRIER();
        if (!counts) continue;
        for (u32 k = 0; k < count; k += SCORES) {
            float scores[SCORES];
            float most = largest;
            UNROLL
            for (u32 i = 0; i < SCORES; i++) {
                scores[i] = k + i < count ? product(query, keys, k + i) : -infinity();
                most = larger(scores[i], most);
            }
            // Scores that are all −∞ have no largest one to subtract.
            float shift = most == -infinity() ? 0.0f : most;
            float shrink = exponential(largest - shift);
            largest = most;
            total *= shrink;
            UNROLL
            for (u32 d = 0; d < WIDE; d++) sum.at[d] *= shrink;
            UNROLL
            for (u32 i = 0; i < SCORES; i++) {
                if (k + i >= count) continue;
                float weight = exponential(scores[i] - shift);
                total += weight;
                add_scaled(sum, weight, values, k + i);
            }
        }
    }
    if (!counts) return;
    float inverse = 1.0f / total;
    for (u32 d = 0; d < dim; d++) out[(u64)row * channels + offset + d] = sum.at[d] * inverse;
    u64 at = ((u64)row * heads + p.head) * 2;
    statistics[at] = largest;
    statistics[at + 1] = inverse;
}
ENTRY(attention_forward)

/// `Σ grad · out` of each row and head. `sums`: `[N, heads]`
KERNEL(256) attention_row_sums(In<float> grad, In<float> out, Out<float> sums, u32 n, u32 heads, u32 dim) {
    u64 i = global_index();
    if (i >= (u64)n * heads) return;
    float sum = 0.0f;
    for (u32 d = 0; d < dim; d++) sum = fused(grad[i * dim + d], out[i * dim + d], sum);
    sums[i] = sum;
}
ENTRY(attention_row_sums)

/// Gradient of the queries: a thread for each.
KERNEL(64) attention_queries(In<float> qkv, In<float> grad, In<float> statistics, In<float> row_sums,
                             In<u32> patches, In<u32> pad, In<u32> order, Out<float> dqkv, u32 heads, u32 dim,
                             float scale, u32 stretches) {
    SHARED(float, keys, KEYS * WIDE);
    SHARED(float, values, KEYS * WIDE);
    Place p = place_of(patches, heads, stretches);
    if (p.first >= p.own) return;
    u32 channels = heads * dim, offset = p.head * dim;
    u32 slot = p.first + thread_index();
    bool counts = slot < p.own;
    u32 row = counts ? order[pad[p.start + slot]] : 0;
    u64 at = (u64)row * heads + p.head;
    Channels query, out_grad, sum;
    clear(query);
    clear(out_grad);
    clear(sum);
    float largest = 0.0f, inverse = 0.0f, row_sum = 0.0f;
    if (counts) {
        query = load_channels(qkv, (u64)row * 3 * channels + offset, dim, scale);
        out_grad = load_channels(grad, (u64)row * channels + offset, dim, 1.0f);
        largest = statistics[at * 2];
        inverse = statistics[at * 2 + 1];
        row_sum = row_sums[at];
    }
    for (u32 first = 0; first < p.slots; first += KEYS) {
        u32 count = smaller(KEYS, p.slots - first);
        BARRIER();
        load_tile(qkv, pad, order, p.start + first, count, 3 * channels, channels + offset, dim, keys);
        load_tile(qkv, pad, order, p.start + first, count, 3 * channels, 2 * channels + offset, dim, values);
        BARRIER();
        for (u32 k = 0; k < count && counts; k++) {
            float weight = exponential(product(query, keys, k) - largest) * inverse;
            float slope = weight * (product(out_grad, values, k) - row_sum);
            add_scaled(sum, slope, keys, k);
        }
    }
    if (!counts) return;
    for (u32 d = 0; d < dim; d++) dqkv[(u64)row * 3 * channels + offset + d] = sum.at[d] * scale;
}
ENTRY(attention_queries)

/// Gradients of keys and values: a thread for each slot. Those of borrowed slots go to `borrowed`, `[slots, 2, C]`.
KERNEL(64) attention_keys(In<float> qkv, In<float> grad, In<float> statistics, In<float> row_sums, In<u32> patches,
                          In<u32> pad, In<u32> order, Out<float> dqkv, Out<float> borrowed, u32 heads, u32 dim,
                          float scale, u32 stretches) {
    SHARED(float, queries, QUERIES * WIDE);
    SHARED(float, grads, QUERIES * WIDE);
    SHARED(float, largest, QUERIES);
    SHARED(float, inverse, QUERIES);
    SHARED(float, row_sum, QUERIES);
    Place p = place_of(patches, heads, stretches);
    if (p.first >= p.slots) return;
    u32 channels = heads * dim, offset = p.head * dim, t = thread_index();
    u32 slot = p.first + t;
    bool there = slot < p.slots;
    u32 row = there ? order[pad[p.start + slot]] : 0;
    Channels key, value, key_sum, value_sum;
    clear(key);
    clear(value);
    clear(key_sum);
    clear(value_sum);
    if (there) {
        key = load_channels(qkv, (u64)row * 3 * channels + channels + offset, dim, scale);
        value = load_channels(qkv, (u64)row * 3 * channels + 2 * channels + offset, dim, 1.0f);
    }
    for (u32 first = 0; first < p.own; first += QUERIES) {
        u32 count = smaller(QUERIES, p.own - first);
        BARRIER();
        load_tile(qkv, pad, order, p.start + first, count, 3 * channels, offset, dim, queries);
        load_tile(grad, pad, order, p.start + first, count, channels, offset, dim, grads);
        if (t < count) {
            u64 at = (u64)order[pad[p.start + first + t]] * heads + p.head;
            largest[t] = statistics[at * 2];
            inverse[t] = statistics[at * 2 + 1];
            row_sum[t] = row_sums[at];
        }
        BARRIER();
        for (u32 q = 0; q < count && there; q++) {
            float weight = exponential(product(key, queries, q) - largest[q]) * inverse[q];
            float slope = weight * (product(value, grads, q) - row_sum[q]);
            add_scaled(value_sum, weight, grads, q);
            add_scaled(key_sum, slope, queries, q);
        }
    }
    if (!there) return;
    if (slot < p.own) {
        u64 to = (u64)row * 3 * channels + offset;
        for (u32 d = 0; d < dim; d++) {
            dqkv[to + channels + d] = key_sum.at[d] * scale;
            dqkv[to + 2 * channels + d] = value_sum.at[d];
        }
    } else {
        u64 to = (u64)(p.borrowed + slot - p.own) * 2 * channels + offset;
        for (u32 d = 0; d < dim; d++) {
            borrowed[to + d] = key_sum.at[d] * scale;
            borrowed[to + channels + d] = value_sum.at[d];
        }
    }
}
ENTRY(attention_keys)

/// Adds the gradients of borrowed slots to their rows; no row is borrowed twice. `slots`: where they are in `pad`.
KERNEL(256) attention_add_borrowed(In<float> borrowed, In<u32> slots, In<u32> pad, In<u32> order, Out<float> dqkv,
                                   u32 count, u32 channels) {
    u64 i = global_index();
    if (i >= (u64)count * 2 * channels) return;
    u64 at;
    u32 channel;
    split_index(i, 2 * channels, at, channel);
    dqkv[(u64)order[pad[slots[at]]] * 3 * channels + channels + channel] += borrowed[i];
}
ENTRY(attention_add_borrowed)
