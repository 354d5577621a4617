//! Group f: whole small networks: intermediate features, all parameter gradients, batch statistics.

use crate::support::Golden;
use crate::support_device::device;
use candle_core::{Tensor, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat_kernels::serialization::{Curve, argsort, codes, invert};
use scenesplat_models::point_transformer_v3::{BatchRule, PoolingReduce};
use scenesplat_models::weights::{WeightSource, unit};
use scenesplat_models::{
    Forward, Mode, Orders, ParamStore, PointCloud, PointTransformerV3, PointTransformerV3Config,
};
use std::collections::BTreeMap;

pub fn config(g: &Golden) -> PointTransformerV3Config {
    let flash = g.config()["flash_semantics"].as_bool().unwrap_or(false);
    PointTransformerV3Config {
        in_channels: g.number("in_channels"),
        stride: g.numbers("stride"),
        enc_depths: g.numbers("enc_depths"),
        enc_channels: g.numbers("enc_channels"),
        enc_num_head: g.numbers("enc_num_head"),
        enc_patch_size: g.numbers("enc_patch_size"),
        dec_depths: g.numbers("dec_depths"),
        dec_channels: g.numbers("dec_channels"),
        dec_num_head: g.numbers("dec_num_head"),
        dec_patch_size: g.numbers("dec_patch_size"),
        mlp_ratio: g.number("mlp_ratio"),
        drop_path: 0.0,
        pooling: if g.config()["pooling_reduce"] == "max" {
            PoolingReduce::Max
        } else {
            PoolingReduce::Mean
        },
        mask_token: g.config()["do_mask"] == true,
        batch_rule: if flash { BatchRule::SharedDepth } else { BatchRule::SharedDepthAndPatch },
        ..PointTransformerV3Config::language()
    }
}

/// Position of each input row inside the network, whose rows are in Morton order.
pub fn inside(cells: &[[i32; 3]], offsets: &[usize]) -> Vec<u32> {
    let mut order = Vec::new();
    for s in offsets.windows(2) {
        let local = argsort(&codes(Curve::Z, &cells[s[0]..s[1]], 21));
        order.extend(local.into_iter().map(|i| i + s[0] as u32));
    }
    invert(&order)
}

/// Features seen on the way, those of the finest scale in the order of the input.
pub fn observed(
    seen: BTreeMap<String, Tensor>,
    cells: &[[i32; 3]],
    offsets: &[usize],
) -> BTreeMap<String, Tensor> {
    let back = Tensor::from_vec(inside(cells, offsets), cells.len(), &device()).unwrap();
    seen.into_iter()
        .map(|(name, t)| {
            let finest = name == "embedding" || name == "enc.enc0" || name.starts_with("dec.dec0");
            let t = if finest { t.index_select(&back, 0).unwrap() } else { t };
            (name, t)
        })
        .collect()
}

pub fn run(case: &str, mode: Mode) {
    let Some(inputs) = Golden::open(&format!("{case}.eval.safetensors")) else { return };
    let (prefix, g) = match mode {
        Mode::Eval => ("eval", Golden::open(&format!("{case}.eval.safetensors")).unwrap()),
        Mode::Train => ("train", Golden::open(&format!("{case}.train.safetensors")).unwrap()),
    };
    let config = config(&inputs);
    let seed = inputs.number("seed") as u64;
    let store = ParamStore::trainable_from(WeightSource::hashed(seed, ""), 0).on(&device());
    let network = PointTransformerV3::new(&config, store.builder()).unwrap();
    if case == "f_tiny" {
        // The stored state dict and the hash formula must say the same.
        let stored = Golden::open("f_tiny.weights.safetensors").unwrap();
        assert_eq!(stored.names("").len(), store.shapes().len());
        for (name, var) in store.parameters() {
            let values = var.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            assert_eq!(values, stored.floats(&name), "{name}");
        }
    }
    let cells = inputs.cells("in.grid_coord");
    let offsets = inputs.offsets("in.offset");
    let feat = Var::from_tensor(&inputs.tensor("in.feat")).unwrap();
    let points = PointCloud::new(cells.clone(), feat.as_tensor().clone(), offsets.clone()).unwrap();
    let mask: Option<Vec<bool>> =
        inputs.has("in.mask").then(|| inputs.ints("in.mask").iter().map(|v| *v != 0).collect());
    let orders = if inputs.has("in.order_perms") {
        let rows = inputs.ints("in.order_perms");
        Orders::Given(rows.chunks(4).map(|r| r.iter().map(|v| *v as usize).collect()).collect())
    } else {
        Orders::Listed
    };
    let mut seen = BTreeMap::new();
    let mut observer = |name: &str, t: &Tensor| {
        seen.insert(name.to_owned(), t.detach());
        Ok(())
    };
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let given = orders.clone();
    let mut cx =
        Forward { mode, orders, observer: Some(&mut observer), ..Forward::train(&mut rng) };
    let both = network.forward_both(&points, mask.as_deref(), &mut cx).unwrap();
    let out = both.decoder.unwrap();

    let n = cells.len();
    let name = |what: &str| format!("{prefix}.{what}");
    if g.has(&name("out.enc_feat")) {
        g.compare_tensor(&name("out.enc_feat"), &both.encoder);
    }
    if g.has(&name("out.feat")) {
        g.compare_tensor(&name("out.feat"), &out);
    }
    let mut compared = 0;
    let skip_aware = observed(seen, &cells, &offsets);
    for (module, t) in &skip_aware {
        let key = match module.strip_suffix(".skip") {
            Some(up) => format!("mid.{up}.sparse_feat"),
            None => format!("mid.{module}.feat"),
        };
        if g.has(&key) {
            g.compare_tensor(&key, t);
            compared += 1;
        }
    }
    let stored = g.names("mid.").iter().filter(|n| n.ends_with("feat")).count();
    assert_eq!(compared, stored, "{}: intermediates", g.file);

    let weighted = |t: &Tensor, name: &str| {
        let r = unit(name, t.elem_count(), seed);
        let r = Tensor::from_vec(r, t.dims(), &device()).unwrap();
        (t * r).unwrap().sum_all().unwrap()
    };
    let mut sum = weighted(&out, "R");
    if config.mask_token {
        sum = (sum + weighted(&both.encoder, "R_enc")).unwrap();
    }
    let loss = (sum / n as f64).unwrap();
    // Summed in f64, so that the network is compared and not the order of a long f32 sum.
    let exact = |t: &Tensor, name: &str| -> f64 {
        let values = t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let r = unit(name, values.len(), seed);
        values.iter().zip(&r).map(|(v, r)| f64::from(*v) * f64::from(*r)).sum()
    };
    let mut total = exact(&out, "R");
    if config.mask_token {
        total += exact(&both.encoder, "R_enc");
    }
    g.compare(&name("loss"), &[(total / n as f64) as f32]);
    let grads = loss.backward().unwrap();
    let norm = |t: &Tensor| t.sqr().unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap().sqrt();
    let mut compared = 0;
    let parameters = store.parameters();
    for (parameter, var) in
        parameters.iter().map(|(n, v)| (n.as_str(), v)).chain([("in.feat", &feat)])
    {
        let grad = grads.get(var).unwrap_or_else(|| panic!("{parameter}: no gradient"));
        let (full, short) =
            (name(&format!("grad.{parameter}")), name(&format!("gradnorm.{parameter}")));
        if g.has(&full) {
            g.compare_tensor(&full, grad);
            compared += 1;
        }
        if g.has(&short) {
            g.compare(&short, &[norm(grad)]);
            compared += 1;
        }
    }
    let stored = g.names(&name("grad.")).len() + g.names(&name("gradnorm.")).len();
    assert_eq!(compared, stored, "{}: gradients", g.file);
    for (buffer, var) in store.buffers() {
        let key = format!("train.buf.{buffer}");
        if mode == Mode::Train && g.has(&key) {
            if buffer.ends_with("num_batches_tracked") {
                g.compare_ints(&key, &[var.to_scalar::<i64>().unwrap()]);
            } else {
                g.compare_tensor(&key, var.as_tensor());
            }
        }
    }

    // The packed network must agree too.
    if mode == Mode::Eval {
        let store = ParamStore::frozen(WeightSource::hashed(seed, "")).on(&device());
        let packed = PointTransformerV3::new(&config, store.builder()).unwrap();
        let points = PointCloud::new(cells, inputs.tensor("in.feat"), offsets).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut cx = Forward { mode, orders: given, ..Forward::eval(&mut rng) };
        let out = packed.forward_both(&points, mask.as_deref(), &mut cx).unwrap().decoder.unwrap();
        g.compare_tensor("eval.out.feat", &out);
    }
}

macro_rules! cases {
    ($($test:ident $case:literal)*) => {$(
        mod $test {
            #[test]
            fn eval() { super::run($case, super::Mode::Eval); }
            #[test]
            fn train() { super::run($case, super::Mode::Train); }
        }
    )*};
}

cases! {
    plain "f_tiny"
    batch "f_tiny_batch"
    flash_patches "f_tiny_flash"
    self_supervised "f_tiny_ssl"
    shuffled_orders "f_tiny_shuffle"
}
