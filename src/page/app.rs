//! The page that labels scenes by itself: the viewer with the library, compiled for browsers, and what that needs.

use super::html::{Carried, assemble_with};
use super::{PageError, classes_near_phrases};
use crate::embedded;
use crate::page_kit::Rights;
use scenesplat_scene::AtomicFile;
use std::path::Path;

/// The library for browsers, gzipped; made by `npm run engine` in the folder `page`.
const ENGINE: &[u8] = include_bytes!("../../page/dist/engine.wasm.gz");

/// What was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AppReport {
    /// Bytes of the file.
    pub bytes: u64,
    /// Bytes of each block in it, as text.
    pub blocks: Vec<(String, usize)>,
}

/// Writes a page that takes a scene file, labels it in the browser with the network inside the program, and shows it as
/// [`write_page`](super::write_page) does. It opens from disk, and its policy forbids requests.
///
/// # Errors
/// If the program was built with broken files, or the page cannot be written; then nothing is left behind.
pub fn write_app(path: &Path) -> Result<AppReport, PageError> {
    let weights = embedded::weights().bytes().map_err(PageError::Damaged)?;
    let parts = [
        ("weights", weights.to_vec()),
        ("phrases", classes_near_phrases()?),
        ("attribution", embedded::attribution().as_bytes().to_vec()),
    ];
    let engine = Carried { name: "engine", bytes: ENGINE };
    let (page, blocks) = assemble_with("scenesplat", &parts, &[engine], Rights::Viewer);
    AtomicFile::write(path, page.as_bytes())?;
    Ok(AppReport { bytes: page.len() as u64, blocks })
}

#[cfg(test)]
mod tests {
    use super::*;
    use sha2::{Digest, Sha256};
    use std::io::Read;

    #[test]
    fn it_is_one_file_below_15_mb_that_asks_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("app.html");
        let report = write_app(&path).unwrap();
        let page = std::fs::read_to_string(&path).unwrap();
        assert_eq!(report.bytes, page.len() as u64);
        assert!(report.bytes <= 15_000_000, "{report:?}");
        let names: Vec<&str> = report.blocks.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["weights", "phrases", "attribution", "engine", "program"]);
        assert_eq!(page.matches("<script").count(), names.len() + 1);
        assert!(page.contains("default-src 'none'") && !page.contains("connect-src 'self'"));
    }

    #[test]
    fn the_engine_is_the_one_that_its_hash_names() {
        let mut engine = Vec::new();
        flate2::read::GzDecoder::new(ENGINE).read_to_end(&mut engine).unwrap();
        assert!(engine.starts_with(b"\0asm"));
        let hex: String = Sha256::digest(&engine).iter().map(|b| format!("{b:02x}")).collect();
        let noted = include_str!("../../page/dist/engine.sha256");
        assert_eq!(noted.split_whitespace().next(), Some(hex.as_str()));
    }
}
