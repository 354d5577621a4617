//! Checkpoints of all origins give every value of the network.

use super::network::*;
use candle_core::DType;
use scenesplat_models::convert::{Branch, ConvLayout};
use scenesplat_models::weights::{
    PickleValue, SourceOptions, TensorEntry, WeightFile, WeightSource, read_single_tensor,
    summarize, unit,
};
use scenesplat_models::{LoadPolicy, LoadReport, ParamStore};

fn report(config: &scenesplat_models::ModelConfig, source: WeightSource) -> LoadReport {
    let store = ParamStore::frozen(source);
    network(config, &store);
    store.report()
}

fn ignored(names: &[(&str, &str)]) -> Vec<(String, String)> {
    names.iter().map(|(n, o)| ((*n).to_owned(), (*o).to_owned())).collect()
}

#[test]
fn checkpoint_of_a_trainer() {
    let source = source("trainer.pth", SourceOptions::default());
    assert_hashed(&config(), &source, SEED);
    let report = report(&config(), source);
    report.check(LoadPolicy::Strict, "trainer.pth").unwrap();
    assert!(report.is_complete());
    assert_eq!(report.matched.len(), 81);
    assert_eq!(report.parameters, config().num_values());
    let rest = ["epoch", "optimizer", "scheduler", "scaler", "best_metric_value"];
    assert_eq!(report.ignored, ignored(&rest.map(|n| (n, "not a tensor"))));
}

#[test]
fn summary_of_a_checkpoint_of_a_trainer() {
    let top = summarize(&data("trainer.pth")).unwrap();
    assert_eq!(top["epoch"], PickleValue::Scalar("3".to_owned()));
    assert_eq!(top["scaler"], PickleValue::Scalar("none".to_owned()));
    assert_eq!(top["best_metric_value"], PickleValue::Scalar("0.5".to_owned()));
    assert_eq!(top["state_dict"], PickleValue::Dict { entries: 81, tensors: 81 });
    assert_eq!(top["optimizer"], PickleValue::Dict { entries: 2, tensors: 0 });
    assert_eq!(top.len(), 6);
    let bare = summarize(&data("text_f16.pt")).unwrap();
    let entry = TensorEntry { shape: vec![5, 8], dtype: "f16".to_owned() };
    assert_eq!(bare[""], PickleValue::Tensor(entry));
}

#[test]
fn plain_state_dict_with_a_head() {
    let source = source("plain.pth", SourceOptions::default());
    assert_hashed(&with_head(), &source, SEED);
    let with = report(&with_head(), source.clone());
    with.check(LoadPolicy::Strict, "plain.pth").unwrap();
    assert!(with.ignored.is_empty());
    // The language network has no use for the classifier.
    let without = report(&config(), source);
    assert_eq!(without.unexpected, ["seg_head.bias", "seg_head.weight"]);
    let refusal = without.check(LoadPolicy::Strict, "plain.pth").unwrap_err().to_string();
    assert!(refusal.contains("plain.pth") && refusal.contains("seg_head.weight"), "{refusal}");
    without.check(LoadPolicy::AllowUnexpected, "plain.pth").unwrap();
}

#[test]
fn self_supervised_pair() {
    let half =
        |branch| source("self_supervised.pth", SourceOptions { branch, ..Default::default() });
    let (teacher, student) = (half(Branch::Teacher), half(Branch::Student));
    assert_hashed(&config(), &teacher, SEED);
    assert_hashed(&config(), &student, STUDENT_SEED);
    let of = |s: &WeightSource| features(&*network(&config(), &ParamStore::frozen(s.clone())));
    assert_ne!(bits(&of(&teacher)), bits(&of(&student)));
    for (source, other) in [(teacher, "backbone_student."), (student, "backbone_teacher.")] {
        let report = report(&config(), source);
        report.check(LoadPolicy::Strict, "self_supervised.pth").unwrap();
        let of_other = report.ignored.iter().filter(|(n, _)| n.starts_with(other)).count();
        assert_eq!(of_other, 81);
        let heads = report.ignored.iter().filter(|(_, o)| o.contains("head")).count();
        assert_eq!(heads, 4);
        assert_eq!(report.ignored.len(), 81 + 4 + 2);
    }
}

