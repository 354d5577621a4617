//! All but the blocks of the trunk, written once more in f64 from the authors' description: pixel by pixel, with weights
//! by their published names.

use super::*;
use scenesplat_models::weights::{hashed_parameter, unit};
use std::cell::RefCell;

pub(super) const SEED: u64 = 5;
const WIDTH: usize = 32;

/// Of 64² pixels; no two sizes that could be exchanged are equal.
pub(super) fn small() -> Sam2Config {
    Sam2Config {
        image_size: 64,
        window_pos_embed_bkg_spatial_size: [7, 5],
        decoder_mlp: 48,
        iou_hidden: 24,
        ..mini()
    }
}

pub(super) type Rows = Vec<Vec<f64>>;

/// Seeded values, and which were asked for.
#[derive(Default)]
pub(super) struct Slow(pub(super) RefCell<Arrays>);

impl Slow {
    pub(super) fn get(&self, name: &str, shape: &[usize]) -> Vec<f64> {
        let value = hashed_parameter(name, shape, SEED).unwrap().flatten_all().unwrap();
        let value: Vec<f32> = value.to_vec1().unwrap();
        self.0.borrow_mut().insert(name.to_owned(), (shape.to_vec(), value.clone()));
        value.iter().map(|v| f64::from(*v)).collect()
    }

    /// A linear layer whose weight is stored in this shape.
    fn linear(&self, x: &Rows, name: &str, shape: &[usize]) -> Rows {
        let w = self.get(&format!("{name}.weight"), shape);
        let b = self.get(&format!("{name}.bias"), &shape[..1]);
        let one = |x: &Vec<f64>| {
            let row = |o: usize| (0..x.len()).map(|i| w[o * x.len() + i] * x[i]).sum::<f64>();
            (0..shape[0]).map(|o| b[o] + row(o)).collect()
        };
        x.iter().map(one).collect()
    }

    fn norm(&self, x: &Rows, name: &str, eps: f64) -> Rows {
        let c = x[0].len();
        let w = self.get(&format!("{name}.weight"), &[c]);
        let b = self.get(&format!("{name}.bias"), &[c]);
        let one = |x: &Vec<f64>| {
            let mean = x.iter().sum::<f64>() / c as f64;
            let spread = x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / c as f64;
            (0..c).map(|i| (x[i] - mean) / (spread + eps).sqrt() * w[i] + b[i]).collect()
        };
        x.iter().map(one).collect()
    }

    fn relu_mlp(&self, x: &Rows, name: &str, sizes: &[usize]) -> Rows {
        let mut x = x.clone();
        for (i, pair) in sizes.windows(2).enumerate() {
            x = self.linear(&x, &format!("{name}.layers.{i}"), &[pair[1], pair[0]]);
            if i + 2 < sizes.len() {
                x.iter_mut().flatten().for_each(|v| *v = v.max(0.0));
            }
        }
        x
    }

    fn attention(&self, name: &str, inner: usize, [q, k, v]: [&Rows; 3]) -> Rows {
        let project =
            |x: &Rows, part: &str| self.linear(x, &format!("{name}.{part}_proj"), &[inner, WIDTH]);
        let (q, k, v) = (project(q, "q"), project(k, "k"), project(v, "v"));
        let dim = inner / 4;
        let mut mixed = vec![vec![0.0; inner]; q.len()];
        for (t, head) in (0..q.len()).flat_map(|t| (0..4).map(move |head| (t, head))) {
            let at = head * dim..(head + 1) * dim;
            let score = |k: &Vec<f64>| {
                (at.clone().map(|c| q[t][c] * k[c]).sum::<f64>() / (dim as f64).sqrt()).exp()
            };
            let sum: f64 = k.iter().map(score).sum();
            for (k, v) in k.iter().zip(&v) {
                at.clone().for_each(|c| mixed[t][c] += score(k) / sum * v[c]);
            }
        }
        self.linear(&mixed, &format!("{name}.out_proj"), &[WIDTH, inner])
    }

    /// Sines, then cosines; `at` in shares of the picture.
    fn place(&self, at: [f64; 2]) -> Vec<f64> {
        let half = WIDTH / 2;
        let name = "sam_prompt_encoder.pe_layer.positional_encoding_gaussian_matrix";
        let g = self.get(name, &[2, half]);
        let turn = |i: usize| {
            let [x, y] = at.map(|v| 2.0 * v - 1.0);
            2.0 * std::f64::consts::PI * (x * g[i] + y * g[half + i])
        };
        (0..half).map(|i| turn(i).sin()).chain((0..half).map(|i| turn(i).cos())).collect()
    }

