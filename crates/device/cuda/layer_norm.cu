// Layer normalisation over the channels of each row: `crates/kernels/src/layer_norm.rs`. A warp has a row.

/// Mean and one over the deviation of a row; where the variance overflows f32, in f64.
DEVICE void row_statistics(In<float> x, u64 from, u32 channels, float eps, float& mean, float& inverse) {
    float sum = 0.0f;
    for (u32 c = lane_index(); c < channels; c += WARP) sum += x[from + c];
    mean = warp_sum(sum) / (float)channels;
    float squares = 0.0f;
    for (u32 c = lane_index(); c < channels; c += WARP) squares += (x[from + c] - mean) * (x[from + c] - mean);
    float variance = warp_sum(squares) / (float)channels;
    if (is_finite(variance)) {
        inverse = 1.0f / square_root(variance + eps);
        return;
    }
    double wide_sum = 0.0;
    for (u32 c = lane_index(); c < channels; c += WARP) wide_sum += (double)x[from + c];
    double wide_mean = warp_sum(wide_sum) / (double)channels;
    double wide_squares = 0.0;
    for (u32 c = lane_index(); c < channels; c += WARP) {
        double d = (double)x[from + c] - wide_mean;
        wide_squares += d * d;
    }
    double wide_variance = warp_sum(wide_squares) / (double)channels;
    mean = (float)wide_mean;
    inverse = (float)(1.0 / square_root(wide_variance + (double)eps));
}

/// `out = LayerNorm(x) [+ residual]`. All `[N, C]`, `weight` and `bias` `[C]`.
KERNEL(256) layer_norm(In<float> x, In<float> residual, In<float> weight, In<float> bias, Out<float> out, u32 n,
                       u32 channels, float eps, u32 has_residual) {
    u64 row = global_index() / WARP;
    if (row >= n) return;
    u64 from = row * channels;
    float mean, inverse;
    row_statistics(x, from, channels, eps, mean, inverse);
    for (u32 c = lane_index(); c < channels; c += WARP) {
        float y = (x[from + c] - mean) * inverse * weight[c] + bias[c];
        out[from + c] = has_residual ? y + residual[from + c] : y;
    }
}
ENTRY(layer_norm)

/// Gradient of the input; keeps mean and deviation of each row for that of the parameters. `statistics`: `[N, 2]`
KERNEL(256) layer_norm_backward(In<float> x, In<float> grad, In<float> weight, Out<float> dx, Out<float> statistics,
                                u32 n, u32 channels, float eps) {
    u64 row = global_index() / WARP;
    if (row >= n) return;
    u64 from = row * channels;
    float mean, inverse;
    row_statistics(x, from, channels, eps, mean, inverse);
    double sum_g = 0.0, sum_gx = 0.0;
    for (u32 c = lane_index(); c < channels; c += WARP) {
        float g = grad[from + c] * weight[c];
        sum_g += (double)g;
        sum_gx += (double)(g * ((x[from + c] - mean) * inverse));
    }
    float mean_g = (float)(warp_sum(sum_g) / (double)channels);
    float mean_gx = (float)(warp_sum(sum_gx) / (double)channels);
    for (u32 c = lane_index(); c < channels; c += WARP) {
        float unit = (x[from + c] - mean) * inverse;
        dx[from + c] = inverse * (grad[from + c] * weight[c] - mean_g - unit * mean_gx);
    }
    if (lane_index() == 0) {
        statistics[row * 2] = mean;
        statistics[row * 2 + 1] = inverse;
    }
}
ENTRY(layer_norm_backward)

#define PART_ROWS 1024

/// Gradients of weight and bias over stretches of rows. `parts`: `[parts, 2, C]`
KERNEL(256) layer_norm_parameters(In<float> x, In<float> grad, In<float> statistics, Out<double> parts, u32 n,
                                  u32 channels) {
    u64 i = global_index();
    u64 count = ((u64)n + PART_ROWS - 1) / PART_ROWS * channels;
    if (i >= count) return;
    u64 part;
    u32 c;
    split_index(i, channels, part, c);
    u64 end = (part + 1) * PART_ROWS < n ? (part + 1) * PART_ROWS : n;
    double dw = 0.0, db = 0.0;
    for (u64 row = part * PART_ROWS; row < end; row++) {
        float g = grad[row * channels + c];
        dw += (double)(g * ((x[row * channels + c] - statistics[row * 2]) * statistics[row * 2 + 1]));
        db += (double)g;
    }
    parts[part * 2 * channels + c] = dw;
    parts[(part * 2 + 1) * channels + c] = db;
}
ENTRY(layer_norm_parameters)
