//! Against numbers of the authors' code, and against the definition in f64.

mod definition;
mod weight_file;

use super::*;
use crate::layers::Norm;
use crate::masks::upscale::{Place, upscale};
use crate::test_files::{Arrays, save};
use scenesplat_test_support::Golden;
use scenesplat_test_support::reference::{gelu, layer_norm};

/// Sums of up to 512 f32 terms through nine blocks: the numbers of the authors' code differ by as much between machines.
const F32: f64 = 1e-4;

fn mini() -> Sam2Config {
    Sam2Config {
        image_size: 128,
        embed_dim: 16,
        num_heads: 1,
        stages: [1, 2, 3, 1],
        global_att_blocks: vec![4],
        window_spec: [8, 4, 4, 2],
        window_pos_embed_bkg_spatial_size: [7, 7],
        d_model: 32,
        decoder_depth: 2,
        decoder_heads: 4,
        decoder_mlp: 64,
        iou_hidden: 32,
    }
}

fn golden() -> Option<Arrays> {
    let golden = Golden::open("goldens/raster/sam2_mini.safetensors")?;
    let array = |name: String| {
        let array = (golden.shape(&name).to_vec(), golden.f32s(&name));
        (name, array)
    };
    Some(golden.names("").into_iter().map(array).collect())
}

/// The weights of the golden file alone, as a weight file; other layouts are made by `change`.
fn weight_file(arrays: &Arrays, change: impl Fn(&mut Arrays)) -> tempfile::NamedTempFile {
    let mut weights = arrays.clone();
    weights.retain(|name, _| !name.starts_with("in.") && !name.starts_with("out."));
    weights.insert("no_mem_embed".to_owned(), arrays["in.no_mem_embed"].clone());
    change(&mut weights);
    let file = tempfile::Builder::new().suffix(".safetensors").tempfile().unwrap();
    save(&weights, file.path());
    file
}

/// `[C, H, W] → [H · W, C]`
fn rows(planes: &[f32], channels: usize) -> Vec<f32> {
    let pixels = planes.len() / channels;
    (0..planes.len()).map(|i| planes[i % channels * pixels + i / channels]).collect()
}

#[track_caller]
fn close(what: &str, got: &[f32], want: &[f32], tolerance: f64) {
    assert_eq!(got.len(), want.len(), "{what}");
    let largest = want.iter().fold(0f32, |most, v| most.max(v.abs()));
    let mut worst = 0f64;
    for (g, w) in got.iter().zip(want) {
        worst = worst.max(f64::from((g - w).abs()));
    }
    println!("{what}: {worst:.2e} of {largest:.2e}");
    assert!(worst <= tolerance * f64::from(largest.max(1.0)), "{what}: {worst} of {largest}");
}

#[test]
fn golden_sam2_mini() {
    let Some(golden) = golden() else { return };
    let array = |name: &str| golden[name].1.as_slice();
    let file = weight_file(&golden, |_| ());
    let network = Sam2::load(file.path(), mini()).unwrap();

    let stages = network.trunk.forward(array("in.image"));
    for (i, stage) in stages.iter().enumerate() {
        close(&format!("trunk{i}"), stage, &rows(array(&format!("out.trunk{i}")), 16 << i), F32);
    }
    let pyramid = network.neck.forward(&stages, 32);
    close("fpn0", &pyramid.fine, &rows(array("out.fpn0"), 32), F32);
    close("fpn1", &pyramid.middle, &rows(array("out.fpn1"), 32), F32);
    close("fpn2", &pyramid.coarse, &rows(array("out.fpn2"), 32), F32);
    close("dense_pe", &network.prompt.grid(8), &rows(array("out.dense_pe"), 32), F32);

    let picture = network.encode_planes(array("in.image"));
    let mut embed = rows(array("out.image_embed"), 32);
    for row in embed.chunks_exact_mut(32) {
        row.iter_mut().zip(&network.prompt.no_mask).for_each(|(v, n)| *v += n);
    }
    close("image_embed", &picture.rows, &embed, F32);

    let side = network.mask_side();
    for prompt in 0..5 {
        let at = [array("in.points")[2 * prompt], array("in.points")[2 * prompt + 1]];
        let label = match array("in.labels")[prompt] as i32 {
            0 => PointLabel::Outside,
            1 => PointLabel::Inside,
            2 => PointLabel::BoxStart,
            _ => PointLabel::BoxEnd,
        };
        let tokens = network.prompt.tokens(&[PromptPoint { at, label }]);
        close("sparse", &tokens, &array("out.sparse")[prompt * 64..][..64], F32);
        let masks = network.decoder.masks(&picture, &tokens);
        let want = &array("out.masks_all4")[prompt * 4 * side * side..][..4 * side * side];
        close("masks", &masks.logits, want, F32);
        for (mask, want) in
            array("out.stability_at_upsampled")[prompt * 4..][..4].iter().enumerate()
        {
            let place = Place { picture: [135, 119], left: 0, top: 0, width: 135, height: 119 };
            let logits = &masks.logits[mask * side * side..(mask + 1) * side * side];
            let got = upscale(logits, side, place, 0.2).stability;
            // Of 16,000 pixels a few lie where roundings decide.
            assert!((got - want).abs() < 1e-3 || got.is_nan() && want.is_nan(), "{got} {want}");
        }
        close("iou", &masks.iou, &array("out.iou_all4")[prompt * 4..][..4], F32);
        let score = [masks.object_score];
        close("object score", &score, &array("out.object_score_logits")[prompt..=prompt], F32);
    }
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let network = Sam2::seeded(mini(), 3, Precision::F32).unwrap();
    let picture = RgbPicture::from_fn(37, 23, |x, y| [x as u8 * 5, y as u8 * 9, (x ^ y) as u8]);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let seen = network.encode(&picture).unwrap();
            let prompts = [[3.0, 4.0], [30.5, 20.0]].map(|at| vec![PromptPoint::inside(at)]);
            let both = network.predict(&seen, &prompts).unwrap();
            // A prompt alone has the bits that it has among others.
            assert_eq!(network.predict(&seen, &prompts[1..]).unwrap()[0], both[1]);
            both
        })
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
    assert!(one.iter().flat_map(|p| &p.logits).all(|v| v.is_finite()));
}

