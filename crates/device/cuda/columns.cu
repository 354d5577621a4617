// Sums of columns, such as the gradient of a bias: in f64, in fixed stretches of rows, so that the order of
// additions is one.

/// Rows of a part.
#define PART_ROWS 1024

/// `parts`: `[parts, C]`; a thread adds one channel of one part.
KERNEL(256) column_parts(In<float> x, Out<double> parts, u32 n, u32 channels) {
    u64 i = global_index();
    u64 count = ((u64)n + PART_ROWS - 1) / PART_ROWS * channels;
    if (i >= count) return;
    u64 part;
    u32 channel;
    split_index(i, channels, part, channel);
    u64 end = (part + 1) * PART_ROWS < n ? (part + 1) * PART_ROWS : n;
    double sum = 0.0;
    for (u64 row = part * PART_ROWS; row < end; row++) sum += (double)x[row * channels + channel];
    parts[i] = sum;
}
ENTRY(column_parts)

/// Sums over parts, in their order. `parts`: `[parts, C]`, `out`: `[C]`
KERNEL(256) add_parts(In<double> parts, Out<float> out, u32 count, u32 channels) {
    u64 channel = global_index();
    if (channel >= channels) return;
    double sum = 0.0;
    for (u32 part = 0; part < count; part++) sum += parts[(u64)part * channels + channel];
    out[channel] = (float)sum;
}
ENTRY(add_parts)
