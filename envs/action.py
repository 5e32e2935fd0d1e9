"""Actions: how what a policy says becomes a viewpoint.

An action turns a batch into viewpoints (n, 7) float32 and back. Nothing is simulated before the whole batch was found
good, so that a bad action leaves every environment as it was.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol, runtime_checkable

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

Viewpoints = NDArray[np.float32]


@runtime_checkable
class Action(Protocol):
    """What an action can do."""

    @property
    def has_mask(self) -> bool:
        """Whether candidates, and with them action masks, make sense."""

    def space(self, num_candidates: int) -> spaces.Space[Any]:
        """Space of one environment's action."""

    def decode(self, actions: Any, candidates: Viewpoints, bounds: Viewpoints, active: NDArray[np.bool_]) -> Viewpoints:
        """Viewpoints of a batch of actions.

        Args:
            actions: The batch, n rows.
            candidates: (n, K, 7) the candidate views.
            bounds: (n, 2, 3) lower and upper corner of what is to be explored, metres.
            active: (n,) environments that are stepped; the actions of others are not looked at.

        Returns:
            (n, 7); zeros where not active.

        Raises:
            TypeError: A dtype that is not an action's.
            ValueError: A wrong shape or value; the message names the environment.
        """

    def encode(self, viewpoint: NDArray[Any], candidates: Viewpoints, bounds: Viewpoints) -> Any:
        """The action that leads to a viewpoint (7,), or as near to it as there is one.

        Args:
            viewpoint: (7,).
            candidates: (K, 7).
            bounds: (2, 3).
        """


@dataclasses.dataclass(frozen=True)
class CandidateIndex:
    """The index of one of the K candidate views: ``Discrete(K)``."""

    has_mask = True

    def space(self, num_candidates: int) -> spaces.Discrete:
        return spaces.Discrete(num_candidates)

    def decode(self, actions: Any, candidates: Viewpoints, bounds: Viewpoints, active: NDArray[np.bool_]) -> Viewpoints:
        n, k, _ = candidates.shape
        indices = np.asarray(actions)
        if indices.dtype.kind not in "iu":
            raise TypeError(f"actions must be integers, got {indices.dtype} ({preview(actions)})")
        if indices.shape != (n,):
            raise ValueError(f"actions must have shape ({n},), got {indices.shape}")
        bad = active & ((indices < 0) | (indices >= k))
        if bad.any():
            i = int(bad.argmax())
            raise ValueError(f"environment {i}: action {indices[i]} is not in 0..{k - 1}")
        if active.all():
            return candidates[np.arange(n), indices]
        chosen = np.where(active, indices, 0).astype(np.intp)
        return np.where(active[:, None], candidates[np.arange(n), chosen], np.float32(0))

    def encode(self, viewpoint: NDArray[Any], candidates: Viewpoints, bounds: Viewpoints) -> np.int64:
        goal = checked_viewpoint(viewpoint)
        # Both signs of a quaternion are the same rotation; 1 - |q.q'| is small where they agree.
        distance = np.linalg.norm(candidates[:, :3] - goal[:3], axis=1)
        turn = 1.0 - np.abs(candidates[:, 3:] @ goal[3:])
        return np.int64(np.argmin(distance + turn))


@dataclasses.dataclass(frozen=True)
class FreeViewpoint:
    """Any viewpoint: ``Box(-1, 1, (7,), float32)``. The first three numbers run from the lower to the upper corner of
    the exploration bounds, the last four are a quaternion of any length but zero."""

    has_mask = False
    #: Quaternions shorter than this have no direction to speak of.
    MIN_NORM = 1e-3

    def space(self, num_candidates: int) -> spaces.Box:
        return spaces.Box(-1.0, 1.0, (7,), np.float32)

    def decode(self, actions: Any, candidates: Viewpoints, bounds: Viewpoints, active: NDArray[np.bool_]) -> Viewpoints:
        n = len(bounds)
        values = np.asarray(actions)
        if values.dtype.kind not in "fiu":
            raise TypeError(f"actions must be real numbers, got {values.dtype} ({preview(actions)})")
        if values.shape != (n, 7):
            raise ValueError(f"actions must have shape ({n}, 7), got {values.shape}")
        values = values.astype(np.float32)
        # Written so that NaN is bad, too; rounding to float32 may step over the edge a little.
        bad = active & ~(np.abs(values) <= 1 + 1e-6).all(axis=1)
        if bad.any():
            i = int(bad.argmax())
            raise ValueError(f"environment {i}: action {values[i].tolist()} is not in [-1, 1]")
        norm = np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
        bad = active & (norm[:, 0] < self.MIN_NORM)
        if bad.any():
            i = int(bad.argmax())
            raise ValueError(f"environment {i}: action {values[i].tolist()} has no direction, its quaternion is 0")
        viewpoints = np.zeros((n, 7), np.float32)
        low, high = bounds[active, 0], bounds[active, 1]
        viewpoints[active, :3] = low + (values[active, :3] + 1) / 2 * (high - low)
        viewpoints[active, 3:] = values[active, 3:] / norm[active]
        return viewpoints

    def encode(self, viewpoint: NDArray[Any], candidates: Viewpoints, bounds: Viewpoints) -> NDArray[np.float32]:
        goal = checked_viewpoint(viewpoint)
        low, high = bounds
        goal[:3] = np.clip((goal[:3] - low) / (high - low) * 2 - 1, -1, 1)
        return goal


def checked_viewpoint(viewpoint: NDArray[Any]) -> NDArray[np.float32]:
    """A viewpoint (7,) with a quaternion of length one."""
    goal = np.array(viewpoint, np.float32)
    if goal.shape != (7,):
        raise ValueError(f"a viewpoint must have shape (7,), got {goal.shape}")
    norm = np.linalg.norm(goal[3:])
    if not (np.isfinite(goal).all() and 1e-6 < norm < np.inf):
        raise ValueError(f"a viewpoint must be finite with a quaternion != 0, got {goal.tolist()}")
    goal[3:] /= norm
    return goal


def preview(actions: object) -> str:
    """The beginning of what was given, for a message."""
    text = " ".join(repr(actions).split())
    return text if len(text) <= 60 else text[:57] + "..."
