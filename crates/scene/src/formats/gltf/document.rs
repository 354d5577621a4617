//! The parts of a glTF document that place and describe Gaussians; everything else is skipped.

use crate::SceneError;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

/// Most objects of a document.
///
/// An object takes up to some hundred bytes of memory but two of text (`{}`), so a document of
/// nothing could fill the memory; scenes with Gaussians have a few.
const MAX_OBJECTS: usize = 1 << 20;

/// Reads the document.
pub(super) fn parse<'a>(json: &'a [u8], path: &Path) -> Result<Document<'a>, SceneError> {
    let objects = json.iter().filter(|&&byte| byte == b'{').count();
    if objects > MAX_OBJECTS {
        let problem = format!("has {objects} JSON objects, more than {MAX_OBJECTS}");
        return Err(SceneError::format(path, problem, "export the Gaussians by themselves"));
    }
    serde_json::from_slice(json)
        .map_err(|e| super::file_error(path, format!("is no glTF document: {e}")))
}

/// The properties of a document that matter here. Indices are not checked yet.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Document<'a> {
    #[serde(borrow)]
    pub buffers: Vec<Buffer<'a>>,
    pub buffer_views: Vec<BufferView>,
    pub accessors: Vec<Accessor>,
    pub meshes: Vec<Mesh>,
    pub nodes: Vec<Node>,
    pub scenes: Vec<Scene>,
    pub scene: Option<usize>,
    pub extensions_required: Vec<String>,
}

/// Bytes: in the file's binary chunk if there is no `uri`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer<'a> {
    #[serde(borrow, default)]
    pub uri: Option<Text<'a>>,
    pub byte_length: u64,
}

/// Text that is not copied unless it has escapes; embedded buffers are long.
#[derive(Debug, Deserialize)]
pub(super) struct Text<'a>(#[serde(borrow)] pub Cow<'a, str>);

/// A part of a buffer.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    #[serde(default)]
    pub byte_stride: Option<u64>,
    #[serde(default)]
    pub extensions: BTreeMap<String, IgnoredAny>,
}

/// How the bytes of a buffer view are read.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    #[serde(default)]
    pub buffer_view: Option<usize>,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
    #[serde(default)]
    pub normalized: bool,
    pub count: u64,
    #[serde(rename = "type")]
    pub shape: String,
    #[serde(default)]
    pub sparse: Option<Box<Sparse>>,
}

/// Elements of an accessor that differ from its buffer view.
#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub count: u64,
    pub indices: SparseIndices,
    pub values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub buffer_view: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub buffer_view: usize,
    #[serde(default)]
    pub byte_offset: u64,
}

#[derive(Debug, Deserialize)]
pub(super) struct Mesh {
    pub primitives: Vec<Primitive>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    /// Index of an accessor for each name.
    #[serde(default)]
    pub attributes: BTreeMap<String, usize>,
    #[serde(default)]
    pub mode: Option<u32>,
    #[serde(default)]
    pub extensions: PrimitiveExtensions,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_gaussian_splatting")]
    pub gaussians: Option<Box<GaussianExtension>>,
    #[serde(rename = "KHR_spz_gaussian_splats_compression")]
    pub spz: Option<CompressedView>,
    #[serde(rename = "KHR_spz_compression")]
    pub spz_first: Option<CompressedView>,
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub draco: Option<IgnoredAny>,
}

/// `KHR_gaussian_splatting`; older files have an empty object.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct GaussianExtension {
    pub kernel: Option<String>,
    pub color_space: Option<String>,
    pub projection: Option<String>,
    /// By their names, those that compress among them.
    pub extensions: BTreeMap<String, CompressedView>,
}

/// An extension that keeps a whole compressed file in a buffer view.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct CompressedView {
    #[serde(default)]
    pub buffer_view: Option<usize>,
}

/// A matrix (column by column), or translation, rotation `x, y, z, w` and scale.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub mesh: Option<u32>,
    pub children: Vec<u32>,
    pub matrix: Option<Box<[f64; 16]>>,
    pub translation: Option<Box<[f64; 3]>>,
    pub rotation: Option<Box<[f64; 4]>>,
    pub scale: Option<Box<[f64; 3]>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Scene {
    pub nodes: Vec<u32>,
}

/// Whether the text is a JSON object with `asset`, as every glTF document. So has the index of 3D Tiles,
/// which no glTF document is: it has a `root`.
pub(super) fn has_asset(json: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Probe {
        #[serde(rename = "asset")]
        _asset: BTreeMap<String, IgnoredAny>,
        root: Option<IgnoredAny>,
    }
    serde_json::from_slice::<Probe>(json).is_ok_and(|probe| probe.root.is_none())
}
