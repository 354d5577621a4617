"""What is in a scene, how it lies, how right labels are."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _scenesplat as native
from ._flags import direction, flags
from ._network import Network, native_of
from ._scenesplat import Scene
from ._types import Path, Progress


@dataclass(frozen=True)
class Alignment:
    """How a network reads a scene."""

    rotation: NDArray[np.float64]
    """Turns the scene upright, +z up. `[3, 3]` float64"""
    metres_per_unit: float
    """What one unit of the scene is, meters."""
    report: dict[str, Any]
    """Evidence, confidence and alternatives."""


@dataclass(frozen=True)
class Inspection:
    """What is in a scene, what is wrong with it, what a network will cost."""

    report: dict[str, Any]
    """Everything, as `scenesplat inspect --json` writes it."""
    text: str
    """The same as the program prints it."""

    @property
    def findings(self) -> list[dict[str, Any]]:
        """What is wrong with the scene, worst first; empty if nothing is."""
        found: list[dict[str, Any]] = self.report["findings"]
        return found

    def __str__(self) -> str:
        return self.text


def align(
    scene: Scene,
    network: Network | None = None,
    *,
    up: str | Sequence[float] | None = None,
    unit: str | float | None = None,
    floor: float | None = None,
    progress: Progress | None = None,
) -> Alignment:
    """Which way is up and what a unit is, as `segment` with this network reads the scene.

    The arguments are those of `features`.
    """
    words = flags(up=direction("up", up), unit=unit, floor=floor)
    rotation, scale, report = native.align(scene, native_of(network), words, progress)
    return Alignment(rotation, scale, json.loads(report))


def inspect(
    scene: Scene,
    *,
    weights: Path | None = None,
    config: Path | None = None,
    setting: str | None = None,
    up: str | Sequence[float] | None = None,
    progress: Progress | None = None,
) -> Inspection:
    """Looks at a scene, as `scenesplat inspect` does.

    - `weights`, `config`, `setting`: the network whose cost is estimated
    - `up`: which way is up; judged by the scene if not given
    """
    words = flags(weights=weights, config=config, setting=setting, up=direction("up", up))
    text, report = native.inspect(scene, None, words, progress)
    return Inspection(json.loads(report), text)


def evaluate(
    scenes: Scene | Path | Sequence[Scene | Path],
    network: Network | None = None,
    *,
    features: Path | None = None,
    text: Path | None = None,
    text_names: Path | None = None,
    label_names: Path | None = None,
    label_base: int | None = None,
    class_map: Path | None = None,
    without: Sequence[str] = (),
    exclude: Sequence[str] | None = None,
    min_score: float | None = None,
    min_margin: float | None = None,
    min_probability: float | None = None,
    surfaces: str | None = None,
    vote_k: int | None = None,
    vote_valid_only: bool = False,
    up: str | Sequence[float] | None = None,
    unit: str | float | None = None,
    floor: float | None = None,
    as_is: bool = False,
    max_memory: str | None = None,
    effect: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Labels scenes and compares with the labels that they carry: the figures that `scenesplat evaluate` writes.

    - `scenes`: scenes, files, or rooms that are made on the spot, such as "synthetic:20:7"
    - `features`: "oracle", or a file of features of the one scene, instead of a network
    - `label_names`: names of the labels in the scenes; if not given they are rows of `text`
    - `label_base`: from where the ids of labels count
    - `class_map`: which class of `text` each label means, a TOML or JSON file
    - `exclude`: classes left out of f_miou and f_macc; by default wall, floor, ceiling
    - `vote_valid_only`: lets only Gaussians vote that have a collected feature

    The others are those of `segment`.
    """
    if isinstance(scenes, (Scene, str, os.PathLike)):
        scenes = [scenes]
    held = [scene for scene in scenes if isinstance(scene, Scene)]
    names = [scene.path if isinstance(scene, Scene) else os.fspath(scene) for scene in scenes]
    if not names:
        raise ValueError("scenes: at least one is expected")
    words = flags(
        features=features,
        text=text,
        text_names=text_names,
        label_names=label_names,
        label_base=label_base,
        class_map=class_map,
        without=without,
        exclude=exclude,
        min_score=min_score,
        min_margin=min_margin,
        min_probability=min_probability,
        surfaces=surfaces,
        vote_k=vote_k,
        vote_valid_only=vote_valid_only,
        up=direction("up", up),
        unit=unit,
        floor=floor,
        as_is=as_is,
        max_memory=max_memory,
        effect=effect,
    )
    report = native.evaluate(held, names, native_of(network), words, progress)
    figures: dict[str, Any] = json.loads(report)
    return figures
