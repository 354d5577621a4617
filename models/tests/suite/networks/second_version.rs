//! The second version of Point Transformer V3 (`PT-v3m2`) against its formulas in f64, which share nothing with the
//! network but the bit-by-bit curve codes; names of its parameters; and what of it is known by its weights.

use super::litept::numerics::error;
use super::litept::reference::{Formulas, Rows, Values, largest};
use super::litept::scenes::{CHANNELS, room};
use crate::gradients::slow;
use crate::support::{Scene, batch, bits, eval, flat, frozen, gradients, refusal, trainable};
use scenesplat_models::point_transformer_v3::{PoolingReduce, Version};
use scenesplat_models::weights::Shapes;
use scenesplat_models::{
    Backbone, Compute, LevelOptions, ModelConfig, PointTransformerV3, PointTransformerV3Config,
};
use std::collections::BTreeMap;

/// Largest difference of an output in f32, relative to the largest value: layer norms of rows that vary little magnify
/// rounding errors.
const EPS: f64 = 3e-5;

/// Three scales; patches shorter than the scenes, so that the last of a scene borrows rows.
fn encoder() -> PointTransformerV3Config {
    let base = PointTransformerV3Config {
        version: Version::M2,
        in_channels: CHANNELS,
        pooling: PoolingReduce::Max,
        mlp_ratio: 2,
        drop_path: 0.0,
        ..PointTransformerV3Config::language()
    };
    base.with_stages(&[[2, 8, 2], [1, 12, 3], [5, 16, 2]], &[], 20)
}

fn with_decoder() -> PointTransformerV3Config {
    let stages = [[2, 8, 2], [1, 12, 3], [1, 16, 2]];
    encoder().with_stages(&stages, &[[1, 10, 2], [2, 12, 1]], 20)
}

/// The network written from its formulas.
struct Reference<'a> {
    config: &'a PointTransformerV3Config,
    layers: Formulas,
}

impl<'a> Reference<'a> {
    fn new(config: &'a PointTransformerV3Config) -> Self {
        let (order, mlp_ratio) = (config.order.clone(), config.mlp_ratio);
        let layers = Formulas { values: Values::default(), order, mlp_ratio, rope_base: None };
        Self { config, layers }
    }

    /// `gelu(LN(Linear(x)))`
    fn layer(&self, x: &[f64], [i, o]: [usize; 2], linear: &str, norm: &str) -> Vec<f64> {
        let x = self.layers.linear(x, i, o, linear);
        slow::gelu(&self.layers.layer_norm(&x, o, norm))
    }

    fn blocks(&self, mut x: Vec<f64>, rows: &Rows, half: &str, stage: usize) -> Vec<f64> {
        let c = self.config;
        let (depths, channels, heads, patches) = match half {
            "enc" => (&c.enc_depths, &c.enc_channels, &c.enc_num_head, &c.enc_patch_size),
            _ => (&c.dec_depths, &c.dec_channels, &c.dec_num_head, &c.dec_patch_size),
        };
        let width = channels[stage];
        for i in 0..depths[stage] {
            let name = format!("{half}.{half}{stage}.block{i}");
            let y = self.layers.conv(&x, rows, [width, width, 3], &format!("{name}.cpe.0"), true);
            let y = self.layers.linear(&y, width, width, &format!("{name}.cpe.1"));
            x = slow::add(&x, &self.layers.layer_norm(&y, width, &format!("{name}.cpe.2")));
            let shape = [width, heads[stage], patches[stage]];
            x = self.layers.attention_mlp(x, rows, shape, i % c.order.len(), &name);
        }
        x
    }

    /// Features of the decoder, or of all scales at the input rows, the finest first.
    fn forward(&self, scenes: &[&Scene]) -> Vec<f64> {
        let c = self.config;
        let cells = scenes.iter().enumerate();
        let cells = cells.flat_map(|(i, s)| s.cells.iter().map(move |v| (i, *v))).collect();
        let feat: Vec<f64> =
            scenes.iter().flat_map(|s| s.feat.iter().map(|v| f64::from(*v))).collect();
        let first = [c.in_channels, c.enc_channels[0]];
        let mut x = self.layer(&feat, first, "embedding.stem.linear", "embedding.stem.norm");
        let mut scales = vec![Rows::new(cells)];
        let (mut features, mut parents) = (Vec::new(), Vec::new());
        for stage in 0..c.num_stages() {
            if stage > 0 {
                let (coarse, of) = scales[stage - 1].coarser(c.stride[stage - 1]);
                let (i, o) = (c.enc_channels[stage - 1], c.enc_channels[stage]);
                let down = format!("enc.enc{stage}.down");
                let wide = self.layers.linear(&x, i, o, &format!("{down}.proj"));
                let most = largest(&wide, o, &of, coarse.cells.len());
                x = slow::gelu(&self.layers.layer_norm(&most, o, &format!("{down}.norm.0")));
                scales.push(coarse);
                parents.push(of);
            }
            x = self.blocks(x, &scales[stage], "enc", stage);
            features.push(x.clone());
        }
        if c.dec_depths.is_empty() {
            return self.side_by_side(&features, &parents);
        }
        for stage in (0..c.dec_depths.len()).rev() {
            let below = c.dec_channels.get(stage + 1).or(c.enc_channels.last()).copied().unwrap();
            let (name, o) = (format!("dec.dec{stage}.up"), c.dec_channels[stage]);
            let branch = |x: &[f64], i: usize, part: &str| {
                self.layer(x, [i, o], &format!("{name}.{part}.0"), &format!("{name}.{part}.1"))
            };
            let coarse = branch(&x, below, "proj");
            x = branch(&features[stage], c.enc_channels[stage], "proj_skip");
            for (row, group) in parents[stage].iter().enumerate() {
                (0..o).for_each(|j| x[row * o + j] += coarse[group * o + j]);
            }
            x = self.blocks(x, &scales[stage], "dec", stage);
        }
        x
    }

