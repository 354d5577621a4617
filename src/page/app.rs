//! The page that labels scenes by itself: the viewer with the library, compiled for browsers, and what that needs.

use super::html::{Carried, assemble_with};
use super::{PageError, classes_near_phrases};
use crate::embedded;
use crate::page_kit::Rights;
use scenesplat_scene::AtomicFile;
use std::path::Path;

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
/// `engine`: this library for browsers, gzipped, as `npm run engine` in the folder `page` makes it.
///
/// # Errors
/// If the program was built with broken files, or the page cannot be written; then nothing is left behind.
pub fn write_app(path: &Path, engine: &[u8]) -> Result<AppReport, PageError> {
    let weights = embedded::weights().bytes().map_err(PageError::Damaged)?;
    let parts = [
        ("weights", weights.to_vec()),
        ("phrases", classes_near_phrases()?),
        ("attribution", embedded::attribution().as_bytes().to_vec()),
    ];
    let engine = Carried { name: "engine", bytes: engine };
    let (page, blocks) = assemble_with("scenesplat", &parts, &[engine], Rights::Viewer);
    AtomicFile::write(path, page.as_bytes())?;
    Ok(AppReport { bytes: page.len() as u64, blocks })
}
