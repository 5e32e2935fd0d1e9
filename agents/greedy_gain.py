"""One-step look-ahead: the view that promises most, by any of the map's gain metrics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..rust_env import Belief
from .agent import admissible, visits


class GreedyGain:
    """The admissible candidate with the largest gain * exp(-cost_weight * travel cost).

    The discount is that of Gonzalez-Banos & Latombe 2002 (IJRR 21); `cost_weight` 0 is the plain greedy planner.
    Strict argmax, ties to the first candidate. Where no view promises anything it takes the least visited one.

    Args:
        metric: name of a gain, one of `Octree.GAINS`.
        cost_weight: lambda, 1/m.
        stride: cast the rays of every `stride`-th pixel row and column. In furnished rooms (64 x 48 pixels, 10 cm)
            4 explores as well as 1, at a fifteenth of the time.
    """

    def __init__(self, metric: str = "unknown_count", cost_weight: float = 0.0, stride: int = 4) -> None:
        if not cost_weight >= 0.0:
            raise ValueError(f"cost_weight must be >= 0 per metre, got {cost_weight}")
        self.metric = metric
        self.cost_weight = cost_weight
        self.stride = stride

    def reset(self, belief: Belief) -> None:
        """Nothing is kept from episode to episode."""

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        indices = admissible(belief)
        views = belief.candidates[indices]
        gains = np.asarray(belief.view_gain(views, self.metric, stride=self.stride), dtype=np.float64)
        if self.cost_weight > 0.0:
            gains = gains * np.exp(-self.cost_weight * belief.travel_cost(views).astype(np.float64))
        if gains.max() > 0.0:
            return views[gains.argmax()]
        return views[visits(belief)[indices].argmin()]
