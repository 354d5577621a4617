//! Labels, scores, instances and language codes, as one block of bytes that any container can carry.
//!
//! The block is a safetensors file: `segment` and `instance` (I32, `[N]`), `segment_score` (F32,
//! `[N]`), `lang_code` (F16, `[N, k]`), `lang_codebook_mean` (F32, `[D]`) and `lang_codebook_axes`
//! (F32, `[k, D]`), each only if the scene has it. SPZ files and SOG archives hold the block
//! itself; for other formats it is a file beside the scene, with the checksum of the scene it
//! belongs to.

mod sidecar;

pub(crate) use sidecar::{Sidecar, read_sidecar};

use crate::value_policy::Rule;
use crate::{GaussianScene, LanguageCode, LanguageCodebook, RepairReport, SceneError};
use half::f16;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;

/// The one metadata key: several would be written in a random order.
const ABOUT: &str = "scenesplat_labels";

/// What the block says of itself.
#[derive(Debug, Serialize, Deserialize)]
struct About {
    version: u32,
    gaussians: usize,
    /// Checksum and size of the scene file, where the block is a file of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    scene: Option<SceneFingerprint>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct SceneFingerprint {
    bytes: u64,
    crc32: u32,
}

impl SceneFingerprint {
    fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, crc32: crc32fast::hash(bytes) }
    }
}

/// Whether a scene has anything that a block can carry.
fn has_any(scene: &GaussianScene) -> bool {
    scene.segment.is_some()
        || scene.instance.is_some()
        || scene.segment_score.is_some()
        || scene.lang_code.is_some()
}

/// The block of a scene, its rows in the given order; `None` if there is nothing to carry.
pub fn encode(scene: &GaussianScene, order: Option<&[u32]>) -> Option<Vec<u8>> {
    encode_with(scene, order, None)
}

