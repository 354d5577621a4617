use super::super::graph::Graph;
use super::*;

/// What reading the model says.
fn refused(made: &Value, bytes: &[u8], file: &str, part: &str) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.json");
    std::fs::write(&path, made.to_string()).unwrap();
    std::fs::write(folder.path().join("made.bin"), bytes).unwrap();
    let error = Detector::open(&path, DetectorSettings::default()).unwrap_err().to_string();
    assert!(error.contains(part) && error.contains(file), "{error}, not {part:?} of {file}");
}

#[test]
fn files_that_are_no_such_graph_are_refused_by_name() {
    let good = miniature_detector();
    let (json, bytes) = (good.json(), &*good.bytes);
    let with = |edit: &dyn Fn(&mut Value)| {
        let mut json = json.clone();
        edit(&mut json);
        json
    };
    let node = |name: &str| {
        json["modelTopology"]["node"]
            .as_array()
            .unwrap()
            .iter()
            .position(|n| n["name"] == name)
            .unwrap()
    };
    let [places, list, parts, scores] = ["places", "list", "parts", "scores"].map(node);
    let edit = |at: usize, key: &'static str, value: Value| {
        with(&move |json: &mut Value| json["modelTopology"]["node"][at][key] = value.clone())
    };
    refused(&json!({"format": "x"}), bytes, "made.json", "is no graph model");
    refused(&with(&|j| j["format"] = json!("layers-model")), bytes, "made.json", "layers-model");
    refused(
        &edit(scores, "op", json!("Softplus")),
        bytes,
        "made.json",
        "node \"scores\" (Softplus): this kind of layer",
    );
    refused(
        &edit(places, "input", json!(["pixels", "gone"])),
        bytes,
        "made.json",
        "no node is called \"gone\"",
    );
    refused(
        &edit(list, "input", json!(["scores", "shape"])),
        bytes,
        "made.json",
        "needs its own result",
    );
    refused(
        &edit(list, "input", json!(["sum", "widths"])),
        bytes,
        "made.json",
        "node \"list\": 20956 values do not make",
    );
    refused(
        &edit(parts, "input", json!(["list", "widths"])),
        bytes,
        "made.json",
        "node \"parts\": has 2 inputs; 3",
    );
    refused(
        &edit(scores, "input", json!(["parts:2"])),
        bytes,
        "made.json",
        "node \"scores\": its input has no result 2",
    );
    let same =
        json!({"padding": {"s": "U0FNRQ=="}, "strides": {"list": {"i": ["1", "16", "32", "1"]}}});
    refused(&edit(places, "attr", same), bytes, "made.json", "do not make shape [1, 169, 124]");
    for (key, value, part) in [
        ("padding", json!({"s": "RVhQTElDSVQ="}), "padding is Some(\"EXPLICIT\")"),
        ("data_format", json!({"s": "TkNIVw=="}), "data_format is \"NCHW\""),
        ("dilations", json!({"list": {"i": ["1", "2", "1", "1"]}}), "dilations"),
        ("strides", json!({"list": {"i": ["1", "0", "1", "1"]}}), "strides is [1, 0, 1, 1]"),
    ] {
        let bad = with(&|j| j["modelTopology"]["node"][places]["attr"][key] = value.clone());
        refused(&bad, bytes, "made.json", part);
    }
    refused(&json, &bytes[1..], "made.bin", "are more than the");
    refused(&json, &[bytes, &[0; 3]].concat(), "made.bin", "3 bytes belong to no weight");
    refused(
        &with(&|j| j["weightsManifest"][0]["paths"] = json!(["../made.bin"])),
        bytes,
        "../made.bin",
        "no file beside",
    );
    refused(
        &with(&|j| j["weightsManifest"][0]["paths"] = json!(["none.bin"])),
        bytes,
        "none.bin",
        "No such file",
    );
    refused(
        &with(&|j| j["weightsManifest"][0]["weights"][1]["shape"] = json!([u64::MAX, 2])),
        bytes,
        "made.bin",
        "kernel",
    );
    refused(
        &with(&|j| j["weightsManifest"][0]["weights"][2]["dtype"] = json!("complex64")),
        bytes,
        "made.bin",
        "complex64",
    );
    let mut damaged = bytes.to_vec();
    let bias = 16 + 2 * 32 * 32 * 3 * 124;
    damaged[bias + 8..bias + 12].copy_from_slice(&f32::NAN.to_le_bytes());
    refused(&json, &damaged, "made.bin", "bias: value 2 is NaN");
}

#[test]
fn weights_are_read_in_every_form() {
    let mut made = GraphFile::default();
    made.node("picture", "Placeholder", &[], json!({}));
    let quantized = |name: &str, dtype: &str| {
        json!({"name": name, "shape": [2], "dtype": "float32",
               "quantization": {"dtype": dtype, "scale": 0.5, "min": -1.0}})
    };
    made.constant(quantized("bytes", "uint8"), [3, 255]);
    made.constant(quantized("words", "uint16"), [1, 1, 0, 2]);
    made.constant(quantized("halves", "float16"), [0x00, 0x3e, 0x00, 0xc0]);
    made.floats("plain", &[2], &[0.25, -8.0]);
    made.node("a", "Add", &["bytes", "words"], json!({}));
    made.node("b", "Add", &["halves", "plain"], json!({}));
    made.node("all", "AddV2", &["a", "b"], json!({}));
    made.node("out", "AddV2", &["picture", "all"], json!({}));
    made.outputs = vec![("one", "out")];
    let folder = tempfile::tempdir().unwrap();
    let graph = Graph::open(&made.write(folder.path())).unwrap();
    let run = graph.run(Tensor::floats(vec![1, 2], vec![100.0, 200.0])).unwrap();
    // 3 / 2 − 1, 257 / 2 − 1, 1.5, 0.25; 255 / 2 − 1, 512 / 2 − 1, −2, −8.
    let sums = [0.5 + 127.5 + 1.5 + 0.25 + 100.0, 126.5 + 255.0 - 2.0 - 8.0 + 200.0];
    assert_eq!((run[0].0, run[0].1.as_floats().unwrap()), ("one", &sums[..]));
}

#[test]
fn an_output_that_another_layer_reads_keeps_its_values() {
    let mut made = GraphFile::default();
    made.node("picture", "Placeholder", &[], json!({}));
    made.node("bent", "LeakyRelu", &["picture"], json!({}));
    made.node("again", "LeakyRelu", &["bent"], json!({}));
    made.outputs = vec![("a", "bent:0"), ("b", "again:0")];
    let folder = tempfile::tempdir().unwrap();
    let graph = Graph::open(&made.write(folder.path())).unwrap();
    let found = graph.run(Tensor::floats(vec![2], vec![-1.0, 3.0])).unwrap();
    let values = |at: usize| found[at].1.as_floats().unwrap();
    assert_eq!((found[0].0, values(0), values(1)), ("a", &[-0.2, 3.0][..], &[-0.2 * 0.2, 3.0][..]));
}
