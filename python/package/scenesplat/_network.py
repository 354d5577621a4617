"""Networks."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from . import _scenesplat as native
from ._flags import flags

if TYPE_CHECKING:
    from ._types import Path, Progress


class Network:
    """A network that is ready to run, with how it is run: `Network.load` makes one, and calls share it.

    It can be used by several threads at once.
    """

    _native: native.NativeNetwork

    def __init__(self) -> None:
        raise TypeError("Network.load(path) loads a network, Network.load() the one inside the package")

    @classmethod
    def load(
        cls,
        weights: Path | None = None,
        *,
        config: Path | None = None,
        precision: str | None = None,
        setting: str | None = None,
        exact: bool = False,
        grid_size: float | None = None,
        halo: int | None = None,
        shuffle_seed: int | None = None,
        device: str | None = None,
        partial_weights: bool = False,
        branch: str | None = None,
        conv_layout: str | None = None,
        head: str | None = None,
        progress: Progress | None = None,
    ) -> Network:
        """Loads weights: a checkpoint, a model folder, "seeded:N" for values without meaning; by default the small network
        inside the package.

        - `config`: language, semseg, ssl, tiny, litept-s, … or a .toml file; by default the weights' own
        - `precision`: "f32", "split", "bf16" or "int8"
        - `setting`: all that trades accuracy for time, such as "voxel=0.04,patch=256,k=8"
        - `exact`: the original's steps instead of one pass
        - `grid_size`: size of voxels, meters; by default the one that it was trained at
        - `halo`: context around a tile, voxels
        - `shuffle_seed`: shuffles the curve orders, as the original does
        - `device`: "cpu", "cuda:0", "gpu" or "auto", if the package was built for it
        - `partial_weights`, `branch`, `conv_layout`, `head`: of checkpoints that need it
        """
        words = flags(
            weights="embedded" if weights is None else os.fspath(weights),
            config=config,
            precision=precision,
            setting=setting,
            exact=exact,
            grid_size=grid_size,
            halo=halo,
            shuffle_orders=shuffle_seed is not None,
            seed=shuffle_seed,
            device=device,
            partial_weights=partial_weights,
            branch=branch,
            conv_layout=conv_layout,
            head=head,
        )
        network = cls.__new__(cls)
        network._native = native.load_network(words, progress)
        return network

    @property
    def out_channels(self) -> int:
        """Numbers of a feature, or classes."""
        return self._native.out_channels

    @property
    def grid_size(self) -> float:
        """Size of the voxels that it was trained at, meters."""
        return self._native.grid_size

    @property
    def is_classifier(self) -> bool:
        """Whether it gives probabilities of classes rather than features."""
        return self._native.is_classifier

    @property
    def has_random_weights(self) -> bool:
        """Whether its weights are seeded, so that no result means anything."""
        return self._native.has_random_weights

    @property
    def parameters(self) -> int:
        """Numbers that it has learned."""
        return self._native.parameters

    @property
    def files(self) -> list[tuple[str, str]]:
        """Weight files, each with its SHA-256."""
        return [(os.fspath(path), sha256) for path, sha256 in self._native.files]

    def __repr__(self) -> str:
        kind = "classes" if self.is_classifier else "features"
        return f"Network({self.out_channels} {kind}, voxels of {self.grid_size} m)"


def native_of(network: Network | None) -> native.NativeNetwork | None:
    """The native part of a network, if one was given."""
    if network is None:
        return None
    if not isinstance(network, Network):
        raise TypeError(f"network: a Network is expected, got {type(network).__name__}; Network.load(path) loads one")
    return network._native
