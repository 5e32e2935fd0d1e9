"""What a planner is: something that looks at a belief and names the next viewpoint."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..rust_env import Belief


@runtime_checkable
class Agent(Protocol):
    """A planner of next best views.

    An agent sees a `Belief` (the map, the estimated pose, the task's candidate viewpoints) and nothing else. If it
    draws random numbers, they come from a seed that its constructor takes, so that a run can be repeated; `reset`
    begins that stream anew.
    """

    def reset(self, belief: Belief) -> None:
        """Begin an episode; `belief` already holds the first image."""

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        """The viewpoint to go to: (7,) float32 `tx ty tz qx qy qz qw`, metres, world_from_camera."""


def admissible(belief: Belief) -> NDArray[np.intp]:
    """Indices of the candidates that the belief allows, what it learnt by touch included; all of them where it allows none
    (the robot is boxed in and the step may end in a contact, which the environment reports)."""
    indices = np.flatnonzero(belief.candidate_mask)
    return indices if indices.size else np.arange(len(belief.candidates))


def visits(belief: Belief) -> NDArray[np.intp]:
    """How often the camera was at each candidate (K,), the start included; to half a voxel and 2 degrees.

    `belief.visited` counts candidates of a fixed set; this also serves sets that move with the robot.
    """
    candidates, trajectory = belief.candidates, belief.trajectory
    distance = np.linalg.norm(candidates[:, None, :3] - trajectory[None, :, :3], axis=2)
    # |q . q'| is the cosine of half the angle between two headings.
    alike = np.abs(candidates[:, 3:] @ trajectory[:, 3:].T) > np.cos(np.deg2rad(1.0))
    return np.count_nonzero((distance < belief.resolution / 2) & alike, axis=1)


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
