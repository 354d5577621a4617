use std::path::{Path, PathBuf};

/// The path of `relative` under the shared reference data (`SCENESPLAT_SHARED`, else `shared` beside the
/// repository).
///
/// `None` where it is not installed. Then a line that begins with `skipped:` is printed, which CI refuses.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let root = std::env::var_os("SCENESPLAT_SHARED").map_or(beside, PathBuf::from);
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {relative} is not in the shared data (set SCENESPLAT_SHARED)");
    None
}
