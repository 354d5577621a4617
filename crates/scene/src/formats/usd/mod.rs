//! USD: `ParticleField3DGaussianSplat` prims in text layers (`.usda`), and such a layer in an archive (`.usdz`).
//!
//! The schema came with OpenUSD 26.03: centers, unit quaternions, standard deviations, opacities from 0 to 1, and harmonics grouped
//! by Gaussian. Binary layers (`.usdc`) are not read; `usdcat FILE -o scene.usda` makes text of them.

mod archive;
mod layer;
mod reader;
mod text;
mod writer;

pub(super) use archive::write_usdz;
pub use archive::{is_usdz, read_usdz};
pub use reader::{is_usda, read_usda};
pub(super) use writer::write_usda;

/// The type of prims that are Gaussians.
const TYPE: &str = "ParticleField3DGaussianSplat";
/// Harmonics, and what their arrays begin with.
const HARMONICS: &str = "radiance:sphericalHarmonicsCoefficients";
/// Their degree.
const DEGREE: &str = "radiance:sphericalHarmonicsDegree";
/// Classes, objects, how sure classes are, and language codes: arrays with a value or a row a Gaussian.
const SEGMENT: &str = "primvars:segment";
const INSTANCE: &str = "primvars:instance";
const SEGMENT_SCORE: &str = "primvars:segment_score";
const LANG_CODE: &str = "primvars:lang_code";
/// What decodes the language codes.
const CODEBOOK_MEAN: &str = "scenesplat:lang_codebook_mean";
const CODEBOOK_AXES: &str = "scenesplat:lang_codebook_axes";
/// Whether the scene was trained for antialiased rendering.
const ANTIALIASED: &str = "scenesplat:antialiased";
/// What to do about text that cannot be read.
const CHECK: &str = "check it with OpenUSD's `usdcat FILE`, or export the scene again";
/// What makes text of a binary layer, and one layer of several.
pub(super) const CONVERT: &str =
    "make text of it with OpenUSD's `usdcat --flatten FILE -o scene.usda`";
