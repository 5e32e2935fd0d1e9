"""Wang et al. 2019, "Autonomous 3D reconstruction, mapping and exploration of indoor environments with a robotic arm"
(IEEE RA-L): ten policies that choose among the neighbours of the current view.

Each scores the candidate poses p_j that are neighbours of the current one by a hand-crafted utility u_g (section III), by
a learnt one u_h (section IV), or by a combination of both (section V), and goes to the best; ties go to the first.
Everything that sets two policies apart is one small function below; read them side by side.

    u_g   mean utility of the rays of a view, `Belief.view_gain`: "view_history" (InfoGain, Eq. 3), "ray_entropy" (BaseGain-E)
          or "ray_probability" (BaseGain-P)
    u_h   how well the way to p_j agrees with the direction that the CNN suggests for the current depth image (Eq. 6)
    t     number of the decision, from 1
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..rust_env import Belief
from .agent import admissible, rotation
from .six_direction import DIRECTIONS, SixDirectionPolicy

Scores = NDArray[np.float64]

#: Step between rays, radians (section III-B).
RAY_STEP = np.pi / 400
#: Steps of the learnt utility before Naive Switching changes over, and of the weighted average before WATC does (section V
#: names "initial steps" for the latter).
TAU = 10
#: Window of Temporal Conditioning, steps (section V).
WINDOW = 3


@dataclass
class Decision:
    """What a strategy may look at: the candidates of one step and what went before."""

    t: int
    #: (k,) hand-crafted utility of each candidate, and the learnt one.
    gain: Callable[[], Scores]
    hint: Callable[[], Scores]
    #: Of the last steps and this one, oldest first: the largest u_g, and whether u_g and u_h suggest different poses. Kept only
    #: for the strategies in :data:`LOOK_BACK`, since it takes both u_g and u_h at every step.
    gains: list[float] = field(default_factory=list)
    differ: list[bool] = field(default_factory=list)


# --- The strategies: Decision -> utility of each candidate --------------------------------------------------------------------


def gain_only(d: Decision) -> Scores:
    """u = u_g: InfoGain, BaseGain-E, BaseGain-P (page 3)."""
    return d.gain()


def hint_only(d: Decision) -> Scores:
    """u = u_h: CNN (page 4)."""
    return d.hint()


def naive_switching(d: Decision) -> Scores:
    """Eq. 7: u = u_h while t <= tau, then u_g: CGain-NS (page 5)."""
    return d.hint() if d.t <= TAU else d.gain()


def weighted_average(d: Decision) -> Scores:
    """Eq. 8: u = (1 - a) u_g + a u_h with a(t) = 1 / t: CGain-WA, and CGain-Rand with a random direction (page 5)."""
    a = 1.0 / d.t
    return (1.0 - a) * d.gain() + a * d.hint()


def temporal_conditioning(d: Decision) -> Scores:
    """Eq. 9: u = u_h where, over a window of three steps, u_g strictly fell (c_1) and both suggested different poses (c_2);
    else u_g: CGain-TC (page 5)."""
    gains, differ = d.gains[-WINDOW:], d.differ[-WINDOW:]
    c1 = len(gains) == WINDOW and all(now < before for before, now in itertools.pairwise(gains))
    c2 = len(differ) == WINDOW and all(differ)
    return d.hint() if c1 and c2 else d.gain()


def weighted_average_then_conditioning(d: Decision) -> Scores:
    """Eq. 8 in the initial steps (t <= tau), then Eq. 9: CGain-WATC (page 5)."""
    return weighted_average(d) if d.t <= TAU else temporal_conditioning(d)


#: The strategies that read the history of a decision.
LOOK_BACK = (temporal_conditioning, weighted_average_then_conditioning)


# --- The policies -------------------------------------------------------------------------------------------------------------


class Wang2019:
    """One of the paper's policies.

    Args:
        strategy: How u_g and u_h become one utility.
        metric: The gain behind u_g; `None` where it is not used.
        direction: The suggested direction behind u_h: "cnn", "random", or `None` where it is not used.
        weights: Checkpoint of the CNN; the one that comes with the package if not given.
        seed: Of the random direction.
    """

    def __init__(
        self,
        strategy: Callable[[Decision], Scores],
        metric: str | None,
        direction: str | None = None,
        weights: str = "",
        seed: int = 0,
    ) -> None:
        self.strategy = strategy
        self.metric = metric
        self.direction = direction
        self.seed = seed
        self._cnn = SixDirectionPolicy.load(weights) if direction == "cnn" else None
        self._rng = np.random.default_rng(seed)
        self._t, self._gains, self._differ = 0, list[float](), list[bool]()

    def reset(self, belief: Belief) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._t, self._gains, self._differ = 0, [], []

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        views = belief.candidates[neighbours(belief)]
        self._t += 1
        known: dict[str, Scores] = {}

        def gain() -> Scores:
            if "gain" not in known:
                known["gain"] = np.asarray(belief.view_gain(views, self.metric or "", angle_step=RAY_STEP), dtype=np.float64)
            return known["gain"]

        def hint() -> Scores:
            if "hint" not in known:
                known["hint"] = agreement(belief.pose, views, self._suggestion(belief))
            return known["hint"]

        if self.strategy in LOOK_BACK:
            self._gains.append(float(gain().max()))
            self._differ.append(int(gain().argmax()) != int(hint().argmax()))
        utility = self.strategy(Decision(self._t, gain, hint, self._gains, self._differ))
        return views[int(utility.argmax())]

    def _suggestion(self, belief: Belief) -> NDArray[np.float64]:
        """e*: the suggested direction in the camera's frame, (3,)."""
        if self._cnn is not None:
            return DIRECTIONS[self._cnn.direction(belief.depth, belief.camera)]
        return DIRECTIONS[int(self._rng.integers(len(DIRECTIONS)))]


