// Softmax attention inside patches with products in bf16 on tensor cores: scores, softmax and sums are f32.
//
// As in `patch_attention.cu`, but a warp has 16 queries, whose scores lie in the registers of the lanes as
// `multiply_16x8x16` leaves them; what it leaves is what the next product wants of its left side. WIDE is a
// multiple of 16. Scaled queries, keys, values and weights are rounded to bf16.

#define QUERIES 64
#define KEYS 64
#define THREADS 128
/// Words of two channels of a key, and one more so that lanes fall into different banks.
#define KEY_PITCH (WIDE / 2 + 1)
/// Words of two keys of a channel.
#define VALUE_PITCH (KEYS / 2 + 1)

/// Copies the keys of a tile, channels in pairs, and the values turned, keys in pairs.
template <class K, class V>
DEVICE void load_tiles(In<u16> qkv, In<u32> pad, In<u32> order, u32 first_slot, u32 count, u32 channels, u32 offset,
                       u32 dim, K& keys, V& values) {
    for (u32 i = thread_index(); i < KEYS * WIDE / 2; i += THREADS) {
        u32 slot = i / (WIDE / 2), d = i % (WIDE / 2) * 2;
        u32 word = 0;
        if (slot < count) {
            u64 from = (u64)order[pad[first_slot + slot]] * 3 * channels + channels + offset;
            if (d < dim) word = qkv[from + d];
            if (d + 1 < dim) word |= (u32)qkv[from + d + 1] << 16;
        }
        keys[slot * KEY_PITCH + d / 2] = word;
    }
    for (u32 i = thread_index(); i < KEYS / 2 * WIDE; i += THREADS) {
        u32 slot = i / WIDE * 2, d = i % WIDE;
        u32 word = 0;
        if (d < dim) {
            u32 from = 2 * channels + offset + d;
            if (slot < count) word = qkv[(u64)order[pad[first_slot + slot]] * 3 * channels + from];
            if (slot + 1 < count) word |= (u32)qkv[(u64)order[pad[first_slot + slot + 1]] * 3 * channels + from] << 16;
        }
        values[d * VALUE_PITCH + slot / 2] = word;
    }
}

/// Two scaled channels of a query.
DEVICE u32 query_pair(In<u16> qkv, u64 from, u32 d, u32 dim, float scale) {
    float low = d < dim ? from_bf16(qkv[from + d]) * scale : 0.0f;
    float high = d + 1 < dim ? from_bf16(qkv[from + d + 1]) * scale : 0.0f;
    return pair_of_bf16(low, high);
}

