"""Kernels from Python beside numpy (and torch, where it is installed): time, and error against f64.

    python benches/python/kernels.py [FOLDER OF bench_inputs]
"""

import sys
import time
from pathlib import Path

import numpy as np

from scenesplat import kernels, num_threads

try:
    import torch

    torch.set_num_threads(num_threads())
except ImportError:
    torch = None

FOLDER = Path(sys.argv[1] if len(sys.argv) > 1 else "../shared/goldens/bench_inputs")
RUNS = 5


def best(work, runs=RUNS):
    """The result, and the best time of some runs after a first one, ms."""
    result, times = work(), []
    for _ in range(runs):
        began = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - began))
    return result, min(times)


def line(name, own, numpy_ms, torch_ms, error):
    shown = "-" if torch_ms is None else f"{torch_ms:.1f}"
    print(f"{name:44} {own:9.1f} {numpy_ms:10.1f} {shown:>9} {error:>12}", flush=True)


def tap_pairs(cells, k=3):
    """Input and output rows of each tap, by sorted keys."""
    side = cells.max() + 8
    key = lambda c: ((c[:, 0] + 4) * side + c[:, 1] + 4) * side + c[:, 2] + 4  # noqa: E731
    keys = key(cells.astype(np.int64))
    order = np.argsort(keys, kind="stable")
    pairs = []
    for tap in np.ndindex(k, k, k):
        wanted = key(cells.astype(np.int64) + np.array(tap) - k // 2)
        at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
        found = keys[order[at]] == wanted
        pairs.append((tap, order[at][found], np.flatnonzero(found)))
    return pairs


def convolution(random):
    cells = np.load(FOLDER / "scene_100k_grid_i32.npy")
    x = random.normal(size=(len(cells), 64)).astype(np.float32)
    weight = (random.normal(size=(64, 3, 3, 3, 64)) / 40).astype(np.float32)
    kernel_map, map_ms = best(lambda: kernels.KernelMap(cells))
    pairs, pairs_ms = best(lambda: tap_pairs(cells), 1)
    line("kernel map, 100k voxels, 3x3x3", map_ms, pairs_ms, None, f"{abs(sum(len(p[1]) for p in pairs) - kernel_map.num_pairs)} pairs")

    def plain(x, weight, out):
        for tap, source, target in pairs:
            # Each target is there once in a tap.
            out[target] += x[source] @ weight[(slice(None), *tap)].T
        return out

    found, own = best(lambda: kernel_map.forward(x, weight))
    _, numpy_ms = best(lambda: plain(x, weight, np.zeros_like(x)), 2)
    exact = plain(x.astype(np.float64), weight.astype(np.float64), np.zeros(x.shape))
    torch_ms = None
    if torch:
        tx, tw = torch.from_numpy(x), torch.from_numpy(weight)
        rows = [(tap, torch.from_numpy(s), torch.from_numpy(t)) for tap, s, t in pairs]

        def of_torch():
            out = torch.zeros_like(tx)
            for tap, source, target in rows:
                out.index_add_(0, target, tx[source] @ tw[(slice(None), *tap)].T)
            return out

        _, torch_ms = best(of_torch)
    line("convolution, 100k voxels, 64 to 64 channels", own, numpy_ms, torch_ms, f"{np.abs(found - exact).max() / np.abs(exact).max():.1e}")


def attention(random):
    n, size, heads, dim = 98_304, 1024, 4, 16
    qkv = random.normal(size=(n, 3, heads, dim)).astype(np.float32)
    order = random.permutation(n)

    def plain(qkv):
        out = np.empty((n, heads, dim), qkv.dtype)
        for first in range(0, n, size):
            rows = order[first : first + size]
            q, k, v = qkv[rows].transpose(1, 2, 0, 3)
            score = q @ k.transpose(0, 2, 1) * qkv.dtype.type(dim**-0.5)
            score = np.exp(score - score.max(-1, keepdims=True))
            out[rows] = (score @ v / score.sum(-1, keepdims=True)).transpose(1, 0, 2)
        return out

    found, own = best(lambda: kernels.patch_attention(qkv, order, size))
    _, numpy_ms = best(lambda: plain(qkv), 1)
    exact = plain(qkv.astype(np.float64))
    torch_ms = None
    if torch:
        tq, to = torch.from_numpy(qkv), torch.from_numpy(order)

        def of_torch():
            q, k, v = tq[to].view(n // size, size, 3, heads, dim).permute(2, 0, 3, 1, 4)
            done = torch.nn.functional.scaled_dot_product_attention(q, k, v)
            out = torch.empty(n, heads, dim)
            out[to] = done.permute(0, 2, 1, 3).reshape(n, heads, dim)
            return out

        _, torch_ms = best(of_torch)
    line("attention, 98k rows, patches of 1024, 4 x 16", own, numpy_ms, torch_ms, f"{np.abs(found - exact).max():.1e}")


def voxels_and_groups(random):
    points = np.load(FOLDER / "room_points_1m_f32.npy")
    found, own = best(lambda: kernels.grid_sample(points, 0.02, order="ravel"))

    def plain():
        cell = np.floor(points.astype(np.float64) / 0.02).astype(np.int64)
        cell -= cell.min(0)
        sides = cell.max(0) + 1
        return np.unique((cell[:, 0] * sides[1] + cell[:, 1]) * sides[2] + cell[:, 2], return_inverse=True)

    (_, inverse), numpy_ms = best(plain, 2)
    line("grid_sample, 1M points, 2 cm", own, numpy_ms, None, f"{(found.inverse != inverse.reshape(-1)).sum()} differ")
    x = random.normal(size=(len(points), 32)).astype(np.float32)
    mean, own = best(lambda: kernels.segment_reduce(x, found.order, found.offsets, "mean"))

    def reduced(x):
        sums = np.add.reduceat(x[found.order], found.offsets[:-1])
        return sums / np.diff(found.offsets)[:, None].astype(x.dtype)

    _, numpy_ms = best(lambda: reduced(x), 1)
    torch_ms = None
    if torch:
        tx, ti = torch.from_numpy(x), torch.from_numpy(found.inverse)
        zero = torch.zeros(len(found), 32)
        index = ti[:, None].expand(-1, 32)
        _, torch_ms = best(lambda: zero.scatter_reduce(0, index, tx, "mean", include_self=False))
    line("segment_reduce, 1M rows of 32, mean", own, numpy_ms, torch_ms, f"{np.abs(mean - reduced(x.astype(np.float64))).max():.1e}")


def curves():
    cells = np.load(FOLDER / "serialize_1m_grid_i32.npy")
    found, own = best(lambda: kernels.serialize(cells, curves=["z"]))
    _, four = best(lambda: kernels.serialize(cells))

    def plain():
        code = np.zeros(len(cells), np.int64)
        for bit in range(int(cells.max()).bit_length()):
            for axis in range(3):
                code |= (cells[:, axis].astype(np.int64) >> bit & 1) << (3 * bit + 2 - axis)
        order = np.argsort(code, kind="stable")
        inverse = np.empty_like(order)
        inverse[order] = np.arange(len(order))
        return code, order

    (code, order), numpy_ms = best(plain, 2)
    wrong = (found.code[0] != code).sum() + (found.order[0] != order).sum()
    line("serialize, 1M cells, z curve", own, numpy_ms, None, f"{wrong} differ")
    line("serialize, 1M cells, four curves", four, float("nan"), None, "")


def votes(random):
    points = np.load(FOLDER / "room_points_1m_f32.npy")
    labels = random.integers(0, 20, len(points)).astype(np.int32)
    found, own = best(lambda: kernels.knn_vote(points, labels, 25), 2)
    some = random.choice(len(points), 200, replace=False)
    expected = []
    for row in some:
        far = ((points[row].astype(np.float64) - points) ** 2).sum(-1)
        near = np.argsort(far, kind="stable")[:25]
        expected.append(np.bincount(labels[near], minlength=20).argmax())
    line("knn_vote, 1M points, k = 25", own, float("nan"), None, f"{(found[some] != expected).sum()} of 200")


def main():
    random = np.random.default_rng(1)
    print(f"{num_threads()} threads, numpy {np.__version__}, torch {torch.__version__ if torch else 'is missing'}")
    print(f"{'ms':44} {'scenesplat':>9} {'numpy':>10} {'torch':>9} {'error':>12}")
    convolution(random)
    attention(random)
    voxels_and_groups(random)
    curves()
    votes(random)


if __name__ == "__main__":
    main()
