"""Pictures of scenes, their gradients, and labels of pictures lifted onto scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, overload

from . import _scenesplat as native
from ._scenesplat import Camera, Rasterized, Scene
from ._types import BoolArray, FloatArray, IndexArray


@dataclass(frozen=True)
class Picture:
    """A picture of a scene, row by row from the upper left."""

    rgb: FloatArray
    """Color with the background, at least 0 and without upper limit. `[H, W, 3]`"""
    alpha: FloatArray
    """What is covered, 0 to 1. `[H, W]`"""
    depth: FloatArray | None
    """Mean depth along the camera's axis, units of the scene; 0 where nothing is. `[H, W]`"""


@dataclass(frozen=True)
class LabelledPicture:
    """A picture that is cut into segments with one feature each."""

    camera: Camera
    """Where it was taken from."""
    segments: Any
    """Segment of each pixel, a row of `features`; −1 = none. `[H, W]` whole numbers"""
    features: Any
    """Finite, any norm; a segment with a row of zeros labels nothing. `[S, D]`"""
    depth: Any = None
    """Measured depth along the camera's axis, 0 = unknown, units of the scene. `[H, W]`"""


@dataclass(frozen=True)
class Lifted:
    """Features of pictures on the Gaussians of a scene."""

    features: FloatArray
    """Unit rows, 0 where there is no feature. `[N, D]`"""
    valid: BoolArray
    """Whether there is a feature. `[N]`"""
    confidence: FloatArray
    """How far the labels agree, 0 to 1. `[N]`"""
    views: IndexArray
    """Pictures that labeled it. `[N]`"""
    coverage: FloatArray
    """Labeled weight, pixels. `[N]`"""
    robust: bool
    """Whether labels were guarded against wrong ones."""


@overload
def render(
    scene: Scene,
    cameras: Camera,
    *,
    depth: bool = ...,
    preset: str = ...,
    antialiased: bool | None = ...,
    background: Sequence[float] | None = ...,
    sh_degree: int | None = ...,
) -> Picture: ...


@overload
def render(
    scene: Scene,
    cameras: Sequence[Camera],
    *,
    depth: bool = ...,
    preset: str = ...,
    antialiased: bool | None = ...,
    background: Sequence[float] | None = ...,
    sh_degree: int | None = ...,
) -> list[Picture]: ...


def render(
    scene: Scene,
    cameras: Camera | Sequence[Camera],
    *,
    depth: bool = False,
    preset: str = "gsplat-1.6",
    antialiased: bool | None = None,
    background: Sequence[float] | None = None,
    sh_degree: int | None = None,
) -> Picture | list[Picture]:
    """Draws a scene as cameras see it: one picture for one camera, a list for several.

    - `cameras`: in the coordinates of the scene's file
    - `preset`: whose constants to use: "gsplat-1.6", "gsplat-1.5" or "inria"
    - `antialiased`: whether opacities make up for the low-pass; as the scene's file says if not given
    - `background`: red, green, blue, 0 to 1; black if not given
    - `sh_degree`: highest band of the harmonics; all if not given
    """
    color = None if background is None else _color(background)
    drawing = native.Drawing(scene, depth, preset, antialiased, color, sh_degree)
    if isinstance(cameras, Camera):
        return Picture(*drawing.draw(cameras))
    return [Picture(*drawing.draw(camera)) for camera in cameras]


def render_features(
    scene: Scene,
    camera: Camera,
    features: Any,
    *,
    preset: str = "gsplat-1.6",
    antialiased: bool | None = None,
) -> FloatArray:
    """Blends rows of the Gaussians, `[N, D]`, as colors are, without background. `[H, W, D]`"""
    drawing = native.Drawing(scene, False, preset, antialiased, None, None)
    return drawing.draw_features(camera, features)


def rasterize(
    means: Any,
    rotations: Any,
    scales: Any,
    opacities: Any,
    sh: Any,
    camera: Camera,
    *,
    preset: str = "gsplat-1.6",
    antialiased: bool = False,
    background: Sequence[float] | None = None,
) -> Rasterized:
    """Draws Gaussians by activated values, and remembers what gradients need: call `backward` of the result.

    - `means`: centers `[N, 3]` · `rotations`: w, x, y, z, any norm `[N, 4]` · `scales`: standard deviations `[N, 3]`
    - `opacities`: 0 to 1 `[N]` · `sh`: `[N, (degree + 1)², 3]`, degree 0 to 3
    """
    color = None if background is None else _color(background)
    return native.Rasterized(means, rotations, scales, opacities, sh, camera, preset, antialiased, color)


def lift(
    scene: Scene,
    pictures: Iterable[LabelledPicture],
    *,
    preset: str = "gsplat-1.6",
    antialiased: bool | None = None,
    robust: str = "auto",
    erosion: int = 0,
    depth: bool = False,
    min_coverage: float = 0.0,
) -> Lifted:
    """Lifts the features of pictures onto the Gaussians: the mean over the pixels that show one, by their blending weight.

    - `pictures`: taken one after the other, so that a generator need not hold them all
    - `robust`: "auto", "on" or "off": whether labels are guarded against wrong ones
    - `erosion`: pixels along borders of segments that label nothing
    - `depth`: only pixels whose depth agrees label a Gaussian: that of the picture, or of the render where it has none
    - `min_coverage`: least labeled weight of a feature, pixels
    """
    parts = ((p.camera, p.segments, p.features, p.depth) for p in pictures)
    return Lifted(**native.lift(scene, parts, preset, antialiased, robust, erosion, depth, min_coverage))


def _color(given: Sequence[float]) -> tuple[float, float, float]:
    numbers = [float(part) for part in given]
    if len(numbers) != 3 or not all(0.0 <= part <= 1.0 for part in numbers):
        raise ValueError(f"background: three numbers from 0 to 1 are expected, got {given!r}")
    return (numbers[0], numbers[1], numbers[2])
