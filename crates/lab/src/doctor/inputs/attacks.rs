//! What a hostile folder may hold: links, devices, folders in place of files.

use super::files::{columns, little, open, refused};
use crate::doctor::case::{Case, Finding, Level, Policy};
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat::{Network, NetworkConfig, WeightOptions, Weights};
use scenesplat_scene::input_file::{open_regular_file, read_text_file};
use scenesplat_scene::{AtomicFile, Policy as ReadPolicy, StagedFolder};

pub(super) fn cases() -> Vec<Case> {
    let case =
        |name: &str, origin: &'static str, check: fn(&Trial<'_>) -> Result<Finding, Failure>| {
            Case {
                area: "attacks",
                origin,
                policy: Policy::Refused,
                reason: "what was there is there afterwards, byte for byte; nothing is measured",
                ..Case::new(name, Level::Inputs, check)
            }
        };
    let mut cases = vec![
        case(
            "folder-in-place-of-a-scene",
            "attack L: anything but a regular file is refused",
            |t| {
                std::fs::create_dir(t.folder().join("scene.ply"))?;
                refused(open(&t.folder().join("scene.ply"), ReadPolicy::Repair), &["scene.ply"])?;
                refused(read_text_file(t.folder()), &[])?;
                Ok(Finding::right())
            },
        ),
        case(
            "folder-in-place-of-an-output",
            "attack H1: what is no regular file is replaced",
            |t| {
                std::fs::create_dir(t.folder().join("out.json"))?;
                refused(AtomicFile::create(&t.folder().join("out.json")), &["out.json"])?;
                Ok(Finding::right())
            },
        ),
        case(
            "weights-cut-short",
            "attack M6: damaged checkpoints; open_questions B 34",
            cut_weights,
        ),
        case(
            "weights-of-another-network",
            "open_questions B 34: mismatched shapes are skipped in silence",
            |t| {
                let path = t.file("model.safetensors", &safetensors("nobody.weight", "[2]", 8))?;
                let loaded = Network::load(
                    NetworkConfig::tiny(),
                    &Weights::File(path),
                    WeightOptions::default(),
                );
                refused(loaded, &["model.safetensors"])?;
                Ok(Finding::right())
            },
        ),
        case(
            "weights-missing",
            "open_questions B 34: a wrong weight path trains from scratch in silence",
            |t| {
                let path = t.folder().join("nothing.safetensors");
                let loaded = Network::load(
                    NetworkConfig::tiny(),
                    &Weights::File(path),
                    WeightOptions::default(),
                );
                refused(loaded, &["nothing.safetensors"])?;
                Ok(Finding::right())
            },
        ),
        case(
            "names-with-control-characters",
            "docs/bad_values.md: names reach the terminal escaped",
            |t| {
                // Windows takes no such names.
                if !cfg!(unix) {
                    return Ok(Finding::right());
                }
                let path = t.file("scene\u{1b}[2J.ply", &little(&columns(3))[..50])?;
                let Err(error) = open(&path, ReadPolicy::Repair) else {
                    return Err(Failure("was not refused".to_owned()));
                };
                ensure!(
                    !error.to_string().contains('\u{1b}'),
                    "an escape code reaches the terminal"
                );
                Ok(Finding::right())
            },
        ),
    ];
    #[cfg(unix)]
    cases.extend([
        case(
            "device-in-place-of-an-output",
            "attack H1: device nodes replaced by regular files",
            |_| {
                refused(AtomicFile::create("/dev/null".as_ref()), &["/dev/null"])?;
                Ok(Finding::right())
            },
        ),
        case(
            "device-in-place-of-an-input",
            "attack L: a FIFO or device as input never ends",
            |_| {
                refused(open_regular_file("/dev/zero".as_ref()), &["/dev/zero"])?;
                Ok(Finding::right())
            },
        ),
        Case {
            policy: Policy::Exact,
            ..case(
                "link-with-a-waiting-name",
                "attack M1: predictable .partial names follow links",
                link,
            )
        },
    ]);
    cases.push(Case {
        policy: Policy::Exact,
        ..case(
            "output-that-is-not-finished",
            "attack M7: a full disk leaves half a result",
            unfinished,
        )
    });
    cases
}

/// A file of one tensor of so many bytes.
fn safetensors(name: &str, shape: &str, bytes: usize) -> Vec<u8> {
    let head = format!(
        "{{\"{name}\":{{\"dtype\":\"F32\",\"shape\":{shape},\"data_offsets\":[0,{bytes}]}}}}"
    );
    let mut out = (head.len() as u64).to_le_bytes().to_vec();
    out.extend_from_slice(head.as_bytes());
    out.resize(out.len() + bytes, 0);
    out
}

fn cut_weights(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let whole = safetensors("nobody.weight", "[200]", 800);
    for rest in [0, 4, 60, whole.len() - 1] {
        let path = trial.file("model.safetensors", &whole[..rest])?;
        let loaded =
            Network::load(NetworkConfig::tiny(), &Weights::File(path), WeightOptions::default());
        refused(loaded, &["model.safetensors"])?;
    }
    // A header of 2^60 bytes.
    let mut lie = whole;
    lie[..8].copy_from_slice(&(1u64 << 60).to_le_bytes());
    let path = trial.file("model.safetensors", &lie)?;
    let loaded =
        Network::load(NetworkConfig::tiny(), &Weights::File(path), WeightOptions::default());
    refused(loaded, &["model.safetensors"])?;
    Ok(Finding::right())
}

/// Links under the names that a careless writer would take for what it has not finished.
#[cfg(unix)]
fn link(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let victim = trial.file("victim", b"precious")?;
    for name in ["out.json.partial", "out.json.part", "out.json.tmp", ".out.json.part"] {
        std::os::unix::fs::symlink(&victim, trial.folder().join(name))?;
    }
    let out = trial.folder().join("out.json");
    AtomicFile::write(&out, b"result")?;
    ensure!(std::fs::read(&victim)? == b"precious", "a link was followed");
    ensure!(std::fs::read(&out)? == b"result", "the result is another");
    ensure!(!out.is_symlink(), "the result is a link");
    Ok(Finding::right())
}

fn unfinished(trial: &Trial<'_>) -> Result<Finding, Failure> {
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
    Ok(Finding::right())
}
