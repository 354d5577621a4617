//! A scene, its labels, objects and language codes as one page.
//!
//! [`write_page`] packs everything into one HTML file that opens from disk without a server: the program (TypeScript in
//! the folder `page`, with three.js and Spark), the Gaussians with rounded values, and what is needed to answer typed
//! queries. The page loads nothing: its policy forbids it. Names and texts of any file are data in it, never markup.
//! [`PageServer`] gives the same page in chunks to a browser on this machine, for scenes too large for a file.

#[cfg(not(target_family = "wasm"))]
mod app;
mod blocks;
mod codes;
mod error;
mod html;
mod pack;
mod relations;
#[cfg(not(target_family = "wasm"))]
mod served;
mod words;

use crate::inference::SceneFeatures;
use crate::page_kit::Rights;
#[cfg(not(target_family = "wasm"))]
pub use app::{AppReport, write_app};
pub use error::PageError;
use pack::Pack;
use scenesplat_objects::Catalogue;
use scenesplat_rooms::Vocabulary;
use scenesplat_scene::frame::Matrix3;
use scenesplat_scene::{AtomicFile, GaussianScene, TextTable};
#[cfg(not(target_family = "wasm"))]
pub use served::{PageServer, Refusal, ServeEvent, Served, ServedPage};
use std::path::Path;
pub use words::{classes_near_phrases, near_classes};

/// The licenses of what the page is made of besides our own code.
pub const LICENSES: &str = include_str!("../../page/dist/LICENSES.txt");

/// Most classes and most objects: 16 bits number them, and 0 is none.
const MOST_NAMES: usize = 65_535;
/// What is shown.
#[derive(Clone, Copy)]
pub struct PageInput<'a> {
    /// First line of the page.
    pub title: &'a str,
    /// The Gaussians.
    pub scene: &'a GaussianScene,
    /// Class of each, −1 = none. `[N]`
    pub labels: Option<&'a [i32]>,
    /// How sure it is, 0..=1 is shown. `[N]`
    pub scores: Option<&'a [f32]>,
    /// Names of the classes.
    pub names: &'a [String],
    /// The objects.
    pub catalogue: Option<&'a Catalogue>,
    /// Features, and the texts of `names` that are compared with them.
    pub features: Option<(&'a SceneFeatures, &'a TextTable)>,
    /// The vocabulary that names and texts are of: colors and groups can be asked for.
    pub vocabulary: Option<&'a Vocabulary>,
    /// The rotation that brings +z up.
    pub upright: Matrix3,
    /// What one unit of the scene is, meters.
    pub metres_per_unit: f64,
    /// What makes labels doubtful, such as that weights were seeded: shown at the top.
    pub warnings: &'a [String],
    /// What else a reader may want to know.
    pub remarks: &'a [String],
}

/// What the page holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageSettings {
    /// Numbers of a language code, 1 to 32.
    pub codes: usize,
    /// Gaussians kept, those that are seen most (opacity times surface) first; all if `None`.
    pub max_splats: Option<usize>,
}

impl Default for PageSettings {
    fn default() -> Self {
        Self { codes: 24, max_splats: None }
    }
}

/// What was written.
#[derive(Debug, Clone, PartialEq)]
pub struct PageReport {
    /// Bytes of the file, or of all that is served.
    pub bytes: u64,
    /// Bytes of each block in it: in a file as text.
    pub blocks: Vec<(String, usize)>,
    /// Gaussians in it.
    pub gaussians: usize,
    /// Gaussians left out: without a place, or more than asked for.
    pub left_out: usize,
    /// Mean cosine between features and what their codes say; `None` without codes.
    pub code_cosine: Option<f64>,
    /// Largest rounding of a position, units of the scene.
    pub position_step: f64,
    /// Pairs of objects that stand in a relation, and how many of them the page does not know: the farthest of those
    /// that are only near each other.
    pub relations: usize,
    /// See `relations`.
    pub relations_left_out: usize,
}

/// The blocks that a page reads, by name, for a program that shows them itself: what it reads first is `about`.
///
/// # Errors
/// If arrays do not fit each other, or there is nothing to show.
pub fn page_parts(
    input: &PageInput<'_>,
    settings: &PageSettings,
) -> Result<Vec<(&'static str, Vec<u8>)>, PageError> {
    let Pack { about, mut parts, .. } = Pack::of(input, settings)?;
    parts.push(("about", about.to_string().into_bytes()));
    Ok(parts)
}

/// Writes a page.
///
/// # Errors
/// If arrays do not fit each other, there is nothing to show, or the file cannot be written; then nothing is left
/// behind.
pub fn write_page(
    path: &Path,
    input: &PageInput<'_>,
    settings: &PageSettings,
) -> Result<PageReport, PageError> {
    let Pack { about, mut parts, report } = Pack::of(input, settings)?;
    parts.push(("about", about.to_string().into_bytes()));
    let (page, blocks) = html::assemble(input.title, &parts, Rights::Viewer);
    AtomicFile::write(path, page.as_bytes())?;
    Ok(PageReport { bytes: page.len() as u64, blocks, ..report })
}
