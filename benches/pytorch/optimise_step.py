"""A plain PyTorch loop of the training step of `scenesplat optimise`, for a comparison on one machine.

    cargo run --release -p scenesplat-optimisation --example optimise_room -- OUT steps=100 threads=1
    python benches/pytorch/optimise_step.py OUT --steps 100 --threads 1

Reads what the example has written (`initial.ply`, `cameras.json`, `images/`, `depth/`) and does the same with
tensors: projection, tiles of 16 x 16, blending front to back, 0.8 L1 + 0.2 (1 - SSIM, reflected borders), accumulated
depth with the outlier rule, the regulariser of scales, autograd, Adam per group. Without the strategy, which costs
next to nothing. Colours are the first harmonic, as in the first 1000 steps of 30,000.

Needs torch, numpy, pillow.
"""

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image

TILE = 16
CUT = 1.0 / 255.0


def read_ply(path):
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    head = data[:end].decode().splitlines()
    rows = next(int(line.split()[2]) for line in head if line.startswith("element vertex"))
    names = [line.split()[2] for line in head if line.startswith("property float")]
    values = np.frombuffer(data[end:], dtype="<f4", count=rows * len(names)).reshape(rows, -1)
    at = {name: i for i, name in enumerate(names)}

    def columns(*wanted):
        return torch.tensor(values[:, [at[name] for name in wanted]].copy())

    return {
        "means": columns("x", "y", "z"),
        "scales": columns("scale_0", "scale_1", "scale_2"),
        "quats": columns("rot_0", "rot_1", "rot_2", "rot_3"),
        "logits": columns("opacity")[:, 0],
        "sh0": columns("f_dc_0", "f_dc_1", "f_dc_2"),
    }


def read_frames(folder):
    frames = []
    for i, camera in enumerate(json.loads((folder / "cameras.json").read_text())):
        if i % 6 == 0:
            continue
        to_world = torch.tensor(camera["rotation"], dtype=torch.float32)
        rotation = to_world.T.contiguous()
        name = camera["img_name"]
        rgb = np.asarray(Image.open(folder / "images" / f"{name}.png").convert("RGB"))
        depth = np.asarray(Image.open(folder / "depth" / f"{name}.png")).astype(np.float32) / 1000.0
        frames.append({
            "rotation": rotation,
            "shift": -rotation @ torch.tensor(camera["position"], dtype=torch.float32),
            "focal": (camera["fx"], camera["fy"]),
            "size": (int(camera["width"]), int(camera["height"])),
            "rgb": torch.tensor(rgb.astype(np.float32) / 255.0),
            "depth": torch.tensor(depth),
        })
    return frames


def rotations(quats):
    w, x, y, z = F.normalize(quats, dim=1).unbind(1)
    return torch.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ], dim=1).reshape(-1, 3, 3)


def draw(p, frame):
    """Colour and accumulated depth: [H, W, 3], [H, W]."""
    width, height = frame["size"]
    fx, fy = frame["focal"]
    camera = p["means"] @ frame["rotation"].T + frame["shift"]
    z = camera[:, 2]
    near = (z > 0.01) & (z < 100.0)
    z = torch.where(near, z, torch.ones_like(z))
    limit = (0.15 * width / fx + width / 2 / fx, 0.15 * height / fy + height / 2 / fy)
    tx = (camera[:, 0] / z).clamp(-limit[0], limit[0])
    ty = (camera[:, 1] / z).clamp(-limit[1], limit[1])
    zero = torch.zeros_like(z)
    jacobian = torch.stack([
        torch.stack([fx / z, zero, -fx * tx / z], 1),
        torch.stack([zero, fy / z, -fy * ty / z], 1),
    ], 1)
    half = jacobian @ frame["rotation"] @ (rotations(p["quats"]) * p["scales"].exp()[:, None, :])
    covariance = half @ half.transpose(1, 2)
    sharp = covariance[:, 0, 0] * covariance[:, 1, 1] - covariance[:, 0, 1] ** 2
    a, b, c = covariance[:, 0, 0] + 0.3, covariance[:, 0, 1], covariance[:, 1, 1] + 0.3
    det = a * c - b * b
    opacity = torch.sigmoid(p["logits"]) * (sharp / det).clamp(min=0.005 ** 2).sqrt()
    u = fx * camera[:, 0] / z + width / 2
    v = fy * camera[:, 1] / z + height / 2
    conic = torch.stack([c / det, -b / det, a / det], 1)
    color = (0.28209479 * p["sh0"] + 0.5).clamp(min=0)
    with torch.no_grad():
        level = 2 * (opacity / CUT).clamp(min=1e-9).log()
        ex, ey = (level.clamp(min=0) * a).sqrt(), (level.clamp(min=0) * c).sqrt()
        seen = near & (level > 0) & (u + ex > 0) & (u - ex < width) & (v + ey > 0) & (v - ey < height)
        order = torch.nonzero(seen)[:, 0]
        order = order[z[order].argsort(stable=True)]
        box = [t[order] for t in (u - ex, u + ex, v - ey, v + ey)]
    rows = []
    for y in range(0, height, TILE):
        row = []
        h = min(TILE, height - y)
        in_row = (box[3] > y) & (box[2] < y + h)
        for x in range(0, width, TILE):
            w = min(TILE, width - x)
            at = order[in_row & (box[1] > x) & (box[0] < x + w)]
            px = torch.arange(x, x + w, dtype=torch.float32) + 0.5
            py = torch.arange(y, y + h, dtype=torch.float32) + 0.5
            dx = u[at][:, None, None] - px[None, None, :]
            dy = v[at][:, None, None] - py[None, :, None]
            q = conic[at][:, :, None, None]
            sigma = 0.5 * (q[:, 0] * dx * dx + q[:, 2] * dy * dy) + q[:, 1] * dx * dy
            alpha = (opacity[at][:, None, None] * (-sigma).exp()).clamp(max=0.99)
            alpha = torch.where((sigma >= 0) & (alpha >= CUT), alpha, torch.zeros_like(alpha))
            after = torch.cumprod(1 - alpha, 0)
            before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
            weight = torch.where(after > 1e-4, alpha * before, torch.zeros_like(alpha)).reshape(len(at), w * h)
            values = torch.cat([color[at], z[at][:, None]], 1)
            row.append((weight.T @ values).reshape(h, w, 4))
        rows.append(torch.cat(row, 1))
    picture = torch.cat(rows, 0)
    return picture[..., :3], picture[..., 3]


