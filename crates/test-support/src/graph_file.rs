//! Graphs of layers in the format of TensorFlow.js, which the detector reads.

use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A model file in the making.
#[derive(Default)]
pub struct GraphFile {
    /// Layers.
    pub nodes: Vec<Value>,
    /// What the bytes are.
    pub weights: Vec<Value>,
    /// Of all weights.
    pub bytes: Vec<u8>,
    /// Keys and nodes of the outputs.
    pub outputs: Vec<(&'static str, &'static str)>,
}

impl GraphFile {
    /// Adds a layer.
    pub fn node(&mut self, name: &str, op: &str, input: &[&str], attr: Value) {
        let mut node = json!({"name": name, "op": op, "input": input});
        node["attr"] = attr;
        self.nodes.push(node);
    }

    /// Adds weights, as the file describes them, with their bytes.
    pub fn constant(&mut self, weight: Value, bytes: impl IntoIterator<Item = u8>) {
        self.nodes.push(json!({"name": weight["name"], "op": "Const", "attr": {}}));
        self.weights.push(weight);
        self.bytes.extend(bytes);
    }

    /// Adds weights of 32 bits.
    pub fn floats(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes());
        self.constant(json!({"name": name, "shape": shape, "dtype": "float32"}), bytes);
    }

    /// Adds whole numbers.
    pub fn ints(&mut self, name: &str, values: &[i32]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes());
        self.constant(json!({"name": name, "shape": [values.len()], "dtype": "int32"}), bytes);
    }

    /// The file's text.
    pub fn json(&self) -> Value {
        let outputs: serde_json::Map<String, Value> = self
            .outputs
            .iter()
            .map(|(key, name)| ((*key).to_owned(), json!({"name": name})))
            .collect();
        json!({
            "format": "graph-model",
            "signature": {"inputs": {"picture": {"name": "picture:0"}}, "outputs": outputs},
            "modelTopology": {"node": self.nodes},
            "weightsManifest": [{"paths": ["made.bin"], "weights": self.weights}],
        })
    }

    /// Writes made.json and made.bin; the path of the first.
    pub fn write(&self, folder: &Path) -> PathBuf {
        let path = folder.join("made.json");
        std::fs::write(&path, self.json().to_string()).unwrap();
        std::fs::write(folder.join("made.bin"), &self.bytes).unwrap();
        path
    }
}

/// A detector of 13 × 13 places whose scores of cups (class 41) and chairs (56) follow from blue and red in the middle of
/// each place: logits `blue - 2` and `red - 1`, all others −9. Boxes reach 1, 0, 2 and 3 strides to their sides.
pub fn miniature_detector() -> GraphFile {
    let mut made = GraphFile::default();
    made.node("picture", "Placeholder", &[], json!({}));
    made.ints("rows", &[0, 2, 3, 1]);
    made.node("pixels", "Transpose", &["picture", "rows"], json!({}));
    let mut kernel = vec![half::f16::ZERO; 32 * 32 * 3 * 124];
    let middle = (16 * 32 + 16) * 3;
    kernel[middle * 124 + 41] = half::f16::ONE;
    kernel[(middle + 2) * 124 + 56] = half::f16::ONE;
    let kernel = kernel.iter().flat_map(|v| v.to_le_bytes());
    let half = json!({"name": "kernel", "shape": [32, 32, 3, 124], "dtype": "float32",
                      "quantization": {"dtype": "float16"}});
    made.constant(half, kernel);
    let valid =
        json!({"padding": {"s": "VkFMSUQ="}, "strides": {"list": {"i": ["1", "32", "32", "1"]}}});
    made.node("places", "Conv2D", &["pixels", "kernel"], valid);
    let mut bias = vec![0.0; 124];
    bias[..80].fill(-9.0);
    (bias[41], bias[56]) = (-2.0, -1.0);
    // Softmax of 60 beside 0 is 1.
    for (side, bin) in [1, 0, 2, 3].into_iter().enumerate() {
        bias[80 + side * 11 + bin] = 60.0;
    }
    made.floats("bias", &[124], &bias);
    made.node("sum", "AddV2", &["places", "bias"], json!({}));
    // A shape as exporters compute it: a default without an index, and a sum.
    made.constant(json!({"name": "none", "shape": [0, 1], "dtype": "int32"}), []);
    made.ints("three", &[3]);
    made.constant(json!({"name": "nothing", "shape": [0], "dtype": "int32"}), []);
    made.ints("zero", &[0]);
    made.node("zeros", "SparseToDense", &["none", "three", "nothing", "zero"], json!({}));
    made.ints("flat", &[1, 169, 124]);
    made.node("shape", "AddV2", &["flat", "zeros"], json!({}));
    made.node("list", "Reshape", &["sum", "shape"], json!({}));
    made.ints("widths", &[80, 44]);
    made.ints("axis", &[-1]);
    made.node("parts", "SplitV", &["list", "widths", "axis"], json!({"num_split": {"i": "2"}}));
    made.node("scores", "Sigmoid", &["parts"], json!({}));
    made.node("distances", "Identity", &["parts:1", "^scores"], json!({}));
    made.outputs = vec![("a", "distances:0"), ("b", "scores:0")];
    made
}
