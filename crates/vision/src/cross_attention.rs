//! Attention between a few tokens and the thousands of rows of a picture.
//!
//! With T tokens and H heads there are only T·H different queries (or keys), 64 for a click, while a projection has
//! 128 columns. So the picture's side of each product is never projected: of `qᵀ(Wx)` the left part is multiplied out,
//! `(Wᵀq)ᵀx`, and of `W(Σ a x)` the sum is taken first. That is half the operations, and nothing of the size of the
//! picture is packed. Parts of a score that are the same for all that one softmax runs over are left out.

use crate::VisionError;
use crate::layers::Linear;
use crate::weights::Weights;
use scenesplat_kernels::activation::exp_in_place;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, gemm_tn};

/// Attention with four projections.
pub(crate) struct Attention {
    heads: usize,
    /// Channels of tokens and rows.
    width: usize,
    /// Channels within.
    inner: usize,
    q: Linear,
    k: Linear,
    v: Linear,
    out: Linear,
    /// The same as they are stored, `[inner, width]` and `[width, inner]`.
    plain: Plain,
}

struct Plain {
    q: Vec<f32>,
    k: Vec<f32>,
    v: Vec<f32>,
    out: Vec<f32>,
}

impl Attention {
    pub fn take(
        weights: &mut Weights,
        prefix: &str,
        width: usize,
        inner: usize,
        heads: usize,
    ) -> Result<Self, VisionError> {
        let mut layer = |part: &str, cin: usize, cout: usize| {
            let weight = weights.take(&format!("{prefix}.{part}.weight"), &[cout, cin])?;
            Ok::<_, VisionError>((weight, weights.take(&format!("{prefix}.{part}.bias"), &[cout])?))
        };
        let parts = [
            layer("q_proj", width, inner)?,
            layer("k_proj", width, inner)?,
            layer("v_proj", width, inner)?,
            layer("out_proj", inner, width)?,
        ];
        Ok(Self::of(parts, width, inner, heads))
    }

    /// Of weights and biases for queries, keys, values (`[inner, width]`) and output (`[width, inner]`).
    pub fn of(parts: [(Vec<f32>, Vec<f32>); 4], width: usize, inner: usize, heads: usize) -> Self {
        let pack = |(weight, bias): &(Vec<f32>, Vec<f32>), cin: usize| Linear {
            weight: PackedMatrix::from_strided(weight, cin, bias.len(), 1, cin),
            bias: bias.clone(),
        };
        let [q, k, v, out] = &parts;
        let (q, k, v, out) = (pack(q, width), pack(k, width), pack(v, width), pack(out, inner));
        let [plain_q, plain_k, plain_v, plain_out] = parts.map(|(weight, _)| weight);
        let plain = Plain { q: plain_q, k: plain_k, v: plain_v, out: plain_out };
        Self { heads, width, inner, q, k, v, out, plain }
    }

    fn dim(&self) -> usize {
        self.inner / self.heads
    }

    /// `1 / √dim`
    fn scale(&self) -> f32 {
        1.0 / (self.dim() as f32).sqrt()
    }

    /// Tokens to tokens. `[T, width] → [T, width]`
    pub fn among(&self, queries: &[f32], keys: &[f32], values: &[f32]) -> Vec<f32> {
        let (q, k, v) = (self.q.forward(queries), self.k.forward(keys), self.v.forward(values));
        let (inner, dim) = (self.inner, self.dim());
        let tokens = k.len() / inner;
        let mut out = vec![0.0; q.len()];
        let mut scores = vec![0.0; tokens];
        for (q, out) in q.chunks_exact(inner).zip(out.chunks_exact_mut(inner)) {
            for head in 0..self.heads {
                let part = head * dim..(head + 1) * dim;
                for (score, k) in scores.iter_mut().zip(k.chunks_exact(inner)) {
                    *score = self.scale() * dot(&q[part.clone()], &k[part.clone()]);
                }
                softmax(&mut scores);
                for (weight, v) in scores.iter().zip(v.chunks_exact(inner)) {
                    for (out, v) in out[part.clone()].iter_mut().zip(&v[part.clone()]) {
                        *out += weight * v;
                    }
                }
            }
        }
        self.out.forward(&out)
    }

