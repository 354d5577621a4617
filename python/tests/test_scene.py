"""Scenes as arrays: views, copies, files."""

import gc
import struct
import warnings

import numpy as np
import pytest
from conftest import arrays

from scenesplat import Error, Scene


def read_ply(path):
    """The vertices of a binary PLY file of floats, without the library."""
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    names = [line.split()[-1].decode() for line in head.splitlines() if line.startswith(b"property")]
    assert all(b" float " in line for line in head.splitlines() if line.startswith(b"property"))
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names))
    return {name: rows[:, i] for i, name in enumerate(names)}


def test_arrays_hold_the_bits_of_the_file(tmp_path, random):
    given = arrays(random)
    path = tmp_path / "a.ply"
    Scene.from_arrays(**given).save(path)
    file, scene = read_ply(path), Scene.open(path)
    assert scene.means.tobytes() == np.stack([file["x"], file["y"], file["z"]], 1).tobytes()
    assert scene.means.tobytes() == given["means"].tobytes()
    assert scene.log_scales[:, 2].tobytes() == file["scale_2"].tobytes()
    assert scene.opacity_logits.tobytes() == given["opacity_logits"].tobytes()
    assert scene.sh_dc.tobytes() == given["sh"][:, 0].tobytes()
    assert scene.sh_rest.shape == (50, 3, 3) and scene.sh_degree == 1
    # Files have the channel outside.
    assert scene.sh_rest[:, 1, 2].tobytes() == file["f_rest_7"].tobytes()
    assert scene.sh.tobytes() == given["sh"].tobytes()


def test_rotations_have_unit_length_and_w_at_least_0(random):
    given = arrays(random)
    found = Scene.from_arrays(**given).rotations
    quats = given["rotations"].astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    quats *= np.where(quats[:, :1] < 0, -1, 1)
    assert np.abs(found - quats).max() < 1e-6


def test_values_are_what_stored_ones_stand_for(random):
    given = arrays(random)
    scene = Scene.from_arrays(**given)
    logits = given["opacity_logits"].astype(np.float64)
    assert np.abs(scene.opacities - 1 / (1 + np.exp(-logits))).max() < 1e-6
    assert np.abs(scene.scales / np.exp(given["log_scales"].astype(np.float64)) - 1).max() < 1e-6
    again = dict(given, scales=scene.scales, opacities=scene.opacities)
    del again["log_scales"], again["opacity_logits"]
    back = Scene.from_arrays(**again)
    assert np.abs(back.log_scales - given["log_scales"]).max() < 1e-5
    assert np.abs(back.opacity_logits - given["opacity_logits"]).max() < 1e-4


def test_views_keep_the_scene_and_cannot_be_written_to(random):
    given = arrays(random)
    scene = Scene.from_arrays(**given)
    means = scene.means
    assert means.base is not None and not means.flags.owndata
    assert np.shares_memory(means, scene.means)
    del scene
    gc.collect()
    assert means.tobytes() == given["means"].tobytes()
    with pytest.raises(ValueError):
        means[0, 0] = 1
    with pytest.raises(ValueError):
        means.setflags(write=True)


def test_extra_columns_come_out_as_they_went_in(tmp_path, random):
    extra = {"age": np.arange(50, dtype=np.float32), "pairs": random.normal(size=(50, 2))}
    scene = Scene.from_arrays(**arrays(random), extra={**extra, "big": np.arange(50, dtype=">i4")})
    assert scene.extra["pairs"].dtype == np.float64 and not scene.extra["pairs"].flags.writeable
    assert scene.extra["pairs"].tobytes() == extra["pairs"].tobytes()
    assert (scene.extra["big"] == np.arange(50)).all()
    path = tmp_path / "a.ply"
    scene.save(path)
    assert (Scene.open(path).extra["age"] == extra["age"]).all()
    with pytest.warns(UserWarning, match="age"):
        assert Scene.open(path, extra=False).extra == {}