    /// Tokens of points in pixels of the square of 64, with their labels' numbers.
    pub(super) fn prompt(&self, points: &[([f64; 2], usize)]) -> Rows {
        let part = |name: &str| self.get(&format!("sam_prompt_encoder.{name}.weight"), &[1, WIDTH]);
        let labels: Rows = (0..4).map(|i| part(&format!("point_embeddings.{i}"))).collect();
        let token = |(at, label): &([f64; 2], usize)| {
            let place = vec![self.place(at.map(|v| (v + 0.5) / 64.0))];
            plus(&place, &vec![labels[*label].clone()]).remove(0)
        };
        let mut tokens: Rows = points.iter().map(token).collect();
        tokens.push(part("not_a_point_embed"));
        tokens
    }

    /// Coarse, middle and fine rows of the neck, ready for the decoder.
    pub(super) fn picture(&self, stages: &[Vec<f32>; 4]) -> [Rows; 3] {
        // Sides 16, 8, 4 and 2; the file counts from the coarsest.
        let lateral = |stage: usize, convolution: usize| {
            let cin = 16 << stage;
            let rows = stages[stage].chunks(cin).map(|r| r.iter().map(|v| f64::from(*v)).collect());
            let name = format!("image_encoder.neck.convs.{convolution}.conv");
            self.linear(&rows.collect(), &name, &[WIDTH, cin, 1, 1])
        };
        let (fine, middle, top) = (lateral(0, 3), lateral(1, 2), lateral(3, 0));
        let mut coarse = lateral(2, 1);
        let memory = self.get("no_mem_embed", &[1, 1, WIDTH]);
        let mask = self.get("sam_prompt_encoder.no_mask_embed.weight", &[1, WIDTH]);
        for (token, row) in coarse.iter_mut().enumerate() {
            let above = &top[token / 4 / 2 * 2 + token % 4 / 2];
            (0..WIDTH).for_each(|c| row[c] += above[c] + memory[c] + mask[c]);
        }
        let high = |x: &Rows, name: &str, cout: usize| {
            self.linear(x, &format!("sam_mask_decoder.{name}"), &[cout, WIDTH, 1, 1])
        };
        [coarse, high(&middle, "conv_s1", WIDTH / 4), high(&fine, "conv_s0", WIDTH / 8)]
    }

    /// Each row of a raster becomes 2 × 2 rows of the raster twice as wide.
    fn transposed(&self, x: &Rows, side: usize, name: &str, cout: usize) -> Rows {
        let cin = x[0].len();
        let w = self.get(&format!("{name}.weight"), &[cin, cout, 2, 2]);
        let b = self.get(&format!("{name}.bias"), &[cout]);
        let pixel = |at: usize| {
            let (y, u) = (at / (2 * side), at % (2 * side));
            let (row, step) = (&x[y / 2 * side + u / 2], y % 2 * 2 + u % 2);
            let value = |o: usize| {
                b[o] + (0..cin).map(|c| row[c] * w[(c * cout + o) * 4 + step]).sum::<f64>()
            };
            (0..cout).map(value).collect()
        };
        (0..4 * side * side).map(pixel).collect()
    }