def ssim(a, b):
    taps = torch.exp(-((torch.arange(11) - 5.0) ** 2) / (2 * 1.5 ** 2))
    taps = taps / taps.sum()
    window = (taps[:, None] * taps[None, :]).expand(15, 1, 11, 11)
    a, b = (t.permute(2, 0, 1)[None] for t in (a, b))
    stack = torch.cat([a, b, a * a, b * b, a * b], 1)
    mean = F.conv2d(F.pad(stack, (5, 5, 5, 5), mode="reflect"), window, groups=15)
    x, y, xx, yy, xy = mean.split(3, 1)
    vx, vy = (xx - x * x).clamp(min=0), (yy - y * y).clamp(min=0)
    top = (2 * x * y + 1e-4) * (2 * (xy - x * y) + 9e-4)
    return (top / ((x * x + y * y + 1e-4) * (vx + vy + 9e-4))).mean()


def depth_loss(drawn, measured):
    known = measured > 0.01
    error = (measured - drawn)[known]
    if error.numel() == 0:
        return drawn.sum() * 0
    median = error.detach().median()
    limit = 10 * median if median > 0 else 2.0
    error = error.abs()
    return error[error.detach() < limit].mean()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    p = {k: v.requires_grad_() for k, v in read_ply(args.folder / "initial.ply").items()}
    rates = {"means": 1.6e-4, "scales": 5e-3, "quats": 1e-3, "logits": 5e-2, "sh0": 2.5e-3}
    groups = [{"params": [p[k]], "lr": rate} for k, rate in rates.items()]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-15, fused=True)
    frames = read_frames(args.folder)
    order = torch.randperm(len(frames))
    seconds = []
    for step in range(args.steps):
        frame = frames[order[step % len(frames)]]
        start = time.perf_counter()
        rgb, depth = draw(p, frame)
        l1 = (rgb - frame["rgb"]).abs().mean()
        loss = 0.8 * l1 + 0.2 * (1 - ssim(rgb, frame["rgb"])) + depth_loss(depth, frame["depth"])
        loss = loss + 0.02 * p["scales"].exp().mean()
        loss.backward()
        adam.step()
        adam.zero_grad(set_to_none=True)
        seconds.append(time.perf_counter() - start)
        if step % 10 == 0 or step + 1 == args.steps:
            psnr = -10 * math.log10(float((rgb.detach() - frame["rgb"]).pow(2).mean()))
            print(f"step {step}: loss {float(loss):.4f}, {psnr:.2f} dB, {seconds[-1]:.2f} s", flush=True)
    print(json.dumps({
        "steps": args.steps, "gaussians": len(p["logits"]), "threads": args.threads,
        "mean_seconds": float(np.mean(seconds)), "median_seconds": float(np.median(seconds)),
        "torch": torch.__version__,
    }))


if __name__ == "__main__":
    main()