#[test]
fn points_are_told_in_pixels_of_the_picture() {
    let network = Sam2::seeded(mini(), 3, Precision::F32).unwrap();
    let picture = RgbPicture::from_fn(256, 64, |x, y| [x as u8, y as u8 * 4, 90]);
    let seen = network.encode(&picture).unwrap();
    assert_eq!(seen.size(), [256, 64]);
    let predicted = network.predict(&seen, &[vec![PromptPoint::inside([200.0, 16.0])]]).unwrap();
    // In the square of 128 it is half as far right and twice as far down.
    let tokens = network.prompt.tokens(&[PromptPoint::inside([100.0, 32.0])]);
    assert_eq!(predicted[0], network.decoder.masks(&seen.inner, &tokens));
    let error = network.predict(&seen, &[vec![]]).unwrap_err().to_string();
    assert!(error.contains("no point"), "{error}");
    let nan = vec![PromptPoint::inside([f32::NAN, 0.0])];
    assert!(network.predict(&seen, &[nan]).unwrap_err().to_string().contains("NaN"));
}

#[test]
fn a_click_in_the_middle_of_a_cell_is_where_the_cell_is() {
    let network = Sam2::seeded(mini(), 3, Precision::F32).unwrap();
    let (size, side) = (network.config.image_size as f32, 4);
    let width = network.config.d_model;
    let grid = network.prompt.grid(side);
    let cell = size / side as f32;
    let token = |x: usize, y: usize| {
        let middle = [x, y].map(|i| (i as f32 + 0.5) * cell);
        // A pixel's number is its lower edge: its middle is half a pixel further.
        network.prompt.tokens(&[PromptPoint::inside(middle.map(|v| v - 0.5))])
    };
    let off = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f32>>();
    // Without what tells that it is a click, which all clicks share.
    for (a, b) in [([0, 0], [3, 1]), ([2, 3], [1, 0])] {
        let row = |[x, y]: [usize; 2]| &grid[(y * side + x) * width..][..width];
        let (first, second) = (token(a[0], a[1]), token(b[0], b[1]));
        let (got, want) = (off(&first[..width], &second[..width]), off(row(a), row(b)));
        for (got, want) in got.iter().zip(&want) {
            assert!((got - want).abs() < 1e-4, "{got} {want}");
        }
    }
}

