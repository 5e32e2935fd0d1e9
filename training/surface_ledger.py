"""What the image from each fixed view does to the surface voxels of a map, known before the robot goes there.

For the oracle: with perfect images of a scene in which nothing moves, an image hits and frees the same voxels whenever it is
taken. So each view's image is made once, and what it adds to any map is counted without simulating a step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..rust_env import Belief, Octree

if TYPE_CHECKING:
    from ..envs.env import NbvEnv

#: Keywords of a setup's `map` that a lone :class:`Octree` takes, too. Clamps do not belong to one image: they cut sums, but never
#: change their sign.
SENSOR = ("hit", "miss")
WIDE = {"clamp_min": 1e-9, "clamp_max": 1.0 - 1e-9}


class SurfaceLedger:
    """The hits and misses of every candidate's image on the surface voxels that coverage is measured against.

    It takes `K` images and maps of one image each, some seconds, and 4 bytes for every surface voxel that a view sees. It holds
    for one episode (the dome of another may stand elsewhere).

    Args:
        env: an environment in an episode, for which :meth:`fits` holds.
    """

    def __init__(self, env: NbvEnv) -> None:
        setup, belief, scene = env.task.setup["map"], env.belief, env.simulator.scene(0)
        self._surface = np.asarray(env.simulator.truth_surface(0)).reshape(-1, 3)
        sensor: dict[str, Any] = {name: setup[name] for name in SENSOR if name in setup} | WIDE
        views, camera = belief.candidates, belief.camera
        # Log-odds of a hit and of a miss, as the map adds them up: those of a voxel's first one. 0 if no view has one.
        self._hit = self._miss = np.float32(0.0)
        hits: list[NDArray[np.int32]] = []
        misses: list[NDArray[np.int32]] = []
        for view in views:
            image = Octree(belief.resolution, **sensor)
            depth = scene.render_depth(camera, view[np.newaxis])[0]
            image.insert_depth(depth, camera, view, setup.get("max_range"), setup.get("integration", "exact"))
            odds = np.asarray(image.log_odds(self._surface))
            hits.append(np.flatnonzero(odds >= 0.0).astype(np.int32))
            misses.append(np.flatnonzero(odds < 0.0).astype(np.int32))
            self._hit, self._miss = np.fmax(self._hit, np.nanmax(odds, initial=0.0)), np.fmin(self._miss, np.nanmin(odds, initial=0.0))
        self._hits, self._misses = Lists(hits), Lists(misses)

    @staticmethod
    def fits(env: NbvEnv) -> bool:
        """Whether images from the candidates are known beforehand: fixed views, a perfect sensor, and nothing that moves."""
        setup = env.task.setup
        fixed = setup["views"]["kind"] != "six_directions"
        return fixed and setup.get("noise") is None and not len(env.simulator.body_poses(0))

    def gains(self, belief: Belief) -> NDArray[np.int64]:
        """By how many the surface voxels that the map holds as occupied would grow with the image of each candidate (K,): those
        that a hit makes occupied, less those that a miss makes free. Exact if the robot gets there."""
        odds = np.asarray(belief.octree.log_odds(self._surface))
        occupied = odds >= 0.0
        won = ~occupied & ~(odds + self._hit < 0.0)  # an unknown voxel's NaN: any hit makes it occupied
        lost = occupied & (odds + self._miss < 0.0)
        return self._hits.count(won) - self._misses.count(lost)


class Lists:
    """Lists of indices, end to end."""

    def __init__(self, lists: list[NDArray[np.int32]]) -> None:
        self._joined = np.concatenate(lists)
        self._ends = np.cumsum([len(one) for one in lists])

    def count(self, marked: NDArray[np.bool_]) -> NDArray[np.int64]:
        """How many indices of each list are marked (k,)."""
        sums: NDArray[Any] = np.concatenate([[0], np.cumsum(marked[self._joined])])
        return np.diff(sums[self._ends], prepend=0)