@pytest.mark.parametrize("name", ["a.compressed.ply", "a.spz", "a.sog", "a.glb", "a.usda", "a.usdz", "a.splat", "folder"])
def test_every_format_is_written_and_read(name, tmp_path, random):
    scene = Scene.from_arrays(**arrays(random, n=300, degree=0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        bytes_ = scene.save(tmp_path / name, format="npy" if name == "folder" else None)
        back = Scene.open(tmp_path / name)
    assert bytes_ > 300 and len(back) == 300
    # Some formats have another order.
    low, high = back.means.min(0), back.means.max(0)
    assert np.abs(low - scene.means.min(0)).max() < 0.02
    assert np.abs(high - scene.means.max(0)).max() < 0.02


def test_what_a_format_cannot_hold_is_a_warning(tmp_path, random):
    scene = Scene.from_arrays(**arrays(random, degree=2))
    with pytest.warns(UserWarning, match="sh"):
        scene.save(tmp_path / "a.splat")


def test_bad_values_are_repaired_with_a_warning_or_refused(random):
    given = arrays(random)
    given["means"][3, 1] = np.nan
    with pytest.warns(UserWarning, match="1 left out"):
        scene = Scene.from_arrays(**given)
    assert len(scene) == 49 and scene.source_rows == 50
    assert scene.kept_rows.tolist() == [i for i in range(50) if i != 3]
    with pytest.raises(Error):
        Scene.from_arrays(**given, strict=True)


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"means": np.zeros((50, 2))}, ValueError, r"means: expected \[N, 3\], got \[50, 2\]"),
        ({"rotations": np.zeros((49, 4))}, ValueError, r"rotations: expected \[50, 4\]"),
        ({"means": [["a"] * 3] * 50}, TypeError, "means: numbers are expected"),
        ({"scales": np.ones((50, 3))}, ValueError, "log_scales: scales says the same"),
        ({"log_scales": None}, ValueError, "log_scales: is missing; give it, or scales"),
        ({"sh": np.zeros((50, 5, 3))}, ValueError, "sh: expected"),
        ({"segment": np.full(50, 2**40)}, ValueError, "segment: a number does not fit"),
        ({"segment": np.zeros(50)}, TypeError, "segment: whole numbers are expected"),
        ({"extra": {"t": ["a"] * 50}}, ValueError, "extra"),
        ({"colour": 1}, TypeError, "colour"),
    ],
)
def test_bad_arguments_are_named(change, error, text, random):
    given = {k: v for k, v in {**arrays(random), **change}.items() if v is not None}
    with pytest.raises(error, match=text):
        Scene.from_arrays(**given)


def test_opacities_beyond_1_are_refused(random):
    given = arrays(random)
    del given["opacity_logits"]
    with pytest.raises(ValueError, match="opacities: row 2 is 1.5, not in 0 to 1"):
        Scene.from_arrays(**given, opacities=np.array([0, 1, 1.5] + [0.5] * 47))


def test_files_that_are_none_raise(tmp_path):
    with pytest.raises(FileNotFoundError):
        Scene.open(tmp_path / "none.ply")
    (tmp_path / "a.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n" + struct.pack("<f", 1))
    with pytest.raises(Error, match="a.ply"):
        Scene.open(tmp_path / "a.ply")


def test_an_existing_file_is_not_replaced(tmp_path, random):
    scene = Scene.from_arrays(**arrays(random))
    scene.save(tmp_path / "a.ply")
    with pytest.raises(Error, match="a.ply"):
        scene.save(tmp_path / "a.ply")
    scene.save(tmp_path / "a.ply", overwrite=True)
    with pytest.raises(ValueError, match="no format has this ending"):
        scene.save(tmp_path / "a.xyz")


class Tensor:
    """What torch's tensors have: DLPack, and nothing of numpy."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **options):
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def test_tensors_come_in_by_dlpack(random):
    given = arrays(random)
    scene = Scene.from_arrays(**{name: Tensor(array) for name, array in given.items()})
    assert scene.means.tobytes() == given["means"].tobytes()


def test_arrays_that_are_not_in_one_piece_come_in(random):
    given = arrays(random)
    wide = np.zeros((50, 6), np.float64)
    wide[:, ::2] = given["means"]
    scene = Scene.from_arrays(**{**given, "means": wide[:, ::2]})
    assert scene.means.tobytes() == given["means"].tobytes()