    /// Logits of the four masks, their IoUs, and the object's score.
    pub(super) fn decode(
        &self,
        [coarse, middle, fine]: &[Rows; 3],
        prompt: &Rows,
    ) -> [Vec<f64>; 3] {
        let name = |part: &str| format!("sam_mask_decoder.{part}");
        let token = |part: &str, count: usize| {
            let values = self.get(&name(&format!("{part}.weight")), &[count, WIDTH]);
            values.chunks(WIDTH).map(<[f64]>::to_vec).collect::<Rows>()
        };
        let places = [
            token("obj_score_token", 1),
            token("iou_token", 1),
            token("mask_tokens", 4),
            prompt.clone(),
        ]
        .concat();
        let grid: Rows = (0..16)
            .map(|t| self.place([(t % 4) as f64, (t / 4) as f64].map(|v| (v + 0.5) / 4.0)))
            .collect();
        let (mut tokens, mut rows) = (places.clone(), coarse.clone());
        for layer in 0..2 {
            let at = |part: &str| name(&format!("transformer.layers.{layer}.{part}"));
            let placed = plus(&tokens, &places);
            tokens = match layer {
                0 => self.attention(&at("self_attn"), WIDTH, [&tokens; 3]),
                _ => {
                    let seen = self.attention(&at("self_attn"), WIDTH, [&placed, &placed, &tokens]);
                    plus(&tokens, &seen)
                }
            };
            tokens = self.norm(&tokens, &at("norm1"), 1e-5);
            let (q, k) = (plus(&tokens, &places), plus(&rows, &grid));
            let to_rows = at("cross_attn_token_to_image");
            tokens = plus(&tokens, &self.attention(&to_rows, WIDTH / 2, [&q, &k, &rows]));
            tokens = self.norm(&tokens, &at("norm2"), 1e-5);
            tokens = plus(&tokens, &self.relu_mlp(&tokens, &at("mlp"), &[WIDTH, 48, WIDTH]));
            tokens = self.norm(&tokens, &at("norm3"), 1e-5);
            let q = plus(&tokens, &places);
            let to_tokens = at("cross_attn_image_to_token");
            rows = plus(&rows, &self.attention(&to_tokens, WIDTH / 2, [&k, &q, &tokens]));
            rows = self.norm(&rows, &at("norm4"), 1e-5);
        }
        let (q, k) = (plus(&tokens, &places), plus(&rows, &grid));
        let last = name("transformer.final_attn_token_to_image");
        tokens = plus(&tokens, &self.attention(&last, WIDTH / 2, [&q, &k, &rows]));
        tokens = self.norm(&tokens, &name("transformer.norm_final_attn"), 1e-5);

        let up = self.transposed(&rows, 4, &name("output_upscaling.0"), WIDTH / 4);
        let mut up = self.norm(&plus(&up, middle), &name("output_upscaling.1"), 1e-6);
        up.iter_mut().flatten().for_each(|v| *v = gelu(*v));
        let up = self.transposed(&up, 8, &name("output_upscaling.3"), WIDTH / 8);
        let mut up = plus(&up, fine);
        up.iter_mut().flatten().for_each(|v| *v = gelu(*v));
        let head = |token: usize, part: &str, sizes: &[usize]| {
            self.relu_mlp(&vec![tokens[token].clone()], &name(part), sizes).remove(0)
        };
        let mut logits = Vec::new();
        for mask in 0..4 {
            let part = format!("output_hypernetworks_mlps.{mask}");
            let h = head(2 + mask, &part, &[WIDTH, WIDTH, WIDTH, WIDTH / 8]);
            let dot = |p: &Vec<f64>| p.iter().zip(&h).map(|(p, h)| p * h).sum::<f64>();
            logits.extend(up.iter().map(dot));
        }
        let iou = head(1, "iou_prediction_head", &[WIDTH, 24, 24, 4]);
        let score = head(0, "pred_obj_score_head", &[WIDTH, WIDTH, WIDTH, 1]);
        [logits, iou.iter().map(|v| 1.0 / (1.0 + (-v).exp())).collect(), score]
    }
}

fn plus(a: &Rows, b: &Rows) -> Rows {
    assert_eq!(a.len(), b.len());
    let one = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| a + b).collect();
    a.iter().zip(b).map(one).collect()
}

fn f32s(rows: &[f64]) -> Vec<f32> {
    rows.iter().map(|v| *v as f32).collect()
}

#[test]
fn clicks_and_boxes_give_the_masks_of_the_definition() {
    let network = Sam2::seeded(small(), SEED, Precision::F32).unwrap();
    let planes: Vec<f32> = unit("planes", 3 * 64 * 64, 2).iter().map(|v| 2.0 * v).collect();
    let (slow, stages) = (Slow::default(), network.trunk.forward(&planes));
    let rows = slow.picture(&stages);
    let picture = network.encode_planes(&planes);
    close("rows", &picture.rows, &f32s(&rows[0].concat()), F32);
    assert_eq!(network.mask_side(), 16);
    // A picture of 128 × 32: columns are halved and rows doubled in the square of 64.
    let seen = Sam2Picture { width: 128, height: 32, inner: picture };
    use PointLabel::{BoxEnd, BoxStart, Inside, Outside};
    for points in [
        vec![([37.0, 9.5], Inside)],
        vec![([10.0, 4.0], BoxStart), ([90.0, 29.0], BoxEnd)],
        vec![([120.0, 1.0], Outside), ([0.0, 31.0], Inside), ([64.0, 16.0], Inside)],
    ] {
        let asked = points.iter().map(|&(at, label)| PromptPoint { at, label }).collect();
        let found = network.predict(&seen, &[asked]).unwrap().remove(0);
        let points: Vec<_> = (points.iter())
            .map(|(at, label)| {
                let number = [Outside, Inside, BoxStart, BoxEnd].iter().position(|l| l == label);
                ([f64::from(at[0]) / 2.0, f64::from(at[1]) * 2.0], number.unwrap())
            })
            .collect();
        let [logits, iou, score] = slow.decode(&rows, &slow.prompt(&points));
        close("logits", &found.logits, &f32s(&logits), F32);
        close("iou", &found.iou, &f32s(&iou), 1e-5);
        close("score", &[found.object_score], &f32s(&score), F32);
        assert!(iou.iter().all(|v| (0.0..1.0).contains(v)));
    }
}

