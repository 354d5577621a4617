"""The rasterizer as a function of torch: a scene learns to look like a picture of another one.

    python examples/autograd.py
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

import scenesplat


class Rasterize(torch.autograd.Function):
    """Color of Gaussians, `[H, W, 3]`, with gradients for all their values."""

    @staticmethod
    def forward(ctx: Any, camera: scenesplat.Camera, *values: torch.Tensor) -> torch.Tensor:
        names = ("means", "rotations", "scales", "opacities", "sh")
        given = {name: value.detach() for name, value in zip(names, values)}
        ctx.picture = scenesplat.rasterize(**given, camera=camera)
        ctx.names = names
        return torch.from_numpy(ctx.picture.rgb)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        slopes = ctx.picture.backward(rgb=grad.contiguous())
        return (None, *(torch.from_numpy(slopes[name]) for name in ctx.names))


def main() -> None:
    random = np.random.default_rng(1)
    camera = scenesplat.Camera.look_at([0, -3, 0], [0, 0, 0], width=64, height=48)
    fixed = {
        "means": torch.from_numpy(0.5 * random.normal(size=(40, 3)).astype(np.float32)),
        "rotations": torch.from_numpy(random.normal(size=(40, 4)).astype(np.float32)),
        "scales": torch.full((40, 3), 0.1),
        "opacities": torch.full((40,), 0.8),
    }
    target = Rasterize.apply(camera, *fixed.values(), torch.from_numpy(random.normal(size=(40, 1, 3)).astype(np.float32)))
    sh = torch.zeros((40, 1, 3), requires_grad=True)
    optimizer = torch.optim.Adam([sh], lr=0.1)
    for step in range(60):
        loss = (Rasterize.apply(camera, *fixed.values(), sh) - target).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % 20 == 0 or step == 59:
            print(f"step {step}: loss {loss.item():.4f}")


if __name__ == "__main__":
    main()
