//! Names behind a prefix of another program.

use super::network::*;
use candle_core::{Device, Tensor};
use scenesplat_models::convert::Branch;
use scenesplat_models::weights::{SourceOptions, WeightFile, WeightSource};
use scenesplat_models::{ModelConfig, ParamStore};
use std::collections::HashMap;

/// The values of a network, by names that are made of its own.
fn values(seed: u64, name: impl Fn(&str) -> String) -> HashMap<String, Tensor> {
    let store = ParamStore::trainable(seed);
    network(&config(), &store);
    let all = store.parameters().into_iter().chain(store.buffers());
    all.map(|(n, v)| (name(&n), v.as_detached_tensor().copy().unwrap())).collect()
}

fn opened(values: &HashMap<String, Tensor>, branch: Branch) -> candle_core::Result<WeightSource> {
    let file = tempfile::Builder::new().suffix(".safetensors").tempfile().unwrap();
    candle_core::safetensors::save(values, file.path()).unwrap();
    let files = vec![WeightFile::open(file.path()).unwrap()];
    let options = SourceOptions { branch, ..SourceOptions::default() };
    let config: ModelConfig = config();
    WeightSource::files(files, options)?.unwrapped(|shapes| config.fits(shapes))
}

#[test]
fn the_prefix_behind_which_a_network_stands_is_cut_off() {
    let plain = values(3, str::to_owned);
    for (prefix, wrapper) in [
        ("", None),
        ("_orig_mod.", None),
        ("module._orig_mod.backbone.", None),
        ("net.", Some("net.")),
        ("model.backbone.", Some("model.")),
        ("lit.model.net.module.", Some("lit.model.net.")),
    ] {
        let mut wrapped = values(3, |name| format!("{prefix}{name}"));
        // What belongs to the program: of other names, and of a name of the network in another shape.
        let one = Tensor::zeros(1, candle_core::DType::F32, &Device::Cpu).unwrap();
        for other in ["criterion.weight", "other.enc.enc0.block0.attn.qkv.weight"] {
            wrapped.insert(other.to_owned(), one.clone());
        }
        let store = ParamStore::trainable_from(opened(&wrapped, Branch::Teacher).unwrap(), 9);
        network(&config(), &store);
        let report = store.report();
        assert!(report.missing.is_empty() && report.misshaped.is_empty(), "{prefix}: {report}");
        assert_eq!(report.wrapper.as_deref(), wrapper, "{prefix}");
        assert_eq!(report.unexpected.len(), 2, "{report}");
        assert_eq!(report.to_string().contains("read without"), wrapper.is_some());
        for (name, var) in store.parameters().iter().chain(&store.buffers()) {
            let equal = var.as_detached_tensor().eq(&plain[name]).unwrap();
            assert_eq!(equal.min_all().unwrap().to_scalar::<u8>().unwrap(), 1, "{prefix}{name}");
        }
    }
}

#[test]
fn of_two_networks_the_half_that_was_chosen_is_taken() {
    let pair = |a: &str, b: &str| {
        let mut both = values(3, |name| format!("{a}{name}"));
        both.extend(values(4, |name| format!("{b}{name}")));
        both
    };
    for (branch, seed) in [(Branch::Teacher, 3), (Branch::Student, 4)] {
        let source = opened(&pair("teacher_net.", "student_net."), branch).unwrap();
        let store = ParamStore::trainable_from(source, 9);
        network(&config(), &store);
        let due = values(seed, str::to_owned);
        for (name, var) in store.parameters() {
            let equal = var.as_detached_tensor().eq(&due[&name]).unwrap();
            assert_eq!(equal.min_all().unwrap().to_scalar::<u8>().unwrap(), 1, "{name}");
        }
    }
    let error = opened(&pair("a.", "b."), Branch::Teacher).unwrap_err().to_string();
    assert!(error.contains("a. and b."), "{error}");
}

#[test]
fn one_of_several_language_heads_is_chosen_by_name() {
    let head = |wide: usize| Tensor::full(wide as f32, (wide, 4), &Device::Cpu).unwrap();
    let with = |heads: &[(&str, usize)]| {
        let mut all = values(3, |name| format!("module.{name}"));
        for (name, wide) in heads {
            all.insert(format!("module.projection.{name}.weight"), head(*wide));
            let bias = head(*wide).narrow(1, 0, 1).unwrap().flatten_all().unwrap();
            all.insert(format!("module.projection.{name}.bias"), bias);
        }
        opened(&all, Branch::Teacher).unwrap()
    };
    let two = || with(&[("lang", 768), ("siglip2", 1152)]);
    for (name, wide) in [("lang", 768), ("siglip2", 1152)] {
        let chosen = two().with_head(Some(name)).unwrap();
        let shapes = chosen.shapes();
        assert_eq!(shapes["projection.weight"], [wide, 4]);
        assert_eq!(shapes["projection.bias"], [wide]);
        assert!(!shapes.keys().any(|n| n.starts_with("projection.lang")), "{shapes:?}");
        // The values are those of the head, and the report counts the other as left out.
        let store = ParamStore::trainable_from(chosen, 0);
        let weight = store.builder().get((wide, 4), "projection.weight").unwrap();
        assert_eq!(weight.max_all().unwrap().to_scalar::<f32>().unwrap(), wide as f32);
        let left = store.report().ignored;
        assert_eq!(left.iter().filter(|(_, why)| why == "another language head").count(), 2);
    }
    let error =
        |source: WeightSource, head: Option<&str>| source.with_head(head).unwrap_err().to_string();
    for (text, part) in [
        (error(two(), None), "lang (768), siglip2 (1152)"),
        (error(two(), Some("dino")), "--head dino"),
        (error(with(&[]), Some("lang")), "no named heads"),
    ] {
        assert!(text.contains(part), "{text}");
    }
    // The only one needs no name; without any nothing changes.
    let one = with(&[("lang", 768)]).with_head(None).unwrap().shapes();
    assert_eq!(one["projection.weight"], [768, 4]);
    assert_eq!(with(&[]).with_head(None).unwrap().shapes(), with(&[]).shapes());
}
