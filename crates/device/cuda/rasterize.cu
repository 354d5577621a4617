// Pictures of Gaussians, forward: `crates/rasterizer/src`.
//
// A thread projects a Gaussian and counts the tiles of 16×16 pixels that its box meets; running sums give each pair of
// Gaussian and tile a place; pairs are sorted by tile, then depth, then row; a block draws a tile, a pixel a thread.
// A tile that the box meets and the ellipse does not only costs time: pixels ask for themselves.

#define TILE 16
#define PIXELS 256

/// What does not depend on the Gaussian. `[36]`
enum Lens {
    WORLD_TO_CAMERA = 0, // 12, row by row
    FOCAL = 12,          // 2
    CENTRE = 14,         // 2
    SIZE = 16,           // 2
    TANGENTS = 18,       // lowest and highest along x, then y
    NEAR = 22,
    FAR = 23,
    LOW_PASS = 24,
    FACTOR_FLOOR = 25,
    ALPHA_CUT = 26,
    REACH = 27,
    SIGMA = 28,
    ROOT_FLOOR = 29,
    EYE = 30, // 3
};

enum Flags { NEAR_EXCLUDED = 1, CIRCLE = 2, NORMALIZE = 4, ANTIALIASED = 8, ISOTROPIC = 16 };

/// What becomes of a Gaussian: the first reason that applies not to draw it.
enum Fate { DRAWN, NOT_FINITE, TOO_NEAR_OR_FAR, OUTSIDE, ZERO_QUAT, OVERFLOWS, TRANSPARENT, BAD_COLOR };

DEVICE float absolute(float v) { return v < 0.0f ? -v : v; }

/// ln of a number above 0: the exponent, and the series of the inverse hyperbolic tangent.
DEVICE float natural_log(float v) {
    // Denormal numbers as normal ones.
    i32 exponent = 0;
    if (v < 1.17549435e-38f) {
        v *= 16777216.0f;
        exponent = -24;
    }
    u32 bits = bits_of(v);
    exponent += (i32)(bits >> 23) - 127;
    double m = (double)float_of((bits & 0x007fffffu) | 0x3f800000u);
    if (m > 1.4142135623730951) {
        m *= 0.5;
        exponent++;
    }
    double s = (m - 1.0) / (m + 1.0), ss = s * s, sum = 0.0;
    for (i32 k = 17; k > 0; k -= 2) sum = sum * ss + 1.0 / (double)k;
    return (float)(2.0 * s * sum + (double)exponent * 0.6931471805599453);
}

/// 2ˣ from −100 on; smaller and NaN count as −100.
DEVICE float power(float x) {
    x = x > -100.0f ? x : -100.0f;
    float n = nearest_even(x), f = x - n;
    float poly = 0.0013264727f;
    poly = fused(poly, f, 0.009671513f);
    poly = fused(poly, f, 0.055507336f);
    poly = fused(poly, f, 0.24022242f);
    poly = fused(poly, f, 0.693147f);
    poly = fused(poly, f, 1.0f);
    return poly * power_of_two(n);
}

/// The first `count` real spherical harmonics of a direction.
DEVICE void harmonics(float dx, float dy, float dz, u32 count, float (&b)[16]) {
    for (u32 k = 0; k < 16; k++) b[k] = 0.0f;
    b[0] = 0.28209479f;
    float norm = square_root(dx * dx + dy * dy + dz * dz);
    if (count == 1 || !(norm > 0.0f)) return;
    float x = dx / norm, y = dy / norm, z = dz / norm;
    b[1] = -0.48860252f * y;
    b[2] = 0.48860252f * z;
    b[3] = -0.48860252f * x;
    if (count == 4) return;
    float zz = z * z, c1 = x * x - y * y, s1 = 2.0f * x * y;
    b[4] = 0.54627424f * s1;
    b[5] = -1.0925485f * z * y;
    b[6] = 0.9461747f * zz - 0.31539157f;
    b[7] = -1.0925485f * z * x;
    b[8] = 0.54627424f * c1;
    if (count == 9) return;
    float c2 = x * c1 - y * s1, s2 = x * s1 + y * c1, k = 0.4570458f - 2.285229f * zz;
    b[9] = -0.5900436f * s2;
    b[10] = 1.4453057f * z * s1;
    b[11] = k * y;
    b[12] = z * (1.8658817f * zz - 1.119529f);
    b[13] = k * x;
    b[14] = 1.4453057f * z * c1;
    b[15] = -0.5900436f * c2;
}

