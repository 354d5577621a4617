//! What an archive and its pickle may look like.

use super::network::*;
use scenesplat_models::weights::{SourceOptions, WeightFile, WeightSource, hashed_parameter};
use std::path::Path;

fn open(file: &str) -> WeightFile {
    WeightFile::open(&data(file)).unwrap()
}

fn numbers(file: &WeightFile, name: &str) -> Vec<f32> {
    let t = file.read(name).unwrap().to_dtype(candle_core::DType::F32).unwrap();
    t.flatten_all().unwrap().to_vec1().unwrap()
}

#[test]
fn other_ways_to_write_an_archive() {
    for name in ["protocol5.pth", "no_checksums.pth", "compressed.pth"] {
        let file = open(name);
        assert_eq!(file.entries().len(), 2, "{name}");
        for (key, shape) in [("a.weight", &[2, 3][..]), ("a.bias", &[2])] {
            let expected = hashed_parameter(key, shape, SEED).unwrap();
            assert_eq!(bits(&file.read(key).unwrap()), bits(&expected), "{name}: {key}");
        }
    }
}

#[test]
fn types_views_and_containers() {
    let file = open("odd_values.pth");
    let dtype = |name: &str| file.entries()[name].dtype.clone();
    assert_eq!(dtype("i16"), "i16");
    assert_eq!(dtype("i8"), "CharStorage");
    assert_eq!(numbers(&file, "f64"), [1.5, -2.0]);
    assert_eq!(numbers(&file, "i16"), [-3.0, 4.0]);
    assert_eq!(numbers(&file, "i32"), [-5.0, 6.0]);
    assert_eq!(numbers(&file, "bool"), [1.0, 0.0]);
    assert_eq!(numbers(&file, "scalar"), [2.5]);
    assert_eq!(file.entries()["scalar"].shape, [0usize; 0]);
    assert_eq!(numbers(&file, "empty"), [0.0; 0]);
    assert_eq!(file.read("empty").unwrap().dims(), [0, 3]);
    assert_eq!(numbers(&file, "window"), [2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    assert_eq!(numbers(&file, "every_other"), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
    let permuted = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 1.0, 3.0, 5.0, 7.0, 9.0, 11.0];
    assert_eq!(numbers(&file, "permuted"), permuted);
    assert_eq!(file.entries()["permuted"].shape, [2, 2, 3]);
    assert_eq!(numbers(&file, "parameter"), [9.0]);
    // `state_dict` is preferred to `model`; what is no tensor of it is listed.
    assert_eq!(file.skipped(), ["model", "again", "number", "nested", "5"]);
    for (name, expected) in [
        ("i8", "CharStorage"),
        ("complex", "Complex"),
        ("expanded", "7 values share 1"),
        ("w", "no such"),
    ] {
        let message = file.read(name).unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains("odd_values.pth"), "{message}");
    }
}

/// Regression: what a pickle names twice was empty the second time.
#[test]
fn a_dictionary_named_twice_is_full_both_times() {
    let top = scenesplat_models::weights::summarize(&data("odd_values.pth")).unwrap();
    assert_eq!(top["model"], top["again"]);
}

#[test]
fn the_format_before_1_6_is_refused_with_advice() {
    let message = WeightFile::open(&data("before_1_6.pth")).unwrap_err().to_string();
    assert!(message.contains("before 1.6") && message.contains("torch.save"), "{message}");
    let message = scenesplat_models::weights::read_single_tensor(&data("before_1_6.pth"));
    assert!(message.unwrap_err().to_string().contains("before 1.6"));
}

#[test]
fn no_command_of_a_pickle_is_executed() {
    let message = WeightFile::open(&data("command.pth")).unwrap_err().to_string();
    assert!(message.contains("neither a dictionary nor a tensor"), "{message}");
    let file = open("command_inside.pth");
    assert_eq!(file.entries().keys().collect::<Vec<_>>(), ["a.bias", "a.weight"]);
    assert_eq!(file.skipped(), ["hook", "b"]);
    assert!(file.read("a.weight").is_ok());
    let source = WeightSource::files(vec![file], SourceOptions::default());
    source.unwrap();
    assert!(!Path::new("executed_by_the_pickle").exists());
}

#[test]
fn neither_kind_of_file() {
    let temp = tempfile::tempdir().unwrap();
    let path = temp.path().join("weights.pth");
    for (bytes, expected) in [
        (&b""[..], "is empty"),
        (b"P", "neither safetensors nor"),
        (b"<html>not found</html>", "neither safetensors nor"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:1", "git-lfs"),
        (b"PK\x03\x04", "cut off"),
        (b"\x80\x02", "before 1.6"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = WeightFile::open(&path).unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains("weights.pth"), "{message}");
    }
    let message = WeightFile::open(&temp.path().join("absent.pth")).unwrap_err().to_string();
    assert!(message.contains("absent.pth"), "{message}");
}
