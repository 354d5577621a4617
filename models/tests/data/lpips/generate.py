"""LPIPS of made-up pictures with made-up weights: `expected.json`.

The weights are a hash of their names and places, so that the test makes the same ones. The network
is written with torch's operations only. torch 2 on a CPU, float32; run with no arguments.
"""

import json
import pathlib

import numpy as np
import torch
import torch.nn.functional as F

ALEX = [(0, 11, 3, 64, 4, 2, None), (3, 5, 64, 192, 1, 2, (3, 2)), (6, 3, 192, 384, 1, 1, (3, 2)),
        (8, 3, 384, 256, 1, 1, None), (10, 3, 256, 256, 1, 1, None)]
VGG_CHANNELS = [(0, 3, 64), (2, 64, 64), (5, 64, 128), (7, 128, 128), (10, 128, 256), (12, 256, 256),
                (14, 256, 256), (17, 256, 512), (19, 512, 512), (21, 512, 512), (24, 512, 512),
                (26, 512, 512), (28, 512, 512)]
BEFORE_POOL = {2, 7, 14, 21, 28}
VGG = [(i, 3, a, b, 1, 1, (2, 2) if i in (5, 10, 17, 24) else None) for i, a, b in VGG_CHANNELS]
SHIFT = torch.tensor([-.030, -.088, -.188]).view(1, 3, 1, 1)
SCALE = torch.tensor([.458, .448, .450]).view(1, 3, 1, 1)


def uniform(seed, count):
    """splitmix64 of seed * 2**32 + place, upper 24 bits, in [0, 1)."""
    with np.errstate(over="ignore"):
        z = np.arange(count, dtype=np.uint64) + np.uint64(seed << 32)
        z = z * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return ((z >> np.uint64(40)).astype(np.float32)) / np.float32(1 << 24)


def weights(net):
    seed, out = (1 if net is ALEX else 100), []
    tap = 0
    for index, side, a, b, *_ in net:
        bound = np.float32((6.0 / (a * side * side)) ** 0.5)
        w = (2 * uniform(seed, a * b * side * side) - 1) * bound
        bias = (2 * uniform(seed + 1, b) - 1) * np.float32(0.1)
        lin = None
        if net is ALEX or index in BEFORE_POOL:
            lin = uniform(seed + 2, b) * np.float32(0.02)
            tap += 1
        out.append((torch.tensor(w).view(b, a, side, side), torch.tensor(bias), lin))
        seed += 3
    return out


def picture(seed, height, width):
    return torch.tensor(uniform(seed, height * width * 3)).view(height, width, 3)


def distance(net, params, a, b):
    x = torch.stack([a, b]).permute(0, 3, 1, 2)
    x = (2 * x - 1 - SHIFT) / SCALE
    total = 0.0
    for (index, _, _, _, stride, padding, pool), (w, bias, lin) in zip(net, params):
        if pool:
            x = F.max_pool2d(x, pool[0], pool[1])
        x = F.relu(F.conv2d(x, w, bias, stride, padding))
        if lin is not None:
            n = x / (x.pow(2).sum(1, keepdim=True).sqrt() + 1e-10)
            d = (n[0] - n[1]) ** 2
            total += (d * torch.tensor(lin).view(-1, 1, 1)).sum(0).mean().item()
    return total


expected = {}
for name, net in (("alex", ALEX), ("vgg", VGG)):
    params = weights(net)
    for height, width in ((31, 31), (40, 57)):
        a, b = picture(1000, height, width), picture(1001, height, width)
        mixed = 0.9 * a + 0.1 * b
        expected[f"{name}_{height}x{width}"] = [distance(net, params, a, b), distance(net, params, a, mixed)]
path = pathlib.Path(__file__).with_name("expected.json")
path.write_text(json.dumps(expected, indent=1) + "\n")
print(path.read_text())
