"""Features, labels, queries and objects of scenes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import _scenesplat as native
from ._flags import as_file, direction, flags
from ._network import Network, native_of
from ._scenesplat import Scene
from ._types import BoolArray, FloatArray, IndexArray, IntArray, Path, Progress


@dataclass(frozen=True)
class Features:
    """Features of a scene. Gaussians of one voxel share a row; `numpy.asarray` gives one row for each."""

    values: FloatArray
    """Distinct rows: of unit length, or probabilities of a classifier. `[S, D]`"""
    inverse: IndexArray
    """Row of each Gaussian. `[N]`"""
    sampled: IndexArray
    """Gaussians that the network read."""
    alignment: dict[str, Any] | None
    """How the scene was turned and scaled for the network."""
    axes: FloatArray | None
    """With the setting codes=K the directions that rows are coordinates along. `[K, D]`"""

    @property
    def width(self) -> int:
        """Numbers of a row."""
        return int(self.values.shape[1])

    def __len__(self) -> int:
        return len(self.inverse)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:
        if copy is False:
            raise ValueError("one row for each Gaussian is a copy; use `values` and `inverse`")
        rows = self.values[self.inverse]
        return rows if dtype is None else rows.astype(dtype)


@dataclass(frozen=True)
class Labels:
    """Labels of a scene."""

    labels: IntArray
    """Class of each Gaussian, a place in `names`; −1 = none. `[N]`"""
    scores: FloatArray | None
    """How sure it is: the cosine with the class's text, or its probability. `[N]`"""
    names: list[str]
    """Names of the classes."""

    def __len__(self) -> int:
        return len(self.labels)

    def counts(self) -> dict[str, int]:
        """Gaussians of each class that occurs, most first; those without one are "unknown"."""
        found, counts = np.unique(self.labels, return_counts=True)
        order = np.argsort(-counts, kind="stable")
        name = {-1: "unknown"}
        return {name.get(int(c), self.names[int(c)]): int(n) for c, n in zip(found[order], counts[order])}


@dataclass(frozen=True)
class Selection:
    """What a phrase means in a scene."""

    scores: FloatArray
    """Cosine with the best of what is meant. `[N]`"""
    selected: BoolArray
    """Whether a Gaussian is meant. `[N]`"""

    def __len__(self) -> int:
        return len(self.scores)


@dataclass(frozen=True)
class Objects(Labels):
    """Objects of a scene, with the labels that make them."""

    instances: IntArray
    """Object of each Gaussian, a place in `table`; −1 = none. `[N]`"""
    table: dict[str, Any]
    """Objects with class, score, box, volume and place, as objects.json has them."""


def features(
    scene: Scene,
    network: Network | None = None,
    *,
    up: str | Sequence[float] | None = None,
    unit: str | float | None = None,
    floor: float | None = None,
    as_is: bool = False,
    max_memory: str | None = None,
    effect: str | None = None,
    effect_plan: Path | None = None,
    progress: Progress | None = None,
) -> Features:
    """Features of every Gaussian, as `scenesplat features` writes them.

    - `up`: which way is up, such as "+z" or three numbers; judged by the scene if not given
    - `unit`: what one unit of the scene is: "m", "cm", "mm", "km" or meters; judged by the scene if not given
    - `floor`: height of the floor along up, in the scene's unit; looked for if not given
    - `as_is`: the network reads the scene neither turned nor scaled
    - `max_memory`: limit for the whole process, such as "8GB"; larger scenes go through overlapping tiles
    - `effect`, `effect_plan`: what is done about effects of the capture
    """
    words = flags(
        up=direction("up", up),
        unit=unit,
        floor=floor,
        as_is=as_is,
        max_memory=max_memory,
        effect=effect,
        effect_plan=effect_plan,
    )
    values, inverse, sampled, report, axes = native.features(
        scene, native_of(network), words, progress
    )
    return Features(values, inverse, sampled, json.loads(report), axes)


