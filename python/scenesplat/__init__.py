"""Scenes of 3D Gaussians: language features, labels, queries, pictures and training, on a plain CPU."""

from ._scenesplat import Error, Scene, __version__, num_threads, set_num_threads

__all__ = ["Error", "Scene", "__version__", "num_threads", "set_num_threads"]
