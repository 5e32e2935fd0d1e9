"""Yamauchi 1997, adapted from going to places to choosing viewpoints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..rust_env import Belief
from .agent import admissible, rotation, visits

#: Frontier voxels that are looked for; more are thinned out evenly.
SAMPLE = 1000


class NearestFrontier:
    """The candidate with the least travel cost among those that look at a good deal of frontier.

    Yamauchi (CIRA 1997) drives to the nearest boundary between open and unknown space. Here a boundary is a free voxel
    beside an unknown one, and a candidate looks at it if it lies in the middle of the image (`focus` of its width and
    height), within the camera's range, with no occupied voxel before it. A good deal is `share` of what the best
    candidate looks at. Without these two the nearest frontier is a sliver at the edge of the last image, and the camera
    creeps along by a hand's breadth a view.

    Costs that differ by less than a voxel are equal; among equals the candidate with more frontier wins, then the
    first. A view that was taken before shows nothing new and is left out while there are others; so are candidates
    without a path. Where no candidate looks at a frontier the least visited, nearest one is taken.

    Args:
        share: of the frontier voxels that the best candidate looks at, in (0, 1].
        focus: part of the image's width and height, in (0, 1].
    """

    def __init__(self, share: float = 0.5, focus: float = 0.25) -> None:
        for name, value in (("share", share), ("focus", focus)):
            if not 0.0 < value <= 1.0:
                raise ValueError(f"{name} must lie in (0, 1], got {value}")
        self.share = share
        self.focus = focus

    def reset(self, belief: Belief) -> None:
        """Nothing is kept from episode to episode."""

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        candidates, visited = belief.candidates, visits(belief)
        indices = admissible(belief)
        fresh = indices[visited[indices] == 0]
        indices = fresh if fresh.size else indices
        cost = np.asarray(belief.travel_cost(candidates[indices]), dtype=np.float64)
        finite = np.isfinite(cost)
        steps = np.where(finite, np.round(np.where(finite, cost, 0.0) / belief.resolution), np.inf)

        frontiers = belief.frontiers()
        if len(frontiers) > SAMPLE:
            frontiers = frontiers[np.linspace(0, len(frontiers) - 1, SAMPLE).astype(np.intp)]
        seen = np.array([visible_count(belief, view, frontiers, self.focus) for view in candidates[indices]])
        good = finite & (seen > 0) & (seen >= self.share * seen[finite].max(initial=0))
        # Of lexsort's keys the last counts most: least cost, then most frontier, then the first candidate.
        order = np.lexsort((-seen[good], steps[good])) if good.any() else np.lexsort((steps, visited[indices]))
        chosen = np.flatnonzero(good)[order[0]] if good.any() else order[0]
        return candidates[indices[chosen]]


def visible_count(belief: Belief, view: NDArray[np.float32], points: NDArray[np.float32], focus: float = 1.0) -> int:
    """How many of the points (n, 3) a camera at `view` (7,) has in the middle `focus` of its image and in sight, by
    the map."""
    camera = belief.camera
    offsets = points - view[:3]
    x, y, z = (offsets @ rotation(view)).T
    ranges = np.linalg.norm(offsets, axis=1)
    inside = (np.abs(x) * camera.fx <= z * focus * camera.width / 2) & (np.abs(y) * camera.fy <= z * focus * camera.height / 2)
    inside &= (z > 0) & (ranges > max(camera.near, 1e-6)) & (ranges <= camera.far)
    if not inside.any():
        return 0
    targets, reach = offsets[inside], ranges[inside]
    origins = np.broadcast_to(view[:3], targets.shape).astype(np.float32)
    directions = (targets / reach[:, None]).astype(np.float32)
    hits, states = belief.octree.cast_rays(origins, directions, float(reach.max()), ignore_unknown=True)
    return int(np.count_nonzero((states != 1) | (hits >= reach)))
