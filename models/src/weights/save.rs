//! Writing tensors by name.

use candle_core::{Result, Tensor};
use scenesplat_scene::{AtomicFile, WriteError};
use std::collections::HashMap;
use std::fmt::Display;
use std::path::Path;

/// Writes tensors to a safetensors file, under their names.
///
/// The file appears when it is complete and durable; a failure leaves what was there before.
///
/// # Errors
/// If the file cannot be written; the text names it.
pub fn save_tensors<K: AsRef<str> + Ord + Display>(
    tensors: &HashMap<K, Tensor>,
    path: &Path,
) -> Result<()> {
    let failed = |e: &dyn Display| candle_core::Error::Msg(format!("{}: {e}", path.display()));
    let file = AtomicFile::create(path).map_err(|e| written(&e))?;
    candle_core::safetensors::save(tensors, file.temporary()).map_err(|e| failed(&e))?;
    file.commit().map_err(|e| written(&e))
}

/// candle's errors have no source: everything is in the text.
fn written(error: &WriteError) -> candle_core::Error {
    use std::error::Error;
    let why = error.source().map(|source| format!(": {source}")).unwrap_or_default();
    candle_core::Error::Msg(format!("{error}{why}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn tensors_come_back_and_a_failure_leaves_what_was_there() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        let one = Tensor::new(&[1f32, 2.0], &Device::Cpu).unwrap();
        save_tensors(&HashMap::from([("one", one)]), &path).unwrap();
        let back = candle_core::safetensors::load(&path, &Device::Cpu).unwrap();
        assert_eq!(back["one"].to_vec1::<f32>().unwrap(), [1.0, 2.0]);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);

        let none: HashMap<&str, Tensor> = HashMap::new();
        let error = save_tensors(&none, dir.path()).unwrap_err().to_string();
        assert!(error.contains("is a folder"), "{error}");
        let error = save_tensors(&none, &dir.path().join("no/a")).unwrap_err().to_string();
        assert!(error.contains("cannot create a file in this folder: "), "{error}");
    }
}