#[test]
fn tokens_of_the_trunk_are_a_convolution_with_two_embeddings() {
    let network = Sam2::seeded(small(), SEED, Precision::F32).unwrap();
    let planes = unit("planes", 3 * 64 * 64, 3);
    let mut found = network.trunk.patch.forward(&trunk::columns(&planes, 16));
    crate::layers::add(&mut found, &network.trunk.position);
    let slow = Slow::default();
    let w = slow.get("image_encoder.trunk.patch_embed.proj.weight", &[16, 3, 7, 7]);
    let b = slow.get("image_encoder.trunk.patch_embed.proj.bias", &[16]);
    let coarse = slow.get("image_encoder.trunk.pos_embed", &[1, 16, 7, 5]);
    let tile = slow.get("image_encoder.trunk.pos_embed_window", &[1, 16, 8, 8]);
    // The cubic of torch, a = −0.75, by the distance; edges are repeated.
    let cubic = |d: f64| match d.abs() {
        d if d < 1.0 => 1.25 * d.powi(3) - 2.25 * d.powi(2) + 1.0,
        d if d < 2.0 => -0.75 * (d.powi(3) - 5.0 * d.powi(2) + 8.0 * d - 4.0),
        _ => 0.0,
    };
    let mut want = Vec::new();
    for (y, x, c) in (0..16 * 16 * 16).map(|i| (i / 256, i / 16 % 16, i % 16)) {
        let mut sum = b[c] + tile[(c * 8 + y % 8) * 8 + x % 8];
        for (channel, ky, kx) in (0..147).map(|i| (i / 49, i / 7 % 7, i % 7)) {
            let (v, u) = ((4 * y + ky) as i64 - 3, (4 * x + kx) as i64 - 3);
            if (0..64).contains(&v) && (0..64).contains(&u) {
                let pixel = f64::from(planes[(channel * 64 + v as usize) * 64 + u as usize]);
                sum += w[((c * 3 + channel) * 7 + ky) * 7 + kx] * pixel;
            }
        }
        let (row, column) =
            ((y as f64 + 0.5) * 7.0 / 16.0 - 0.5, (x as f64 + 0.5) * 5.0 / 16.0 - 0.5);
        for (v, u) in (-2..10i64).flat_map(|v| (-2..8i64).map(move |u| (v, u))) {
            let at = v.clamp(0, 6) as usize * 5 + u.clamp(0, 4) as usize;
            sum += cubic(v as f64 - row) * cubic(u as f64 - column) * coarse[c * 35 + at];
        }
        want.push(sum as f32);
    }
    close("tokens", &found, &want, 1e-5);
}

#[test]
fn a_picture_is_squashed_and_each_channel_gets_its_mean_and_spread() {
    let network = Sam2::seeded(small(), SEED, Precision::F32).unwrap();
    let picture = RgbPicture::from_fn(96, 40, |x, y| [(2 * x) as u8, (6 * y) as u8, (x * y) as u8]);
    // One and a half pixels across and 0.625 down make one: a triangle as wide as a pixel of the larger raster.
    let taps = |from: usize, i: usize| -> Vec<(usize, f64)> {
        let scale = from as f64 / 64.0;
        let (middle, reach) = ((i as f64 + 0.5) * scale, scale.max(1.0));
        let weight = |k: usize| (1.0 - ((k as f64 + 0.5 - middle) / reach).abs()).max(0.0);
        let sum: f64 = (0..from).map(weight).sum();
        (0..from).map(|k| (k, weight(k) / sum)).filter(|(_, w)| *w > 0.0).collect()
    };
    let (mean, spread) = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]);
    let mut planes = Vec::new();
    for (c, y, x) in (0..3 * 64 * 64).map(|i| (i / 4096, i / 64 % 64, i % 64)) {
        let across = taps(96, x);
        let row = |v: usize| {
            let pixel = |u: usize| f64::from(picture.get(u as u32, v as u32).unwrap()[c]) / 255.0;
            across.iter().map(|(u, w)| w * pixel(*u)).sum::<f64>()
        };
        let value: f64 = taps(40, y).iter().map(|(v, w)| w * row(*v)).sum();
        planes.push(((value - mean[c]) / spread[c]) as f32);
    }
    let (seen, want) = (network.encode(&picture).unwrap(), network.encode_planes(&planes));
    assert_eq!(seen.size(), [96, 40]);
    close("rows", &seen.inner.rows, &want.rows, F32);
    assert!(network.encode(&RgbPicture::filled(0, 3, [0; 3])).is_err());
}
