//! Networks and files that do not fit: the report is exact, the policy decides.

use super::network::*;
use candle_core::{Device, Tensor};
use scenesplat_models::weights::{SourceOptions, WeightFile, WeightSource, hashed_parameter};
use scenesplat_models::{LoadPolicy, ParamStore};
use std::collections::HashMap;

const DROPPED: &str = "enc.enc0.block0.attn.qkv.bias";
const RENAMED: &str = "dec.dec0.up.proj.1.running_var";
const RESHAPED: &str = "enc.enc1.down.proj.weight";

/// The network's state without one entry, with one under another name, with one of another shape.
fn damaged() -> (tempfile::TempDir, WeightSource) {
    let store = ParamStore::frozen(WeightSource::hashed(SEED, ""));
    network(&config(), &store);
    let mut tensors: HashMap<String, Tensor> = store
        .shapes()
        .into_iter()
        .map(|(name, shape)| {
            let value = hashed_parameter(&name, &shape, SEED).unwrap();
            (format!("module.backbone.{name}"), value)
        })
        .collect();
    let key = |name: &str| format!("module.backbone.{name}");
    tensors.remove(&key(DROPPED)).unwrap();
    let moved = tensors.remove(&key(RENAMED)).unwrap();
    tensors.insert(key("dec.dec0.up.proj.1.variance"), moved);
    let other = Tensor::zeros((6, 5), candle_core::DType::F32, &Device::Cpu).unwrap();
    tensors.insert(key(RESHAPED), other).unwrap();
    tensors
        .insert("module.mae_head.0.bias".to_owned(), Tensor::new(&[1f32], &Device::Cpu).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.safetensors");
    candle_core::safetensors::save(&tensors, &path).unwrap();
    let file = WeightFile::open(&path).unwrap();
    (folder, WeightSource::files(vec![file], SourceOptions::default()).unwrap())
}

#[test]
fn the_report_lists_every_difference() {
    let (_folder, source) = damaged();
    let (store, _) = built(&config(), source);
    let report = store.report();
    assert_eq!(report.missing, [RENAMED, DROPPED]);
    assert_eq!(report.unexpected, ["dec.dec0.up.proj.1.variance"]);
    assert_eq!(report.misshaped, [(RESHAPED.to_owned(), vec![6, 4], vec![6, 5])]);
    let head = ("module.mae_head.0.bias", "self-supervised reconstruction head");
    assert_eq!(report.ignored, [(head.0.to_owned(), head.1.to_owned())]);
    assert_eq!(report.matched.len(), 81 - 3);
    assert!(report.matched.is_sorted() && !report.is_complete());
    assert_eq!(report.parameters, config().num_values());

    for policy in [LoadPolicy::Strict, LoadPolicy::AllowUnexpected] {
        let message = report.check(policy, "some/file").unwrap_err().to_string();
        for part in ["some/file", "78 of 81", DROPPED, RENAMED, RESHAPED, "[6, 4]", "[6, 5]"] {
            assert!(message.contains(part), "{part}: {message}");
        }
    }
    report.check(LoadPolicy::Partial, "some/file").unwrap();
}

#[test]
fn a_partial_load_keeps_the_first_values_of_the_rest() {
    let (_folder, source) = damaged();
    let store = ParamStore::trainable_from(source, 11);
    network(&config(), &store);
    let got = values(&store);
    let hashed = values(&built(&config(), WeightSource::hashed(SEED, "")).0);
    let fresh = ParamStore::trainable(11);
    network(&config(), &fresh);
    let fresh = values(&fresh);
    for (name, got) in &got {
        let lost = [DROPPED, RENAMED, RESHAPED].contains(&name.as_str());
        assert_eq!(got, if lost { &fresh[name] } else { &hashed[name] }, "{name}");
    }
}

#[test]
fn unexpected_entries_alone_are_a_matter_of_policy() {
    let mut shallow = config();
    shape(&mut shallow).dec_depths = vec![0];
    let (store, _) = built(&shallow, source("half.pth", SourceOptions::default()));
    let report = store.report();
    assert!(report.missing.is_empty() && report.misshaped.is_empty());
    assert_eq!(report.unexpected.len(), 18);
    assert!(report.unexpected.iter().all(|n| n.starts_with("dec.dec0.block0.")));
    let message = report.check(LoadPolicy::Strict, "half.pth").unwrap_err().to_string();
    assert!(message.contains("18 unexpected") && message.contains("… 13 more"), "{message}");
    report.check(LoadPolicy::AllowUnexpected, "half.pth").unwrap();
}

#[test]
fn nothing_in_common_is_refused_even_in_part() {
    let (store, _) = built(&config(), source("protocol5.pth", SourceOptions::default()));
    let report = store.report();
    assert_eq!((report.matched.len(), report.missing.len()), (0, 81));
    let message = report.check(LoadPolicy::Partial, "other.pth").unwrap_err().to_string();
    assert!(message.contains("0 of 81"), "{message}");
}

#[test]
fn an_entry_of_an_unreadable_type_is_named() {
    // Complex numbers where a bias should be.
    let store = ParamStore::frozen(source("odd_values.pth", SourceOptions::default()));
    let vb = store.builder();
    let message = vb.get_with_hints(1, "complex", candle_nn::Init::Const(0.0)).unwrap_err();
    let message = message.to_string();
    assert!(message.contains("complex") && message.contains("not supported"), "{message}");
    // Integers are values like others.
    let t = vb.get_with_hints(2, "i16", candle_nn::Init::Const(0.0)).unwrap();
    assert_eq!(t.to_vec1::<f32>().unwrap(), [-3.0, 4.0]);
}
