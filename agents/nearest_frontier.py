"""Yamauchi 1997, adapted from going to places to choosing viewpoints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..rust_env import Belief
from .agent import admissible, visits

#: Candidates whose frontiers are looked for at once: the nearest usually does, so that most are never looked at.
BATCH = 16


class NearestFrontier:
    """The candidate with the least travel cost that sees at least `min_voxels` frontier voxels.

    Yamauchi (CIRA 1997) drives to the nearest boundary between open and unknown space. Here a boundary is a free voxel
    beside an unknown one, and a candidate sees it if it lies in the image, within the camera's range, with no
    occupied voxel before it. Costs that differ by less than a voxel are equal; among equals the one with more
    frontier voxels wins, then the first. A view that was taken before shows nothing new and is left out while there
    are others; so are candidates without a path. Where no candidate sees a frontier the least visited, nearest is taken.

    Args:
        min_voxels: smaller groups of frontier voxels are noise.
        sample: look for at most so many frontier voxels, evenly spread over all; 0 looks for all of them. The
            number that a candidate must see is lowered in proportion.
    """

    def __init__(self, min_voxels: int = 20, sample: int = 4000) -> None:
        if min_voxels < 1 or sample < 0:
            raise ValueError(f"min_voxels must be >= 1 and sample >= 0, got {min_voxels} and {sample}")
        self.min_voxels = min_voxels
        self.sample = sample

    def reset(self, belief: Belief) -> None:
        pass

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        candidates, visited = belief.candidates, visits(belief)
        indices = admissible(belief)
        fresh = indices[visited[indices] == 0]
        indices = fresh if fresh.size else indices
        cost = np.asarray(belief.travel_cost(candidates[indices]), dtype=np.float64)
        steps = np.where(np.isfinite(cost), np.round(cost / belief.resolution), np.inf)
        order = np.argsort(steps, kind="stable")

        frontiers = belief.frontiers()
        total = len(frontiers)
        if self.sample and total > self.sample:
            frontiers = frontiers[np.linspace(0, total - 1, self.sample).astype(np.intp)]
        needed = max(1, round(self.min_voxels * len(frontiers) / max(total, 1)))

        start = 0
        while start < len(order) and np.isfinite(steps[order[start]]) and len(frontiers):
            # A batch never ends within a group of equal cost.
            end = min(start + BATCH, len(order))
            while end < len(order) and steps[order[end]] == steps[order[end - 1]]:
                end += 1
            batch = order[start:end]
            seen = np.array([visible_count(belief, candidates[i], frontiers) for i in indices[batch]])
            good = seen >= needed
            if good.any():
                nearest = batch[good][0]
                ties = good & (steps[batch] == steps[nearest])
                return candidates[indices[batch[np.argmax(np.where(ties, seen, -1))]]]
            start = end
        best = np.lexsort((steps, visited[indices]))[0]
        return candidates[indices[best]]


def visible_count(belief: Belief, view: NDArray[np.float32], points: NDArray[np.float32]) -> int:
    """How many of the points (n, 3) a camera at `view` (7,) has in its image and in sight, by the map."""
    camera = belief.camera
    offsets = points - view[:3]
    x, y, z = (offsets @ rotation(view)).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    ranges = np.linalg.norm(offsets, axis=1)
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    inside &= (ranges > max(camera.near, 1e-6)) & (ranges <= camera.far)
    if not inside.any():
        return 0
    targets, reach = offsets[inside], ranges[inside]
    origins = np.broadcast_to(view[:3], targets.shape).astype(np.float32)
    directions = (targets / reach[:, None]).astype(np.float32)
    hits, states = belief.octree.cast_rays(origins, directions, float(reach.max()), ignore_unknown=True)
    return int(np.count_nonzero((states != 1) | (hits >= reach)))


def rotation(view: NDArray[np.float32]) -> NDArray[np.float64]:
    """The rotation matrix (3, 3) of a viewpoint; its columns are the camera's axes in the world."""
    x, y, z, w = np.asarray(view[3:7], dtype=np.float64) / np.linalg.norm(view[3:7])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
