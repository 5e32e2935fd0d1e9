"""Rewards and success tests: functions on columns of metrics.

A column is an array (n,), one value per environment; their names and units stand in :data:`nbv_gym.rust_env.METRICS`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..rust_env import METRICS

Columns: TypeAlias = Mapping[str, NDArray[np.float64]]
Metric: TypeAlias = Callable[[Columns], NDArray[Any]]


@dataclasses.dataclass(frozen=True)
class Reward:
    """What a step gained, minus what it cost.

    Attributes:
        gain: A column, in its own unit: ``information_gain_bits`` (entropy of the map lost in this step, bits),
            ``uncertainty_gain`` (rise of the sum of 1 - u over occupied voxels, Lluvia 2023 Eq. 11) or
            ``new_surface_voxels`` (surface voxels first held as occupied).
        scale: Reward per unit of gain.
        travel_cost: Reward lost per metre travelled.
        collision_cost: Reward lost when the motion was stopped by contact.
    """

    gain: str
    scale: float = 1.0
    travel_cost: float = 0.0
    collision_cost: float = 0.0

    def __post_init__(self) -> None:
        if self.gain not in METRICS:
            raise ValueError(f"reward gain {self.gain!r} is not a metric; there are {', '.join(METRICS)}")
        for name in ("scale", "travel_cost", "collision_cost"):
            value = getattr(self, name)
            if not np.isfinite(value) or (value < 0 and name != "scale"):
                raise ValueError(f"reward {name} must be finite{' and >= 0' * (name != 'scale')}, got {value}")

    def __call__(self, metrics: Columns) -> NDArray[np.float64]:
        reward = self.scale * metrics[self.gain]
        if self.travel_cost:
            reward = reward - self.travel_cost * metrics["travel"]
        if self.collision_cost:
            reward = reward - self.collision_cost * metrics["contact"]
        return reward


@dataclasses.dataclass(frozen=True)
class CoverageAtLeast:
    """Success when the map holds this fraction of the surface voxels that sight can reach."""

    fraction: float

    def __post_init__(self) -> None:
        if not 0 < self.fraction <= 1:
            raise ValueError(f"coverage must lie in (0, 1], got {self.fraction}")

    def __call__(self, metrics: Columns) -> NDArray[np.bool_]:
        return metrics["coverage"] >= self.fraction
