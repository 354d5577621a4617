// Groups of rows: `crates/kernels/src/segment.rs`. A thread adds the members of a group in their order.

/// Whether a value takes the place of the largest one so far: NaN exceeds all but NaN.
DEVICE bool exceeds(float value, float largest) {
    return value > largest || (is_nan(value) && !is_nan(largest));
}

/// `how`: 0 sum, 1 mean, 2 largest.
KERNEL(256) segment_reduce(In<float> x, In<u32> rows, In<u32> offsets, Out<float> out, u32 groups,
                           u32 channels, u32 how) {
    u64 i = global_index();
    if (i >= (u64)groups * channels) return;
    u64 group;
    u32 channel;
    split_index(i, channels, group, channel);
    u32 begin = offsets[group], end = offsets[group + 1];
    float value = 0.0f;
    for (u32 at = begin; at < end; at++) {
        float member = x[(u64)rows[at] * channels + channel];
        if (at == begin) {
            // Not added to 0, which would lose the sign of −0.
            value = member;
        } else if (how == 2) {
            value = exceeds(member, value) ? member : value;
        } else {
            value += member;
        }
    }
    if (how == 1 && end > begin) value /= (float)(end - begin);
    out[i] = value;
}
ENTRY(segment_reduce)

KERNEL(256) segment_reduce_backward(In<float> grad, In<u32> inverse, In<u32> offsets, Out<float> dx, u32 n,
                                    u32 channels, u32 how) {
    u64 i = global_index();
    if (i >= (u64)n * channels) return;
    u64 row;
    u32 channel;
    split_index(i, channels, row, channel);
    u32 group = inverse[row];
    float value = grad[(u64)group * channels + channel];
    if (how == 1) value /= (float)(offsets[group + 1] - offsets[group]);
    dx[i] = value;
}
ENTRY(segment_reduce_backward)

KERNEL(256) segment_largest(In<float> x, In<u32> rows, In<u32> offsets, Out<u32> largest, u32 groups,
                            u32 channels) {
    u64 i = global_index();
    if (i >= (u64)groups * channels) return;
    u64 group;
    u32 channel;
    split_index(i, channels, group, channel);
    u32 begin = offsets[group], end = offsets[group + 1], best = NONE;
    float value = 0.0f;
    for (u32 at = begin; at < end; at++) {
        u32 row = rows[at];
        float member = x[(u64)row * channels + channel];
        if (at == begin || exceeds(member, value)) {
            value = member;
            best = row;
        }
    }
    largest[i] = best;
}
ENTRY(segment_largest)

KERNEL(256) segment_largest_backward(In<float> grad, In<u32> inverse, In<u32> largest, Out<float> dx, u32 n,
                                     u32 channels) {
    u64 i = global_index();
    if (i >= (u64)n * channels) return;
    u64 row;
    u32 channel;
    split_index(i, channels, row, channel);
    u64 at = (u64)inverse[row] * channels + channel;
    dx[i] = largest[at] == (u32)row ? grad[at] : 0.0f;
}
ENTRY(segment_largest_backward)