    /// For each head and token, `Σ_d W[head, d]ᵀ · x[token, head, d]`, scaled. `[H · T, width]`
    fn unprojected(&self, x: &[f32], weight: &[f32]) -> Vec<f32> {
        let (dim, tokens) = (self.dim(), x.len() / self.inner);
        let mut out = vec![0.0; self.heads * tokens * self.width];
        for (row, out) in out.chunks_exact_mut(self.width).enumerate() {
            let (head, token) = (row / tokens, row % tokens);
            for d in head * dim..(head + 1) * dim {
                let factor = self.scale() * x[token * self.inner + d];
                for (out, w) in out.iter_mut().zip(&weight[d * self.width..]) {
                    *out += factor * w;
                }
            }
        }
        out
    }

    /// Scores of every row with every head and token. `[N, width] → [N, H · T]`
    fn scores(&self, rows: &[f32], columns: &[f32], bias: Option<&[f32]>) -> Vec<f32> {
        let n = columns.len() / self.width;
        let packed = PackedMatrix::from_strided(columns, self.width, n, 1, self.width);
        let mut out = vec![0.0; rows.len() / self.width * n];
        gemm(rows, &packed, Epilogue { bias, ..Epilogue::default() }, &mut out);
        out
    }

    /// What the tokens see of the picture.
    ///
    /// `queries`: `[T, width]` with their places · `placed`: `[N, width]` rows with their places · `rows`: `[N, width]` ·
    /// returns `[T, width]`
    pub fn tokens_to_rows(&self, queries: &[f32], placed: &[f32], rows: &[f32]) -> Vec<f32> {
        let q = self.q.forward(queries);
        let (dim, tokens) = (self.dim(), q.len() / self.inner);
        let columns = self.heads * tokens;
        // The keys' bias adds the same to all scores of a query.
        let mut scores = self.scores(placed, &self.unprojected(&q, &self.plain.k), None);
        let sums = softmax_down(&mut scores, columns);
        let mut seen = vec![0.0; columns * self.width];
        gemm_tn(&scores, columns, rows, self.width, None, &mut seen);
        let mut values = vec![0.0; tokens * self.inner];
        for (token, out) in values.chunks_exact_mut(self.inner).enumerate() {
            for (d, out) in out.iter_mut().enumerate() {
                let column = d / dim * tokens + token;
                let seen = &seen[column * self.width..][..self.width];
                let weight = &self.plain.v[d * self.width..][..self.width];
                *out = dot(weight, seen) / sums[column] + self.v.bias[d];
            }
        }
        self.out.forward(&values)
    }

