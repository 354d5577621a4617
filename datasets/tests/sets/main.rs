//! Scenes as sets to learn from, and what a capture did to them; one program, for linking takes longer than
//! compiling.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod chunking;
mod effect_plan;
mod effect_profile;
mod loader;
mod rooms_of_points;
mod sources;
mod weighted_mix;
mod wiring;

/// Something among the shared real data; `None`, with a line saying so, where they are not installed.
fn shared(relative: &str) -> Option<std::path::PathBuf> {
    let beside = std::path::PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let root = std::env::var_os("SCENESPLAT_SHARED").map_or(beside, Into::into);
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not in the shared data (set SCENESPLAT_SHARED)", path.display());
    None
}
