"""Kernels against plain numpy."""

import numpy as np
import pytest

from scenesplat import Error, kernels


@pytest.fixture
def cells(random):
    """Distinct voxels of a surface, in random order."""
    x, y = np.meshgrid(np.arange(20), np.arange(20))
    z = (4 + 2 * np.sin(x / 3) + y / 4).astype(int)
    cells = np.stack([x, y, z], -1).reshape(-1, 3)
    return cells[random.permutation(len(cells))].astype(np.int32)


def conv(x, weight, grid_coord, bias=0.0):
    """Submanifold convolution, in f64 by a dictionary of cells."""
    k = weight.shape[1]
    row_of = {tuple(cell): row for row, cell in enumerate(grid_coord.tolist())}
    out = np.zeros((len(x), weight.shape[0])) + bias
    for row, (cx, cy, cz) in enumerate(grid_coord.tolist()):
        for tx, ty, tz in np.ndindex(k, k, k):
            at = row_of.get((cx + tx - k // 2, cy + ty - k // 2, cz + tz - k // 2))
            if at is not None:
                out[row] += weight[:, tx, ty, tz].astype(np.float64) @ x[at]
    return out


@pytest.mark.parametrize("k", [1, 3, 5])
def test_convolution(k, cells, random):
    x = random.normal(size=(len(cells), 6)).astype(np.float32)
    weight = random.normal(size=(5, k, k, k, 6)).astype(np.float32)
    bias = random.normal(size=5).astype(np.float32)
    found = kernels.subm_conv(x, weight, cells, bias)
    expected = conv(x, weight, cells, bias)
    assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()


def test_gradients_of_a_convolution(cells, random):
    x = random.normal(size=(len(cells), 4))
    weight = random.normal(size=(3, 3, 3, 3, 4))
    grad = random.normal(size=(len(cells), 3))
    dx, dw, db = kernels.KernelMap(cells).backward(grad, x, weight)
    # The result is linear in each, so differences are exact.
    for given, found, of in [(x, dx, lambda v: conv(v, weight, cells)), (weight, dw, lambda v: conv(x, v, cells))]:
        step = random.normal(size=given.shape)
        expected = ((of(given + step) - of(given)) * grad).sum()
        assert abs((found * step).sum() - expected) < 1e-3 * abs(expected) + 1e-3
    assert np.abs(db - grad.sum(0)).max() < 1e-4


def test_scenes_of_a_batch_do_not_meet(cells, random):
    both = np.concatenate([cells, cells])
    x = random.normal(size=(len(both), 4)).astype(np.float32)
    weight = random.normal(size=(3, 3, 3, 3, 4)).astype(np.float32)
    n = len(cells)
    found = kernels.subm_conv(x, weight, both, offsets=[0, n, 2 * n])
    assert found[:n].tobytes() == kernels.subm_conv(x[:n], weight, cells).tobytes()
    assert found[n:].tobytes() == kernels.subm_conv(x[n:], weight, cells).tobytes()


def test_voxels(random):
    coord = random.uniform(-1, 1, size=(500, 3)).astype(np.float32)
    found = kernels.grid_sample(coord, 0.25)
    cell = np.floor(coord.astype(np.float64) / 0.25)
    low = cell.min(0)
    assert (found.min_cell == low).all()
    assert (found.grid_coord[found.inverse] == cell - low).all()
    assert len(found) == len(np.unique(cell, axis=0))
    assert sorted(found.order.tolist()) == list(range(500))
    for voxel in range(len(found)):
        rows = found.order[found.offsets[voxel] : found.offsets[voxel + 1]]
        assert (np.diff(rows) > 0).all() and (found.inverse[rows] == voxel).all()
    assert (found.first == [np.flatnonzero(found.inverse == v)[0] for v in range(len(found))]).all()
    ravel = kernels.grid_sample(coord, 0.25, order="ravel")
    sides = (cell - low).max(0) + 1
    keys = ravel.grid_coord @ np.array([sides[1] * sides[2], sides[2], 1])
    assert (np.diff(keys) > 0).all()


def morton(cell, depth):
    code = 0
    for bit in range(depth):
        for axis in range(3):
            code |= (int(cell[axis]) >> bit & 1) << (3 * bit + 2 - axis)
    return code


def test_curves(cells):
    found = kernels.serialize(cells)
    assert found.code.shape == found.order.shape == found.inverse.shape == (4, len(cells))
    assert found.code[0].tolist() == [morton(cell, 5) for cell in cells]
    assert found.code[1].tolist() == [morton(cell[[1, 0, 2]], 5) for cell in cells]
    for code, order, inverse in zip(found.code, found.order, found.inverse):
        assert (np.diff(code[order]) > 0).all()
        assert (inverse[order] == np.arange(len(cells))).all()
    # A Hilbert curve goes from cell to neighboring cell.
    cube = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    path = cube[kernels.serialize(cube, curves=["hilbert"]).order[0]]
    assert (np.abs(np.diff(path, axis=0)).sum(1) == 1).all()


def nearest(points, query, k):
    far = ((query[:, None].astype(np.float64) - points[None]) ** 2).sum(-1)
    rows = np.argsort(far, axis=1, kind="stable")[:, :k]
    return rows, np.sqrt(np.take_along_axis(far, rows, 1))


def test_neighbors_and_votes(random):
    # On a grid, so that many are equally near.
    points = random.integers(0, 5, size=(300, 3)).astype(np.float32)
    query = random.uniform(0, 5, size=(70, 3)).astype(np.float32)
    rows, far = kernels.knn(points, 7, query=query)
    expected = nearest(points, query, 7)
    assert (rows == expected[0]).all() and np.abs(far - expected[1]).max() < 1e-9
    assert (kernels.knn(points, 7)[0] == nearest(points, points, 7)[0]).all()
    labels = random.integers(-1, 4, size=300).astype(np.int32)
    found = kernels.knn_vote(points, labels, 7, query=query)
    for row, near in enumerate(labels[expected[0]]):
        votes = np.bincount(near[near >= 0], minlength=4)
        assert found[row] == (votes.argmax() if votes.any() else -1)
    valid = random.random(300) < 0.5
    some = kernels.knn_vote(points[valid], labels[valid], 7, query=query, num_classes=4)
    assert (kernels.knn_vote(points, labels, 7, query=query, valid=valid, num_classes=4) == some).all()


def test_attention(random):
    n, heads, dim, size = 25, 2, 4, 8
    qkv = random.normal(size=(n, 3, heads, dim)).astype(np.float32)
    order = random.permutation(n)
    found = kernels.patch_attention(qkv, order, size)
    expected = np.zeros((n, heads, dim))
    for first in range(0, n, size):
        own = order[first : first + size]
        # The last patch is filled up: its keys are the last rows of the sequence.
        seen = own if len(own) == size else order[n - size :]
        q, k, v = (qkv[rows, i].astype(np.float64) for rows, i in ((own, 0), (seen, 1), (seen, 2)))
        score = np.einsum("qhd,khd->hqk", q, k) / np.sqrt(dim)
        weight = np.exp(score - score.max(-1, keepdims=True))
        weight /= weight.sum(-1, keepdims=True)
        expected[own] = np.einsum("hqk,khd->qhd", weight, v)
    assert np.abs(found - expected).max() < 1e-5
    grad = random.normal(size=found.shape).astype(np.float32)
    step = 1e-2 * random.normal(size=qkv.shape).astype(np.float32)
    change = (kernels.patch_attention(qkv + step, order, size).astype(np.float64) * grad).sum()
    change -= (kernels.patch_attention(qkv - step, order, size).astype(np.float64) * grad).sum()
    slope = kernels.patch_attention_backward(grad, qkv, order, size)
    assert abs((slope * step).sum() - change / 2) < 2e-3 * abs(change) + 1e-4


@pytest.mark.parametrize("how", ["mean", "max", "sum"])
def test_groups_of_rows(how, random):
    x = random.normal(size=(100, 3)).astype(np.float32)
    voxels = kernels.grid_sample(random.uniform(size=(100, 3)), 0.3)
    found = kernels.segment_reduce(x, voxels.order, voxels.offsets, how)
    expected = [getattr(x[voxels.inverse == v].astype(np.float64), how)(0) for v in range(len(voxels))]
    assert np.abs(found - expected).max() < 1e-6
    grad = random.normal(size=found.shape).astype(np.float32)
    slope = kernels.segment_reduce_backward(grad, x, voxels.order, voxels.offsets, how)
    counts = np.bincount(voxels.inverse)[voxels.inverse][:, None]
    own = grad[voxels.inverse]
    of = {"sum": own, "mean": own / counts, "max": own * (x == found[voxels.inverse])}
    assert np.abs(slope - of[how]).max() < 1e-6


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: kernels.grid_sample([[0, 0, np.nan]], 0.1), Error, "row 0"),
        (lambda: kernels.grid_sample([[0, 0, 0]], -1), Error, "-1"),
        (lambda: kernels.grid_sample([[0, 0]], 1), ValueError, "coord: expected"),
        (lambda: kernels.serialize([[0, 0, -1]]), Error, "-1"),
        (lambda: kernels.serialize([[9, 0, 0]], depth=2), ValueError, "depth: 2 bits"),
        (lambda: kernels.serialize([[0, 0, 0]], curves=["u"]), ValueError, "curves"),
        (lambda: kernels.knn([[0, 0, 0.0]], 2), ValueError, "k: 2 is not in 1 to 1"),
        (lambda: kernels.knn_vote([[0, 0, 0.0]], [5], 1, num_classes=3), Error, "5"),
        (lambda: kernels.knn_vote([[0, 0, 0.0]], [0.5], 1), TypeError, "labels: whole numbers"),
        (lambda: kernels.subm_conv([[1.0]], np.ones((1, 2, 2, 2, 1)), [[0, 0, 0]]), Error, "kernel size 2"),
        (lambda: kernels.subm_conv([[1.0, 2]], np.ones((1, 3, 3, 3, 1)), [[0, 0, 0]]), ValueError, "x: expected"),
        (lambda: kernels.subm_conv([[1.0]], np.ones((1, 3, 3, 3, 1)), [[0, 0, 0]], offsets=[0, 2]), Error, "offsets"),
        (lambda: kernels.segment_reduce([[1.0]], [1], [0, 1]), Error, "out of range"),
        (lambda: kernels.patch_attention(np.ones((2, 3, 1, 4)), [0, 0], 2), ValueError, "order"),
        (lambda: kernels.patch_attention(np.ones((2, 3, 1, 4)), [0, 1], 0), ValueError, "patch_size"),
    ],
)
def test_wrong_use_is_an_exception(call, error, text):
    with pytest.raises(error, match=text):
        call()
