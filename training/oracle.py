"""The upper bound: greedy with the true gain. IT CHEATS, on purpose.

An oracle is made from the environment itself and lets the simulator try views out. It stands in `training` because
`agents` cannot see the truth, by construction; it is no entry of `AGENTS`, and `evaluate` knows it as "oracle".
Every other result can then be read as "x % of the oracle".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..agents.agent import admissible, visits
from ..rust_env import METRICS, Belief

if TYPE_CHECKING:
    from ..envs.env import NbvEnv

#: Views that are simulated at once when the lazy search asks for better bounds.
BATCH = 8


class Oracle:
    """The admissible candidate whose simulated step gives most of a metric; ties to the first.

    With `lazy` (Minoux 1978) a candidate is simulated again only while its last known gain could still win: what a
    fixed view adds can hardly grow while the map fills, so that the choice is the full search's save for rare ties with
    measurement effects, at a fraction of the cost. Candidates that move with the robot are always all simulated.

    Args:
        env: the environment whose truth is used.
        metric: a per-step name of `METRICS`: new_surface_voxels, information_gain_bits or uncertainty_gain.
        lazy: see above.
    """

    cheats = True

    def __init__(self, env: NbvEnv, metric: str = "new_surface_voxels", lazy: bool = True) -> None:
        if metric not in METRICS:
            raise ValueError(f"the oracle's metric must be one of {', '.join(METRICS)}, got {metric!r}")
        self.env = env
        self.metric = metric
        self.lazy = lazy
        self._column = METRICS.index(metric)
        self._bounds: NDArray[np.float64] | None = None
        self._candidates: NDArray[np.float32] | None = None

    def reset(self, belief: Belief) -> None:
        self._bounds = self._candidates = None

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        candidates = belief.candidates
        indices = admissible(belief)
        moved = self._candidates is None or not np.array_equal(self._candidates, candidates)
        if moved or self._bounds is None or not self.lazy:
            self._bounds = np.full(len(candidates), np.inf)
            self._candidates = candidates
        bounds, fresh = self._bounds, np.zeros(len(candidates), dtype=bool)
        while True:
            stale = indices[~fresh[indices]]
            known = bounds[indices[fresh[indices]]].max(initial=-np.inf)
            # Equal bounds are simulated too: of equal gains the first candidate wins.
            hopeful = stale[bounds[stale] >= known]
            if not hopeful.size:
                break
            unknown = hopeful[np.isinf(bounds[hopeful])]
            batch = unknown if unknown.size else hopeful[np.argsort(-bounds[hopeful], kind="stable")][:BATCH]
            bounds[batch] = self.true_gain(candidates[batch])
            fresh[batch] = True
        best = bounds[indices]
        if best.max() > 0.0:
            return candidates[indices[best.argmax()]]
        return candidates[indices[visits(belief)[indices].argmin()]]

    def true_gain(self, views: NDArray[np.float32]) -> NDArray[np.float64]:
        """What a step to each view (k, 7) would give, (k,)."""
        return np.asarray(self.env.simulator.true_gain(0, views))[:, self._column]
