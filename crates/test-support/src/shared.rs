use std::path::{Path, PathBuf};

/// The folder that holds this workspace: what tests read of another crate, the documentation or the settings stands in it.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The path of `relative` under the shared reference data (`SCENESPLAT_SHARED`, else `shared` beside the
/// repository).
///
/// `None` where it is not installed. Then a line that begins with `skipped:` is printed, which CI refuses.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let beside = repository().join("../shared");
    let root = std::env::var_os("SCENESPLAT_SHARED").map_or(beside, PathBuf::from);
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {relative} is not in the shared data (set SCENESPLAT_SHARED)");
    None
}
