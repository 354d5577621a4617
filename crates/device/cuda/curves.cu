// Codes of space-filling curves: `crates/kernels/src/serialization`.

/// Moves bit i of a 21-bit number to bit 3i.
DEVICE u64 spread_bits(u64 v) {
    v = (v | v << 32) & 0x001f00000000ffffull;
    v = (v | v << 16) & 0x001f0000ff0000ffull;
    v = (v | v << 8) & 0x100f00f00f00f00full;
    v = (v | v << 4) & 0x10c30c30c30c30c3ull;
    return (v | v << 2) & 0x1249249249249249ull;
}

DEVICE u64 morton_code(u32 x, u32 y, u32 z, u32 bits) {
    u64 mask = (1ull << bits) - 1;
    return spread_bits(x & mask) << 2 | spread_bits(y & mask) << 1 | spread_bits(z & mask);
}

/// All ones where the bit is set, else zero.
DEVICE u32 bit_mask(u32 value, u32 bit) { return 0u - (value >> bit & 1u); }

/// Flips the lower bits of `x` where `other` has the level's bit, else exchanges those of the two.
DEVICE void turn(u32& x, u32& other, u32 level, u32 lower) {
    u32 set = bit_mask(other, level);
    u32 exchange = (x ^ other) & lower & ~set;
    x ^= exchange | (lower & set);
    other ^= exchange;
}

DEVICE u64 hilbert_code(u32 x, u32 y, u32 z, u32 bits) {
    for (u32 level = bits; level-- > 0;) {
        u32 lower = (1u << level) - 1;
        x ^= lower & bit_mask(x, level);
        turn(x, y, level, lower);
        turn(x, z, level, lower);
    }
    // The Gray code of the code, of which a bit is the parity of these from the top down to it.
    u64 code = morton_code(x, y, z, bits);
    for (u32 step = 1; step <= 32; step *= 2) code ^= code >> step;
    return code;
}

/// `curve`: 0 Morton, 1 Morton of (y, x, z), 2 Hilbert, 3 Hilbert of (y, x, z). `cells`: `[N, 3]`
KERNEL(256) curve_codes(In<i32> cells, Out<u64> codes, u32 n, u32 curve, u32 depth) {
    u64 i = global_index();
    if (i >= n) return;
    u32 x = (u32)cells[3 * i], y = (u32)cells[3 * i + 1], z = (u32)cells[3 * i + 2];
    bool exchanged = (curve & 1) != 0;
    u32 first = exchanged ? y : x, second = exchanged ? x : y;
    codes[i] = curve < 2 ? morton_code(first, second, z, depth) : hilbert_code(first, second, z, depth);
}
ENTRY(curve_codes)