/// `qkv`: `[N, 3·C]`, `out`: `[N, C]`, both bf16.
KERNEL(128) attention_bf16(In<u16> qkv, In<u32> patches, In<u32> pad, In<u32> order, Out<u16> out, u32 heads, u32 dim,
                           float scale, u32 stretches) {
    SHARED(u32, keys, KEYS * KEY_PITCH);
    SHARED(u32, values, WIDE * VALUE_PITCH);
    u32 block = block_index();
    u64 patch = block / stretches / heads * 4ull;
    u32 start = patches[patch], slots = patches[patch + 1], own = patches[patch + 2];
    u32 head = block / stretches % heads, first_query = block % stretches * QUERIES;
    if (first_query >= own) return;
    u32 channels = heads * dim, offset = head * dim;
    // Rows of the product that this lane has parts of: g and g + 8, columns 2t and 2t + 1 of eight.
    u32 g = lane_index() / 4, t = lane_index() % 4;
    u32 slot[2], row[2];
    for (u32 half = 0; half < 2; half++) {
        slot[half] = first_query + warp_index() * 16 + half * 8 + g;
        row[half] = slot[half] < own ? order[pad[start + slot[half]]] : NONE;
    }
    u32 query[WIDE / 16][4];
    UNROLL
    for (u32 k = 0; k < WIDE / 16; k++) {
        UNROLL
        for (u32 part = 0; part < 4; part++) {
            u32 r = row[part % 2], d = k * 16 + part / 2 * 8 + 2 * t;
            query[k][part] = r != NONE ? query_pair(qkv, (u64)r * 3 * channels + offset, d, dim, scale) : 0;
        }
    }
    float sum[WIDE / 8][4];
    UNROLL
    for (u32 n = 0; n < WIDE / 8; n++) {
        UNROLL
        for (u32 i = 0; i < 4; i++) sum[n][i] = 0.0f;
    }
    float largest[2] = {-infinity(), -infinity()}, total[2] = {0.0f, 0.0f};
    for (u32 first = 0; first < slots; first += KEYS) {
        u32 count = smaller(KEYS, slots - first);
        BARRIER();
        load_tiles(qkv, pad, order, start + first, count, channels, offset, dim, keys, values);
        BARRIER();
        float scores[KEYS / 8][4];
        float most[2] = {largest[0], largest[1]};
        UNROLL
        for (u32 n = 0; n < KEYS / 8; n++) {
            UNROLL
            for (u32 i = 0; i < 4; i++) scores[n][i] = 0.0f;
            UNROLL
            for (u32 k = 0; k < WIDE / 16; k++) {
                u32 at = (n * 8 + g) * KEY_PITCH + k * 8 + t;
                u32 right[2] = {keys[at], keys[at + 4]};
                multiply_16x8x16(scores[n], query[k], right);
            }
            UNROLL
            for (u32 i = 0; i < 4; i++) {
                if (n * 8 + 2 * t + i % 2 >= count) scores[n][i] = -infinity();
                most[i / 2] = larger(scores[n][i], most[i / 2]);
            }
        }
        float shift[2], shrink[2];
        UNROLL
        for (u32 half = 0; half < 2; half++) {
            // The four lanes that share a row.
            most[half] = larger(warp_xor(most[half], 1), most[half]);
            most[half] = larger(warp_xor(most[half], 2), most[half]);
            shift[half] = most[half] == -infinity() ? 0.0f : most[half];
            shrink[half] = exponential(largest[half] - shift[half]);
            largest[half] = most[half];
            total[half] *= shrink[half];
        }
        u32 weights[KEYS / 16][4];
        UNROLL
        for (u32 n = 0; n < KEYS / 8; n++) {
            UNROLL
            for (u32 half = 0; half < 2; half++) {
                float low = exponential(scores[n][half * 2] - shift[half]);
                float high = exponential(scores[n][half * 2 + 1] - shift[half]);
                total[half] += low + high;
                weights[n / 2][n % 2 * 2 + half] = pair_of_bf16(low, high);
            }
        }
        UNROLL
        for (u32 n = 0; n < WIDE / 8; n++) {
            UNROLL
            for (u32 i = 0; i < 4; i++) sum[n][i] *= shrink[i / 2];
            UNROLL
            for (u32 k = 0; k < KEYS / 16; k++) {
                u32 at = (n * 8 + g) * VALUE_PITCH + k * 8 + t;
                u32 right[2] = {values[at], values[at + 4]};
                multiply_16x8x16(sum[n], weights[k], right);
            }
        }
    }
    float inverse[2];
    UNROLL
    for (u32 half = 0; half < 2; half++) {
        total[half] += warp_xor(total[half], 1);
        total[half] += warp_xor(total[half], 2);
        inverse[half] = 1.0f / total[half];
    }
    UNROLL
    for (u32 n = 0; n < WIDE / 8; n++) {
        UNROLL
        for (u32 i = 0; i < 4; i++) {
            u32 d = n * 8 + 2 * t + i % 2, r = row[i / 2];
            if (r != NONE && d < dim) out[(u64)r * channels + offset + d] = round_to_bf16(sum[n][i] * inverse[i / 2]);
        }
    }
}
ENTRY(attention_bf16)
