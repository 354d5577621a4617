"""Keyword arguments as flags of the program: `vote_k=25` is `--vote-k=25`."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Union

import numpy as np

Value = Union[None, bool, int, float, str, "os.PathLike[str]", Sequence[str]]


def _text(name: str, value: object) -> str:
    if isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name}: True and False are no value of it")
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (str, os.PathLike)):
        return os.fspath(value)
    raise TypeError(f"{name}: a number, a text or a path is expected, got {type(value).__name__}")


def flags(*, repeated: Sequence[str] = (), **values: Value) -> list[str]:
    """Flags of these arguments; None and False leave one out, and a list becomes one flag, or one for each if `repeated`."""
    found: list[str] = []
    for name, value in values.items():
        flag = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            found.append(flag)
        elif isinstance(value, (list, tuple)):
            parts = [_text(name, part) for part in value]
            if name in repeated:
                found.extend(f"{flag}={part}" for part in parts)
                continue
            for part in parts:
                if "," in part:
                    raise ValueError(f"{name}: {part!r} has a comma, which stands between names")
            if parts:
                found.append(f"{flag}={','.join(parts)}")
        else:
            found.append(f"{flag}={_text(name, value)}")
    return found


def direction(name: str, value: str | Sequence[float] | None) -> str | None:
    """A way up: an axis such as "+z", or three numbers."""
    if value is None or isinstance(value, str):
        return value
    numbers = [float(part) for part in value]
    if len(numbers) != 3:
        raise ValueError(f"{name}: an axis such as '+z' or three numbers are expected, got {value!r}")
    return ",".join(repr(number) for number in numbers)


@contextlib.contextmanager
def as_file(name: str, value: Any) -> Iterator[str | None]:
    """The path of an array: of the file that was given, or of one that holds it for this call."""
    if value is None or isinstance(value, (str, os.PathLike)):
        yield None if value is None else os.fspath(value)
        return
    array = np.asarray(value)
    if array.ndim != 2 or array.dtype.kind != "f":
        raise ValueError(f"{name}: expected [N, D] of floats, got {list(array.shape)} of {array.dtype}")
    with tempfile.TemporaryDirectory(prefix="scenesplat-") as folder:
        path = Path(folder) / f"{name}.npy"
        np.save(path, np.ascontiguousarray(array))
        yield str(path)