#[test]
fn bad_weights_are_refused_by_name() {
    let Some(golden) = golden() else { return };
    let message = |change: &dyn Fn(&mut Arrays)| {
        let file = weight_file(&golden, change);
        Sam2::load(file.path(), mini()).unwrap_err().to_string()
    };
    let norm = "image_encoder.trunk.blocks.3.norm2.weight";
    let missing = message(&|w| {
        w.remove(norm);
    });
    assert!(missing.contains(&format!("has no tensor {norm}")), "{missing}");
    let nan = message(&|w| w.get_mut(norm).unwrap().1[5] = f32::NAN);
    assert!(nan.contains(&format!("{norm}: value 5 is NaN")), "{nan}");
    let shape = message(&|w| w.get_mut(norm).unwrap().0 = vec![8, 8]);
    assert!(shape.contains("[8, 8]") && shape.contains(norm), "{shape}");
    let foreign = message(&|w| {
        w.insert("unet.0.weight".to_owned(), (vec![1], vec![0.0]));
    });
    assert!(foreign.contains("unet.0.weight"), "{foreign}");
    // What only videos need may be there.
    let video = |w: &mut Arrays| {
        w.insert("memory_encoder.x".to_owned(), (vec![1], vec![0.0]));
    };
    assert!(Sam2::load(weight_file(&golden, video).path(), mini()).is_ok());
    let file = weight_file(&golden, |_| ());
    let unknown = Sam2::open(file.path(), Precision::F32).unwrap_err().to_string();
    assert!(unknown.contains("16 channels in 7 blocks"), "{unknown}");
    let bytes = std::fs::read(file.path()).unwrap();
    std::fs::write(file.path(), &bytes[..bytes.len() - 9]).unwrap();
    assert!(Sam2::load(file.path(), mini()).is_err());
}

/// Hiera by its definition, in f64, window by window.
mod reference {
    use super::*;

    type Rows = Vec<Vec<f64>>;

    struct Block {
        norms: [Norm; 2],
        /// Weight `[out, in]` and bias of qkv, output, both of the perceptron, and the skip.
        linear: [Option<(Vec<f32>, Vec<f32>)>; 5],
        heads: usize,
        window: usize,
    }

    fn linear(x: &Rows, layer: &Option<(Vec<f32>, Vec<f32>)>) -> Rows {
        let (w, b) = layer.as_ref().unwrap();
        x.iter()
            .map(|x| {
                let rows = w.chunks_exact(x.len()).zip(b);
                rows.map(|(w, b)| {
                    f64::from(*b) + w.iter().zip(x).map(|(w, x)| f64::from(*w) * x).sum::<f64>()
                })
                .collect()
            })
            .collect()
    }

    fn norm(x: &Rows, norm: &Norm) -> Rows {
        let c = norm.weight.len();
        let flat: Vec<f32> = x.iter().flatten().map(|v| *v as f32).collect();
        let out = layer_norm(&flat, c, &norm.weight, &norm.bias, f64::from(norm.eps));
        out.chunks_exact(c).map(<[f64]>::to_vec).collect()
    }

    /// The largest of each 2 × 2 of a raster.
    fn pool(x: &Rows, side: usize) -> Rows {
        let half = side / 2;
        (0..half * half)
            .map(|t| {
                let (y, u) = (t / half * 2, t % half * 2);
                let four =
                    [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(a, b)| &x[(y + a) * side + u + b]);
                (0..x[0].len())
                    .map(|c| four.iter().map(|r| r[c]).fold(f64::MIN, f64::max))
                    .collect()
            })
            .collect()
    }

    /// What the query of one token attends to, head by head.
    fn attend(q: &[f64], k: &Rows, v: &Rows, heads: usize) -> Vec<f64> {
        let dim = q.len() / heads;
        let mut out = Vec::new();
        for head in 0..heads {
            let at = head * dim..(head + 1) * dim;
            let scores: Vec<f64> = k
                .iter()
                .map(|k| {
                    let dot: f64 =
                        q[at.clone()].iter().zip(&k[at.clone()]).map(|(q, k)| q * k).sum();
                    (dot / (dim as f64).sqrt()).exp()
                })
                .collect();
            let sum: f64 = scores.iter().sum();
            for d in at {
                let terms = scores.iter().zip(v).map(|(s, v)| s * v[d]);
                out.push(terms.sum::<f64>() / sum);
            }
        }
        out
    }

