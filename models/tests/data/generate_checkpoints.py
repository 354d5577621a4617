"""Writes the checkpoints that `weights.rs` reads.

Run with Python 3.11, torch 2.15.0, numpy 2.4.6, safetensors 0.8.0:

    python generate_checkpoints.py

The network is a Point Transformer V3 too small to be of use, its values the integer hash of
`src/weights/hash_init.rs`, so a test can say what every tensor of every file must be.
"""

import collections
import json
import math
import os
import pathlib
import zipfile

import numpy as np
import torch
from safetensors.torch import save_file

HERE = pathlib.Path(__file__).parent
SEED = 7
STUDENT_SEED = 8
CONFIG = {
    "in_channels": 2,
    "stride": [2],
    "enc_depths": [1, 1],
    "enc_channels": [4, 6],
    "enc_num_head": [2, 3],
    "enc_patch_size": [16, 16],
    "dec_depths": [1],
    "dec_channels": [4],
    "dec_num_head": [2],
    "dec_patch_size": [16],
    "mlp_ratio": 1,
    "drop_path": 0.0,
}
NUM_CLASSES = 3


# ---- The integer hash. ----


def unit(name, count, seed):
    mask = (1 << 64) - 1
    h = 0xCBF29CE484222325
    for byte in name.encode():
        h = ((h ^ byte) * 0x100000001B3) & mask
    h ^= (seed * 0xD6E8FEB86659FD93) & mask
    with np.errstate(over="ignore"):
        z = np.uint64(h) + np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    integers = (z >> np.uint64(40)).astype(np.int64) - 8388608
    return integers.astype(np.float32) * np.float32(2.0**-23)


def parameter(name, shape, seed=SEED):
    if name.endswith("num_batches_tracked"):
        return torch.zeros(shape, dtype=torch.int64)
    values = unit(name, math.prod(shape), seed)
    offset, factor = 0.0, 0.125
    if name.endswith("running_var"):
        offset, factor = 1.0, 0.5
    elif name.endswith("running_mean"):
        pass
    elif len(shape) == 1 and name.endswith("weight"):
        offset, factor = 1.0, 0.25
    elif len(shape) > 1:
        factor = np.float32(math.sqrt(3.0 / math.prod(shape[1:])))
        if name.endswith("qkv.weight"):
            factor = factor * np.float32(2.0)
    values = values * np.float32(factor) + np.float32(offset)
    return torch.from_numpy(values.reshape(shape).copy())


# ---- Names and shapes of the network. ----


def linear(name, cin, cout):
    return {f"{name}.weight": (cout, cin), f"{name}.bias": (cout,)}


def norm(name, c, batch):
    out = {f"{name}.weight": (c,), f"{name}.bias": (c,)}
    if batch:
        out |= {f"{name}.running_mean": (c,), f"{name}.running_var": (c,)}
        out[f"{name}.num_batches_tracked"] = ()
    return out


def block(name, c):
    return {
        f"{name}.cpe.0.weight": (c, 3, 3, 3, c),
        f"{name}.cpe.0.bias": (c,),
        **linear(f"{name}.cpe.1", c, c),
        **norm(f"{name}.cpe.2", c, False),
        **norm(f"{name}.norm1.0", c, False),
        **linear(f"{name}.attn.qkv", c, 3 * c),
        **linear(f"{name}.attn.proj", c, c),
        **norm(f"{name}.norm2.0", c, False),
        **linear(f"{name}.mlp.0.fc1", c, CONFIG["mlp_ratio"] * c),
        **linear(f"{name}.mlp.0.fc2", CONFIG["mlp_ratio"] * c, c),
    }


def shapes():
    (c0, c1), (d0,) = CONFIG["enc_channels"], CONFIG["dec_channels"]
    return {
        "embedding.stem.conv.weight": (c0, 5, 5, 5, CONFIG["in_channels"]),
        **norm("embedding.stem.norm", c0, True),
        **block("enc.enc0.block0", c0),
        **linear("enc.enc1.down.proj", c0, c1),
        **norm("enc.enc1.down.norm.0", c1, True),
        **block("enc.enc1.block0", c1),
        **linear("dec.dec0.up.proj.0", c1, d0),
        **norm("dec.dec0.up.proj.1", d0, True),
        **linear("dec.dec0.up.proj_skip.0", c0, d0),
        **norm("dec.dec0.up.proj_skip.1", d0, True),
        **block("dec.dec0.block0", d0),
    }


def state(prefix="", seed=SEED):
    return collections.OrderedDict(
        (prefix + name, parameter(name, shape, seed)) for name, shape in shapes().items()
    )


def head():
    return {n: parameter(n, s) for n, s in linear("seg_head", CONFIG["dec_channels"][0], NUM_CLASSES).items()}


# ---- Files. ----


def save(value, name, **options):
    path = HERE / name
    torch.save(value, path, **options)