def segment(
    scene: Scene,
    network: Network | None = None,
    *,
    features: Path | FloatArray | None = None,
    text: Path | None = None,
    text_names: Path | None = None,
    text_model: Path | None = None,
    template: Sequence[str] = (),
    without: Sequence[str] = (),
    min_score: float | None = None,
    min_margin: float | None = None,
    min_probability: float | None = None,
    surfaces: str | None = None,
    strange: str | None = None,
    vote_k: int | None = None,
    up: str | Sequence[float] | None = None,
    unit: str | float | None = None,
    floor: float | None = None,
    as_is: bool = False,
    max_memory: str | None = None,
    effect: str | None = None,
    effect_plan: Path | None = None,
    progress: Progress | None = None,
) -> Labels:
    """A class for every Gaussian, as `scenesplat segment` writes them.

    - `network`: by default the one inside the package, or language codes if the scene carries such
    - `features`: rows made before instead of a network, `[N, D]`: a file or an array
    - `text`: embeddings of the classes, a .safetensors or .pt file, or "vocabulary", the words of the network inside the
      package; with `text_model` also a file of names
    - `text_names`: names of its rows, where the file has none
    - `text_model`, `template`: folder of a text model that reads names, and what it reads them in
    - `without`: classes that may not be predicted
    - `min_score`, `min_margin`, `min_probability`: what is less sure stays −1
    - `surfaces`: "auto", "on" or "off": whether labels agree on smooth surfaces
    - `strange`: "auto", "label" or "unknown": what becomes of what the network inside the package does not know
    - `vote_k`: neighbors that vote on each label; 0 for no vote, 25 if not given

    The others are those of `features`.
    """
    with as_file("features", features) as file:
        words = flags(
            repeated=("template",),
            features=file,
            text=text,
            text_names=text_names,
            text_model=text_model,
            template=template,
            without=without,
            min_score=min_score,
            min_margin=min_margin,
            min_probability=min_probability,
            surfaces=surfaces,
            strange=strange,
            vote_k=vote_k,
            up=direction("up", up),
            unit=unit,
            floor=floor,
            as_is=as_is,
            max_memory=max_memory,
            effect=effect,
            effect_plan=effect_plan,
        )
        labels, scores, names = native.segment(scene, native_of(network), words, progress)
    return Labels(labels, scores, names)


def query(
    scene: Scene,
    phrase: str,
    network: Network | None = None,
    *,
    embedding: Path | None = None,
    features: Path | FloatArray | None = None,
    text: Path | None = None,
    text_names: Path | None = None,
    text_model: Path | None = None,
    template: Sequence[str] = (),
    without: Sequence[str] = (),
    min_score: float | None = None,
    min_margin: float | None = None,
    vote_k: int | None = None,
    up: str | Sequence[float] | None = None,
    unit: str | float | None = None,
    floor: float | None = None,
    as_is: bool = False,
    max_memory: str | None = None,
    effect: str | None = None,
    effect_plan: Path | None = None,
    progress: Progress | None = None,
) -> Selection:
    """The Gaussians that a phrase means, as `scenesplat query` writes them.

    - `embedding`: the vector of the phrase, a .npy or .pt file, for networks whose text model is not at hand
    - `text`: the rivals of the phrase

    The others are those of `segment`.
    """
    with as_file("features", features) as file:
        words = flags(
            repeated=("template",),
            embedding=embedding,
            features=file,
            text=text,
            text_names=text_names,
            text_model=text_model,
            template=template,
            without=without,
            min_score=min_score,
            min_margin=min_margin,
            vote_k=vote_k,
            up=direction("up", up),
            unit=unit,
            floor=floor,
            as_is=as_is,
            max_memory=max_memory,
            effect=effect,
            effect_plan=effect_plan,
        )
        scores, selected = native.query(
            scene, phrase, native_of(network), words, progress
        )
    return Selection(scores, selected.view(np.bool_))


def objects(
    scene: Scene,
    network: Network | None = None,
    *,
    label_names: Path | None = None,
    label_base: int | None = None,
    pieces: bool = False,
    min_count: int | None = None,
    gap: float | None = None,
    features: Path | FloatArray | None = None,
    text: Path | None = None,
    text_names: Path | None = None,
    text_model: Path | None = None,
    template: Sequence[str] = (),
    without: Sequence[str] = (),
    min_score: float | None = None,
    min_margin: float | None = None,
    min_probability: float | None = None,
    surfaces: str | None = None,
    strange: str | None = None,
    vote_k: int | None = None,
    up: str | Sequence[float] | None = None,
    unit: str | float | None = None,
    floor: float | None = None,
    as_is: bool = False,
    max_memory: str | None = None,
    effect: str | None = None,
    effect_plan: Path | None = None,
    progress: Progress | None = None,
) -> Objects:
    """The objects of a scene with their boxes, as `scenesplat objects` writes them.

    - `label_names`: takes the labels that the scene carries, whose names these are, instead of a network
    - `label_base`: from where the ids of those labels count
    - `pieces`: looks for objects even where the scene carries instances
    - `min_count`: fewest Gaussians of an object, 20 if not given
    - `gap`: Gaussians of a class this near to each other, meters, belong together

    The others are those of `segment`.
    """
    with as_file("features", features) as file:
        words = flags(
            repeated=("template",),
            label_names=label_names,
            label_base=label_base,
            pieces=pieces,
            min_count=min_count,
            gap=gap,
            features=file,
            text=text,
            text_names=text_names,
            text_model=text_model,
            template=template,
            without=without,
            min_score=min_score,
            min_margin=min_margin,
            min_probability=min_probability,
            surfaces=surfaces,
            strange=strange,
            vote_k=vote_k,
            up=direction("up", up),
            unit=unit,
            floor=floor,
            as_is=as_is,
            max_memory=max_memory,
            effect=effect,
            effect_plan=effect_plan,
        )
        (labels, scores, names), instances, table = native.objects(
            scene, native_of(network), words, progress
        )
    return Objects(labels, scores, names, instances, json.loads(table))
