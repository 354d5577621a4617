"""Types of the native part."""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Optional, final

import numpy as np
from numpy.typing import NDArray

from ._types import BoolArray, FloatArray, IndexArray, IntArray, Path, Progress

__all__ = [
    "Camera",
    "Drawing",
    "Error",
    "KernelMap",
    "NativeNetwork",
    "Rasterized",
    "Scene",
    "__version__",
    "align",
    "evaluate",
    "features",
    "forget_threads",
    "grid_sample",
    "inspect",
    "knn",
    "knn_vote",
    "lift",
    "load_network",
    "num_threads",
    "objects",
    "patch_attention",
    "patch_attention_backward",
    "query",
    "run_program",
    "segment",
    "segment_reduce",
    "segment_reduce_backward",
    "serialize",
    "set_num_threads",
    "train",
]

__version__: str

class Error(Exception):
    """What the library refuses or cannot do, in the words of the program."""

def num_threads() -> int:
    """Number of threads that work."""

def set_num_threads(threads: int) -> None:
    """Takes so many threads from now on; by default RAYON_NUM_THREADS, or the cores. Results do not depend on it."""

def forget_threads() -> None: ...
def run_program(words: Sequence[str], started_by: Sequence[str]) -> int: ...

@final
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
    ) -> Scene:
        """Reads a scene in any format that the program reads: PLY (trainers', compressed), SPZ, SOG, KSPLAT, splat, glTF, USD,
        folders of .npy, training folders; a labeled point cloud becomes Gaussians, with a warning.

        - `strict`: refuses files with values that would be repaired; else what was repaired is a warning
        - `segment_name`: which labels to read: a PLY property or the stem of a .npy file
        - `lod`: level of detail of a streamed scene, 0 = finest
        - `sh`, `lang_feat`, `extra`: whether to read harmonics beyond the first, language features, columns of unknown
          meaning
        - `spz_frame`: "rub", as the format prescribes, or "raw", as in the PLY file it was made from
        """
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
    ) -> Scene:
        """A scene of arrays: numpy's, torch's by DLPack, or whatever numpy takes. They are copied.

        - `means`: centers, meters. `[N, 3]`
        - `rotations`: w, x, y, z, any norm above 0. `[N, 4]`
        - `log_scales` or `scales`: standard deviations in meters, as natural logarithms or as they are. `[N, 3]`
        - `opacity_logits` or `opacities`: before the sigmoid, or 0 to 1. `[N]`
        - `sh` `[N, (degree + 1)², 3]`, or `colors` 0 to 1 `[N, 3]`
        - `normals` `[N, 3]`, `segment`, `instances` `[N]` whole numbers, −1 = none
        - `extra`: further columns by name, `[N, …]` each
        - `strict`: refuses values that would be repaired; else what was repaired is a warning, as for files
        """
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
    ) -> int:
        """Writes the scene. The format is that of the ending (.ply, .compressed.ply, .spz, .sog, .glb, .usda, .usdz, .splat, a folder, …)
        or `format`. What the format cannot hold is a warning.

        Returns the number of bytes written.
        """
    def __len__(self) -> int: ...
    @property
    def path(self) -> str:
        """The file or folder it was read from; "<arrays>" for a scene of arrays."""
    @property
    def format(self) -> str:
        """What the file is, such as "ply" or "spz"."""
    @property
    def report(self) -> str:
        """What was noticed and repaired while reading."""
    @property
    def source_rows(self) -> int:
        """Rows of the source, those left out included."""
    @property
    def origin(self) -> tuple[float, float, float]:
        """What is subtracted from all positions of the file: a center is at `means + origin` there. Zero for scenes near 0."""
    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 4."""
    @property
    def antialiased(self) -> bool:
        """Whether it was trained for antialiased rendering."""
    @property
    def means(self) -> FloatArray:
        """Centers relative to `origin`, meters. `[N, 3]` float32, a view"""
    @property
    def log_scales(self) -> FloatArray:
        """Natural logarithms of the standard deviations in meters. `[N, 3]` float32, a view"""
    @property
    def rotations(self) -> FloatArray:
        """Orientations w, x, y, z, unit norm, w at least 0. `[N, 4]` float32, a view"""
    @property
    def opacity_logits(self) -> FloatArray:
        """Opacities before the sigmoid; infinite ones are legal. `[N]` float32, a view"""
    @property
    def sh_dc(self) -> FloatArray:
        """First harmonic: color is 0.5 + 0.2820948 of it. `[N, 3]` float32, a view"""
    @property
    def sh_rest(self) -> FloatArray:
        """Higher harmonics, (degree + 1)² − 1 for each channel. `[N, K, 3]` float32, a view"""
    @property
    def normals(self) -> FloatArray | None:
        """Unit normals, if the scene has any. `[N, 3]` float32, a view"""
    @property
    def segment(self) -> IntArray | None:
        """Classes that the scene carries, −1 = none, if it does. `[N]` int32, a view"""
    @property
    def segment_scores(self) -> FloatArray | None:
        """How sure these classes are, if the scene says it. `[N]` float32, a view"""
    @property
    def instances(self) -> IntArray | None:
        """Instances that the scene carries, −1 = none, if it does. `[N]` int32, a view"""
    @property
    def lang_feat(self) -> NDArray[np.float16] | None:
        """Language features that the scene carries, if it does. `[N, D]` float16, a view"""
    @property
    def valid_feat_mask(self) -> BoolArray | None:
        """Whether a row of `lang_feat` holds a feature. `[N]` bool, a view"""
    @property
    def kept_rows(self) -> NDArray[np.uint32] | None:
        """Rows of the source that the scene is made of, ascending; None if all. `[N]` uint32, a view"""
    @property
    def extra(self) -> dict[str, NDArray[Any]]:
        """Columns of the file whose meaning is not known, by name, in the types of the file. `[N, …]` each, views"""
    @property
    def scales(self) -> FloatArray:
        """Standard deviations along the axes, meters. `[N, 3]` float32, computed"""
    @property
    def opacities(self) -> FloatArray:
        """Opacities, 0 to 1. `[N]` float32, computed"""
    @property
    def sh(self) -> FloatArray:
        """All harmonics, the first in front. `[N, (degree + 1)², 3]` float32, a copy"""
    @property
    def labelled_points(self) -> dict[str, Any] | None:
        """Labeled points that benchmarks evaluate on, if the scene has any: "coord" `[M, 3]` float32 (meters, relative to
        `origin`), "segment" and "instance" `[M]` int32 or None. Views
        """

@final
class Camera:
    """A camera with its pose: axes x right, y down, z forward."""

    def __new__(
        cls,
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
    ) -> Camera: ...
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
    ) -> Camera:
        """A camera at `eye` with `target` in the middle of its picture: up in the scene is up in the picture. `fov`: angle of
        view across the shorter side, degrees.
        """
    @staticmethod
    def open(path: Path) -> list[Camera]:
        """The cameras of a file: cameras.json, transforms.json or a COLMAP folder."""
    def resized(self, width: int, height: int) -> Camera:
        """The same camera with a picture of another size, pixels."""
    @property
    def name(self) -> str:
        """Of its picture, as a file says it."""
    @property
    def width(self) -> int:
        """Pixels."""
    @property
    def height(self) -> int:
        """Pixels."""
    @property
    def intrinsics(self) -> tuple[float, float, float, float]:
        """Focal lengths and principal point, pixels: fx, fy, cx, cy."""
    @property
    def rotation(self) -> NDArray[np.float64]:
        """World to camera. `[3, 3]` float64"""
    @property
    def translation(self) -> NDArray[np.float64]:
        """World to camera. `[3]` float64"""

@final
class Drawing:
    def __new__(
        cls,
        scene: Scene,
        depth: bool,
        preset: str,
        antialiased: bool | None,
        background: tuple[float, float, float] | None,
        sh_degree: int | None,
    ) -> Drawing: ...
    def draw(self, camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray | None]: ...
    def draw_features(self, camera: Camera, features: Any) -> FloatArray: ...

@final
class Rasterized:
    """A picture with what its gradients need."""

    def __new__(
        cls,
        means: Any,
        rotations: Any,
        scales: Any,
        opacities: Any,
        sh: Any,
        camera: Camera,
        preset: str,
        antialiased: bool,
        background: tuple[float, float, float] | None,
    ) -> Rasterized: ...
    @property
    def rgb(self) -> FloatArray:
        """Color, at least 0. `[H, W, 3]` float32"""
    @property
    def alpha(self) -> FloatArray:
        """What is covered, 0 to 1. `[H, W]` float32"""
    @property
    def depth(self) -> FloatArray:
        """Mean depth along the camera's axis, units of the world; 0 where nothing is. `[H, W]` float32"""
    def backward(self, *, rgb: Any = ..., alpha: Any = ..., depth: Any = ...) -> dict[str, FloatArray]:
        """Gradients of `Σ grad · picture` with respect to the arrays that were given, by their names. What is not given is 0."""

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

@final
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

@final
class KernelMap:
    """Which voxels a submanifold convolution joins: made once for the voxels of a batch."""

    def __new__(cls, grid_coord: Any, kernel_size: int = ..., *, offsets: Any = ...) -> KernelMap:
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
