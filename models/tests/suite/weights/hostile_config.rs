//! Configurations whose sizes are lies: an error each, without memory for what they claim.

use super::allocations::largest;
use super::network::*;
use scenesplat_models::weights::{SourceOptions, WeightSource, resolve};
use scenesplat_models::{LoadPolicy, MAX_VALUES, ModelConfig, ParamStore};
use serde_json::{Value, json};

/// What no network has; 2^20 and more, so that nothing here is a network that is merely large.
const SIZES: [u64; 9] =
    [0, 1_000_000, 1 << 20, 1 << 31, 1 << 32, 1 << 62, i64::MAX as u64, 1 << 63, u64::MAX];

/// The fields that hold sizes; all but `order`, flags, names and rates.
fn size_fields(config: &Value) -> Vec<String> {
    let is_size = |v: &Value| v.is_u64() || v[0].is_u64();
    let fields = config.as_object().unwrap().iter().filter(|(_, v)| is_size(v));
    fields
        .map(|(name, _)| name.clone())
        .chain(["projection", "num_classes"].map(String::from))
        .collect()
}

/// Every way to put `size` into a field: as it is, or as each entry of the list and as all of them.
fn with_size(config: &Value, field: &str, size: u64) -> Vec<Value> {
    let put = |value: Value| {
        let mut config = config.clone();
        config[field] = value;
        config
    };
    let Some(list) = config[field].as_array() else { return vec![put(json!(size))] };
    let one = |i: usize| {
        let mut list = list.clone();
        list[i] = json!(size);
        put(Value::Array(list))
    };
    let all = put(json!(vec![size; list.len()]));
    (0..list.len()).map(one).chain([all, put(json!(vec![size; 5000]))]).collect()
}

#[test]
fn no_size_is_believed() {
    let folder = data("hub");
    let text = std::fs::read_to_string(folder.join("config.json")).unwrap();
    let good: Value = serde_json::from_str(&text).unwrap();
    let fields = size_fields(&good);
    assert!(fields.len() >= 11, "{fields:?}");
    let mut cases = 0;
    for field in &fields {
        for size in SIZES {
            for config in with_size(&good, field, size) {
                cases += 1;
                let (result, bytes) = largest(|| {
                    let config: ModelConfig = serde_json::from_value(config.clone())?;
                    config.num_values();
                    config.check().map_err(boxed)?;
                    let files = resolve(&folder).map_err(boxed)?.files;
                    let source = WeightSource::files(files, SourceOptions::default());
                    let store = ParamStore::frozen(source.map_err(boxed)?);
                    config.build(store.builder()).map_err(boxed)?;
                    store.report().check(LoadPolicy::Strict, "hub").map_err(boxed)?;
                    Ok::<(), Box<dyn std::error::Error>>(())
                });
                assert!(bytes < 1 << 20, "{field} = {size}: {bytes} bytes at once");
                let depth_of_nothing = field.ends_with("depths") && size == 0;
                let error = match result {
                    Err(error) => error.to_string(),
                    Ok(()) => panic!("{field} = {size} is a network"),
                };
                let named = error.contains(field.as_str()) || error.contains("values");
                assert!(named || depth_of_nothing, "{field} = {size}: {error}");
            }
        }
    }
    assert!(cases > 300, "{cases}");
}

#[allow(clippy::needless_pass_by_value, reason = "for map_err")]
fn boxed(error: candle_core::Error) -> Box<dyn std::error::Error> {
    error.to_string().into()
}

/// Sizes that each are possible, but not together with these weights.
#[test]
fn a_network_far_larger_than_its_weights_is_not_built() {
    let (mut large, mut wide) = (config(), config());
    shape(&mut large).in_channels = 60_000;
    shape(&mut large).enc_channels = vec![32, 6];
    large.check().unwrap();
    let sizes = shape(&mut wide);
    (sizes.enc_channels, sizes.enc_num_head) = (vec![32, 3200], vec![2, 2]);
    (sizes.dec_channels, sizes.dec_num_head) = (vec![3200], vec![2]);
    wide.check().unwrap();
    // What comes before the first impossible entry is made.
    for (config, made) in [(large, 1 << 20), (wide, 1 << 28)] {
        let files = resolve(&data("hub")).unwrap().files;
        let source = WeightSource::files(files, SourceOptions::default()).unwrap();
        let store = ParamStore::frozen(source);
        let (result, bytes) = largest(|| config.build(store.builder()));
        let Err(error) = result else { panic!("it is built") };
        let error = error.to_string();
        assert!(error.contains("weight: the network has ["), "{error}");
        assert!(error.contains("the file [") || error.contains("the file nothing"), "{error}");
        assert!(bytes < made, "{bytes} bytes at once");
    }
}

/// Seeded values are as many as asked for, so their number has a limit of its own.
#[test]
fn seeded_networks_have_a_limit() {
    let store = ParamStore::frozen(WeightSource::hashed(0, ""));
    for shape in [vec![MAX_VALUES + 1], vec![1 << 16, 1 << 16], vec![usize::MAX, 2]] {
        let (result, bytes) = largest(|| {
            store.builder().get_with_hints(shape.clone(), "w", candle_nn::Init::Const(0.0))
        });
        let error = result.unwrap_err().to_string();
        assert!(error.contains("w: ") && error.contains("1073741824"), "{error}");
        assert!(bytes < 1 << 20);
    }
}