class RandomNeighbour:
    """Random: a uniformly drawn neighbour of the current pose (page 6)."""

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed
        self._rng = np.random.default_rng(seed)

    def reset(self, belief: Belief) -> None:
        self._rng = np.random.default_rng(self.seed)

    def next_view(self, belief: Belief) -> NDArray[np.float32]:
        return belief.candidates[self._rng.choice(neighbours(belief))]


def neighbours(belief: Belief) -> NDArray[np.intp]:
    """Omega_i: the admissible candidates next to the current one; all admissible ones where there are none."""
    allowed = admissible(belief)
    near = np.intersect1d(allowed, belief.neighbours())
    return near if near.size else allowed


def agreement(pose: NDArray[np.float32], views: NDArray[np.float32], suggestion: NDArray[np.float64]) -> Scores:
    """Eq. 6: u_h = (delta e_ji . e*_i + 1) / 2 with e*_i = R_i e*, in [0, 1].

    Args:
        pose: (7,) the current viewpoint.
        views: (k, 7) the candidates; one at the same place agrees by 1/2.
        suggestion: (3,) unit direction e* in the camera's frame.
    """
    way = views[:, :3].astype(np.float64) - pose[:3]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    way = np.divide(way, length, out=np.zeros_like(way), where=length > 1e-9)
    return (way @ (rotation(pose) @ suggestion) + 1.0) / 2.0


def base_gain_p() -> Wang2019:
    return Wang2019(gain_only, "ray_probability")


def base_gain_e() -> Wang2019:
    return Wang2019(gain_only, "ray_entropy")


def info_gain() -> Wang2019:
    return Wang2019(gain_only, "view_history")


def cnn(weights: str = "") -> Wang2019:
    return Wang2019(hint_only, None, "cnn", weights)


def cgain_rand(seed: int = 0) -> Wang2019:
    return Wang2019(weighted_average, "view_history", "random", seed=seed)


def cgain_tc(weights: str = "") -> Wang2019:
    return Wang2019(temporal_conditioning, "view_history", "cnn", weights)


def cgain_watc(weights: str = "") -> Wang2019:
    return Wang2019(weighted_average_then_conditioning, "view_history", "cnn", weights)


def cgain_ns(weights: str = "") -> Wang2019:
    return Wang2019(naive_switching, "view_history", "cnn", weights)


def cgain_wa(weights: str = "") -> Wang2019:
    return Wang2019(weighted_average, "view_history", "cnn", weights)


#: The ten policies in the order of the paper's Table I.
POLICIES: dict[str, Callable[..., Any]] = {
    "random_neighbour": RandomNeighbour,
    "basegain_p": base_gain_p,
    "basegain_e": base_gain_e,
    "infogain": info_gain,
    "cnn": cnn,
    "cgain_rand": cgain_rand,
    "cgain_tc": cgain_tc,
    "cgain_watc": cgain_watc,
    "cgain_ns": cgain_ns,
    "cgain_wa": cgain_wa,
}
#: Those that ask for the gain `view_history`, so that the map must keep one.
NEED_VIEW_HISTORY = frozenset({"infogain", "cgain_rand", "cgain_tc", "cgain_watc", "cgain_ns", "cgain_wa"})
#: Those that ask the CNN, so that torch must be there.
LEARNT = frozenset({"cnn", "cgain_tc", "cgain_watc", "cgain_ns", "cgain_wa"})