def trainer():
    """As the trainer of SceneSplat on several GPUs: `module.` names, AdamW after one step."""
    weights = {n: torch.nn.Parameter(t) for n, t in state().items() if t.is_floating_point()}
    block_names = [n for n in weights if "block" in n]
    optimizer = torch.optim.AdamW(
        [
            {"params": [p for n, p in weights.items() if n not in block_names], "lr": 0.006},
            {"params": [weights[n] for n in block_names], "lr": 0.0006},
        ],
        weight_decay=0.05,
    )
    # AdamW keeps moments of what has had a gradient; a few are enough here.
    for name in ["enc.enc0.block0.norm1.0.weight", "embedding.stem.norm.bias"]:
        weights[name].grad = torch.ones_like(weights[name])
    optimizer.step()
    saved = optimizer.state_dict()
    scheduler = torch.optim.lr_scheduler.OneCycleLR(optimizer, [0.006, 0.0006], total_steps=10)
    return {
        "epoch": 3,
        "state_dict": state("module.backbone."),
        "optimizer": saved,
        "scheduler": {k: v for k, v in scheduler.state_dict().items() if not callable(v)},
        "scaler": None,
        "best_metric_value": 0.5,
    }


def self_supervised():
    entries = collections.OrderedDict()
    entries |= state("backbone_student.", STUDENT_SEED)
    entries |= state("backbone_teacher.", SEED)
    for name, shape in [
        ("mae_head.0.weight", (2, 4)),
        ("mae_head.0.bias", (2,)),
        ("dino_head.mlp.0.weight", (3, 6)),
        ("ibot_head.mlp.0.weight", (3, 4)),
    ]:
        entries[name] = parameter(name, shape)
    return {"epoch": 1, "state_dict": entries, "best_metric_value": 0}


def embeddings():
    return torch.from_numpy(unit("text", 40, SEED).reshape(5, 8).copy())


def hub():
    tensors = list(state("backbone.").items())
    half = len(tensors) // 2
    parts = {
        "model-00001-of-00002.safetensors": dict(tensors[:half]),
        "model-00002-of-00002.safetensors": dict(tensors[half:]),
    }
    folder = HERE / "hub"
    folder.mkdir(exist_ok=True)
    for name, part in parts.items():
        save_file(part, folder / name, metadata={"format": "pt"})
        (folder / name).chmod(0o644)
    index = {
        "metadata": {"total_size": sum(t.numel() * t.element_size() for _, t in tensors)},
        "weight_map": {n: file for file, part in parts.items() for n in part},
    }
    (folder / "model.safetensors.index.json").write_text(json.dumps(index) + "\n")
    (folder / "config.json").write_text(json.dumps(CONFIG, indent=1) + "\n")


class Command:
    """Unpickled by Python, this would make a folder."""

    def __reduce__(self):
        return os.mkdir, ("executed_by_the_pickle",)


def odd_values():
    """Types, strides and containers a state dict may hold."""
    base = torch.arange(12, dtype=torch.float32)
    shared = {"w": base[2:8].reshape(2, 3)}
    return {
        # Named twice: the second is a reference to the first.
        "model": shared,
        "state_dict": {
            "f64": torch.tensor([1.5, -2.0], dtype=torch.float64),
            "i16": torch.tensor([-3, 4], dtype=torch.int16),
            "i32": torch.tensor([-5, 6], dtype=torch.int32),
            "bool": torch.tensor([True, False]),
            "i8": torch.tensor([1], dtype=torch.int8),
            "complex": torch.tensor([1j]),
            "scalar": torch.tensor(2.5),
            "empty": torch.zeros(0, 3),
            "expanded": torch.ones(1).expand(7),
            "window": shared["w"],
            "every_other": base[::2],
            "permuted": base.reshape(2, 3, 2).permute(2, 0, 1),
            "parameter": torch.nn.Parameter(torch.tensor([9.0])),
            "number": 3,
            "nested": {"w": base[:1]},
            5: torch.tensor([5.0]),
        },
        "again": shared,
    }


def main():
    plain = state("backbone.") | head()
    save(trainer(), "trainer.pth")
    save(plain, "plain.pth")
    save(self_supervised(), "self_supervised.pth")
    save({n: t.half() if t.is_floating_point() else t for n, t in state().items()}, "half.pth")
    save(
        {n: t.permute(1, 2, 3, 4, 0).contiguous() if t.dim() == 5 else t for n, t in state().items()},
        "spconv1.pth",
    )
    text = embeddings()
    save(text, "text_f32.pt")
    save(text.half(), "text_f16.pt")
    save(text.bfloat16(), "text_bf16.pt")
    save(text.t().contiguous().t(), "text_transposed.pt")
    hub()
    # Same state, other containers: the newest pickle, and an archive without checksums.
    small = {"a.weight": parameter("a.weight", (2, 3)), "a.bias": parameter("a.bias", (2,))}
    save(small, "protocol5.pth", pickle_protocol=5)
    torch.serialization.set_crc32_options(False)
    save(small, "no_checksums.pth")
    torch.serialization.set_crc32_options(True)
    save(small, "before_1_6.pth", _use_new_zipfile_serialization=False)
    save(odd_values(), "odd_values.pth")
    save(Command(), "command.pth")
    save({"state_dict": small | {"b": Command()}, "hook": Command()}, "command_inside.pth")
    # PyTorch never compresses; a file packed again by hand is.
    with zipfile.ZipFile(HERE / "protocol5.pth") as source:
        with zipfile.ZipFile(HERE / "compressed.pth", "w", zipfile.ZIP_DEFLATED) as target:
            for name in source.namelist():
                info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                info.compress_type = zipfile.ZIP_DEFLATED
                target.writestr(info, source.read(name))
    total = sum(p.stat().st_size for p in HERE.rglob("*") if p.is_file())
    print(f"{total} bytes in all")


if __name__ == "__main__":
    main()
