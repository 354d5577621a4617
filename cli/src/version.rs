//! What program this is: for `--version` and reports of bugs.

use std::sync::LazyLock;

/// Version of the package.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
/// The commit, with a word about changes; `None` if the sources were no checkout.
pub const COMMIT: Option<&str> = option_env!("SCENESPLAT_COMMIT");

/// The features that the program was built with.
fn features() -> String {
    let all = [
        (cfg!(feature = "cuda"), "cuda"),
        (cfg!(feature = "wgpu"), "wgpu"),
        (cfg!(feature = "mcp"), "mcp"),
        (cfg!(feature = "mpi"), "mpi"),
        (cfg!(feature = "nccl"), "nccl"),
        (cfg!(feature = "onnx"), "onnx"),
    ];
    let built: Vec<&str> = all.into_iter().filter(|(built, _)| *built).map(|row| row.1).collect();
    if built.is_empty() { "none".to_owned() } else { built.join(", ") }
}

/// Version, commit, target, features and compiler, one a line.
pub fn long() -> &'static str {
    static LONG: LazyLock<String> = LazyLock::new(told);
    &LONG
}

fn told() -> String {
    format!(
        "{VERSION}\ncommit: {}\ntarget: {}\nfeatures: {}\ncompiler: {}",
        COMMIT.unwrap_or("unknown"),
        env!("SCENESPLAT_TARGET"),
        features(),
        env!("SCENESPLAT_RUSTC"),
    )
}
