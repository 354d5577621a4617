"""Types of the native part."""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray

from ._types import BoolArray, FloatArray, IndexArray, IntArray, Path, Progress

__version__: str

class Error(Exception):
    """What the library refuses or cannot do, in the words of the program."""

def num_threads() -> int:
    """Number of threads that work."""

def set_num_threads(threads: int) -> None:
    """Takes so many threads from now on; by default RAYON_NUM_THREADS, or the cores. Results do not depend on it."""

def forget_threads() -> None: ...
def run_program(words: Sequence[str], started_by: Sequence[str]) -> int: ...

class Scene:
    """A scene of 3D Gaussians, one row of every array for each Gaussian."""

    @staticmethod
    def open(
        path: Path,
        *,
        strict: bool = ...,
        segment_name: str | None = ...,
        lod: int = ...,
        sh: bool = ...,
        lang_feat: bool = ...,
        extra: bool = ...,
        spz_frame: str = ...,
    ) -> Scene: ...
    @staticmethod
    def from_arrays(
        *,
        means: Any,
        rotations: Any,
        log_scales: Any = ...,
        scales: Any = ...,
        opacity_logits: Any = ...,
        opacities: Any = ...,
        sh: Any = ...,
        colors: Any = ...,
        normals: Any = ...,
        segment: Any = ...,
        instances: Any = ...,
        extra: dict[str, Any] | None = ...,
        antialiased: bool = ...,
        strict: bool = ...,
    ) -> Scene: ...
    def save(
        self,
        path: Path,
        *,
        format: str | None = ...,
        overwrite: bool = ...,
        spz_version: int = ...,
        spz_frame: str = ...,
        lod_levels: int = ...,
        progress: Progress | None = ...,
    ) -> int: ...
    def __len__(self) -> int: ...
    @property
    def path(self) -> str: ...
    @property
    def format(self) -> str: ...
    @property
    def report(self) -> str: ...
    @property
    def source_rows(self) -> int: ...
    @property
    def origin(self) -> tuple[float, float, float]: ...
    @property
    def sh_degree(self) -> int: ...
    @property
    def antialiased(self) -> bool: ...
    @property
    def means(self) -> FloatArray: ...
    @property
    def log_scales(self) -> FloatArray: ...
    @property
    def rotations(self) -> FloatArray: ...
    @property
    def opacity_logits(self) -> FloatArray: ...
    @property
    def sh_dc(self) -> FloatArray: ...
    @property
    def sh_rest(self) -> FloatArray: ...
    @property
    def normals(self) -> FloatArray | None: ...
    @property
    def segment(self) -> IntArray | None: ...
    @property
    def segment_scores(self) -> FloatArray | None: ...
    @property
    def instances(self) -> IntArray | None: ...
    @property
    def lang_feat(self) -> NDArray[np.float16] | None: ...
    @property
    def valid_feat_mask(self) -> BoolArray | None: ...
    @property
    def kept_rows(self) -> NDArray[np.uint32] | None: ...
    @property
    def extra(self) -> dict[str, NDArray[Any]]: ...
    @property
    def scales(self) -> FloatArray: ...
    @property
    def opacities(self) -> FloatArray: ...
    @property
    def sh(self) -> FloatArray: ...
    @property
    def labelled_points(self) -> dict[str, Any] | None: ...

class Camera:
    """A camera with its pose: axes x right, y down, z forward."""

    def __init__(
        self,
        *,
        width: int,
        height: int,
        fx: float,
        fy: float | None = ...,
        cx: float | None = ...,
        cy: float | None = ...,
        rotation: Any,
        translation: Any,
        name: str = ...,
    ) -> None: ...
    @staticmethod
    def look_at(
        eye: Sequence[float],
        target: Sequence[float],
        *,
        up: str = ...,
        fov: float = ...,
        width: int = ...,
        height: int = ...,
        name: str = ...,
    ) -> Camera: ...
    @staticmethod
    def open(path: Path) -> list[Camera]: ...
    def resized(self, width: int, height: int) -> Camera: ...
    @property
    def name(self) -> str: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def intrinsics(self) -> tuple[float, float, float, float]: ...
    @property
    def rotation(self) -> NDArray[np.float64]: ...
    @property
    def translation(self) -> NDArray[np.float64]: ...

class Drawing:
    def __init__(
        self,
        scene: Scene,
        depth: bool,
        preset: str,
        antialiased: bool | None,
        background: tuple[float, float, float] | None,
        sh_degree: int | None,
    ) -> None: ...
    def draw(self, camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray | None]: ...
    def draw_features(self, camera: Camera, features: Any) -> FloatArray: ...