    /// What the picture sees of the tokens, added to it.
    ///
    /// `placed`, `rows`: `[N, width]` · `keys`, `values`: `[T, width]` · returns `[N, width]`
    pub fn rows_to_tokens(
        &self,
        placed: &[f32],
        rows: &[f32],
        keys: &[f32],
        values: &[f32],
    ) -> Vec<f32> {
        let (k, v) = (self.k.forward(keys), self.v.forward(values));
        let (dim, inner) = (self.dim(), self.inner);
        let tokens = k.len() / inner;
        let columns = self.heads * tokens;
        // The queries' bias adds to each score what depends on the key.
        let bias: Vec<f32> = (0..columns)
            .map(|column| {
                let part = column / tokens * dim..(column / tokens + 1) * dim;
                let key = &k[column % tokens * inner..][part.clone()];
                self.scale() * dot(key, &self.q.bias[part])
            })
            .collect();
        let unprojected = self.unprojected(&k, &self.plain.q);
        let mut scores = self.scores(placed, &unprojected, Some(&bias));
        for row in scores.chunks_exact_mut(columns) {
            for head in row.chunks_exact_mut(tokens) {
                let top = head.iter().fold(f32::MIN, |top, v| v.max(top));
                head.iter_mut().for_each(|v| *v -= top);
            }
        }
        exp_in_place(&mut scores);
        for head in scores.chunks_exact_mut(tokens) {
            let sum: f32 = head.iter().sum();
            head.iter_mut().for_each(|v| *v /= sum);
        }
        // What each head and token adds to a row that looks at nothing else.
        let mut added = vec![0.0; columns * self.width];
        for (column, added) in added.chunks_exact_mut(self.width).enumerate() {
            let part = column / tokens * dim..(column / tokens + 1) * dim;
            let value = &v[column % tokens * inner..][part.clone()];
            for (channel, added) in added.iter_mut().enumerate() {
                *added = dot(&self.plain.out[channel * inner..][part.clone()], value);
            }
        }
        let packed = PackedMatrix::from_strided(&added, columns, self.width, self.width, 1);
        let mut out = vec![0.0; rows.len()];
        let epilogue = Epilogue { bias: Some(&self.out.bias), gelu: false, residual: Some(rows) };
        gemm(&scores, &packed, epilogue, &mut out);
        out
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn softmax(scores: &mut [f32]) {
    let top = scores.iter().fold(f32::MIN, |top, v| v.max(top));
    scores.iter_mut().for_each(|v| *v -= top);
    exp_in_place(scores);
    let sum: f32 = scores.iter().sum();
    scores.iter_mut().for_each(|v| *v /= sum);
}

/// Exponentials of the scores of each column relative to its largest, and their sums.
///
/// `scores`: `[N, columns]`
fn softmax_down(scores: &mut [f32], columns: usize) -> Vec<f32> {
    let mut top = vec![f32::MIN; columns];
    for row in scores.chunks_exact(columns) {
        top.iter_mut().zip(row).for_each(|(top, v)| *top = v.max(*top));
    }
    for row in scores.chunks_exact_mut(columns) {
        row.iter_mut().zip(&top).for_each(|(v, top)| *v -= top);
    }
    exp_in_place(scores);
    // Sums of stretches: thousands of terms in one chain would cost digits.
    let mut sums = vec![0f32; columns];
    let mut part = vec![0f32; columns];
    for rows in scores.chunks(128 * columns) {
        part.fill(0.0);
        for row in rows.chunks_exact(columns) {
            crate::layers::add(&mut part, row);
        }
        crate::layers::add(&mut sums, &part);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::Precision;

    fn values(len: usize, seed: u64) -> Vec<f32> {
        scenesplat_models::weights::unit("attention", len, seed)
    }

    fn project(w: &[f32], bias: &[f32], x: &[f32], cin: usize) -> Vec<f64> {
        let rows = x.chunks_exact(cin).flat_map(|x| {
            w.chunks_exact(cin).zip(bias).map(move |(w, b)| {
                f64::from(*b)
                    + w.iter().zip(x).map(|(w, x)| f64::from(*w) * f64::from(*x)).sum::<f64>()
            })
        });
        rows.collect()
    }

    /// The definition, in f64.
    fn reference(a: &Attention, queries: &[f32], keys: &[f32], values: &[f32]) -> Vec<f64> {
        let (inner, dim) = (a.inner, a.dim());
        let q = project(&a.plain.q, &a.q.bias, queries, a.width);
        let k = project(&a.plain.k, &a.k.bias, keys, a.width);
        let v = project(&a.plain.v, &a.v.bias, values, a.width);
        let mut mixed = Vec::new();
        for q in q.chunks_exact(inner) {
            for head in 0..a.heads {
                let part = head * dim..(head + 1) * dim;
                let scores: Vec<f64> = k
                    .chunks_exact(inner)
                    .map(|k| {
                        let pairs = q[part.clone()].iter().zip(&k[part.clone()]);
                        (pairs.map(|(q, k)| q * k).sum::<f64>() / (dim as f64).sqrt()).exp()
                    })
                    .collect();
                let sum: f64 = scores.iter().sum();
                for d in part {
                    let terms = scores.iter().zip(v.chunks_exact(inner));
                    mixed.push((terms.map(|(s, v)| s * v[d]).sum::<f64>() / sum) as f32);
                }
            }
        }
        project(&a.plain.out, &a.out.bias, &mixed, inner)
    }

    #[test]
    fn both_directions_agree_with_the_definition_in_f64() {
        for (width, inner, heads, tokens, rows) in
            [(16, 8, 2, 3, 50), (32, 16, 4, 8, 300), (8, 8, 1, 1, 1)]
        {
            let mut weights = Weights::seeded(7, Precision::F32);
            let a = Attention::take(&mut weights, "a", width, inner, heads).unwrap();
            let (x, y) = (values(rows * width, 1), values(rows * width, 2));
            let (t, u) = (values(tokens * width, 3), values(tokens * width, 4));
            let close = |got: &[f32], want: &[f64]| {
                assert_eq!(got.len(), want.len());
                for (g, w) in got.iter().zip(want) {
                    assert!((f64::from(*g) - w).abs() < 2e-5, "{g} {w}");
                }
            };
            close(&a.among(&t, &u, &t), &reference(&a, &t, &u, &t));
            close(&a.tokens_to_rows(&t, &y, &x), &reference(&a, &t, &y, &x));
            let mut want = reference(&a, &y, &t, &u);
            want.iter_mut().zip(&x).for_each(|(w, x)| *w += f64::from(*x));
            close(&a.rows_to_tokens(&y, &x, &t, &u), &want);
        }
    }
}