/// First and one beyond the last of `count` tiles that what lies between two coordinates meets.
DEVICE void tiles_between(float low, float high, u32 count, u32& first, u32& end) {
    float most = (float)count;
    float from = floor_of(low), to = ceil_of(high);
    from = from > 0.0f ? (from < most ? from : most) : 0.0f;
    to = to > 0.0f ? (to < most ? to : most) : 0.0f;
    first = (u32)from;
    end = (u32)to;
}

/// Projects all Gaussians. `means`, `scales`: `[N, 3]` · `quats`: `[N, 4]` · `opacities`: `[N]` · `sh`: `[N, stride]` ·
/// `splats`: `[N, 8]`, centre, slope, across, down, log₂ of the opacity, depth, 0 · `colors`: `[N, 3]` ·
/// `tiles`: `[N, 4]`, first and end along x, then y · `counts`: `[N]`, tiles · `fates`: `[N]`
KERNEL(128) project_gaussians(In<float> means, In<float> quats, In<float> scales, In<float> opacities, In<float> sh,
                              In<float> lens, Out<float> splats, Out<float> colors, Out<u32> tiles, Out<u32> counts,
                              Out<u32> fates, u32 n, u32 flags, u32 sh_stride, u32 sh_count, u32 with_color,
                              u32 columns, u32 rows) {
    u64 i = global_index();
    if (i >= n) return;
    float m[3], s[3];
    for (u32 a = 0; a < 3; a++) {
        m[a] = means[3 * i + a];
        s[a] = scales[3 * i + a];
    }
    // Scenes far from their origin lose digits in f32.
    float along[3];
    for (u32 r = 0; r < 3; r++) {
        u32 at = WORLD_TO_CAMERA + 4 * r;
        along[r] = (float)((double)lens[at] * (double)m[0] + (double)lens[at + 1] * (double)m[1] +
                           (double)lens[at + 2] * (double)m[2] + (double)lens[at + 3]);
    }
    float z = along[2], inverse_z = 1.0f / z;
    bool near = z > lens[NEAR] || (!(flags & NEAR_EXCLUDED) && z == lens[NEAR]);
    bool in_depth = near && z <= lens[FAR];
    float tangent[2], centre[2], beyond[2];
    float largest = larger(larger(absolute(s[0]), absolute(s[1])), absolute(s[2]));
    bool beside = false;
    for (u32 k = 0; k < 2; k++) {
        float t = along[k] * inverse_z, low = lens[TANGENTS + 2 * k], high = lens[TANGENTS + 2 * k + 1];
        t = larger(t, low);
        tangent[k] = smaller(t, high);
        float f = lens[FOCAL + k];
        centre[k] = f * along[k] / z + lens[CENTRE + k];
        float low_pass = square_root(lens[LOW_PASS]);
        beyond[k] = 1.001f * lens[REACH] * (f / z * square_root(1.0f + tangent[k] * tangent[k]) * largest + low_pass) + 1.0f;
        beside |= centre[k] + beyond[k] < 0.0f || centre[k] - beyond[k] > lens[SIZE + k];
    }
    bool finite = is_finite(s[0]) && is_finite(s[1]) && is_finite(s[2]);
    bool placed = is_finite(m[0]) && is_finite(m[1]) && is_finite(m[2]);
    bool bounded = !(flags & CIRCLE) && (flags & NORMALIZE);
    u32 fate = in_depth ? (bounded && finite && beside ? OUTSIDE : DRAWN) : (placed ? TOO_NEAR_OR_FAR : NOT_FINITE);

    // The rows of V = J R Q diag(s); the determinant is that of |r₁ × r₂|², without a difference of large products.
    float v[2][3];
    float w = quats[4 * i], x = quats[4 * i + 1], y = quats[4 * i + 2], zq = quats[4 * i + 3];
    float norm = w * w + x * x + y * y + zq * zq;
    float unit = flags & NORMALIZE ? 1.0f / square_root(norm) : 1.0f;
    w *= unit;
    x *= unit;
    y *= unit;
    zq *= unit;
    float q[3][3] = {{1.0f - 2.0f * (y * y + zq * zq), 2.0f * (x * y - w * zq), 2.0f * (x * zq + w * y)},
                     {2.0f * (x * y + w * zq), 1.0f - 2.0f * (x * x + zq * zq), 2.0f * (y * zq - w * x)},
                     {2.0f * (x * zq - w * y), 2.0f * (y * zq + w * x), 1.0f - 2.0f * (x * x + y * y)}};
    bool isotropic = (flags & ISOTROPIC) != 0;
    for (u32 k = 0; k < 2; k++) {
        float j = lens[FOCAL + k] * inverse_z, p[3];
        for (u32 a = 0; a < 3; a++)
            p[a] = j * (lens[WORLD_TO_CAMERA + 4 * k + a] - tangent[k] * lens[WORLD_TO_CAMERA + 8 + a]);
        for (u32 a = 0; a < 3; a++)
            v[k][a] = isotropic ? p[a] * s[0] : s[a] * (p[0] * q[0][a] + p[1] * q[1][a] + p[2] * q[2][a]);
    }
    bool all_finite = is_finite(s[0]) && (isotropic || (is_finite(norm) && is_finite(s[1]) && is_finite(s[2])));
    bool directed = isotropic || !(norm < 1e-12f);
    float s11 = v[0][0] * v[0][0] + v[0][1] * v[0][1] + v[0][2] * v[0][2];
    float s22 = v[1][0] * v[1][0] + v[1][1] * v[1][1] + v[1][2] * v[1][2];
    float s12 = v[0][0] * v[1][0] + v[0][1] * v[1][1] + v[0][2] * v[1][2];
    float cx = v[0][1] * v[1][2] - v[0][2] * v[1][1];
    float cy = v[0][2] * v[1][0] - v[0][0] * v[1][2];
    float cz = v[0][0] * v[1][1] - v[0][1] * v[1][0];
    float sharp = cx * cx + cy * cy + cz * cz, eps = lens[LOW_PASS];
    float det = sharp + eps * (s11 + s22) + eps * eps;
    bool held = det > 0.0f && is_finite(det) && is_finite(centre[0]) && is_finite(centre[1]);
    float floor = lens[FACTOR_FLOOR] * lens[FACTOR_FLOOR];
    float compensation = flags & ANTIALIASED ? square_root(larger(sharp / det, floor)) : 1.0f;
    float own = opacities[i], opacity = smaller(own, 1.0f) * compensation;
    bool seen = !is_nan(own) && opacity >= lens[ALPHA_CUT];
    u32 found = !all_finite ? NOT_FINITE : !directed ? ZERO_QUAT : !held ? OVERFLOWS : !seen ? TRANSPARENT : DRAWN;
    fate = fate == DRAWN ? found : fate;

    float v11 = s11 + eps, v22 = s22 + eps, half[2] = {0.0f, 0.0f};
    if (fate == DRAWN) {
        float level = larger(2.0f * natural_log(opacity / lens[ALPHA_CUT]), 0.0f);
        half[0] = square_root(level * v11);
        half[1] = square_root(level * v22);
        if (flags & CIRCLE) {
            float mean = 0.5f * (v11 + v22);
            float longest = mean + square_root(larger(mean * mean - det, lens[ROOT_FLOOR]));
            half[0] = half[1] = ceil_of(lens[SIGMA] * square_root(longest));
        }
        for (u32 k = 0; k < 2; k++) {
            float radius = ceil_of(half[k]);
            if (!(centre[k] + radius > 0.0f && centre[k] - radius < lens[SIZE + k])) fate = OUTSIDE;
        }
    }
    if (with_color && fate == DRAWN) {
        float basis[16];
        harmonics(m[0] - lens[EYE], m[1] - lens[EYE + 1], m[2] - lens[EYE + 2], sh_count, basis);
        for (u32 c = 0; c < 3; c++) {
            float sum = 0.5f;
            for (u32 k = 0; k < sh_count; k++) sum += basis[k] * sh[i * sh_stride + 3 * k + c];
            // NaN and infinities are not hidden.
            if (!is_finite(sum)) fate = BAD_COLOR;
            colors[3 * i + c] = sum < 0.0f ? 0.0f : sum;
        }
    }
    u32 x0 = 0, x1 = 0, y0 = 0, y1 = 0;
    if (fate == DRAWN) {
        float side = (float)TILE;
        // The box of an ellipse a little wider, for what is rounded; the square of a circle is what it is.
        float more = flags & CIRCLE ? 0.0f : 1e-3f + 1e-4f * larger(half[0], half[1]);
        tiles_between(centre[0] / side - (half[0] + more) / side, centre[0] / side + (half[0] + more) / side, columns, x0, x1);
        tiles_between(centre[1] / side - (half[1] + more) / side, centre[1] / side + (half[1] + more) / side, rows, y0, y1);
        float inverse = 1.0f / det, a = v22 * inverse, b = -s12 * inverse;
        u64 to = 8 * i;
        splats[to] = centre[0];
        splats[to + 1] = centre[1];
        splats[to + 2] = b / a;
        splats[to + 3] = -0.5f * 1.44269504f * a;
        splats[to + 4] = -0.5f * 1.44269504f / v22;
        splats[to + 5] = natural_log(opacity) * 1.44269504f;
        splats[to + 6] = z;
        splats[to + 7] = 0.0f;
    }
    tiles[4 * i] = x0;
    tiles[4 * i + 1] = x1;
    tiles[4 * i + 2] = y0;
    tiles[4 * i + 3] = y1;
    counts[i] = x1 > x0 && y1 > y0 ? (x1 - x0) * (y1 - y0) : 0;
    fates[i] = fate;
}
ENTRY(project_gaussians)

