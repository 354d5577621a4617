//! Group f: whole small networks: intermediate features, all parameter gradients, batch statistics.

use crate::support::devices::here;
use crate::support::{Tensors, flat, noise_like, rng};
use candle_core::backprop::GradStore;
use candle_core::{Result, Tensor, Var};
use scenesplat_kernels::serialization::{Curve, argsort, codes, invert};
use scenesplat_models::point_transformer_v3::{BatchRule, PoolingReduce};
use scenesplat_models::weights::WeightSource;
use scenesplat_models::{
    Forward, Mode, Orders, ParamStore, PointCloud, PointTransformerV3, PointTransformerV3Config,
};
use scenesplat_test_support::Golden;

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
        pooling: match g.config()["pooling_reduce"] == "max" {
            true => PoolingReduce::Max,
            false => PoolingReduce::Mean,
        },
        mask_token: g.config()["do_mask"] == true,
        batch_rule: if flash { BatchRule::SharedDepth } else { BatchRule::SharedDepthAndPatch },
        ..PointTransformerV3Config::language()
    }
}

/// A function that keeps what a network shows.
pub fn observe(seen: &mut Vec<(String, Tensor)>) -> impl FnMut(&str, &Tensor) -> Result<()> + '_ {
    move |name, t| {
        seen.push((name.to_owned(), t.detach()));
        Ok(())
    }
}

/// Rows that a network showed, those of the finest scale in the order of the input: inside, scenes are in Morton order.
pub fn outside(module: &str, t: &Tensor, points: &PointCloud) -> Tensor {
    if module != "embedding" && module != "enc.enc0" && !module.starts_with("dec.dec0") {
        return t.clone();
    }
    let mut order = Vec::new();
    for s in points.offsets.windows(2) {
        let local = argsort(&codes(Curve::Z, &points.grid_coord[s[0]..s[1]], 21));
        order.extend(local.into_iter().map(|i| i + s[0] as u32));
    }
    let back = Tensor::from_vec(invert(&order), points.grid_coord.len(), &here()).unwrap();
    t.index_select(&back, 0).unwrap()
}

/// A network with its numbers of one mode, and the inputs of both.
pub struct Case {
    pub config: PointTransformerV3Config,
    pub seed: u64,
    pub inputs: Golden,
    pub numbers: Golden,
    prefix: &'static str,
}

impl Case {
    pub fn open(name: &str, mode: Mode) -> Option<Self> {
        let inputs = Golden::network(&format!("{name}.eval"))?;
        let prefix = if mode == Mode::Eval { "eval" } else { "train" };
        let numbers = Golden::network(&format!("{name}.{prefix}")).unwrap();
        let (config, seed) = (config(&inputs), inputs.number("seed") as u64);
        Some(Self { config, seed, inputs, numbers, prefix })
    }

    fn name(&self, what: &str) -> String {
        format!("{}.{what}", self.prefix)
    }

    pub fn orders(&self) -> Orders {
        if !self.inputs.has("in.order_perms") {
            return Orders::Listed;
        }
        let rows: Vec<usize> = self.inputs.ints("in.order_perms");
        Orders::Given(rows.chunks(4).map(<[usize]>::to_vec).collect())
    }

    /// Compares if there are numbers; whether there are.
    fn compare(&self, name: &str, got: &Tensor) -> bool {
        let there = self.numbers.has(name);
        if there {
            self.numbers.compare_tensor(name, got);
        }
        there
    }

    fn compare_seen(&self, seen: &[(String, Tensor)], points: &PointCloud) {
        let compared = seen.iter().filter(|(module, t)| {
            let key = match module.strip_suffix(".skip") {
                Some(up) => format!("mid.{up}.sparse_feat"),
                None => format!("mid.{module}.feat"),
            };
            self.compare(&key, &outside(module, t, points))
        });
        let stored = self.numbers.names("mid.").iter().filter(|n| n.ends_with("feat")).count();
        assert_eq!(compared.count(), stored, "{}: intermediates", self.numbers.file());
    }

