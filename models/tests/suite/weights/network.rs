//! The network the files fit, and what its values are.

pub use crate::support::bits;
use crate::support::{Scene, batch, eval};
use candle_core::Tensor;
use scenesplat_models::weights::{SourceOptions, WeightFile, WeightSource};
use scenesplat_models::{
    Backbone, BackboneConfig, ModelConfig, ParamStore, PointCloud, PointTransformerV3Config,
};
use std::collections::BTreeMap;
use std::path::PathBuf;

pub const SEED: u64 = 7;
pub const STUDENT_SEED: u64 = 8;

pub fn data(file: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(file)
}

pub fn config() -> ModelConfig {
    let text = std::fs::read_to_string(data("hub/config.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

pub fn with_head() -> ModelConfig {
    config().with_classes(3)
}

/// The shape of the backbone.
pub fn shape(config: &mut ModelConfig) -> &mut PointTransformerV3Config {
    match &mut config.backbone {
        BackboneConfig::PointTransformerV3(shape) => shape,
        #[allow(unreachable_patterns)]
        other => panic!("{other:?}"),
    }
}

/// 60 voxels of one scene.
pub fn points() -> PointCloud {
    let cells: Vec<[i32; 3]> = (0..60).map(|i| [i % 5, i / 5 % 4, i / 20]).collect();
    batch(&[&Scene::new(cells, 2, "feat", 1)])
}

pub fn network(config: &ModelConfig, store: &ParamStore) -> Box<dyn Backbone> {
    config.build(store.builder()).unwrap()
}

pub fn features(network: &dyn Backbone) -> Tensor {
    eval(network, &points())
}

pub fn source(file: &str, options: SourceOptions) -> WeightSource {
    WeightSource::files(vec![WeightFile::open(&data(file)).unwrap()], options).unwrap()
}

/// All values of a store, as bits; integers as they are.
pub fn values(store: &ParamStore) -> BTreeMap<String, Vec<u64>> {
    let all = store.parameters().into_iter().chain(store.buffers());
    all.map(|(name, var)| {
        let t = var.as_tensor().flatten_all().unwrap();
        let values = if t.dtype().is_int() {
            t.to_vec1::<i64>().unwrap().into_iter().map(|v| v as u64).collect()
        } else {
            bits(&t).into_iter().map(u64::from).collect()
        };
        (name, values)
    })
    .collect()
}

/// A trainable store that a network was built from, and the network.
pub fn built(config: &ModelConfig, source: WeightSource) -> (ParamStore, Box<dyn Backbone>) {
    let store = ParamStore::trainable_from(source, 0);
    let network = network(config, &store);
    (store, network)
}

pub fn assert_same(got: &BTreeMap<String, Vec<u64>>, expected: &BTreeMap<String, Vec<u64>>) {
    assert_eq!(got.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
    for (name, values) in got {
        assert!(*values == expected[name], "{name} differs");
    }
}

/// Checks that a source gives what the hash gives, in values and in features, packed or not.
pub fn assert_hashed(config: &ModelConfig, source: &WeightSource, seed: u64) {
    let hashed = WeightSource::hashed(seed, "");
    let (store, from_file) = built(config, source.clone());
    let (expected, from_hash) = built(config, hashed.clone());
    assert_same(&values(&store), &values(&expected));
    assert_eq!(bits(&features(&*from_file)), bits(&features(&*from_hash)));
    let frozen = |s: &WeightSource| network(config, &ParamStore::frozen(s.clone()));
    assert_eq!(bits(&features(&*frozen(source))), bits(&features(&*frozen(&hashed))));
}
