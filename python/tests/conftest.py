"""Scenes and files that several tests read: made once by the program itself."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import scenesplat

Run = "subprocess.CompletedProcess[str]"


def program(*words, **options):
    """Runs the program as its entry point does."""
    words = [sys.executable, "-m", "scenesplat", *map(str, words)]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, **options)


@pytest.fixture(scope="session")
def demo(tmp_path_factory) -> Path:
    """A quarter of the room of `scenesplat demo` with its labels: room.ply, labels.npy, scores.npy, classes.json."""
    folder = tmp_path_factory.mktemp("demo")
    whole, out = folder / "whole", folder / "out"
    out.mkdir()
    for words in (
        ["demo", "--out", whole],
        ["convert", whole / "room.ply", out / "room.ply", "--sample", "25%"],
        ["segment", out / "room.ply", "--out", out],
    ):
        done = program(*words)
        assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="session")
def room(demo) -> scenesplat.Scene:
    return scenesplat.Scene.open(demo / "room.ply")


@pytest.fixture(scope="session")
def network() -> scenesplat.Network:
    return scenesplat.Network.load()


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(7)


def arrays(random, n=50, degree=1):
    """Arguments of `Scene.from_arrays`."""
    return {
        "means": random.normal(size=(n, 3)).astype(np.float32),
        "rotations": random.normal(size=(n, 4)).astype(np.float32),
        "log_scales": random.uniform(-4, -2, size=(n, 3)).astype(np.float32),
        "opacity_logits": random.normal(size=n).astype(np.float32),
        "sh": random.normal(size=(n, (degree + 1) ** 2, 3)).astype(np.float32),
    }
