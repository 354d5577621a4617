"""Types of arguments."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

Path = Union[str, "os.PathLike[str]"]
#: Called with the name of a step and the share of it that is done (0 to 1), or None where that is not known. An exception
#: ends the work.
Progress = Callable[[str, Optional[float]], Any]
FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int32]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