    /// The loss ⟨decoder, R⟩ (and ⟨encoder, R_enc⟩ with a mask token) by row.
    fn loss(&self, out: &Tensor, encoder: &Tensor) -> Tensor {
        let mut terms = vec![(out, "R")];
        terms.extend(self.config.mask_token.then_some((encoder, "R_enc")));
        let n = out.dim(0).unwrap() as f64;
        let (mut loss, mut exact) = (None, 0.0);
        for (t, name) in terms {
            let noise = noise_like(t, name, self.seed);
            // Summed in f64, so that the network is compared and not the order of a long f32 sum.
            let pairs = flat(t).into_iter().zip(flat(&noise));
            exact += pairs.map(|(v, r)| f64::from(v) * f64::from(r)).sum::<f64>();
            let sum = (t * noise).unwrap().sum_all().unwrap();
            loss = Some(loss.map_or_else(|| sum.clone(), |loss: Tensor| (loss + &sum).unwrap()));
        }
        self.numbers.compare(&self.name("loss"), &[(exact / n) as f32]);
        (loss.unwrap() / n).unwrap()
    }

    fn compare_gradients(&self, grads: &GradStore, store: &ParamStore, feat: &Var) {
        let norm = |t: &Tensor| t.sqr().unwrap().sum_all().unwrap().sqrt().unwrap();
        let parameters = store.parameters();
        let vars = parameters.iter().map(|(n, v)| (n.as_str(), v)).chain([("in.feat", feat)]);
        let mut compared = 0;
        for (parameter, var) in vars {
            let grad = grads.get(var).unwrap_or_else(|| panic!("{parameter}: no gradient"));
            compared += usize::from(self.compare(&self.name(&format!("grad.{parameter}")), grad));
            let short = self.name(&format!("gradnorm.{parameter}"));
            if self.numbers.has(&short) {
                self.numbers.compare(&short, &flat(&norm(grad)));
                compared += 1;
            }
        }
        let stored = |what: &str| self.numbers.names(&self.name(what)).len();
        let stored = stored("grad.") + stored("gradnorm.");
        assert_eq!(compared, stored, "{}: gradients", self.numbers.file());
    }
}

pub fn run(name: &str, mode: Mode) {
    let Some(case) = Case::open(name, mode) else { return };
    let (config, g) = (&case.config, &case.numbers);
    let source = WeightSource::hashed(case.seed, "");
    let store = ParamStore::trainable_from(source.clone(), 0).on(&here());
    let network = PointTransformerV3::new(config, store.builder()).unwrap();
    if name == "f_tiny" {
        // The stored state dict and the hash formula must say the same.
        let stored = Golden::network("f_tiny.weights").unwrap();
        assert_eq!(stored.names("").len(), store.shapes().len());
        for (name, var) in store.parameters() {
            assert_eq!(flat(&var), stored.f32s(&name), "{name}");
        }
    }
    let points = case.inputs.points();
    let mask = case.inputs.mask();
    let feat = Var::from_tensor(&points.feat).unwrap();
    let tracked = PointCloud { feat: feat.as_tensor().clone(), ..points.clone() };
    let (mut seen, mut rng) = (Vec::new(), rng(0));
    let mut observer = observe(&mut seen);
    let orders = case.orders();
    let mut cx =
        Forward { mode, orders, observer: Some(&mut observer), ..Forward::train(&mut rng) };
    let both = network.forward_both(&tracked, mask.as_deref(), &mut cx).unwrap();
    drop(observer);
    let out = both.decoder.unwrap();
    case.compare(&case.name("out.enc_feat"), &both.encoder);
    case.compare(&case.name("out.feat"), &out);
    case.compare_seen(&seen, &points);
    let grads = case.loss(&out, &both.encoder).backward().unwrap();
    case.compare_gradients(&grads, &store, &feat);
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
        let store = ParamStore::frozen(source).on(&here());
        let packed = PointTransformerV3::new(config, store.builder()).unwrap();
        let mut cx = Forward { mode, orders: case.orders(), ..Forward::eval(&mut rng) };
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