class Rasterized:
    """A picture with what its gradients need."""

    def __init__(
        self,
        means: Any,
        rotations: Any,
        scales: Any,
        opacities: Any,
        sh: Any,
        camera: Camera,
        preset: str,
        antialiased: bool,
        background: tuple[float, float, float] | None,
    ) -> None: ...
    @property
    def rgb(self) -> FloatArray: ...
    @property
    def alpha(self) -> FloatArray: ...
    @property
    def depth(self) -> FloatArray: ...
    def backward(self, *, rgb: Any = ..., alpha: Any = ..., depth: Any = ...) -> dict[str, FloatArray]: ...

def lift(
    scene: Scene,
    pictures: Any,
    preset: str,
    antialiased: bool | None,
    robust: str,
    erosion: int,
    depth: bool,
    min_coverage: float,
) -> dict[str, Any]: ...

class NativeNetwork:
    @property
    def out_channels(self) -> int: ...
    @property
    def grid_size(self) -> float: ...
    @property
    def is_classifier(self) -> bool: ...
    @property
    def has_random_weights(self) -> bool: ...
    @property
    def parameters(self) -> int: ...
    @property
    def files(self) -> list[tuple[os.PathLike[str], str]]: ...

_LabelParts = tuple[IntArray, Optional[FloatArray], list[str]]

def load_network(flags: Sequence[str], progress: Progress | None) -> NativeNetwork: ...
def features(
    scene: Scene, network: NativeNetwork | None, flags: Sequence[str], progress: Progress | None
) -> tuple[FloatArray, IndexArray, IndexArray, str, FloatArray | None]: ...
def segment(
    scene: Scene, network: NativeNetwork | None, flags: Sequence[str], progress: Progress | None
) -> _LabelParts: ...
def query(
    scene: Scene, phrase: str, network: NativeNetwork | None, flags: Sequence[str], progress: Progress | None
) -> tuple[FloatArray, NDArray[np.uint8]]: ...
def objects(
    scene: Scene, network: NativeNetwork | None, flags: Sequence[str], progress: Progress | None
) -> tuple[_LabelParts, IntArray, str]: ...
def align(
    scene: Scene, network: NativeNetwork | None, flags: Sequence[str], progress: Progress | None
) -> tuple[NDArray[np.float64], float, str]: ...
def inspect(
    scene: Scene, network: NativeNetwork | None, flags: Sequence[str], progress: Progress | None
) -> tuple[str, str]: ...
def evaluate(
    scenes: Sequence[Scene],
    names: Sequence[str],
    network: NativeNetwork | None,
    flags: Sequence[str],
    progress: Progress | None,
) -> str: ...
def train(
    path: str | None,
    changes: Sequence[str],
    text: str | None,
    out: str,
    resume: bool | None,
    seed: int | None,
    device: str,
    callbacks: Sequence[Callable[[dict[str, Any]], bool | None]],
) -> tuple[int, int, int, os.PathLike[str], list[str]]: ...
def read_experiment(path: Path, changes: Sequence[str]) -> str: ...

class KernelMap:
    """Which voxels a submanifold convolution joins: made once for the voxels of a batch."""

    def __init__(self, grid_coord: Any, kernel_size: int = ..., *, offsets: Any = ...) -> None:
        """`grid_coord`: 0 to 2²¹ − 1. `[N, 3]` · `kernel_size`: 1, 3, 5 or 7 · `offsets`: ends of scenes. `[B + 1]`"""
    @property
    def kernel_size(self) -> int: ...
    @property
    def num_pairs(self) -> int: ...
    def __len__(self) -> int: ...
    def pairs(self, tap: int) -> tuple[IndexArray, IndexArray]: ...
    def forward(self, x: Any, weight: Any, bias: Any = ..., *, precision: str = ...) -> FloatArray:
        """Convolves rows, `[N, cin]`, by weights, `[cout, k, k, k, cin]`. `[N, cout]`"""
    def backward(self, grad: Any, x: Any, weight: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gradients of rows, weights and bias from that of the result, `[N, cout]`."""

def grid_sample(coord: Any, grid_size: float, order: str) -> Mapping[str, Any]: ...
def serialize(
    grid_coord: Any, curves: list[str], depth: int | None
) -> tuple[IndexArray, IndexArray, IndexArray]: ...
def knn(points: Any, query: Any, k: int) -> tuple[IndexArray, NDArray[np.float64]]: ...
def knn_vote(
    coord: Any, labels: Any, query: Any, k: int, num_classes: int | None, valid: Any
) -> IntArray: ...
def patch_attention(qkv: Any, order: Any, patch_size: int, offsets: Any) -> FloatArray: ...
def patch_attention_backward(
    grad: Any, qkv: Any, order: Any, patch_size: int, offsets: Any
) -> FloatArray: ...
def segment_reduce(x: Any, order: Any, offsets: Any, how: str) -> FloatArray: ...
def segment_reduce_backward(grad: Any, x: Any, order: Any, offsets: Any, how: str) -> FloatArray: ...