    fn block(b: &Block, x: &Rows, side: usize) -> (Rows, usize) {
        let y = norm(x, &b.norms[0]);
        let pools = b.linear[4].is_some();
        let skip = if pools { pool(&linear(&y, &b.linear[4]), side) } else { x.clone() };
        let across = side.div_ceil(b.window);
        let (out_side, out_window) =
            if pools { (side / 2, b.window / 2) } else { (side, b.window) };
        let mut attended: Rows = vec![Vec::new(); out_side * out_side];
        let zero = vec![0.0; y[0].len()];
        for cell in 0..across * across {
            let (top, left) = (cell / across, cell % across);
            let tokens: Rows = (0..b.window * b.window)
                .map(|t| {
                    let (v, u) = (top * b.window + t / b.window, left * b.window + t % b.window);
                    if v < side && u < side { y[v * side + u].clone() } else { zero.clone() }
                })
                .collect();
            let qkv = linear(&tokens, &b.linear[0]);
            let width = qkv[0].len() / 3;
            let part = |i: usize| -> Rows {
                qkv.iter().map(|row| row[i * width..(i + 1) * width].to_vec()).collect()
            };
            let (mut q, k, v) = (part(0), part(1), part(2));
            if pools {
                q = pool(&q, b.window);
            }
            for (t, q) in q.iter().enumerate() {
                let (row, column) =
                    (top * out_window + t / out_window, left * out_window + t % out_window);
                if row >= out_side || column >= out_side {
                    continue;
                }
                attended[row * out_side + column] = attend(q, &k, &v, b.heads);
            }
        }
        let plus = |a: Rows, b: &Rows| -> Rows {
            let rows = a.iter().zip(b);
            rows.map(|(a, b)| a.iter().zip(b).map(|(a, b)| a + b).collect()).collect()
        };
        let x = plus(linear(&attended, &b.linear[1]), &skip);
        let mut hidden = linear(&norm(&x, &b.norms[1]), &b.linear[2]);
        hidden.iter_mut().flatten().for_each(|v| *v = gelu(*v));
        (plus(linear(&hidden, &b.linear[3]), &x), out_side)
    }

    fn take(weights: &mut Weights, i: usize, size: [usize; 4]) -> Block {
        let [before, dim, heads, window] = size;
        let name = |part: &str| format!("image_encoder.trunk.blocks.{i}.{part}");
        let mut linear = |part: &str, cin: usize, cout: usize| {
            let weight = weights.take(&name(&format!("{part}.weight")), &[cout, cin]).unwrap();
            Some((weight, weights.take(&name(&format!("{part}.bias")), &[cout]).unwrap()))
        };
        let layers = [
            linear("attn.qkv", before, 3 * dim),
            linear("attn.proj", dim, dim),
            linear("mlp.layers.0", dim, 4 * dim),
            linear("mlp.layers.1", 4 * dim, dim),
            if before == dim { None } else { linear("proj", before, dim) },
        ];
        let norms = [("norm1", before), ("norm2", dim)]
            .map(|(n, c)| weights.norm(&name(n), c, 1e-6).unwrap());
        Block { norms, linear: layers, heads, window }
    }

    /// A trunk of 96² pixels and one of 64² whose windows divide nothing, against the definition.
    #[test]
    fn windows_that_do_not_divide() {
        // Sides of the stages: 24, 12, 6, 3 and 32, 16, 8, 4.
        for (size, windows, global) in [
            (96, [8, 4, 4, 2], vec![4]),
            (128, [8, 6, 10, 3], vec![]),
            (96, [8, 8, 14, 7], vec![5]),
        ] {
            let mut config = mini();
            (config.image_size, config.window_spec, config.global_att_blocks) =
                (size, windows, global.clone());
            config.check().unwrap();
            let network = Sam2::seeded(config.clone(), 11, Precision::F32).unwrap();
            let planes = scenesplat_models::weights::unit("planes", 3 * size * size, 5);
            let stages = network.trunk.forward(&planes);

            let mut side = size / 4;
            let mut x = network.trunk.patch.forward(&trunk::columns(&planes, side));
            crate::layers::add(&mut x, &network.trunk.position);
            let mut x: Rows =
                x.chunks_exact(16).map(|r| r.iter().map(|v| f64::from(*v)).collect()).collect();
            let mut weights = Weights::seeded(11, Precision::F32);
            let mut index = 0;
            for (stage, count) in config.stages.into_iter().enumerate() {
                for i in 0..count {
                    let starts = stage > 0 && i == 0;
                    let (dim, heads) = (16 << stage, 1 << stage);
                    let before = if starts { dim / 2 } else { dim };
                    let window = if global.contains(&index) {
                        side
                    } else {
                        windows[stage - usize::from(starts)]
                    };
                    let layer = take(&mut weights, index, [before, dim, heads, window]);
                    (x, side) = block(&layer, &x, side);
                    index += 1;
                }
                let want: Vec<f32> = x.iter().flatten().map(|v| *v as f32).collect();
                close(&format!("{size} {windows:?} stage {stage}"), &stages[stage], &want, F32);
            }
        }
    }
}
