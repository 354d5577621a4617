//! What the tests share: scenes, networks of hashed weights, reference numbers as tensors, other devices.

pub mod devices;

use candle_core::{DType, Device, Result, Tensor};
use candle_nn::VarBuilder;
use devices::here;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat_models::weights::{WeightSource, unit};
use scenesplat_models::{Backbone, Forward, ParamStore, PointCloud};
use scenesplat_test_support::Golden;
use std::collections::BTreeMap;

/// Seed of the hashed weights.
pub const SEED: u64 = 5;

/// Voxels with rows of features.
#[derive(Clone)]
pub struct Scene {
    pub cells: Vec<[i32; 3]>,
    pub feat: Vec<f32>,
    pub channels: usize,
}

impl Scene {
    /// With features that depend on a name and a seed.
    pub fn new(cells: Vec<[i32; 3]>, channels: usize, name: &str, seed: u64) -> Self {
        let feat = unit(name, cells.len() * channels, seed);
        Self { cells, feat, channels }
    }

    /// A floor and two walls with bumps every `bump` voxels.
    pub fn room(side: i32, bump: i32, channels: usize, name: &str, seed: u64) -> Self {
        let mut cells = Vec::new();
        for a in 0..side {
            for b in 0..side {
                cells.push([a, b, (a / bump) % 2]);
                if b > 1 {
                    cells.extend([[a, 0, b], [0, a + 1, b]]);
                }
            }
        }
        Self::new(cells, channels, name, seed)
    }

    /// Its rows in another order.
    pub fn in_order(&self, order: &[usize]) -> Self {
        let rows = self.feat.chunks_exact(self.channels);
        let rows: Vec<&[f32]> = rows.collect();
        Self {
            cells: order.iter().map(|&i| self.cells[i]).collect(),
            feat: order.iter().flat_map(|&i| rows[i]).copied().collect(),
            channels: self.channels,
        }
    }
}

pub fn batch(scenes: &[&Scene]) -> PointCloud {
    let mut offsets = vec![0];
    let (mut cells, mut feat) = (Vec::new(), Vec::new());
    for scene in scenes {
        cells.extend_from_slice(&scene.cells);
        feat.extend_from_slice(&scene.feat);
        offsets.push(cells.len());
    }
    let feat = Tensor::from_vec(feat, (cells.len(), scenes[0].channels), &here()).unwrap();
    PointCloud::new(cells, feat, offsets).unwrap()
}

pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A packed network of hashed weights.
pub fn frozen<B>(build: impl FnOnce(VarBuilder<'_>) -> Result<B>) -> B {
    build(ParamStore::frozen(WeightSource::hashed(SEED, "")).on(&here()).builder()).unwrap()
}

/// A network of hashed weights that has gradients.
pub fn trainable<B>(build: impl FnOnce(VarBuilder<'_>) -> Result<B>) -> (ParamStore, B) {
    let store = ParamStore::trainable_from(WeightSource::hashed(SEED, ""), 0).on(&here());
    let network = build(store.builder()).unwrap();
    (store, network)
}

pub fn try_eval(network: &dyn Backbone, points: &PointCloud) -> Result<Tensor> {
    network.forward(points, &mut Forward::eval(&mut rng(0)))
}

/// What a network makes of points, deterministic.
pub fn eval(network: &dyn Backbone, points: &PointCloud) -> Tensor {
    try_eval(network, points).unwrap()
}

/// Why a network refuses points.
pub fn refusal(network: &dyn Backbone, points: &PointCloud) -> String {
    try_eval(network, points).unwrap_err().to_string()
}

/// What a network shows on its way, by name.
pub fn observed(network: &dyn Backbone, points: &PointCloud) -> Vec<(String, Tensor)> {
    let mut seen = Vec::new();
    let mut observer = |name: &str, t: &Tensor| {
        seen.push((name.to_owned(), t.detach()));
        Ok(())
    };
    let mut rng = rng(0);
    let mut cx = Forward { observer: Some(&mut observer), ..Forward::eval(&mut rng) };
    network.forward(points, &mut cx).unwrap();
    seen
}

pub fn flat(t: &Tensor) -> Vec<f32> {
    t.to_dtype(DType::F32).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

pub fn bits(t: &Tensor) -> Vec<u32> {
    flat(t).into_iter().map(f32::to_bits).collect()
}

pub fn rows(t: &Tensor) -> Vec<Vec<f32>> {
    t.to_vec2().unwrap()
}

pub fn is_finite(t: &Tensor) -> bool {
    flat(t).iter().all(|v| v.is_finite())
}

/// Noise of a tensor's shape.
pub fn noise_like(t: &Tensor, name: &str, seed: u64) -> Tensor {
    Tensor::from_vec(unit(name, t.elem_count(), seed), t.dims(), t.device()).unwrap()
}

/// Gradients of ⟨output, noise⟩ to all parameters, by name.
pub fn gradients(store: &ParamStore, out: &Tensor, seed: u64) -> BTreeMap<String, Vec<f32>> {
    let loss = (out * noise_like(out, "R", seed)).unwrap().sum_all().unwrap();
    let grads = loss.backward().unwrap();
    let named = store.parameters().into_iter().map(|(name, var)| {
        let grad = grads.get(&var).unwrap_or_else(|| panic!("{name}: no gradient"));
        (name, flat(grad))
    });
    named.collect()
}

pub fn with_threads<R: Send>(n: usize, f: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(f)
}

/// Reference numbers as tensors.
pub trait Tensors {
    fn tensor(&self, name: &str) -> Tensor;
    fn cells(&self, name: &str) -> Vec<[i32; 3]>;
    /// `[0, offset…]` from cumulative counts.
    fn offsets(&self, name: &str) -> Vec<usize>;
    /// Which rows are hidden, if any are.
    fn mask(&self) -> Option<Vec<bool>>;
    /// All tensors, as a weight source needs them.
    fn weights(&self) -> BTreeMap<String, Tensor>;
    fn points(&self) -> PointCloud;
    fn compare_tensor(&self, name: &str, got: &Tensor);
    fn compare_ints<T: Copy + Into<i64>>(&self, name: &str, got: &[T]);
}

impl Tensors for Golden {
    fn tensor(&self, name: &str) -> Tensor {
        Tensor::from_vec(self.f32s(name), self.shape(name), &here()).unwrap()
    }
    fn cells(&self, name: &str) -> Vec<[i32; 3]> {
        self.ints(name).as_chunks().0.to_vec()
    }
    fn offsets(&self, name: &str) -> Vec<usize> {
        [vec![0], self.ints(name)].concat()
    }
    fn mask(&self) -> Option<Vec<bool>> {
        let hidden = |v: &i64| *v != 0;
        self.has("in.mask").then(|| self.ints("in.mask").iter().map(hidden).collect())
    }
    fn weights(&self) -> BTreeMap<String, Tensor> {
        let value = |name: &str| match self.is_integer(name) {
            true => Tensor::from_vec(self.ints::<i64>(name), self.shape(name), &here()).unwrap(),
            false => self.tensor(name),
        };
        self.names("").into_iter().map(|name| (name.clone(), value(&name))).collect()
    }
    fn points(&self) -> PointCloud {
        let (cells, feat) = (self.cells("in.grid_coord"), self.tensor("in.feat"));
        PointCloud::new(cells, feat, self.offsets("in.offset")).unwrap()
    }
    fn compare_tensor(&self, name: &str, got: &Tensor) {
        assert_eq!(got.dims(), self.shape(name), "{}: {name}: shape", self.file());
        self.compare(name, &flat(got));
    }
    fn compare_ints<T: Copy + Into<i64>>(&self, name: &str, got: &[T]) {
        let got: Vec<i64> = got.iter().map(|v| (*v).into()).collect();
        assert_eq!(got, self.ints::<i64>(name), "{}: {name}", self.file());
    }
}

/// A tensor on the CPU.
pub fn on_cpu(values: Vec<f32>, shape: &[usize]) -> Tensor {
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}
