"""The reference that every planner has to beat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..rust_env import Belief
from .agent import admissible


class RandomView:
    """A uniformly drawn admissible candidate, without repetition while there are candidates that were not visited."""

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed
        self._rng = np.random.default_rng(seed)

    def reset(self, belief: Belief) -> None:
        self._rng = np.random.default_rng(self.seed)

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        indices = admissible(belief)
        fresh = indices[belief.visited[indices] == 0]
        return belief.candidates[self._rng.choice(fresh if fresh.size else indices)]
