"""Tiny ONNX files for the tests of `crates/vision/src/onnx`: a network that answers clicks by colour, and a picture encoder.

    venv/bin/pip install onnx==1.23.2 onnxruntime==1.32.0 numpy==2.4.6
    venv/bin/python onnx_miniature.py ../../crates/vision/tests/data/onnx

`encoder.onnx`: pictures of 64 x 64 to means of 4 x 4 (`image_embed`) and of 2 x 2 pixels (`high_res_feats_0`).
`decoder.onnx`: of each click the colour c there, and the logits 40 (t - |colour - c|^2) at 32 x 32 for t of `LIMITS`,
at least -16 and at most 16.
`fixed/decoder.onnx`: the same for exactly four clicks at once, with four masks, the first one of t = 0.1.
`features.onnx`: mean of each channel, and mean square of the first two, of 32 x 32 pixels.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

LIMITS = [0.05, 0.2, 0.4]
EXPECTED = [0.75, 0.85, 0.95]


def model(name, nodes, inputs, outputs, constants):
    value = lambda pair: helper.make_tensor_value_info(pair[0], TensorProto.FLOAT, pair[1])
    initializers = [numpy_helper.from_array(np.asarray(v), k) for k, v in constants.items()]
    graph = helper.make_graph(nodes, name, [value(p) for p in inputs], [value(p) for p in outputs], initializers)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8, producer_name="")
    onnx.checker.check_model(made, full_check=True)
    return made


def encoder():
    pool = lambda out, size: helper.make_node("AveragePool", ["image"], [out], kernel_shape=[size] * 2, strides=[size] * 2)
    return model(
        "encoder",
        [pool("image_embed", 4), pool("high_res_feats_0", 2)],
        [("image", [1, 3, 64, 64])],
        [("image_embed", [1, 3, 16, 16]), ("high_res_feats_0", [1, 3, 32, 32])],
        {},
    )


def decoder(clicks, limits, expected):
    f = lambda *v: np.array(v, np.float32)
    y, x = np.mgrid[0:16, 0:16].astype(np.float32)
    node = helper.make_node
    nodes = [
        # Which cell of image_embed a click is in: nearly all of a softmax over squared distances.
        node("Mul", ["point_coords", "to_cells"], ["scaled"]),
        node("Sub", ["scaled", "half"], ["cells"]),
        node("Split", ["cells", "ones_2"], ["cx", "cy"], axis=2),
        node("Sub", ["grid_x", "cx"], ["dx"]),
        node("Sub", ["grid_y", "cy"], ["dy"]),
        node("Mul", ["dx", "dx"], ["dx2"]),
        node("Mul", ["dy", "dy"], ["dy2"]),
        node("Add", ["dx2", "dy2"], ["d2"]),
        node("Mul", ["d2", "sharp"], ["nearness"]),
        node("Softmax", ["nearness"], ["share"], axis=2),
        node("Reshape", ["image_embed", "flat"], ["embed_flat"]),
        node("Transpose", ["embed_flat"], ["embed_rows"], perm=[0, 2, 1]),
        node("MatMul", ["share", "embed_rows"], ["colour_row"]),
        node("Reshape", ["colour_row", "as_pixel"], ["colour"]),
        node("Sub", ["high_res_feats_0", "colour"], ["apart"]),
        node("Mul", ["apart", "apart"], ["apart_2"]),
        node("ReduceSum", ["apart_2", "channel"], ["distance"], keepdims=1),
        node("Sub", ["limits", "distance"], ["inside"]),
        node("Mul", ["inside", "steep"], ["unbounded"]),
        node("Clip", ["unbounded", "lowest", "highest"], ["steep_inside"]),
        node("Reshape", ["point_labels", "as_one"], ["label"]),
        node("Mul", ["steep_inside", "label"], ["of_label"]),
        node("Mul", ["mask_input", "has_mask_input"], ["given"]),
        node("Add", ["of_label", "given"], ["masks"]),
        node("Mul", ["point_labels", "expected"], ["iou_predictions"]),
    ]
    constants = {
        "to_cells": f(0.25),
        "half": f(0.5),
        "ones_2": np.array([1, 1], np.int64),
        "grid_x": x.reshape(1, 1, 256),
        "grid_y": y.reshape(1, 1, 256),
        "sharp": f(-8.0),
        "flat": np.array([1, 3, 256], np.int64),
        "as_pixel": np.array([-1, 3, 1, 1], np.int64),
        "as_one": np.array([-1, 1, 1, 1], np.int64),
        "channel": np.array([1], np.int64),
        "limits": f(*limits).reshape(1, -1, 1, 1),
        "steep": np.float32(40.0),
        "lowest": np.float32(-16.0),
        "highest": np.float32(16.0),
        "expected": f(*expected).reshape(1, -1),
    }
    inputs = [
        ("image_embed", [1, 3, 16, 16]),
        ("high_res_feats_0", [1, 3, 32, 32]),
        ("point_coords", [clicks, 1, 2]),
        ("point_labels", [clicks, 1]),
        ("mask_input", [clicks, 1, 32, 32]),
        ("has_mask_input", [1]),
    ]
    outputs = [("masks", [clicks, len(limits), 32, 32]), ("iou_predictions", [clicks, len(limits)])]
    return model("decoder", nodes, inputs, outputs, constants)


def features():
    node = helper.make_node
    nodes = [
        node("ReduceMean", ["pixel_values"], ["means"], axes=[2, 3], keepdims=0),
        node("Mul", ["pixel_values", "pixel_values"], ["squares"]),
        node("ReduceMean", ["squares"], ["mean_squares"], axes=[2, 3], keepdims=0),
        node("Slice", ["mean_squares", "from", "to", "axis"], ["two"]),
        node("Concat", ["means", "two"], ["pooler_output"], axis=1),
        node("Identity", ["pixel_values"], ["last_hidden_state"]),
    ]
    constants = {"from": np.array([0], np.int64), "to": np.array([2], np.int64), "axis": np.array([1], np.int64)}
    inputs = [("pixel_values", ["n", 3, 32, 32])]
    return model("features", nodes, inputs, [("last_hidden_state", ["n", 3, 32, 32]), ("pooler_output", ["n", 5])], constants)


def main():
    folder = Path(sys.argv[1])
    (folder / "fixed").mkdir(parents=True, exist_ok=True)
    onnx.save(encoder(), folder / "encoder.onnx")
    onnx.save(decoder("clicks", LIMITS, EXPECTED), folder / "decoder.onnx")
    onnx.save(decoder(4, [0.1, *LIMITS], [0.7, *EXPECTED]), folder / "fixed" / "decoder.onnx")
    onnx.save(encoder(), folder / "fixed" / "encoder.onnx")
    onnx.save(features(), folder / "features.onnx")


if __name__ == "__main__":
    main()
