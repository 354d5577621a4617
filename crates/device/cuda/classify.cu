// The class whose text is nearest to a row, by cosine: `crates/metrics/src/zero_shot.rs`. A warp has a row.

/// `features`: `[N, D]`, any norm · `text`: `[C, D]`, unit rows · `candidates`: `[C]`, not 0 for classes that compete ·
/// `labels`, `scores`, `margins`: `[N]`. A row without a direction gets −1 and zeros; a label is withheld, −1, where
/// the cosine or its lead over the second is below its minimum.
KERNEL(256) classify_rows(In<float> features, In<float> text, In<u32> candidates, Out<i32> labels, Out<float> scores,
                          Out<float> margins, u32 n, u32 dim, u32 classes, float min_cosine, float min_margin) {
    u64 row = global_index() / WARP;
    if (row >= n) return;
    u64 from = row * dim;
    // In f64 no square of an f32 over- or underflows.
    double squares = 0.0;
    for (u32 d = lane_index(); d < dim; d += WARP) squares += (double)features[from + d] * (double)features[from + d];
    double norm = square_root(warp_sum(squares));
    // False for NaN too.
    bool usable = norm > 0.0 && is_finite((float)(norm * 1e-10));
    double inverse = usable ? 1.0 / norm : 0.0;
    i32 label = -1;
    float first = -infinity(), second = -infinity();
    u32 competing = 0;
    for (u32 c = 0; c < classes && usable; c++) {
        if (!candidates[c]) continue;
        competing++;
        float dot = 0.0f;
        for (u32 d = lane_index(); d < dim; d += WARP)
            dot = fused((float)((double)features[from + d] * inverse), text[(u64)c * dim + d], dot);
        dot = warp_sum(dot);
        // Equal ones: the smaller class.
        if (dot > first) {
            second = first;
            first = dot;
            label = (i32)c;
        } else if (dot > second) {
            second = dot;
        }
    }
    if (lane_index() != 0) return;
    float score = usable ? larger(-1.0f, smaller(1.0f, first)) : 0.0f;
    float margin = !usable ? 0.0f : competing == 1 ? infinity() : first - second;
    labels[row] = score < min_cosine || margin < min_margin ? -1 : label;
    scores[row] = score;
    margins[row] = margin;
}
ENTRY(classify_rows)
