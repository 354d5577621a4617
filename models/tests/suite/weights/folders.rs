//! Model folders.

use super::network::*;
use scenesplat_models::weights::{SourceOptions, WeightSource, resolve};
use scenesplat_models::{LoadPolicy, ParamStore};
use std::path::Path;

fn copy(to: &Path, files: &[(&str, &str)]) {
    for (from, name) in files {
        std::fs::copy(data(from), to.join(name)).unwrap();
    }
}

fn error(folder: &Path) -> String {
    resolve(folder).unwrap_err().to_string()
}

#[test]
fn safetensors_in_shards() {
    let folder = resolve(&data("hub")).unwrap();
    assert_eq!(folder.files.len(), 2);
    assert_eq!(folder.config, Some(data("hub/config.json")));
    let source = WeightSource::files(folder.files, SourceOptions::default()).unwrap();
    assert_hashed(&config(), &source, SEED);
    let store = ParamStore::frozen(source);
    network(&config(), &store);
    store.report().check(LoadPolicy::Strict, "hub").unwrap();
}

#[test]
fn one_pytorch_file() {
    let temp = tempfile::tempdir().unwrap();
    copy(temp.path(), &[("plain.pth", "pytorch_model.bin"), ("hub/config.json", "config.json")]);
    let folder = resolve(temp.path()).unwrap();
    assert_eq!(folder.config, Some(temp.path().join("config.json")));
    let source = WeightSource::files(folder.files, SourceOptions::default()).unwrap();
    assert_hashed(&with_head(), &source, SEED);
}

#[test]
fn pytorch_shards_and_the_only_checkpoint() {
    let temp = tempfile::tempdir().unwrap();
    copy(temp.path(), &[("half.pth", "part.bin")]);
    let index = r#"{"weight_map": {"a": "part.bin", "b": "part.bin"}}"#;
    std::fs::write(temp.path().join("pytorch_model.bin.index.json"), index).unwrap();
    assert_eq!(resolve(temp.path()).unwrap().files.len(), 1);

    let temp = tempfile::tempdir().unwrap();
    copy(temp.path(), &[("trainer.pth", "model_best.pth")]);
    assert_eq!(resolve(temp.path()).unwrap().files[0].path(), temp.path().join("model_best.pth"));
    copy(temp.path(), &[("trainer.pth", "model_last.pth")]);
    let choice = error(temp.path());
    assert!(choice.contains("model_best.pth") && choice.contains("model_last.pth"), "{choice}");
}

#[test]
fn what_is_wrong_with_a_folder_is_said() {
    let temp = tempfile::tempdir().unwrap();
    assert!(error(temp.path()).contains("no weights"));
    assert!(error(&temp.path().join("nowhere")).contains("nowhere"));

    let index = temp.path().join("model.safetensors.index.json");
    for (text, expected) in [
        ("{", "index.json"),
        (r#"{"metadata": {}}"#, "no weight_map"),
        (r#"{"weight_map": []}"#, "no weight_map"),
        (r#"{"weight_map": {}}"#, "names no file"),
        (r#"{"weight_map": {"w": "../outside.safetensors"}}"#, "not a file name"),
        (r#"{"weight_map": {"w": 3}}"#, "not a file name"),
        (r#"{"weight_map": {"w": ""}}"#, "not a file name"),
        (r#"{"weight_map": {"w": ".."}}"#, "not a file name"),
        (r#"{"weight_map": {"w": "absent.safetensors"}}"#, "absent.safetensors"),
    ] {
        std::fs::write(&index, text).unwrap();
        let message = error(temp.path());
        assert!(message.contains(expected), "{text}: {message}");
    }
}

#[test]
fn a_missing_shard_and_a_repeated_tensor() {
    let temp = tempfile::tempdir().unwrap();
    let shards = ["model-00001-of-00002.safetensors", "model-00002-of-00002.safetensors"];
    let index = "model.safetensors.index.json";
    copy(
        temp.path(),
        &[(&format!("hub/{}", shards[0]), shards[0]), (&format!("hub/{index}"), index)],
    );
    assert!(error(temp.path()).contains(shards[1]));
    // The first shard once more under the name of the second: its tensors are there twice.
    copy(temp.path(), &[(&format!("hub/{}", shards[0]), shards[1])]);
    let folder = resolve(temp.path()).unwrap();
    let twice = WeightSource::files(folder.files, SourceOptions::default()).unwrap_err();
    assert!(twice.to_string().contains("both name"), "{twice}");
}
