"""Rows of a scene and of its file."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._scenesplat import Scene


def to_source_rows(scene: Scene, values: Any, fill: Any) -> NDArray[Any]:
    """One value for each row of the scene's file, as the program writes them: rows that were left out get `fill`.

    - `values`: one for each Gaussian. `[N, …]`

    Returns `[source_rows, …]`, a copy.
    """
    given = np.asarray(values)
    if given.shape[:1] != (len(scene),):
        raise ValueError(f"values: expected [{len(scene)}, …], got {list(given.shape)}")
    if scene.kept_rows is None:
        return given.copy()
    rows = np.full((scene.source_rows, *given.shape[1:]), fill, given.dtype)
    rows[scene.kept_rows] = given
    return rows
