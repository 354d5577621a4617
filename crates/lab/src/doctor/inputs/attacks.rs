//! What a hostile folder may hold: links, devices, folders in place of files.

use super::files::{columns, little, open, refused};
use crate::doctor::case::Case;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat::{Network, NetworkConfig, WeightOptions, Weights};
use scenesplat_scene::input_file::{open_regular_file, read_text_file};
use scenesplat_scene::{AtomicFile, Policy as ReadPolicy, StagedFolder};
use std::path::PathBuf;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = vec![
        case("folder-in-place-of-a-scene", |t| {
            std::fs::create_dir(t.folder().join("scene.ply"))?;
            refused(open(&t.folder().join("scene.ply"), ReadPolicy::Repair), &["scene.ply"])?;
            refused(read_text_file(t.folder()), &[])
        }),
        case("folder-in-place-of-an-output", |t| {
            std::fs::create_dir(t.folder().join("out.json"))?;
            refused(AtomicFile::create(&t.folder().join("out.json")), &["out.json"])
        }),
        case("weights-cut-short", cut_weights),
        case("weights-of-another-network", |t| {
            refused_weights(t.file("model.safetensors", &safetensors("[2]", 8))?)
        }),
        case("weights-missing", |t| refused_weights(t.folder().join("nothing.safetensors"))),
        case("names-with-control-characters", control_characters),
    ];
    #[cfg(unix)]
    cases.extend([
        case("device-in-place-of-an-output", |_| {
            refused(AtomicFile::create("/dev/null".as_ref()), &["/dev/null"])
        }),
        case("device-in-place-of-an-input", |_| {
            refused(open_regular_file("/dev/zero".as_ref()), &["/dev/zero"])
        }),
        case("link-with-a-waiting-name", link),
    ]);
    cases.push(case("output-that-is-not-finished", unfinished));
    cases
}

/// That weights for the tiny network are refused, and the file is named.
fn refused_weights(path: PathBuf) -> Result<(), Failure> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let weights = Weights::File(path);
    let loaded = Network::load(NetworkConfig::tiny(), &weights, WeightOptions::default());
    refused(loaded, &[&name])
}

fn control_characters(trial: &Trial<'_>) -> Result<(), Failure> {
    // Windows takes no such names.
    if !cfg!(unix) {
        return Ok(());
    }
    let path = trial.file("scene\u{1b}[2J.ply", &little(&columns(3))[..50])?;
    let Err(error) = open(&path, ReadPolicy::Repair) else {
        return Err(Failure("was not refused".to_owned()));
    };
    ensure!(!error.to_string().contains('\u{1b}'), "an escape code reaches the terminal");
    Ok(())
}

/// A file of one tensor that no network has, of so many bytes.
fn safetensors(shape: &str, bytes: usize) -> Vec<u8> {
    let tensor = format!("{{\"dtype\":\"F32\",\"shape\":{shape},\"data_offsets\":[0,{bytes}]}}");
    let head = format!("{{\"nobody.weight\":{tensor}}}");
    let mut out = (head.len() as u64).to_le_bytes().to_vec();
    out.extend_from_slice(head.as_bytes());
    out.resize(out.len() + bytes, 0);
    out
}

fn cut_weights(trial: &Trial<'_>) -> Result<(), Failure> {
    let mut whole = safetensors("[200]", 800);
    for rest in [0, 4, 60, whole.len() - 1] {
        refused_weights(trial.file("model.safetensors", &whole[..rest])?)?;
    }
    // A header of 2^60 bytes.
    whole[..8].copy_from_slice(&(1u64 << 60).to_le_bytes());
    refused_weights(trial.file("model.safetensors", &whole)?)
}

/// Links under the names that a careless writer would take for what it has not finished.
#[cfg(unix)]
fn link(trial: &Trial<'_>) -> Result<(), Failure> {
    let victim = trial.file("victim", b"precious")?;
    for name in ["out.json.partial", "out.json.part", "out.json.tmp", ".out.json.part"] {
        std::os::unix::fs::symlink(&victim, trial.folder().join(name))?;
    }
    let out = trial.folder().join("out.json");
    AtomicFile::write(&out, b"result")?;
    ensure!(std::fs::read(&victim)? == b"precious", "a link was followed");
    ensure!(std::fs::read(&out)? == b"result", "the result is another");
    ensure!(!out.is_symlink(), "the result is a link");
    Ok(())
}

fn unfinished(trial: &Trial<'_>) -> Result<(), Failure> {
    use std::io::Write;
    let out = trial.file("out.json", b"before")?;
    let mut file = AtomicFile::create(&out)?;
    file.write_all(b"half a res")?;
    drop(file);
    ensure!(std::fs::read(&out)? == b"before", "half a result took the place of a whole one");
    let folder = trial.folder().join("results");
    let mut staged = StagedFolder::create(&folder)?;
    std::fs::write(staged.add("labels.npy"), b"half")?;
    drop(staged);
    ensure!(!folder.join("labels.npy").exists(), "a file of an unfinished folder is there");
    Ok(())
}
