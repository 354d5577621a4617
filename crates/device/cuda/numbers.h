// Functions of numbers that several kernels share, as in `crates/kernels/src/activation.rs` and `gemm/bf16.rs`.
#ifndef SCENESPLAT_NUMBERS_H
#define SCENESPLAT_NUMBERS_H

/// 2ⁿ for whole numbers in −126..=127.
DEVICE float power_of_two(float n) { return float_of((u32)((i32)n + 127) << 23); }

/// `eˣ`; 0 below −87.3 (no denormals), +∞ above 88.7, NaN for NaN.
DEVICE float exponential(float x) {
    if (is_nan(x)) return x;
    if (x > 88.72f) return infinity();
    if (x < -87.3f) return 0.0f;
    float n = nearest_even(x * 1.44269504f);
    // ln 2 in two parts, the first of which times n is exact.
    float r = fused(n, -0.6933594f, x);
    r = fused(n, 2.1219444e-4f, r);
    float poly = 0.0013814599f;
    poly = fused(poly, r, 0.008368717f);
    poly = fused(poly, r, 0.04166839f);
    poly = fused(poly, r, 0.16666521f);
    poly = fused(poly, r, 0.49999994f);
    float value = fused(r * r, poly, r) + 1.0f;
    // In two steps, since n can be 128.
    float half = nearest_even(n * 0.5f);
    return value * power_of_two(half) * power_of_two(n - half);
}

/// `e^(−x²/2)` and the normal distribution function `Φ(x)`, whose tail is computed as such.
DEVICE void normal_law(float x, float& bell, float& distribution) {
    bell = exponential(x * x * -0.5f);
    float size = x < 0.0f ? -x : x;
    size = size > 1e4f ? 1e4f : size;
    float t = 1.0f / fused(size, 0.33f, 1.0f);
    float tail = -0.020442365f;
    tail = fused(tail, t, 0.121348195f);
    tail = fused(tail, t, -0.2637096f);
    tail = fused(tail, t, 0.22078338f);
    tail = fused(tail, t, -0.05396884f);
    tail = fused(tail, t, 0.12077658f);
    tail = fused(tail, t, 0.11131944f);
    tail = fused(tail, t, 0.13226923f);
    tail = fused(tail, t, 0.131624f);
    tail = tail * t * bell;
    distribution = x > 0.0f ? 1.0f - tail : tail;
}

/// The exact GELU, `x·Φ(x)`.
DEVICE float gelu(float x) {
    float bell, distribution;
    normal_law(x, bell, distribution);
    return distribution * x;
}

/// Its slope, `Φ(x) + x·φ(x)`.
DEVICE float gelu_slope(float x) {
    float bell, distribution;
    normal_law(x, bell, distribution);
    // Bounded, since ∞ · 0 would be NaN.
    float bounded = x > 1e4f ? 1e4f : x < -1e4f ? -1e4f : x;
    return fused(bounded * 0.3989423f, bell, distribution);
}

/// The nearest bf16, ties to even; NaN stays NaN.
DEVICE u16 round_to_bf16(float v) {
    u32 bits = bits_of(v);
    if (is_nan(v)) return (u16)(bits >> 16 | 0x40u);
    return (u16)((bits + 0x7fffu + (bits >> 16 & 1u)) >> 16);
}
DEVICE float from_bf16(u16 v) { return float_of((u32)v << 16); }
/// Two values as bf16 in a word, the first in the lower half.
DEVICE u32 pair_of_bf16(float low, float high) {
    return (u32)round_to_bf16(low) | (u32)round_to_bf16(high) << 16;
}

#endif
