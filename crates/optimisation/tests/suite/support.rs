//! Numbers of `goldens/raster/optimise.safetensors`.

use scenesplat_test_support::Golden;
use serde_json::Value;

/// `None`, with a line saying so, where the shared data are not installed.
pub fn golden() -> Option<Golden> {
    Golden::raster("optimise")
}

/// A picture `[3, H, W]` as `[H, W, 3]`.
pub fn picture(golden: &Golden, name: &str) -> Vec<f32> {
    let values = golden.f32s(name);
    let plane = values.len() / 3;
    (0..3 * plane).map(|i| values[i % 3 * plane + i / 3]).collect()
}

/// A number that the manifest has at this path.
pub fn number(golden: &Golden, path: &str) -> f64 {
    golden.entry()["scalars"].pointer(path).and_then(Value::as_f64).unwrap()
}
