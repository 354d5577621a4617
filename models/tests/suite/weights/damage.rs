//! Cut off and altered files: an error or the right values, never a panic, never much memory.

use super::allocations::largest;
use super::network::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_models::LoadPolicy;
use scenesplat_models::weights::{
    SourceOptions, WeightFile, WeightSource, hashed_parameter, summarize,
};
use scenesplat_models::{ParamStore, convert};
use std::collections::BTreeMap;
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};

/// No file here is larger than a tenth of this.
const MEMORY: usize = 4 << 20;
const MUTATIONS: u64 = 2000;

/// All entries of a file, or the first error.
fn read_all(path: &Path) -> candle_core::Result<BTreeMap<String, Vec<u32>>> {
    let (result, asked): (candle_core::Result<_>, usize) = largest(|| {
        let file = WeightFile::open(path)?;
        let names: Vec<String> = file.entries().keys().cloned().collect();
        names
            .into_iter()
            .map(|name| {
                let t = file.read(&name)?.to_dtype(candle_core::DType::F32)?;
                Ok((name, bits(&t)))
            })
            .collect()
    });
    assert!(asked < MEMORY, "asked for {asked} bytes");
    if let Err(e) = &result {
        let message = e.to_string();
        assert!(message.contains(&path.display().to_string()), "no path in: {message}");
    }
    result
}

struct Scratch {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

impl Scratch {
    fn new(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        Self { _folder: folder, path }
    }
    fn write(&self, bytes: &[u8]) -> &Path {
        std::fs::write(&self.path, bytes).unwrap();
        &self.path
    }
}

/// The files that are damaged: a checkpoint of a trainer and a shard.
fn victims() -> [PathBuf; 2] {
    [data("trainer.pth"), data("hub/model-00001-of-00002.safetensors")]
}

#[test]
fn cut_off_anywhere() {
    for victim in victims() {
        let whole = std::fs::read(&victim).unwrap();
        let scratch = Scratch::new("cut");
        let dense = (0..200).chain(whole.len() - 200..whole.len());
        for length in dense.chain((200..whole.len() - 200).step_by(89)) {
            let path = scratch.write(&whole[..length]);
            assert!(read_all(path).is_err(), "{}: {length} bytes", victim.display());
        }
        assert!(read_all(scratch.write(&whole)).is_ok());
        let mut longer = whole.clone();
        longer.push(0);
        if let Ok(values) = read_all(scratch.write(&longer)) {
            assert_eq!(values, read_all(&victim).unwrap());
        }
    }
}

fn mutate(bytes: &mut [u8], rng: &mut ChaCha8Rng) -> Vec<usize> {
    let count = rng.random_range(1..=3);
    (0..count)
        .map(|_| {
            let at = rng.random_range(0..bytes.len());
            bytes[at] = if rng.random::<bool>() {
                bytes[at] ^ 1 << rng.random_range(0..8)
            } else {
                rng.random()
            };
            at
        })
        .collect()
}

#[test]
fn altered_checkpoints_are_noticed() {
    let victim = data("trainer.pth");
    let whole = std::fs::read(&victim).unwrap();
    let right = read_all(&victim).unwrap();
    let scratch = Scratch::new("altered.pth");
    let (mut refused, mut kept) = (0, 0);
    for seed in 0..MUTATIONS {
        let mut bytes = whole.clone();
        let places = mutate(&mut bytes, &mut ChaCha8Rng::seed_from_u64(seed));
        match read_all(scratch.write(&bytes)) {
            Ok(values) => {
                assert_eq!(values, right, "mutation {seed} at {places:?}");
                kept += 1;
            }
            Err(_) => refused += 1,
        }
        _ = summarize(&scratch.path);
    }
    println!("{refused} refused, {kept} had no effect on a weight");
    assert!(refused > 0 && kept > 0);
}

/// Regression: contents exchanged by exchanging names have good checksums.
#[test]
fn exchanged_names_are_noticed() {
    let victim = data("trainer.pth");
    let whole = std::fs::read(&victim).unwrap();
    let scratch = Scratch::new("exchanged.pth");
    let directory_entry = |number: usize| {
        let name = format!("trainer/data/{number}");
        let found = whole.windows(name.len()).rposition(|w| w == name.as_bytes()).unwrap();
        found + name.len() - 2
    };
    for first in 10..60 {
        let (a, b) = (directory_entry(first), directory_entry(first + 1));
        let mut bytes = whole.clone();
        bytes[a..a + 2].copy_from_slice(&whole[b..b + 2]);
        bytes[b..b + 2].copy_from_slice(&whole[a..a + 2]);
        let error = read_all(scratch.write(&bytes)).unwrap_err().to_string();
        assert!(error.contains("data/"), "{error}");
    }
}

/// Regression: the checksum of a storage was never compared.
#[test]
fn every_altered_value_is_noticed() {
    let whole = std::fs::read(data("text_f32.pt")).unwrap();
    let value = scenesplat_models::weights::unit("text", 1, SEED)[0].to_le_bytes();
    let start = whole.windows(4).position(|w| w == value).unwrap();
    let scratch = Scratch::new("altered.pt");
    for at in start..start + 160 {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        let error = read_all(scratch.write(&bytes)).unwrap_err().to_string();
        assert!(error.contains("checksum"), "{error}");
    }
}

#[test]
fn altered_safetensors_are_noticed_outside_of_the_values() {
    let victim = data("hub/model-00001-of-00002.safetensors");
    let whole = std::fs::read(&victim).unwrap();
    let header = 8 + u64::from_le_bytes(whole[..8].try_into().unwrap()) as usize;
    let right = read_all(&victim).unwrap();
    let names: Vec<&String> = right.keys().collect();
    let scratch = Scratch::new("altered.safetensors");
    for seed in 0..MUTATIONS {
        let mut bytes = whole.clone();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // The header is short beside the values: half of the attempts go there.
        let places = match seed % 2 {
            0 => mutate(&mut bytes[..header], &mut rng),
            _ => mutate(&mut bytes, &mut rng),
        };
        let Ok(values) = read_all(scratch.write(&bytes)) else { continue };
        if places.iter().all(|at| *at >= header) {
            // The format has no checksum: an altered number is another number, and nothing else.
            assert_eq!(values.keys().collect::<Vec<_>>(), names);
            let pairs = values.values().zip(right.values());
            let wrong: usize =
                pairs.map(|(a, b)| a.iter().zip(b).filter(|(a, b)| a != b).count()).sum();
            assert!(wrong <= places.len(), "mutation {seed} at {places:?}");
        }
    }
}

/// The checksum guards the pickle; behind a right one it may still hold anything.
#[test]
fn altered_pickles_with_a_right_checksum() {
    for (victim, rounds) in [("trainer.pth", MUTATIONS / 8), ("odd_values.pth", MUTATIONS)] {
        let archive = std::fs::read(data(victim)).unwrap();
        let mut archive = zip::ZipArchive::new(Cursor::new(archive)).unwrap();
        let mut entries = Vec::new();
        for i in 0..archive.len() {
            let mut entry = archive.by_index(i).unwrap();
            let name = entry.name().unwrap().into_owned();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            entries.push((name, bytes));
        }
        let pack = |entries: &[(String, Vec<u8>)]| -> Vec<u8> {
            let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
            let stored = zip::write::SimpleFileOptions::default()
                .compression_method(zip::CompressionMethod::Stored);
            for (name, bytes) in entries {
                writer.start_file(name.as_str(), stored).unwrap();
                writer.write_all(bytes).unwrap();
            }
            writer.finish().unwrap().into_inner()
        };
        let scratch = Scratch::new("altered.pth");
        if victim == "trainer.pth" {
            assert!(read_all(scratch.write(&pack(&entries))).is_ok());
        }
        let pickle = entries.iter().position(|(n, _)| n.ends_with("data.pkl")).unwrap();
        let whole = entries[pickle].1.clone();
        for seed in 0..rounds {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            mutate(&mut entries[pickle].1, &mut rng);
            let path = scratch.write(&pack(&entries));
            _ = read_all(path);
            _ = largest(|| summarize(path));
            entries[pickle].1.clone_from(&whole);
        }
    }
}

/// Sizes and counts that only a hostile file claims.
#[test]
fn claims_are_not_believed() {
    let scratch = Scratch::new("claims");
    let safetensors = |header: &str, data: usize| {
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend(header.as_bytes());
        bytes.resize(bytes.len() + data, 0);
        bytes
    };
    for header in [
        r#"{"w":{"dtype":"F32","shape":[1000000000000],"data_offsets":[0,4]}}"#,
        r#"{"w":{"dtype":"F32","shape":[4294967296,4294967296],"data_offsets":[0,4]}}"#,
        r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[4,0]}}"#,
        r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[0,4000000000]}}"#,
        r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[0,4]},"v":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#,
        r#"{"w":{"dtype":"F32","shape":[-1],"data_offsets":[0,4]}}"#,
        r#"{"w":{"dtype":"F33","shape":[1],"data_offsets":[0,4]}}"#,
        r#"{"w":[]}"#,
        "{}",
        r#"{"w":{"dtype":"F8_E8M0","shape":[4],"data_offsets":[0,4]}}"#,
        r#"{"w":{"dtype":"BOOL","shape":[4],"data_offsets":[0,4]}}"#,
        r#"{"w":{"dtype":"C64","shape":[0],"data_offsets":[0,0]}}"#,
    ] {
        let result = read_all(scratch.write(&safetensors(header, 4)));
        assert!(result.is_err(), "{header}: {result:?}");
    }
    // Less than a number.
    let halves = r#"{"w":{"dtype":"F4","shape":[8],"data_offsets":[0,4]}}"#;
    assert!(read_all(scratch.write(&safetensors(halves, 4))).is_err());
    // A header longer than the file.
    let mut long = u64::MAX.to_le_bytes().to_vec();
    long.extend(b"{}");
    assert!(read_all(scratch.write(&long)).is_err());
}

