//! Every text compiles for the processors we mean, by the compiler that users have.

use scenesplat_device::modules;
use scenesplat_device::nvrtc::{Architecture, Cache, NvrtcError, compile, compile_anew, version};

/// Whether the compiler is there; says loudly if not.
fn compiler_is_there() -> bool {
    match version() {
        Ok((major, minor)) => {
            println!("NVRTC {major}.{minor}");
            true
        }
        Err(error @ NvrtcError::Named { .. }) => panic!("{error}"),
        Err(error) => {
            println!("NOT RUN: {error}");
            false
        }
    }
}

fn every_text_compiles_for(architecture: &str) {
    if !compiler_is_there() {
        return;
    }
    for module in modules() {
        // Both processors get the same text, so one of them tells in the quick tests.
        let mut lines = module.source.lines().filter(|line| line.contains("__CUDA_ARCH__"));
        assert!(lines.all(|line| line.contains(">= 800")), "{}", module.name);
        let ptx = compile_anew(module, architecture).unwrap();
        for kernel in module.entries {
            let entry = format!(".entry {}(", kernel.name);
            assert!(ptx.contains(&entry), "{}: no {}", module.name, kernel.name);
            let threads = format!(".maxntid {}", kernel.threads);
            assert!(ptx.contains(&threads), "{}: {threads}", module.name);
        }
    }
}

#[test]
fn every_text_compiles_to_machine_code_for_ampere() {
    every_text_compiles_for("sm_80");
}

#[test]
#[ignore = "compiles all texts once more; .ci/optional runs it"]
fn every_text_compiles_to_machine_code_for_hopper() {
    every_text_compiles_for("sm_90");
}

#[test]
fn what_was_compiled_is_kept_and_a_damaged_file_is_compiled_again() {
    if !compiler_is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let cache = Cache::at(folder.path());
    let hopper = Architecture { major: 9, minor: 0 };
    let module = &modules()[0];
    let first = compile(module, hopper, &cache).unwrap();
    assert!(!first.from_cache && first.not_kept.is_none());
    let second = compile(module, hopper, &cache).unwrap();
    assert!(second.from_cache && second.ptx == first.ptx);
    let file = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    let third = compile(module, hopper, &cache).unwrap();
    assert!(!third.from_cache && third.ptx == first.ptx);
    assert!(compile(module, hopper, &cache).unwrap().from_cache);
    // A folder that cannot be made is said, and the code is there nevertheless.
    let nowhere = Cache::at(file.join("below a file"));
    let unkept = compile(module, hopper, &nowhere).unwrap();
    assert!(unkept.ptx == first.ptx && unkept.not_kept.unwrap().contains("cannot be written"));
}

#[test]
fn an_error_names_text_line_and_processor() {
    if !compiler_is_there() {
        return;
    }
    let source = "extern \"C\" __global__ void k(float* x) {\n    x[0] = y;\n}\n";
    let module = scenesplat_device::KernelModule { name: "broken", source, entries: &[] };
    let error = compile_anew(&module, "compute_90").unwrap_err().to_string();
    for part in ["broken", "compute_90", "(2)", "\"y\""] {
        assert!(error.contains(part), "{part}: {error}");
    }
}