    fn side_by_side(&self, features: &[Vec<f64>], parents: &[Vec<usize>]) -> Vec<f64> {
        let channels = &self.config.enc_channels;
        let mut out = Vec::new();
        for row in 0..features[0].len() / channels[0] {
            let mut at = row;
            for (stage, (values, c)) in features.iter().zip(channels).enumerate() {
                if stage > 0 {
                    at = parents[stage - 1][at];
                }
                out.extend_from_slice(&values[at * c..][..*c]);
            }
        }
        out
    }
}

fn packed(config: &PointTransformerV3Config, compute: Compute) -> PointTransformerV3 {
    let config = PointTransformerV3Config { compute, ..config.clone() };
    frozen(|vb| PointTransformerV3::new(&config, vb))
}

#[test]
fn outputs_and_names_are_those_of_the_formulas() {
    let scenes = [&room(9, "a"), &room(6, "b")];
    for (name, config) in [("encoder", encoder()), ("decoder", with_decoder())] {
        let slow = Reference::new(&config);
        let want = slow.forward(&scenes);
        for compute in [Compute::EXACT, Compute::default()] {
            let found = error(&flat(&eval(&packed(&config, compute), &batch(&scenes))), &want);
            assert!(found < EPS, "{name}, {compute:?}: {found:.1e}");
        }
        let (store, network) = trainable(|vb| PointTransformerV3::new(&config, vb));
        let out = eval(&network, &batch(&scenes));
        assert!(error(&flat(&out), &want) < EPS, "{name}, trainable");
        // Names and shapes that the formulas asked for, and no others; every parameter has a gradient.
        assert_eq!(store.shapes(), slow.layers.values.shapes(), "{name}");
        let values: usize =
            store.shapes().values().map(|shape| shape.iter().product::<usize>()).sum();
        assert_eq!(config.num_values(), values, "{name}");
        let silent: Vec<String> = gradients(&store, &out, 5)
            .into_iter()
            .filter(|(_, gradient)| gradient.iter().all(|v| *v == 0.0))
            .map(|(parameter, _)| parameter)
            .collect();
        // A key's bias moves all scores of a query alike; it lies in the middle of a longer one.
        assert!(silent.is_empty(), "{name}: {silent:?}");
    }
}

#[test]
fn gradients_are_differences_of_the_formulas() {
    let scenes = [&room(4, "a")];
    let config = with_decoder();
    let (store, network) = trainable(|vb| PointTransformerV3::new(&config, vb));
    let out = eval(&network, &batch(&scenes));
    let got = gradients(&store, &out, 5);
    let noise: Vec<f64> = scenesplat_models::weights::unit("R", out.elem_count(), 5)
        .into_iter()
        .map(f64::from)
        .collect();
    let slow = Reference::new(&config);
    let loss = || -> f64 { slow.forward(&scenes).iter().zip(&noise).map(|(o, r)| o * r).sum() };
    loss();
    // What the second version has of its own: the stem, a pooling, both branches of an unpooling, the convolution
    // behind them.
    for parameter in [
        "embedding.stem.linear.weight",
        "embedding.stem.norm.bias",
        "enc.enc1.down.norm.0.weight",
        "dec.dec0.up.proj.1.weight",
        "dec.dec1.up.proj_skip.1.bias",
        "dec.dec0.block0.cpe.0.weight",
    ] {
        let gradient = &got[parameter];
        let along: Vec<f64> = scenesplat_models::weights::unit(parameter, gradient.len(), 9)
            .into_iter()
            .map(f64::from)
            .collect();
        let step = 1e-6;
        slow.layers.values.shift(parameter, step, &along);
        let above = loss();
        slow.layers.values.shift(parameter, -2.0 * step, &along);
        let want = (above - loss()) / (2.0 * step);
        slow.layers.values.shift(parameter, step, &along);
        let found: f64 = gradient.iter().zip(&along).map(|(g, d)| f64::from(*g) * d).sum();
        let scale = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        assert!((found - want).abs() < 3e-5 * scale.max(1e-3), "{parameter}: {found} {want}");
    }
}

