//! glTF documents built piece by piece.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use scenesplat_scene::formats::gltf::read_gltf;
use scenesplat_scene::gaussian_scene::sigmoid;
use scenesplat_scene::{GaussianScene, LoadedScene, ReadOptions};
use serde_json::{Value, json};
use std::path::Path;

pub(crate) const FLOAT: u32 = 5126;
pub(crate) const PREFIX: &str = "KHR_gaussian_splatting:";

/// A document under construction, with its bytes.
pub(crate) struct Doc {
    pub(crate) json: Value,
    pub(crate) bin: Vec<u8>,
}

impl Doc {
    pub(crate) fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "meshes": [],
            "nodes": [], "scene": 0, "scenes": [{"nodes": []}],
        });
        Self { json, bin: Vec::new() }
    }

    pub(crate) fn push(&mut self, list: &str, entry: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(entry);
        list.len() - 1
    }

    pub(crate) fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0xee);
        }
        let offset = self.bin.len();
        self.bin.extend_from_slice(bytes);
        let view = json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()});
        self.push("bufferViews", view)
    }

    pub(crate) fn accessor(
        &mut self,
        bytes: &[u8],
        component: u32,
        shape: &str,
        count: usize,
    ) -> usize {
        let view = self.view(bytes);
        let normalized = component != FLOAT;
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": component, "type": shape, "count": count,
                   "normalized": normalized}),
        )
    }

    pub(crate) fn floats(&mut self, values: &[f32], shape: &str, count: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(&bytes, FLOAT, shape, count)
    }

    /// A mesh of one primitive with the present attribute names.
    pub(crate) fn mesh(&mut self, scene: &GaussianScene, log_scale: bool) -> usize {
        let n = scene.len();
        let mut attributes = json!({});
        let mut set = |name: String, index: usize| attributes[name] = json!(index);
        let index = self.floats(scene.coord.as_flattened(), "VEC3", n);
        set("POSITION".into(), index);
        let quat: Vec<f32> = scene.quat.iter().flat_map(|q| [q[1], q[2], q[3], q[0]]).collect();
        let index = self.floats(&quat, "VEC4", n);
        set(format!("{PREFIX}ROTATION"), index);
        let size = |s: f32| if log_scale { s } else { f64::from(s).exp() as f32 };
        let scale: Vec<f32> = scene.log_scale.as_flattened().iter().map(|&s| size(s)).collect();
        let index = self.floats(&scale, "VEC3", n);
        set(format!("{PREFIX}SCALE"), index);
        let opacity: Vec<f32> = scene.opacity_logit.iter().map(|&v| sigmoid(v)).collect();
        let index = self.floats(&opacity, "SCALAR", n);
        set(format!("{PREFIX}OPACITY"), index);
        let index = self.floats(scene.sh_dc.as_flattened(), "VEC3", n);
        set(format!("{PREFIX}SH_DEGREE_0_COEF_0"), index);
        let k = scene.sh_rest_len();
        for l in 1..=usize::from(scene.sh_degree) {
            for c in 0..=2 * l {
                let at = (l * l - 1 + c) * 3;
                let rows = scene.sh_rest.chunks_exact(3 * k);
                let values: Vec<f32> = rows.flat_map(|row| row[at..at + 3].to_vec()).collect();
                let index = self.floats(&values, "VEC3", n);
                set(format!("{PREFIX}SH_DEGREE_{l}_COEF_{c}"), index);
            }
        }
        let about = json!({"kernel": "ellipse", "colorSpace": "srgb_rec709_display"});
        let primitive = json!({"attributes": attributes, "mode": 0,
                               "extensions": {"KHR_gaussian_splatting": about}});
        self.push("meshes", json!({"primitives": [primitive]}))
    }

    /// A node; shown by the scene if `root`.
    pub(crate) fn node(&mut self, node: Value, root: bool) -> usize {
        let index = self.push("nodes", node);
        if root {
            self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(index));
        }
        index
    }

    pub(crate) fn gltf(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&self.bin));
        json["buffers"] = json!([{"uri": uri, "byteLength": self.bin.len()}]);
        serde_json::to_vec(&json).unwrap()
    }

    pub(crate) fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        let mut text = serde_json::to_vec(&json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut out = b"glTF".to_vec();
        let total = 12 + 8 + text.len() + 8 + bin.len();
        for word in [2, total as u32, text.len() as u32] {
            out.extend_from_slice(&word.to_le_bytes());
        }
        out.extend_from_slice(b"JSON");
        out.extend_from_slice(&text);
        out.extend_from_slice(&(bin.len() as u32).to_le_bytes());
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(&bin);
        out
    }

    pub(crate) fn read(&self) -> LoadedScene {
        read(&self.glb())
    }

    pub(crate) fn error(&self) -> String {
        let options = ReadOptions::default();
        read_gltf(&self.glb(), Path::new("a.glb"), &options).unwrap_err().to_string()
    }
}

pub(crate) fn read(bytes: &[u8]) -> LoadedScene {
    read_gltf(bytes, Path::new("a.glb"), &ReadOptions::default()).unwrap()
}

pub(crate) fn close(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b} within {tolerance}");
    }
}
