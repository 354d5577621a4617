"""Kernels of point-cloud networks on numpy arrays: what spconv, flash-attn and torch-scatter do, on a CPU.

Arrays may be numpy's or torch's (on the CPU). float32 in memory row by row is taken without a copy. Do not write to an array
while a function that got it runs in another thread. Results do not depend on the number of threads. Row numbers that come
out are int64, as numpy and torch index with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _scenesplat as native
from ._scenesplat import KernelMap
from ._types import FloatArray, IndexArray, IntArray

__all__ = [
    "KernelMap",
    "Serialization",
    "Voxels",
    "grid_sample",
    "knn",
    "knn_vote",
    "patch_attention",
    "patch_attention_backward",
    "segment_reduce",
    "segment_reduce_backward",
    "serialize",
    "subm_conv",
]


@dataclass(frozen=True)
class Voxels:
    """Points grouped by voxel: `order[offsets[v]:offsets[v + 1]]` are the rows of voxel v, ascending."""

    order: IndexArray
    """Rows voxel by voxel. `[N]`"""
    offsets: IndexArray
    """Where each voxel begins in `order`, closed by N. `[V + 1]`"""
    inverse: IndexArray
    """Voxel of each row. `[N]`"""
    grid_coord: IntArray
    """Cell of each voxel, the smallest of each axis being 0. `[V, 3]`"""
    min_cell: NDArray[np.float64]
    """What was subtracted: the smallest cell of each axis. `[3]`"""

    @property
    def first(self) -> IndexArray:
        """The smallest row of each voxel. `[V]`"""
        rows: IndexArray = self.order[self.offsets[:-1]]
        return rows

    def __len__(self) -> int:
        return len(self.grid_coord)


@dataclass(frozen=True)
class Serialization:
    """Cells along space-filling curves, a row for each curve."""

    code: IndexArray
    """`[C, N]`, at most 63 bits"""
    order: IndexArray
    """Row at each position; equal codes by row. `[C, N]`"""
    inverse: IndexArray
    """Position of each row. `[C, N]`"""


def grid_sample(coord: Any, grid_size: float, *, order: str = "morton") -> Voxels:
    """Groups points by voxel: the cell of a point is `floor(coord / grid_size)`.

    - `coord`: meters, finite. `[N, 3]`
    - `grid_size`: side of a voxel, meters
    - `order`: how voxels are listed: "morton" (along a z-order curve), or as the original does, "fnv" or "ravel"
    """
    return Voxels(**native.grid_sample(coord, grid_size, order))


def serialize(
    grid_coord: Any,
    *,
    curves: Sequence[str] = ("z", "z-trans", "hilbert", "hilbert-trans"),
    depth: int | None = None,
) -> Serialization:
    """Orders cells along space-filling curves.

    - `grid_coord`: 0 to 2²¹ − 1. `[N, 3]`
    - `depth`: bits of an axis; by default as many as the largest coordinate has
    """
    return Serialization(*native.serialize(grid_coord, list(curves), depth))


def knn(points: Any, k: int, *, query: Any = None) -> tuple[IndexArray, NDArray[np.float64]]:
    """The k nearest points of each query, nearest first, equally near ones by row: rows `[M, k]` and distances `[M, k]`.

    - `points`: meters, finite. `[N, 3]`
    - `query`: `[M, 3]`; by default the points themselves, each of which is its own nearest
    """
    return native.knn(points, query, k)


def knn_vote(
    coord: Any,
    labels: Any,
    k: int = 25,
    *,
    query: Any = None,
    num_classes: int | None = None,
    valid: Any = None,
) -> IntArray:
    """The label that most of the k nearest points have, for each query; the smaller one of equals; −1 where none has any.

    - `coord`: meters, finite. `[N, 3]` · `labels`: classes, −1 = none. `[N]`
    - `query`: `[M, 3]`; by default the points themselves
    - `num_classes`: by default one more than the largest label
    - `valid`: which points vote; by default all. `[N]`
    """
    return native.knn_vote(coord, labels, query, k, num_classes, valid)


def subm_conv(
    x: Any,
    weight: Any,
    grid_coord: Any,
    bias: Any = None,
    *,
    offsets: ArrayLike | None = None,
    precision: str = "f32",
) -> FloatArray:
    """Submanifold convolution. For several over the same voxels make a `KernelMap` once and call its `forward`.

    - `x`: rows of the voxels. `[N, cin]` · `grid_coord`: 0 to 2²¹ − 1. `[N, 3]`
    - `weight`: as spconv 2 stores it. `[cout, k, k, k, cin]`, k 1, 3, 5 or 7 · `bias`: `[cout]`
    - `offsets`: ends of the scenes of a batch, from 0. `[B + 1]`
    - `precision`: "f32", "split", "bf16" or "int8"

    Returns `[N, cout]`.
    """
    shape = np.shape(weight)
    if len(shape) != 5:
        raise ValueError(f"weight: expected [cout, k, k, k, cin], got {list(shape)}")
    map = KernelMap(grid_coord, int(shape[1]), offsets=offsets)
    return map.forward(x, weight, bias, precision=precision)


def patch_attention(qkv: Any, order: Any, patch_size: int, *, offsets: ArrayLike | None = None) -> FloatArray:
    """Softmax attention of each row to the rows of its patch, scaled by 1 / √channels.

    - `qkv`: queries, keys and values. `[N, 3, heads, channels]`
    - `order`: row at each position of the sequence, such as a row of `Serialization.order`. `[N]`
    - `patch_size`: rows of a patch; the last patch of a scene is filled up with rows of the one before
    - `offsets`: ends of the scenes of a batch in the sequence, from 0. `[B + 1]`

    Returns `[N, heads, channels]`.
    """
    return native.patch_attention(qkv, order, patch_size, offsets)


def patch_attention_backward(
    grad: Any, qkv: Any, order: Any, patch_size: int, *, offsets: ArrayLike | None = None
) -> FloatArray:
    """The gradient of `qkv` from that of the result, `[N, heads, channels]`. `[N, 3, heads, channels]`"""
    return native.patch_attention_backward(grad, qkv, order, patch_size, offsets)


def segment_reduce(x: Any, order: Any, offsets: Any, how: str = "mean") -> FloatArray:
    """One row for each group of rows, such as those of `Voxels`.

    - `x`: `[N, C]` · `order`: rows group by group. `[N]` · `offsets`: where each group begins, closed by N. `[G + 1]`
    - `how`: "mean", "max" (NaN counts as larger than anything) or "sum"

    Returns `[G, C]`.
    """
    return native.segment_reduce(x, order, offsets, how)


def segment_reduce_backward(grad: Any, x: Any, order: Any, offsets: Any, how: str = "mean") -> FloatArray:
    """The gradient of `x` from that of the result, `[G, C]`; of a maximum it goes to the first row that has it. `[N, C]`"""
    return native.segment_reduce_backward(grad, x, order, offsets, how)