/// Counts of fates, and of pairs with tiles, which 32 bits may not hold. `totals`: `[9]`, zeros before.
KERNEL(256) count_fates(In<u32> fates, In<u32> tiles, Out<u64> totals, u32 n) {
    SHARED(u32, count, 8);
    SHARED(u64, pairs, 1);
    u32 t = thread_index();
    if (t < 8) count[t] = 0;
    if (t == 0) pairs[0] = 0;
    BARRIER();
    u64 i = global_index();
    if (i < n) {
        add_atomically(count[fates[i]], 1u);
        add_atomically(pairs[0], (u64)tiles[i]);
    }
    BARRIER();
    if (t < 8) add_atomically(totals[t], (u64)count[t]);
    if (t == 0) add_atomically(totals[8], pairs[0]);
}
ENTRY(count_fates)

/// Pairs of tile and Gaussian. `keys`: tile above the bits of the depth, which sort as the depth does.
KERNEL(128) list_tile_pairs(In<float> splats, In<u32> tiles, In<u32> counts, In<u32> before, Out<u64> keys, Out<u32> of,
                            u32 n, u32 columns) {
    u64 i = global_index();
    if (i >= n || counts[i] == 0) return;
    u32 depth = bits_of(splats[8 * i + 6]), at = before[i];
    for (u32 y = tiles[4 * i + 2]; y < tiles[4 * i + 3]; y++) {
        for (u32 x = tiles[4 * i]; x < tiles[4 * i + 1]; x++) {
            keys[at] = (u64)(y * columns + x) << 32 | depth;
            of[at] = (u32)i;
            at++;
        }
    }
}
ENTRY(list_tile_pairs)

