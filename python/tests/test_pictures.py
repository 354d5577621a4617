"""Pictures, their gradients, and lifting."""

import json
import struct
import zlib

import numpy as np
import pytest
from conftest import arrays, program

import scenesplat
from scenesplat import Camera, LabelledPicture, Scene


def read_png(path):
    """An 8-bit RGB picture, without the library."""
    data, at, body, size = path.read_bytes(), 8, b"", None
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        kind, part = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            size = struct.unpack(">II", part[:8])
            assert part[8:] == b"\x08\x02\x00\x00\x00"
        body += part if kind == b"IDAT" else b""
        at += 12 + length
    width, height = size
    rows = np.frombuffer(zlib.decompress(body), np.uint8).reshape(height, 1 + 3 * width)
    out = np.zeros((height, 3 * width), np.uint8)
    for y, row in enumerate(rows):
        above = out[y - 1].astype(int) if y else np.zeros(3 * width, int)
        for x, value in enumerate(row[1:].astype(int)):
            left = int(out[y, x - 3]) if x >= 3 else 0
            corner = int(above[x - 3]) if x >= 3 else 0
            p = left + int(above[x]) - corner
            nearest = min((left, int(above[x]), corner), key=lambda v: abs(p - v))
            out[y, x] = (value + [0, left, above[x], (left + above[x]) // 2, nearest][row[0]]) & 255
    return out.reshape(height, width, 3)


def test_pictures_are_those_of_the_program(demo, room, tmp_path):
    done = program("render", demo / "room.ply", "--inside=2", "--size=96x64", "--out", tmp_path / "r")
    assert done.returncode == 0, done.stderr
    cameras = Camera.open(tmp_path / "r/cameras.json")
    assert len(cameras) == 2 and cameras[0].width == 96
    for camera in cameras:
        found = scenesplat.render(room, camera, depth=True)
        file = read_png(tmp_path / "r" / f"{camera.name}.png")
        rounded = np.clip(found.rgb * 255 + 0.5, 0, 255).astype(int)
        assert (np.abs(rounded - file) <= 1).mean() > 0.99
        assert found.depth.shape == found.alpha.shape == (64, 96)
        assert 0 <= found.alpha.min() <= found.alpha.max() <= 1


def test_one_gaussian():
    gray = Scene.from_arrays(
        means=[[0, 0, 2]], rotations=[[1, 0, 0, 0]], scales=[[0.1] * 3], opacities=[0.5], colors=[[0.5] * 3]
    )
    camera = Camera(width=9, height=9, fx=50, rotation=np.eye(3).tolist(), translation=[0, 0, 0])
    assert camera.intrinsics == (50, 50, 4.5, 4.5)
    found = scenesplat.render(gray, camera, depth=True, background=(1, 0, 0))
    assert np.abs(found.rgb[4, 4] - [0.75, 0.25, 0.25]).max() < 1e-6
    assert abs(found.alpha[4, 4] - 0.5) < 1e-6 and abs(found.depth[4, 4] - 2) < 1e-6
    features = scenesplat.render_features(gray, camera, [[1.0, 2.0]])
    assert np.abs(features[4, 4] - [0.5, 1]).max() < 1e-6
    both = scenesplat.render(gray, [camera, camera.resized(18, 18)])
    assert both[1].rgb.shape == (18, 18, 3)


def test_gradients_of_a_picture(random):
    given = arrays(random, n=12, degree=1)
    given = {name: array.astype(np.float64) for name, array in given.items()}
    values = {
        # Apart in depth: where two change places the picture jumps.
        "means": np.stack([0.3 * given["means"][:, 0], np.linspace(-1, 1, 12), 0.3 * given["means"][:, 2]], 1),
        "rotations": given["rotations"],
        "scales": np.exp(given["log_scales"] + 1),
        "opacities": 1 / (1 + np.exp(-given["opacity_logits"])),
        "sh": 0.3 * given["sh"],
    }
    camera = Camera.look_at([0, -3, 0.3], [0, 0, 0], width=40, height=30)
    y, x = np.mgrid[:30, :40]
    weights = np.stack([np.sin(x / 9), np.cos(y / 7), np.sin((x + y) / 8)], -1)

    def loss(**changed):
        picture = scenesplat.rasterize(**{**values, **changed}, camera=camera)
        return (picture.rgb.astype(np.float64) * weights).sum(), picture

    _, picture = loss()
    slopes = picture.backward(rgb=weights)
    assert picture.rgb.std() > 0.01
    for name, value in values.items():
        assert slopes[name].shape == value.shape
        # Along the gradient, where a change is large beside what the cut at small alphas, which has no derivative, does.
        step = slopes[name] * random.uniform(0.5, 1.5, size=value.shape)
        step *= (2e-2 if name == "rotations" else 2e-3) / np.abs(step).max()
        change = (loss(**{name: value + step})[0] - loss(**{name: value - step})[0]) / 2
        assert abs((slopes[name] * step).sum() - change) < 0.1 * abs(change), name


def test_labels_are_lifted_back(demo, room):
    labels = np.load(demo / "labels.npy")
    table = np.eye(64, dtype=np.float32)
    center = room.means.mean(0).tolist()
    eyes = [[center[0] + dx, center[1] + dy, center[2]] for dx, dy in ((1, 0.5), (-1, 0.5), (0.5, -1))]
    cameras = [Camera.look_at(eye, center, fov=90, width=160, height=120) for eye in eyes]

    def pictures():
        for camera in cameras:
            seen = scenesplat.render_features(room, camera, table[labels])
            segments = np.where(seen.sum(-1) > 0.5, seen.argmax(-1), -1)
            yield LabelledPicture(camera, segments, table)

    found = scenesplat.lift(room, pictures())
    assert found.features.shape == (len(room), 64) and found.valid.mean() > 0.2
    assert np.abs(np.linalg.norm(found.features[found.valid], axis=1) - 1).max() < 1e-5
    assert not found.features[~found.valid].any()
    sure = found.valid & (found.coverage > 1)
    assert (found.features[sure].argmax(1) == labels[sure]).mean() > 0.8


def test_wrong_use_is_an_exception(room):
    camera = Camera.look_at([0, 0, 1], [1, 0, 1], width=8, height=6)
    bad = [
        (lambda: Camera.look_at([0, 0, 0], [0, 0, 0]), "same"),
        (lambda: scenesplat.render(room, camera, preset="x"), "preset"),
        (lambda: scenesplat.render(room, camera, background=(2, 0, 0)), "background"),
        (lambda: scenesplat.render_features(room, camera, [[1.0]]), "features: expected"),
        (lambda: scenesplat.lift(room, []), "pictures: there is none"),
        (lambda: scenesplat.lift(room, [LabelledPicture(camera, np.full((6, 8), 3), np.eye(2))]), "3 is neither"),
        (lambda: scenesplat.lift(room, [LabelledPicture(camera, np.zeros((8, 6), int), np.eye(2))]), "segments"),
    ]
    for call, text in bad:
        with pytest.raises(ValueError, match=text):
            call()
    with pytest.raises(scenesplat.Error, match="rotation"):
        Camera(width=8, height=6, fx=5, rotation=(2 * np.eye(3)).tolist(), translation=[0, 0, 0])
    assert json.dumps(camera.translation.tolist())
