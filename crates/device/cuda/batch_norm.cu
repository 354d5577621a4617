// Batch normalisation over the rows of each channel: `crates/kernels/src/batch_norm.rs`. Sums are f64, over fixed
// stretches of rows; variances are summed from a mean nearby.

#define PART_ROWS 1024

/// Sum, and squares of the differences from the stretch's mean. `parts`: `[parts, 2, C]`
KERNEL(256) batch_moments(In<float> x, Out<double> parts, u32 n, u32 channels) {
    u64 i = global_index();
    u64 count = ((u64)n + PART_ROWS - 1) / PART_ROWS * channels;
    if (i >= count) return;
    u64 part;
    u32 c;
    split_index(i, channels, part, c);
    u64 begin = part * PART_ROWS, end = begin + PART_ROWS < n ? begin + PART_ROWS : n;
    double sum = 0.0;
    for (u64 row = begin; row < end; row++) sum += (double)x[row * channels + c];
    double mean = sum / (double)(end - begin), squares = 0.0;
    for (u64 row = begin; row < end; row++) {
        double d = (double)x[row * channels + c] - mean;
        squares += d * d;
    }
    parts[part * 2 * channels + c] = sum;
    parts[(part * 2 + 1) * channels + c] = squares;
}
ENTRY(batch_moments)

/// Mean and biased variance of each channel; zeros without rows. `statistics`: `[2, C]`
KERNEL(256) batch_statistics(In<double> parts, Out<double> statistics, u32 n, u32 channels) {
    u64 c = global_index();
    if (c >= channels) return;
    double rows = 0.0, sum = 0.0, squares = 0.0;
    for (u64 begin = 0, part = 0; begin < n; begin += PART_ROWS, part++) {
        double more = (double)(begin + PART_ROWS < n ? PART_ROWS : n - begin);
        double others = parts[part * 2 * channels + c];
        if (rows > 0.0) {
            double apart = others / more - sum / rows;
            squares += apart * apart * (rows * more / (rows + more));
        }
        rows += more;
        sum += others;
        squares += parts[(part * 2 + 1) * channels + c];
    }
    double count = n > 0 ? (double)n : 1.0;
    statistics[c] = sum / count;
    statistics[channels + c] = squares / count;
}
ENTRY(batch_statistics)

/// `out = x · scale + shift` per channel, then the exact GELU if asked for.
KERNEL(256) batch_apply(In<float> x, In<float> scale, In<float> shift, Out<float> out, u32 n, u32 channels,
                        u32 with_gelu) {
    u64 i = global_index();
    if (i >= (u64)n * channels) return;
    u64 row;
    u32 c;
    split_index(i, channels, row, c);
    float y = x[i] * scale[c] + shift[c];
    out[i] = with_gelu ? gelu(y) : y;
}
ENTRY(batch_apply)

/// Sums of `grad · (x − mean)` and of `grad` over stretches of rows. `parts`: `[parts, 2, C]`
KERNEL(256) batch_gradient_parts(In<float> x, In<float> grad, In<double> mean, Out<double> parts, u32 n, u32 channels) {
    u64 i = global_index();
    u64 count = ((u64)n + PART_ROWS - 1) / PART_ROWS * channels;
    if (i >= count) return;
    u64 part;
    u32 c;
    split_index(i, channels, part, c);
    u64 begin = part * PART_ROWS, end = begin + PART_ROWS < n ? begin + PART_ROWS : n;
    double products = 0.0, plain = 0.0;
    for (u64 row = begin; row < end; row++) {
        double g = (double)grad[row * channels + c];
        products += g * ((double)x[row * channels + c] - mean[c]);
        plain += g;
    }
    parts[part * 2 * channels + c] = products;
    parts[(part * 2 + 1) * channels + c] = plain;
}
ENTRY(batch_gradient_parts)

/// Gradients of weight and bias, and what the gradient of a row needs of each channel. `channel`: `[3, C]`, factor,
/// constant and slope; the last two are zero where the statistics are constants (`batch` 0).
KERNEL(256) batch_parameters(In<double> parts, In<float> weight, In<double> inverse, Out<float> dw, Out<float> db,
                             Out<double> channel, u32 n, u32 channels, u32 batch) {
    u64 c = global_index();
    if (c >= channels) return;
    double products = 0.0, plain = 0.0;
    for (u64 begin = 0, part = 0; begin < n; begin += PART_ROWS, part++) {
        products += parts[part * 2 * channels + c];
        plain += parts[(part * 2 + 1) * channels + c];
    }
    double slope = products * inverse[c], count = n > 0 ? (double)n : 1.0;
    dw[c] = (float)slope;
    db[c] = (float)plain;
    channel[c] = inverse[c] * (double)weight[c];
    channel[channels + c] = batch ? plain / count : 0.0;
    channel[2 * channels + c] = batch ? slope * inverse[c] / count : 0.0;
}
ENTRY(batch_parameters)

/// `dx = (grad − constant − slope · (x − mean)) · factor`
KERNEL(256) batch_input(In<float> x, In<float> grad, In<double> mean, In<double> channel, Out<float> dx, u32 n,
                        u32 channels, u32 batch) {
    u64 i = global_index();
    if (i >= (u64)n * channels) return;
    u64 row;
    u32 c;
    split_index(i, channels, row, c);
    double g = (double)grad[i];
    if (batch) g = g - channel[channels + c] - ((double)x[i] - mean[c]) * channel[2 * channels + c];
    dx[i] = (float)(g * channel[c]);
}
ENTRY(batch_input)
