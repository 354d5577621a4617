//! Tells the program what it is built from, for which system and by which compiler: `SCENESPLAT_COMMIT`, absent if the
//! sources are no checkout (a package from a registry, an archive), `SCENESPLAT_TARGET` and `SCENESPLAT_RUSTC`.

use std::path::{Path, PathBuf};
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-env=SCENESPLAT_TARGET={}", variable("TARGET"));
    let compiler = text_of(Command::new(variable("RUSTC")).arg("--version"));
    let compiler = compiler.unwrap_or_else(|| "an unknown compiler".to_owned());
    println!("cargo::rustc-env=SCENESPLAT_RUSTC={compiler}");
    let package = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    // The repository's root is the package's parent; another one further up is somebody else's.
    let Some(root) = package.parent().filter(|root| root.join(".git").exists()) else { return };
    let Some(commit) = git(root, &["rev-parse", "HEAD"]) else { return };
    // Whatever moves HEAD writes here.
    for name in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(root, &["rev-parse", "--git-path", name]) {
            let path = root.join(path);
            if path.exists() {
                println!("cargo::rerun-if-changed={}", path.display());
            }
        }
    }
    let files =
        ["ls-files", "--", "*.rs", "*.toml", ":!*/tests/*", ":!*/benches/*", ":!examples/*"];
    for file in git(root, &files).unwrap_or_default().lines() {
        println!("cargo::rerun-if-changed={}", root.join(file).display());
    }
    let changed = git(root, &["status", "--porcelain", "--untracked-files=no"]);
    let changed = if changed.is_none_or(|c| c.is_empty()) { "" } else { " with changes" };
    println!("cargo::rustc-env=SCENESPLAT_COMMIT={commit}{changed}");
}

/// What git answers, without the line's end.
fn git(root: &Path, args: &[&str]) -> Option<String> {
    text_of(Command::new("git").current_dir(root).args(args))
}

/// What cargo tells a build script.
fn variable(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}

/// What a program that ends well prints, without the line's end.
fn text_of(command: &mut Command) -> Option<String> {
    let out = command.output().ok()?;
    let text = String::from_utf8(out.stdout).ok()?;
    out.status.success().then(|| text.trim_end().to_owned())
}
