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
    """Indices of the candidates that the belief allows; all of them where it allows none (the robot is boxed in and
    the step may end in a contact, which the environment reports)."""
    indices = np.flatnonzero(belief.candidate_mask)
    return indices if indices.size else np.arange(len(belief.candidates))


class Bumps:
    """Remembers goals that the robot did not reach, because something that no image showed stood in the way.

    A planner that is sure of itself would bump into the same thing for ever.
    """

    def __init__(self) -> None:
        self._goal: NDArray[np.float32] | None = None
        self._missed: list[tuple[NDArray[np.float32], float]] = []

    def reset(self) -> None:
        self._goal, self._missed = None, []

    def sent_to(self, goal: NDArray[np.float32]) -> NDArray[np.float32]:
        """Note where the robot is sent; returns it."""
        self._goal = goal
        return goal

    def allowed(self, belief: Belief) -> NDArray[np.intp]:
        """Admissible candidates that are not as near to a missed goal as the robot fell short of it."""
        if self._goal is not None:
            short = float(np.linalg.norm(self._goal[:3] - belief.pose[:3]))
            if short > belief.resolution / 2:
                self._missed.append((self._goal[:3], short))
            self._goal = None
        indices = admissible(belief)
        positions = belief.candidates[indices, :3]
        clear = np.ones(len(indices), dtype=bool)
        for goal, short in self._missed:
            clear &= np.linalg.norm(positions - goal, axis=1) >= short
        return indices[clear] if clear.any() else indices


def visits(belief: Belief) -> NDArray[np.intp]:
    """How often the camera was at each candidate (K,), the start included; to half a voxel and 2 degrees.

    `belief.visited` counts candidates of a fixed set; this also serves sets that move with the robot.
    """
    candidates, trajectory = belief.candidates, belief.trajectory
    distance = np.linalg.norm(candidates[:, None, :3] - trajectory[None, :, :3], axis=2)
    # |q . q'| is the cosine of half the angle between two headings.
    alike = np.abs(candidates[:, 3:] @ trajectory[:, 3:].T) > np.cos(np.deg2rad(1.0))
    return np.count_nonzero((distance < belief.resolution / 2) & alike, axis=1)
