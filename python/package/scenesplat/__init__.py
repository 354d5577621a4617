"""Scenes of 3D Gaussians: language features, labels, queries, pictures and training, on a plain CPU.

    import scenesplat
    labels = scenesplat.segment(scenesplat.Scene.open("scene.ply"))
    print(labels.names[labels.labels[0]])
"""

import os as _os

from . import kernels
from ._labels import Features, Labels, Objects, Selection, features, objects, query, segment
from ._looking import Alignment, Inspection, align, evaluate, inspect
from ._network import Network
from ._pictures import (
    LabelledPicture,
    Lifted,
    Picture,
    lift,
    rasterize,
    render,
    render_features,
)
from ._rows import to_source_rows
from ._scenesplat import (
    Camera,
    Error,
    Rasterized,
    Scene,
    __version__,
    forget_threads,
    num_threads,
    set_num_threads,
)
from ._training import Trained, train

if hasattr(_os, "register_at_fork"):
    # The threads of the parent are not in the child.
    _os.register_at_fork(after_in_child=forget_threads)

__all__ = [
    "Alignment",
    "Camera",
    "Error",
    "Features",
    "Inspection",
    "LabelledPicture",
    "Labels",
    "Lifted",
    "Network",
    "Objects",
    "Picture",
    "Rasterized",
    "Scene",
    "Selection",
    "Trained",
    "__version__",
    "align",
    "evaluate",
    "features",
    "inspect",
    "kernels",
    "lift",
    "num_threads",
    "objects",
    "query",
    "rasterize",
    "render",
    "render_features",
    "segment",
    "set_num_threads",
    "to_source_rows",
    "train",
]