/// A value that no weight has, behind an intact header, reaches the network as it is; only batch
/// norms check theirs, because a negative variance has no root.
#[test]
fn an_impossible_variance_is_refused() {
    let name = "embedding.stem.norm.running_var";
    let mut tensors = BTreeMap::new();
    for (name, shape) in {
        let store = ParamStore::frozen(WeightSource::hashed(SEED, ""));
        network(&config(), &store);
        store.shapes()
    } {
        tensors.insert(name.clone(), hashed_parameter(&name, &shape, SEED).unwrap());
    }
    let bad = candle_core::Tensor::new(&[1f32, -0.5, 1.0, 1.0], &candle_core::Device::Cpu).unwrap();
    tensors.insert(name.to_owned(), bad);
    let store = ParamStore::frozen(WeightSource::tensors(tensors));
    let message = config().build(store.builder()).err().unwrap();
    assert!(message.to_string().contains("running_var[1] is -0.5"), "{message}");
}

/// Names are data too: the table must end for every one of them.
#[test]
fn names_of_nothing_but_prefixes() {
    let name = "module.".repeat(10_000) + "backbone.";
    let renamed = convert::rename(&name, convert::Branch::Teacher);
    assert_eq!(renamed, convert::Renamed::Weight(String::new()));
    let store = ParamStore::frozen(source("half.pth", SourceOptions::default()));
    network(&config(), &store);
    store.report().check(LoadPolicy::Strict, "half.pth").unwrap();
}