#[test]
fn the_missing_half_of_a_pair_is_named() {
    let file = WeightFile::open(&data("self_supervised.pth")).unwrap();
    let student = file.entries().keys().filter(|n| n.starts_with("backbone_student."));
    let tensors: std::collections::HashMap<String, _> =
        student.map(|n| (n.clone(), file.read(n).unwrap())).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("student.safetensors");
    candle_core::safetensors::save(&tensors, &path).unwrap();
    let source =
        WeightSource::files(vec![WeightFile::open(&path).unwrap()], SourceOptions::default());
    let refusal = report(&config(), source.unwrap()).check(LoadPolicy::Partial, "student");
    let refusal = refusal.unwrap_err().to_string();
    assert!(refusal.contains("choose that branch"), "{refusal}");
}

#[test]
fn half_precision_state_dict() {
    let file = source("half.pth", SourceOptions::default());
    report(&config(), file.clone()).check(LoadPolicy::Strict, "half.pth").unwrap();
    let (store, _) = built(&config(), file);
    let (expected, _) = built(&config(), WeightSource::hashed(SEED, ""));
    let got = store.parameters().into_iter().chain(store.buffers());
    let want = expected.parameters().into_iter().chain(expected.buffers());
    for ((name, got), (_, want)) in got.zip(want) {
        if got.dtype() == DType::F32 {
            let rounded = want.to_dtype(DType::F16).unwrap().to_dtype(DType::F32).unwrap();
            assert_eq!(bits(&got), bits(&rounded), "{name}");
        }
    }
}

#[test]
fn convolutions_of_spconv_1() {
    let turned = SourceOptions { conv_layout: ConvLayout::KernelInOut, ..Default::default() };
    assert_hashed(&config(), &source("spconv1.pth", turned), SEED);
    report(&config(), source("spconv1.pth", turned)).check(LoadPolicy::Strict, "").unwrap();
    // In the wrong layout, either way, the report shows both shapes and the advice is right.
    for (file, options, stem) in [
        ("spconv1.pth", SourceOptions::default(), vec![5, 5, 5, 2, 4]),
        ("half.pth", turned, vec![2, 4, 5, 5, 5]),
    ] {
        let report = report(&config(), source(file, options));
        let shown: Vec<&str> = report.misshaped.iter().map(|(n, _, _)| n.as_str()).collect();
        assert_eq!(
            shown,
            [
                "dec.dec0.block0.cpe.0.weight",
                "embedding.stem.conv.weight",
                "enc.enc0.block0.cpe.0.weight",
                "enc.enc1.block0.cpe.0.weight"
            ]
        );
        assert_eq!(report.misshaped[1].1, [4, 5, 5, 5, 2]);
        assert_eq!(report.misshaped[1].2, stem);
        assert_eq!(report.matched.len(), 77);
        let refusal = report.check(LoadPolicy::AllowUnexpected, file).unwrap_err().to_string();
        assert!(refusal.contains("spconv") && refusal.contains(&format!("{stem:?}")), "{refusal}");
    }
}

#[test]
fn bare_tensors() {
    let expected = unit("text", 40, SEED);
    let read = |file: &str| {
        let t = read_single_tensor(&data(file)).unwrap();
        assert_eq!((t.dims(), t.dtype()), (&[5, 8][..], DType::F32), "{file}");
        t.flatten_all().unwrap().to_vec1::<f32>().unwrap()
    };
    assert_eq!(read("text_f32.pt"), expected);
    assert_eq!(read("text_transposed.pt"), expected);
    let rounded = |dtype| {
        let t = candle_core::Tensor::new(expected.as_slice(), &candle_core::Device::Cpu).unwrap();
        let t = t.to_dtype(dtype).unwrap().to_dtype(DType::F32).unwrap();
        t.to_vec1::<f32>().unwrap()
    };
    assert_eq!(read("text_f16.pt"), rounded(DType::F16));
    assert_eq!(read("text_bf16.pt"), rounded(DType::BF16));
    let several = read_single_tensor(&data("half.pth")).unwrap_err().to_string();
    assert!(several.contains("81 tensors, expected one"), "{several}");
}