fn encode_with(
    scene: &GaussianScene,
    order: Option<&[u32]>,
    belongs_to: Option<SceneFingerprint>,
) -> Option<Vec<u8>> {
    let n = scene.len();
    let mut tensors: Vec<(&str, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
    fn rows<T: Copy, const B: usize>(
        values: &[T],
        width: usize,
        order: Option<&[u32]>,
        bytes: impl Fn(T) -> [u8; B],
    ) -> Vec<u8> {
        match order {
            None => values.iter().flat_map(|&v| bytes(v)).collect(),
            Some(order) => order
                .iter()
                .flat_map(|&row| &values[row as usize * width..(row as usize + 1) * width])
                .flat_map(|&v| bytes(v))
                .collect(),
        }
    }
    for (name, values) in [("segment", &scene.segment), ("instance", &scene.instance)] {
        if let Some(values) = values {
            // Negative means none, whichever negative it is.
            let bytes = rows(values, 1, order, |label| label.max(-1).to_le_bytes());
            tensors.push((name, Dtype::I32, vec![n], bytes));
        }
    }
    if let Some(values) = &scene.segment_score {
        let bytes = rows(values, 1, order, f32::to_le_bytes);
        tensors.push(("segment_score", Dtype::F32, vec![n], bytes));
    }
    if let Some(code) = &scene.lang_code {
        let (k, width) = (code.width(), code.codebook.feature_width());
        let bytes = rows(&code.values, k, order, f16::to_le_bytes);
        tensors.push(("lang_code", Dtype::F16, vec![n, k], bytes));
        let mean = rows(&code.codebook.mean, 1, None, f32::to_le_bytes);
        tensors.push(("lang_codebook_mean", Dtype::F32, vec![width], mean));
        let axes = rows(&code.codebook.axes, 1, None, f32::to_le_bytes);
        tensors.push(("lang_codebook_axes", Dtype::F32, vec![k, width], axes));
    }
    if tensors.is_empty() {
        return None;
    }
    let views = tensors.iter().map(|(name, dtype, shape, bytes)| {
        let view = TensorView::new(*dtype, shape.clone(), bytes);
        (*name, view.expect("the bytes were made for this shape"))
    });
    let about = About { version: 1, gaussians: n, scene: belongs_to };
    let about = serde_json::to_string(&about).expect("numbers only");
    let about = HashMap::from([(ABOUT.to_owned(), about)]);
    let bytes = safetensors::serialize(views, Some(about));
    Some(bytes.expect("names are unique and shapes match"))
}

/// Adds what a block holds to a scene of `rows` Gaussians as it was read (before bad rows are left
/// out). `path` is for messages.
///
/// # Errors
/// If the block is malformed or made for another number of Gaussians; the scene is then as it was.
pub fn decode(
    bytes: &[u8],
    rows: usize,
    scene: &mut GaussianScene,
    report: &mut RepairReport,
    path: &Path,
) -> Result<(), SceneError> {
    let bad = |problem: String| damaged(path, &problem);
    let about = read_about(bytes).map_err(|e| bad(format!("cannot be read: {e}")))?;
    if about.gaussians != rows {
        return Err(bad(format!("is for {} Gaussians, not {rows}", about.gaussians)));
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| bad(format!("is damaged: {e}")))?;
    // Shapes were checked against the length of the block by the call above.
    let get = |name: &str, dtype: Dtype, shape: &[Option<usize>]| {
        let Ok(view) = tensors.tensor(name) else { return Ok(None) };
        let fits = view.shape().len() == shape.len()
            && view.shape().iter().zip(shape).all(|(&a, b)| b.is_none_or(|b| a == b));
        if view.dtype() != dtype || !fits {
            let (got, is) = (view.shape().to_vec(), view.dtype());
            return Err(bad(format!("holds {name} as {is:?} {got:?}")));
        }
        Ok(Some(view))
    };
    let n = Some(rows);
    let segment = get("segment", Dtype::I32, &[n])?;
    let instance = get("instance", Dtype::I32, &[n])?;
    let score = get("segment_score", Dtype::F32, &[n])?;
    let code = get("lang_code", Dtype::F16, &[n, None])?;
    let mean = get("lang_codebook_mean", Dtype::F32, &[None])?;
    let axes = get("lang_codebook_axes", Dtype::F32, &[None, None])?;
    let codebook = codebook([&code, &mean, &axes], path)?;
    // Nothing can fail any more.
    for (view, into) in [(segment, &mut scene.segment), (instance, &mut scene.instance)] {
        if let Some(view) = view {
            let values = view.data().as_chunks().0.iter().map(|b| i32::from_le_bytes(*b));
            // Negative means none, as everywhere.
            *into = Some(values.map(|v| v.max(-1)).collect());
        }
    }
    if let Some(view) = score {
        scene.segment_score = Some(floats(view.data()));
    }
    if let (Some(code), Some(codebook)) = (code, codebook) {
        let values = code.data().as_chunks().0.iter().map(|b| f16::from_le_bytes(*b)).collect();
        scene.lang_code = Some(clean_code(LanguageCode { values, codebook }, report));
    }
    Ok(())
}

fn damaged(path: &Path, problem: &str) -> SceneError {
    let problem = format!("its block of labels {problem}");
    SceneError::format(path, problem, "write the scene with its labels again")
}

/// The codebook of codes, from its mean and its axes; `None` if nothing of all three is there.
fn codebook(
    parts: [&Option<TensorView<'_>>; 3],
    path: &Path,
) -> Result<Option<LanguageCodebook>, SceneError> {
    let [Some(code), Some(mean), Some(axes)] = parts else {
        let problem = "has language codes without the whole codebook";
        let is_torn = parts.iter().any(|part| part.is_some());
        return if is_torn { Err(damaged(path, problem)) } else { Ok(None) };
    };
    let (k, width) = (code.shape()[1], mean.shape()[0]);
    if axes.shape() != [k, width] {
        return Err(damaged(path, &format!("has codes of {k}, but axes {:?}", axes.shape())));
    }
    let codebook = LanguageCodebook { mean: floats(mean.data()), axes: floats(axes.data()) };
    codebook.check()?;
    Ok(Some(codebook))
}

/// Codes that are not finite become 0, which is no feature, and are reported.
pub(crate) fn clean_code(mut code: LanguageCode, report: &mut RepairReport) -> LanguageCode {
    let k = code.width();
    for (row, values) in code.values.chunks_exact_mut(k).enumerate() {
        if let Some(bad) = values.iter().find(|v| !v.is_finite()) {
            report.add(Rule::CodeNotFinite, 1, row, &bad.to_string());
            values.fill(f16::ZERO);
        }
    }
    code
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

fn read_about(bytes: &[u8]) -> Result<About, String> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|e| e.to_string())?;
    let about = metadata.metadata().as_ref().and_then(|m| m.get(ABOUT));
    let about = about.ok_or("it is no block of labels")?;
    let about: About = serde_json::from_str(about).map_err(|e| e.to_string())?;
    if about.version != 1 {
        return Err(format!("version {} is newer than this program", about.version));
    }
    Ok(about)
}
