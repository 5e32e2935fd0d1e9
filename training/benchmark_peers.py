"""Peers, where they are installed: each function does what a case of `benchmark_cases.py` asks of every contestant."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Frames of a sequence: points (n, 3) in the world, free end points among them, and where they were seen from.
Frames = list[tuple[NDArray[np.float64], NDArray[np.float64]]]
OCTOMAP = "OctoMap"


class Peers:
    """The peers that can be imported."""

    def __init__(self) -> None:
        self.versions: dict[str, str] = {}
        self.octomap: Any = None
        if find_spec("octomap") is not None:
            import octomap

            self.octomap = octomap
            self.versions["octomap-python"] = version("octomap-python")

    def integrate(self, frames: Frames, resolution: float, max_range: float) -> dict[str, Callable[[], object]]:
        """Insert all frames into a fresh map."""
        if self.octomap is None:
            return {}

        def insert() -> object:
            tree = self.octomap.OcTree(resolution)
            for points, origin in frames:
                tree.insertPointCloud(points, origin, maxrange=max_range)
            return tree

        return {OCTOMAP: insert}

    def cast(
        self, frames: Frames, resolution: float, max_range: float, origins: NDArray[Any], directions: NDArray[Any]
    ) -> dict[str, Callable[[], object]]:
        """Cast rays to the first occupied or unknown voxel of the map of these frames.

        The binding takes one ray a call; its overhead of about a microsecond is part of what a Python user gets.
        """
        if self.octomap is None:
            return {}
        tree = self.octomap.OcTree(resolution)
        for points, origin in frames:
            tree.insertPointCloud(points, origin, maxrange=max_range)
        starts, ways = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)

        def cast() -> object:
            end = np.zeros(3)
            for start, way in zip(starts, ways, strict=True):
                tree.castRay(start, way, end, ignoreUnknownCells=False, maxRange=max_range)
            return end

        return {OCTOMAP: cast}
