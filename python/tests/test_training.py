"""Training from Python."""

import numpy as np
import pytest
from conftest import program

import scenesplat
from scenesplat import Network, Scene


def boards(count=3):
    """Flat checkerboards of two classes, as dictionaries."""
    for number in range(count):
        side = 30 + 4 * number
        x, y = np.meshgrid(np.arange(side), np.arange(side))
        kind = ((x // 8 + y // 8) % 2).reshape(-1)
        yield {
            "means": np.stack([0.05 * x, 0.05 * y, 0 * x], -1).reshape(-1, 3),
            "rotations": np.tile([1.0, 0, 0, 0], (side * side, 1)),
            "log_scales": np.full((side * side, 3), -4.0),
            "opacity_logits": np.full(side * side, 4.0),
            "colors": np.repeat(kind[:, None], 3, 1).astype(float),
            "segment": kind,
        }


def config(source, epochs=2):
    return {
        "task": "semantic_segmentation",
        "model": {
            "grid_size": 0.05,
            "stride": [2],
            "enc_depths": [1, 1],
            "enc_channels": [16, 16],
            "enc_num_head": [2, 2],
            "enc_patch_size": [64, 64],
            "dec_depths": [1],
            "dec_channels": [16],
            "dec_num_head": [2],
            "dec_patch_size": [64],
            "num_classes": 2,
            "in_channels": 11,
        },
        "train": [
            {
                "source": source,
                "transforms": [
                    {"type": "center_shift", "apply_z": True},
                    {"type": "grid_sample", "grid_size": 0.05},
                ],
            }
        ],
        "loader": {"batch_size": 1, "workers": 1},
        "losses": [{"type": "cross_entropy", "weight": 1.0}],
        "optimizer": {"lr": 0.01},
        "trainer": {"epochs": epochs, "log_every": 1},
    }


def losses(events):
    return [e["measurements"]["train/loss"] for e in events if e["event"] == "step"]


def test_scenes_from_python_are_learned(tmp_path):
    events = []
    done = scenesplat.train(config(boards(), 6), out=tmp_path / "run", callbacks=[events.append])
    assert done.step == done.total_steps == 18
    kinds = [e["event"] for e in events]
    assert kinds[0] == "fit_start" and kinds[-1] == "fit_end" and "checkpoint" in kinds
    found = losses(events)
    assert len(found) == 18 and np.mean(found[-3:]) < 0.7 * np.mean(found[:3])
    network = Network.load(done.model)
    assert network.is_classifier and network.out_channels == 2
    board = next(boards())
    kind = board.pop("segment")
    labels = scenesplat.segment(Scene.from_arrays(**board), network, as_is=True, vote_k=0).labels
    assert (labels == kind).mean() > 0.8


def test_a_stopped_training_goes_on_with_the_same_bits(tmp_path):
    whole = scenesplat.train(config(boards()), out=tmp_path / "a")
    stopped = scenesplat.train(
        config(boards()), out=tmp_path / "b", callbacks=[lambda e: not (e["event"] == "step" and e["step"] == 2)]
    )
    assert stopped.step == 2 < stopped.total_steps
    # The scenes are there already; the source is not asked again.
    rest = scenesplat.train(config(boards(0)), out=tmp_path / "b", resume=True)
    assert rest.step == whole.step
    [a, b] = [(tmp_path / run / "model/model.safetensors").read_bytes() for run in ("a", "b")]
    assert a == b


def test_an_exception_of_a_callback_ends_the_training(tmp_path):
    def fail(event):
        if event["event"] == "step":
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        scenesplat.train(config(boards()), out=tmp_path / "run", callbacks=[fail])
    assert scenesplat.train(config(boards()), out=tmp_path / "run", resume=None).step == 6


def test_a_file_trains_as_the_program_does(tmp_path):
    first = scenesplat.train(config(boards(), 1), out=tmp_path / "a")
    file = tmp_path / "a/config.toml"
    done = program("train", file, "--out", tmp_path / "b", "--quiet")
    assert done.returncode == 0, done.stderr
    second = scenesplat.train(file, out=tmp_path / "c", set=["trainer.epochs=1"])
    models = [tmp_path / run / "model/model.safetensors" for run in ("a", "b", "c")]
    assert first.step == second.step == 3
    assert models[0].read_bytes() == models[1].read_bytes() == models[2].read_bytes()


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"colour": 1}, scenesplat.Error, "colour"),
        ({"task": "dance"}, scenesplat.Error, "dance"),
        ({"model": {"grid_size": object()}}, TypeError, "model.grid_size"),
        ({"train": [{"source": [1], "transforms": []}]}, TypeError, "Scene or a dictionary"),
        ({"train": [{"source": [], "transforms": []}]}, ValueError, "there is no scene"),
    ],
)
def test_wrong_settings_are_named(change, error, text, tmp_path):
    with pytest.raises(error, match=text):
        scenesplat.train({**config(boards(1)), **change}, out=tmp_path / "run")
