//! What a store writes, it reads.

use super::network::*;
use crate::support::rng;
use scenesplat_models::weights::{SourceOptions, WeightFile, WeightSource};
use scenesplat_models::{Forward, LoadPolicy, ParamStore};

#[test]
fn save_and_load_gives_identical_tensors() {
    let store = ParamStore::trainable(3);
    let net = network(&config(), &store);
    // A training pass moves the batch statistics away from their first values.
    net.forward(&points(), &mut Forward::train(&mut rng(0))).unwrap();
    let temp = tempfile::tempdir().unwrap();
    let path = temp.path().join("model.safetensors");
    store.save(&path).unwrap();

    let file = WeightFile::open(&path).unwrap();
    let shapes = store.shapes();
    assert_eq!(file.entries().keys().collect::<Vec<_>>(), shapes.keys().collect::<Vec<_>>());
    for (name, buffer) in store.buffers() {
        let read = file.read(&name).unwrap();
        if name.ends_with("num_batches_tracked") {
            assert_eq!(read.to_scalar::<i64>().unwrap(), 1, "{name}");
        } else {
            assert_eq!(bits(&read), bits(&buffer), "{name}");
        }
        let first = if name.ends_with("running_var") { 1f32 } else { 0.0 };
        if !name.ends_with("num_batches_tracked") {
            assert!(bits(&read).iter().any(|b| *b != first.to_bits()), "{name} did not move");
        }
    }

    let source = WeightSource::files(vec![file], SourceOptions::default()).unwrap();
    let (again, reloaded) = built(&config(), source);
    again.report().check(LoadPolicy::Strict, "model.safetensors").unwrap();
    assert_same(&values(&again), &values(&store));
    assert_eq!(bits(&features(&*reloaded)), bits(&features(&*net)));
    // Saving once more gives the same file, and replaces the old one.
    let first = std::fs::read(&path).unwrap();
    again.save(&path).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), first);
    assert_eq!(std::fs::read_dir(temp.path()).unwrap().count(), 1, "no partial file stays");
}

#[test]
fn what_cannot_be_saved() {
    let temp = tempfile::tempdir().unwrap();
    let path = temp.path().join("model.safetensors");
    let frozen = ParamStore::frozen(WeightSource::hashed(SEED, ""));
    network(&config(), &frozen);
    assert!(frozen.save(&path).unwrap_err().to_string().contains("frozen"));
    assert!(!path.exists());
    let store = ParamStore::trainable(0);
    network(&config(), &store);
    let message =
        store.save(&temp.path().join("absent/model.safetensors")).unwrap_err().to_string();
    assert!(message.contains("absent"), "{message}");
    // A folder is in the way: the error leaves nothing behind.
    std::fs::create_dir_all(path.join("inside")).unwrap();
    assert!(store.save(&path).is_err());
    assert_eq!(std::fs::read_dir(temp.path()).unwrap().count(), 1);
}
