//! What a hostile folder may hold: links, devices, folders in place of files.

use super::files::{columns, little, open, refused};
use super::input;
use crate::doctor::case::Case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat::{Network, NetworkConfig, WeightOptions, Weights};
use scenesplat_scene::input_file::{open_regular_file, read_text_file};
use scenesplat_scene::{AtomicFile, Policy as ReadPolicy, StagedFolder};
use std::path::PathBuf;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = vec![
        input(
            "folder-in-place-of-a-scene",
            "attack L: anything but a regular file is refused",
            |t| {
                std::fs::create_dir(t.folder().join("scene.ply"))?;
                refused(open(&t.folder().join("scene.ply"), ReadPolicy::Repair), &["scene.ply"])?;
                refused(read_text_file(t.folder()), &[])
            },
        ),
        input(
            "folder-in-place-of-an-output",
            "attack H1: what is no regular file is replaced",
            |t| {
                std::fs::create_dir(t.folder().join("out.json"))?;
                refused(AtomicFile::create(&t.folder().join("out.json")), &["out.json"])
            },
        ),
        input(
            "weights-cut-short",
            "attack M6: damaged checkpoints; open_questions B 34",
            cut_weights,
        ),
        input(
            "weights-of-another-network",
            "open_questions B 34: mismatched shapes are skipped in silence",
            |t| refused_weights(t.file("model.safetensors", &safetensors("[2]", 8))?),
        ),
        input(
            "weights-missing",
            "open_questions B 34: a wrong weight path trains from scratch in silence",
            |t| refused_weights(t.folder().join("nothing.safetensors")),
        ),
        input(
            "names-with-control-characters",
            "docs/bad_values.md: names reach the terminal escaped",
            control_characters,
        ),
    ];
    #[cfg(unix)]
    cases.extend([
        input(
            "device-in-place-of-an-output",
            "attack H1: device nodes replaced by regular files",
            |_| refused(AtomicFile::create("/dev/null".as_ref()), &["/dev/null"]),
        ),
        input(
            "device-in-place-of-an-input",
            "attack L: a FIFO or device as input never ends",
            |_| refused(open_regular_file("/dev/zero".as_ref()), &["/dev/zero"]),
        ),
        input(
            "link-with-a-waiting-name",
            "attack M1: predictable .partial names follow links",
            link,
        ),
    ]);
    cases.push(input(
        "output-that-is-not-finished",
        "attack M7: a full disk leaves half a result",
        unfinished,
    ));
    let reason = "what was there is there afterwards, byte for byte; nothing is measured";
    let is_legal = |case: &Case| case.name.starts_with("link") || case.name.starts_with("output");
    let expected = |case: Case| if is_legal(&case) { case } else { case.refused() };
    cases.into_iter().map(|case| expected(case).because(reason)).collect()
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
