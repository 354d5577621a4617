// The exact GELU and its gradient, and rows of unit length: `crates/kernels/src/activation.rs`, `crates/kernels/src/normalize.rs`.

KERNEL(256) gelu_forward(In<float> x, Out<float> out, u64 count) {
    u64 i = global_index();
    if (i < count) out[i] = gelu(x[i]);
}
ENTRY(gelu_forward)

KERNEL(256) gelu_backward(In<float> x, In<float> grad, Out<float> dx, u64 count) {
    u64 i = global_index();
    if (i < count) dx[i] = gelu_slope(x[i]) * grad[i];
}
ENTRY(gelu_backward)

/// Divides each row by its norm, in f64; a row of zeros stays as it is. A warp has a row.
KERNEL(256) normalize_rows(In<float> x, Out<float> out, u32 n, u32 channels) {
    u64 row = global_index() / WARP;
    if (row >= n) return;
    u64 from = row * channels;
    double squares = 0.0;
    for (u32 c = lane_index(); c < channels; c += WARP) squares += (double)x[from + c] * (double)x[from + c];
    double norm = square_root(warp_sum(squares));
    double inverse = 1.0 / (norm < 1e-12 ? 1e-12 : norm);
    for (u32 c = lane_index(); c < channels; c += WARP) out[from + c] = (float)((double)x[from + c] * inverse);
}
ENTRY(normalize_rows)
