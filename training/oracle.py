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
from .surface_ledger import SurfaceLedger

if TYPE_CHECKING:
    from ..envs.env import NbvEnv

#: The metric whose gains a :class:`SurfaceLedger` knows.
SURFACE = "new_surface_voxels"


class Oracle:
    """The admissible candidate whose simulated step gives most of a metric; ties to the first; the least visited one if none
    gives anything.

    A simulated step copies the whole map, so a `lazy` oracle simulates only the candidates that can still win by an upper bound
    of their gain:

    - For `new_surface_voxels` with fixed views, perfect images and nothing that moves the bound is the gain itself, counted by
      a :class:`SurfaceLedger`, for candidates that the robot gets to without contact; the others, whose images are taken on the
      way, are all simulated. The choices are those of the full search.
    - Else it is the candidate's last known gain (Minoux 1978). What a fixed view adds hardly grows while the map fills, but it can:
      misses and noise take voxels away again, entropy comes back with contradictions. So the choice is the full search's save
      for rare, small differences. Candidates that move with the robot are always all simulated.

    Args:
        env: the environment whose truth is used.
        metric: a per-step name of `METRICS`: new_surface_voxels, information_gain_bits or uncertainty_gain.
        lazy: see above.
    """

    cheats = True

    def __init__(self, env: NbvEnv, metric: str = SURFACE, lazy: bool = True) -> None:
        if metric not in METRICS:
            raise ValueError(f"the oracle's metric must be one of {', '.join(METRICS)}, got {metric!r}")
        self.env = env
        self.metric = metric
        self.lazy = lazy
        self._column = METRICS.index(metric)
        self._bounds: NDArray[np.float64] | None = None
        self._candidates: NDArray[np.float32] | None = None
        self._ledger: SurfaceLedger | None = None

    def reset(self, belief: Belief) -> None:
        self._bounds = self._candidates = None
        known = self.lazy and self.metric == SURFACE and SurfaceLedger.fits(self.env)
        self._ledger = SurfaceLedger(self.env) if known else None

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        candidates = belief.candidates
        indices = admissible(belief)
        bounds = self._upper_bounds(belief)
        stale = np.zeros(len(candidates), dtype=bool)
        stale[indices] = True
        best, gain = -1, 0.0
        while True:
            # Of equal gains the first candidate wins, and a gain must be positive to win at all.
            hopeful = np.flatnonzero(stale & ((bounds > gain) | ((bounds == gain) & (np.arange(len(bounds)) < best))))
            if not hopeful.size:
                break
            unknown = hopeful[np.isinf(bounds[hopeful])]
            tried = unknown if unknown.size else hopeful[[bounds[hopeful].argmax()]]
            bounds[tried] = self.true_gain(candidates[tried])
            stale[tried] = False
            found = tried[bounds[tried].argmax()]
            if bounds[found] > gain or (bounds[found] == gain and found < best):
                best, gain = int(found), float(bounds[found])
        return candidates[best if best >= 0 else indices[visits(belief)[indices].argmin()]]

    def _upper_bounds(self, belief: Belief) -> NDArray[np.float64]:
        """Of each candidate's gain (K,); what is written into them is kept for the next step."""
        if self._ledger is not None:
            bounds = self._ledger.gains(belief).astype(np.float64)
            allowed = admissible(belief)
            stopped = np.asarray(self.env.simulator.true_contact(0, belief.candidates[allowed]))
            bounds[allowed[stopped]] = np.inf
            return bounds
        candidates = belief.candidates
        moved = self._candidates is None or not np.array_equal(self._candidates, candidates)
        if moved or self._bounds is None or not self.lazy:
            self._bounds = np.full(len(candidates), np.inf)
            self._candidates = candidates
        return self._bounds

    def true_gain(self, views: NDArray[np.float32]) -> NDArray[np.float64]:
        """What a step to each view (k, 7) would give, (k,)."""
        return np.asarray(self.env.simulator.true_gain(0, views))[:, self._column]
