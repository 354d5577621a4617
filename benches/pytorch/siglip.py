"""SigLIP of transformers with weights from an integer hash: numbers for `crates/vision/src/siglip/tests.rs`, and its speed.

    venv/bin/pip install torch==2.15.0 transformers==5.23.0 numpy==2.4.6
    venv/bin/python siglip.py --numbers > ../../crates/vision/tests/data/siglip_mini.json
    venv/bin/python siglip.py --time --threads 2 --runs 3
"""

import argparse
import json
import math
import time

import numpy as np
import torch
import transformers
from transformers import SiglipConfig, SiglipModel

MASK = (1 << 64) - 1
SEED = 19
MINI = {
    "model_type": "siglip",
    "text_config": {
        "model_type": "siglip_text_model",
        "vocab_size": 40,
        "hidden_size": 24,
        "intermediate_size": 40,
        "num_hidden_layers": 2,
        "num_attention_heads": 3,
        "max_position_embeddings": 12,
    },
    "vision_config": {
        "model_type": "siglip_vision_model",
        "hidden_size": 24,
        "intermediate_size": 40,
        "num_hidden_layers": 2,
        "num_attention_heads": 3,
        "image_size": 34,
        "patch_size": 8,
    },
}


def unit(name, length, seed):
    """`length` numbers in -1..1, as `scenesplat_models::weights::unit` makes them."""
    code = 0xCBF29CE484222325
    for byte in name.encode():
        code = ((code ^ byte) * 0x100000001B3) & MASK
    start = np.uint64(code ^ ((seed * 0xD6E8FEB86659FD93) & MASK))
    with np.errstate(over="ignore"):
        z = start + np.arange(1, length + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return ((z >> np.uint64(40)).astype(np.int64) - 8388608).astype(np.float32) * np.float32(2.0**-23)


def parameter(name, shape):
    values = unit(name, math.prod(shape), SEED)
    if len(shape) == 1 and name.endswith("weight"):
        offset, factor = 1.0, 0.25
    elif len(shape) == 1:
        offset, factor = 0.0, 0.125
    else:
        offset, factor = 0.0, math.sqrt(3.0 / max(1, math.prod(shape[1:])))
    values = values * np.float32(factor) + np.float32(offset)
    return torch.from_numpy(values.reshape(shape))


def numbers():
    model = SiglipModel(SiglipConfig(**json.loads(json.dumps(MINI)))).eval()
    shapes = {}
    with torch.no_grad():
        for name, value in model.state_dict().items():
            if name.endswith("position_ids"):
                continue
            shapes[name] = list(value.shape)
            value.copy_(parameter(name, list(value.shape)))
        side = MINI["vision_config"]["image_size"]
        planes = torch.from_numpy(unit("planes", 2 * 3 * side * side, SEED)).reshape(2, 3, side, side)
        ids = torch.tensor([[5, 6, 7, 1] + [0] * 8, [39, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 1]])
        vision = model.vision_model(pixel_values=planes)
        text = model.text_model(input_ids=ids)
        out = {
            "made_with": f"transformers {transformers.__version__}, torch {torch.__version__}",
            "seed": SEED,
            "config": MINI,
            "shapes": shapes,
            "ids": ids.tolist(),
            "image": vision.pooler_output.flatten().tolist(),
            "text": text.pooler_output.flatten().tolist(),
        }
    print(json.dumps(out))


def timed(threads, runs):
    torch.set_num_threads(threads)
    config = {"vision_config": {"image_size": 512}, "text_config": {"vocab_size": 8}}
    for dtype in [torch.float32, torch.bfloat16]:
        model = SiglipModel(SiglipConfig(**config)).vision_model.eval().to(dtype)
        for batch in [1, 8]:
            planes = torch.rand(batch, 3, 512, 512).to(dtype)
            seconds = []
            with torch.no_grad():
                for _ in range(runs + 1):
                    start = time.perf_counter()
                    model(pixel_values=planes)
                    seconds.append((time.perf_counter() - start) / batch)
            seconds = sorted(seconds[1:])
            print(f"{dtype} batch {batch}: best {seconds[0]:.3f} s a picture, median {seconds[len(seconds) // 2]:.3f} s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--numbers", action="store_true")
    parser.add_argument("--time", action="store_true")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    if options.numbers:
        numbers()
    if options.time:
        timed(options.threads, options.runs)
