"""Training."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, Union

import numpy as np

from . import _scenesplat as native
from ._scenesplat import Scene
from ._types import Path

#: Called with what happened: "event" (fit_start, step, eval, evaluated, checkpoint, alarm, fit_end), "step", "epoch",
#: "total_steps", and what belongs to the event, such as "measurements". False ends the training, which saves.
Callback = Callable[[dict[str, Any]], Union[bool, None]]


@dataclass(frozen=True)
class Trained:
    """What came of a training."""

    model: str
    """Folder of the network, as `Network.load` takes it."""
    step: int
    """Steps done."""
    total_steps: int
    """Steps planned; fewer are done if it was stopped, and `resume=True` goes on."""
    epoch: int
    """Epoch under way, from 0."""
    remarks: list[str]
    """Things to know: what was loaded, scenes that were repaired or left out."""


def train(
    config: Mapping[str, Any] | Path,
    *,
    out: Path,
    set: Sequence[str] = (),
    resume: bool | None = False,
    seed: int | None = None,
    device: str = "cpu",
    callbacks: Sequence[Callback] = (),
) -> Trained:
    """Trains a network as an experiment says, as `scenesplat train` does.

    - `config`: a TOML file, or its settings as a dictionary. In a dictionary the `source` of `train` and `evaluate` may be
      scenes from Python: an iterable of `Scene`s or of dictionaries of the arguments of `Scene.from_arrays`. They are
      written below `out` first, so that the training can be resumed with the same bits.
    - `out`: folder of everything that the run writes
    - `set`: changes such as "trainer.epochs=3", of a file
    - `resume`: goes on with the run in `out`; None: if there is one
    - `callbacks`: called for every event, see `Callback`; an exception ends the training, which saves before

    Ctrl-C saves, and raises KeyboardInterrupt.
    """
    path: str | None = None
    text: str | None = None
    if isinstance(config, Mapping):
        if set:
            raise ValueError("set: changes are for files; change the dictionary")
        text = _table(_stored(config, FilePath(out)))
    else:
        path = os.fspath(config)
    done = native.train(path, list(set), text, os.fspath(out), resume, seed, device, list(callbacks))
    step, total_steps, epoch, model, remarks = done
    return Trained(os.fspath(model), step, total_steps, epoch, remarks)


def _stored(config: Mapping[str, Any], out: FilePath) -> dict[str, Any]:
    """The settings with scenes from Python as folders."""
    stored = dict(config)
    for table in ("train", "evaluate"):
        entries = []
        for number, entry in enumerate(stored.get(table, [])):
            source = entry.get("source") if isinstance(entry, Mapping) else None
            if source is None or isinstance(source, Mapping):
                entries.append(entry)
                continue
            folder = out / "scenes" / f"{table}-{number}"
            _store(source, folder, f"{table}[{number}].source")
            entries.append({**entry, "source": {"type": "generic", "root": str(folder.resolve())}})
        if entries:
            stored[table] = entries
    return stored


#: Says that all scenes of a source are there.
_COMPLETE = "complete.json"


def _store(source: Iterable[Scene | Mapping[str, Any]], folder: FilePath, name: str) -> None:
    if (folder / _COMPLETE).is_file():
        # A run that is resumed has the scenes of its beginning.
        return
    if isinstance(source, (str, bytes)) or not isinstance(source, Iterable):
        raise TypeError(f"{name}: a table, or an iterable of scenes or dictionaries is expected")
    count = 0
    for number, scene in enumerate(source):
        if isinstance(scene, Mapping):
            scene = Scene.from_arrays(**scene)
        if not isinstance(scene, Scene):
            raise TypeError(f"{name}[{number}]: a Scene or a dictionary is expected, got {type(scene).__name__}")
        folder.mkdir(parents=True, exist_ok=True)
        scene.save(folder / f"scene-{number:05}", format="npy", overwrite=True)
        count = number + 1
    if count == 0:
        raise ValueError(f"{name}: there is no scene")
    (folder / _COMPLETE).write_text(json.dumps({"scenes": count}))


def _value(value: Any, name: str) -> str:
    """A value as TOML."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        number = float(value)
        if math.isfinite(number):
            return repr(number)
        return "nan" if math.isnan(number) else ("inf" if number > 0 else "-inf")
    if isinstance(value, (str, os.PathLike)):
        # JSON's text is TOML's, but for one letter.
        return json.dumps(os.fspath(value)).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        parts = [f"{_key(k)} = {_value(v, f'{name}.{k}')}" for k, v in value.items() if v is not None]
        return "{ " + ", ".join(parts) + " }" if parts else "{}"
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(_value(part, f"{name}[{i}]") for i, part in enumerate(value)) + "]"
    raise TypeError(f"{name}: no setting can be a {type(value).__name__}")


def _key(key: object) -> str:
    if not isinstance(key, str):
        raise TypeError(f"{key!r}: names of settings are texts")
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def _table(config: Mapping[str, Any]) -> str:
    lines = [f"{_key(k)} = {_value(v, k)}" for k, v in config.items() if v is not None]
    return "\n".join(lines) + "\n"