#[test]
fn masked_rows_read_the_token_behind_the_stem() {
    let config = PointTransformerV3Config { mask_token: true, ..encoder() };
    let network: PointTransformerV3 = packed(&config, Compute::EXACT);
    let scene = room(6, "a");
    let mask: Vec<bool> = (0..scene.cells.len()).map(|row| row % 3 == 0).collect();
    let masked = |scene: &Scene| {
        let options = LevelOptions { mask: Some(&mask), decoder: false };
        let mut rng = crate::support::rng(0);
        let mut cx = scenesplat_models::Forward::eval(&mut rng);
        let levels = network.forward_levels(&batch(&[scene]), options, &mut cx).unwrap();
        levels.up_cast(0).unwrap()
    };
    // What a masked row had is not seen; what another had, is.
    let mut other = scene.clone();
    other.feat[..CHANNELS].fill(9.0);
    assert_eq!(bits(&masked(&scene)), bits(&masked(&other)));
    other.feat[CHANNELS..2 * CHANNELS].fill(9.0);
    assert_ne!(bits(&masked(&scene)), bits(&masked(&other)));
    assert_ne!(bits(&masked(&scene)), bits(&eval(&network, &batch(&[&scene]))));
}

#[test]
fn scenes_do_not_meet_and_small_ones_work() {
    let network: PointTransformerV3 = packed(&with_decoder(), Compute::default());
    let (a, b) = (room(7, "a"), room(4, "b"));
    let alone = bits(&eval(&network, &batch(&[&b])));
    let together = bits(&eval(&network, &batch(&[&a, &b])));
    assert_eq!(together[together.len() - alone.len()..], alone);
    assert!(
        refusal(&network, &batch(&[&Scene::new(vec![], CHANNELS, "none", 3)])).contains("voxel")
    );
    for rows in [1, 2] {
        let few = Scene::new(vec![[0, 0, 0], [5, 5, 5]][..rows].to_vec(), CHANNELS, "few", 3);
        let out = eval(&network, &batch(&[&few]));
        assert_eq!(out.dims(), [rows, 10]);
        assert!(flat(&out).iter().all(|v| v.is_finite()));
    }
}

/// Sizes that are published: of the encoder 108.5 million parameters.
#[test]
fn published_networks_are_known_by_their_weights() {
    let sonata = PointTransformerV3Config::sonata();
    assert_eq!((sonata.out_channels(), sonata.num_values() / 100_000), (1232, 1084));
    assert_eq!(PointTransformerV3Config::concerto_large().out_channels(), 1728);
    // Shapes alone, of names that the network asks for.
    let shapes = |config: &PointTransformerV3Config| -> Shapes {
        let mut out = BTreeMap::from([(
            "embedding.stem.linear.weight".to_owned(),
            vec![config.enc_channels[0], config.in_channels],
        )]);
        let mut stage = |half: &str, s: usize, depth: usize, c: usize| {
            for block in 0..depth {
                out.insert(
                    format!("{half}.{half}{s}.block{block}.attn.qkv.weight"),
                    vec![3 * c, c],
                );
            }
        };
        for (s, (&depth, &c)) in config.enc_depths.iter().zip(&config.enc_channels).enumerate() {
            stage("enc", s, depth, c);
        }
        for (s, (&depth, &c)) in config.dec_depths.iter().zip(&config.dec_channels).enumerate() {
            stage("dec", s, depth, c);
        }
        for s in 1..config.num_stages() {
            let (fine, coarse) = (config.enc_channels[s - 1], config.enc_channels[s]);
            out.insert(format!("enc.enc{s}.down.proj.weight"), vec![coarse, fine]);
        }
        for (s, &c) in config.dec_channels.iter().enumerate() {
            let below = config.dec_channels.get(s + 1).unwrap_or(&config.enc_channels[4]);
            out.insert(format!("dec.dec{s}.up.proj.0.weight"), vec![c, *below]);
            out.insert(
                format!("dec.dec{s}.up.proj_skip.0.weight"),
                vec![c, config.enc_channels[s]],
            );
        }
        out.into_iter().collect()
    };
    let eleven = PointTransformerV3Config { in_channels: 11, ..sonata.clone() };
    for config in [
        sonata,
        eleven,
        PointTransformerV3Config::sonata_with_decoder(),
        PointTransformerV3Config::concerto_large(),
    ] {
        let mut found = shapes(&config);
        assert_eq!(ModelConfig::recognize(&found), Some(ModelConfig::new(config.clone())));
        // As it is trained: with a token, and with a classifier behind it.
        found.insert("embedding.mask_token".to_owned(), vec![1, config.enc_channels[0]]);
        found.insert("seg_head.weight".to_owned(), vec![20, config.out_channels()]);
        let trained = PointTransformerV3Config { mask_token: true, ..config };
        let trained = ModelConfig::new(trained).with_classes(20);
        assert_eq!(ModelConfig::recognize(&found), Some(trained));
    }
}