/// First pair of each tile, closed by the number of pairs. `starts`: `[tiles + 1]`
KERNEL(256) tile_starts(In<u64> keys, Out<u32> starts, u32 pairs, u32 tiles) {
    u64 tile = global_index();
    if (tile > tiles) return;
    u32 low = 0, high = pairs;
    while (low < high) {
        u32 middle = low + (high - low) / 2;
        if (keys[middle] >> 32 < tile) low = middle + 1;
        else high = middle;
    }
    starts[tile] = low;
}
ENTRY(tile_starts)

/// Draws a tile, a pixel a thread, front to back. `rgb`: `[H, W, 3]` · `transmittance`, `depth`, `median`: `[H, W]`
KERNEL(256) blend_tiles(In<float> splats, In<float> colors, In<u32> starts, In<u32> of, Out<float> rgb,
                        Out<float> transmittance, Out<float> depth_sums, Out<float> medians, u32 width, u32 height,
                        u32 columns, float alpha_cut, float alpha_max, float stop_above, float red, float green,
                        float blue, u32 with_color) {
    SHARED(float, splat, PIXELS * 7);
    SHARED(float, color, PIXELS * 3);
    SHARED(u32, live, 1);
    u32 t = thread_index(), tile = block_index();
    u32 x0 = tile % columns * TILE, y0 = tile / columns * TILE;
    u32 x = x0 + t % TILE, y = y0 + t / TILE;
    bool inside = x < width && y < height;
    float row = (float)(t / TILE), column = (float)(t % TILE);
    float light = inside ? 1.0f : 0.0f, sums[3] = {0.0f, 0.0f, 0.0f}, depth = 0.0f, median = 0.0f;
    bool going = inside;
    u32 end = starts[tile + 1];
    for (u32 first = starts[tile]; first < end; first += PIXELS) {
        // Nobody reads what was loaded before any more.
        BARRIER();
        if (t == 0) live[0] = 0;
        if (first + t < end) {
            u64 from = of[first + t];
            for (u32 k = 0; k < 7; k++) splat[t * 7 + k] = splats[from * 8 + k];
            for (u32 k = 0; k < 3 && with_color; k++) color[t * 3 + k] = colors[from * 3 + k];
        }
        BARRIER();
        if (going) live[0] = 1;
        BARRIER();
        if (live[0] == 0) break;
        u32 count = smaller(PIXELS, end - first);
        for (u32 k = 0; k < count && going; k++) {
            float u = splat[k * 7] - ((float)x0 + 0.5f), v = splat[k * 7 + 1] - ((float)y0 + 0.5f);
            float dy = v - row;
            float middle = u + splat[k * 7 + 2] * dy;
            float top = splat[k * 7 + 5] + splat[k * 7 + 4] * dy * dy;
            float dx = column - middle;
            float full = power(fused(splat[k * 7 + 3] * dx, dx, top));
            if (!(full >= alpha_cut)) continue;
            float weight = smaller(full, alpha_max) * light, after = light - weight;
            if (!(after > stop_above)) {
                going = false;
                break;
            }
            if (with_color)
                for (u32 c = 0; c < 3; c++) sums[c] += weight * color[k * 3 + c];
            float z = splat[k * 7 + 6];
            depth += weight * z;
            if (light > 0.5f) median = z;
            light = after;
        }
    }
    if (!inside) return;
    u64 at = (u64)y * width + x;
    if (with_color) {
        rgb[3 * at] = sums[0] + light * red;
        rgb[3 * at + 1] = sums[1] + light * green;
        rgb[3 * at + 2] = sums[2] + light * blue;
    }
    transmittance[at] = light;
    depth_sums[at] = depth;
    medians[at] = median;
}
ENTRY(blend_tiles)
