"""What Wang et al. 2019 (RA-L) print: Table I, what their methods are called there, and which rooms of ours stand for theirs."""

from __future__ import annotations

from ..agents.wang2019 import POLICIES

#: Names in the paper's Table I.
NAMES = {
    "random_neighbour": "Random",
    "basegain_p": "BaseGain-P",
    "basegain_e": "BaseGain-E",
    "infogain": "InfoGain",
    "cnn": "CNN",
    "cgain_rand": "CGain-Rand",
    "cgain_tc": "CGain-TC",
    "cgain_watc": "CGain-WATC",
    "cgain_ns": "CGain-NS",
    "cgain_wa": "CGain-WA",
}
SYNTHETIC = ("room1", "room2", "room3", "room4")
#: Our generated rooms, and the synthetic room that each stands for. Ours hold ever more: 25, 39, 50 and 62 pieces of furniture and
#: things on it. The paper does not say how its rooms differ.
ROOMS = dict(zip(("room:38", "room:53", "room:1", "room:50"), SYNTHETIC, strict=True))
REAL = ("mroom", "lab", "office", "corridor", "storage")
#: Steps of a run, and metres of a voxel.
STEPS = 130
VOXEL = 0.025

#: Coverage after 130 steps and its standard deviation over five runs, by room; methods in the order of `NAMES`.
_MEANS = {
    "room1": (0.49, 0.22, 0.52, 0.89, 0.26, 0.91, 0.89, 0.94, 0.93, 0.99),
    "room2": (0.53, 0.28, 0.45, 0.83, 0.15, 0.83, 0.83, 0.86, 0.84, 0.87),
    "room3": (0.52, 0.24, 0.48, 0.89, 0.19, 0.80, 0.86, 0.87, 0.90, 0.83),
    "room4": (0.58, 0.23, 0.53, 0.84, 0.24, 0.81, 0.85, 0.90, 0.82, 0.90),
    "mroom": (0.39, 0.32, 0.42, 0.78, 0.29, 0.80, 0.78, 0.82, 0.79, 0.84),
    "lab": (0.35, 0.49, 0.45, 0.86, 0.25, 0.85, 0.89, 0.79, 0.83, 0.84),
    "office": (0.49, 0.20, 0.20, 0.87, 0.31, 0.89, 0.89, 0.85, 0.89, 0.89),
    "corridor": (0.44, 0.10, 0.16, 0.83, 0.43, 0.86, 0.81, 0.83, 0.84, 0.72),
    "storage": (0.43, 0.29, 0.44, 0.87, 0.40, 0.99, 0.85, 0.97, 0.81, 0.84),
}
_DEVIATIONS = {
    "room1": (0.20, 0.15, 0.10, 0.20, 0.10, 0.02, 0.20, 0.04, 0.04, 0.03),
    "room2": (0.15, 0.04, 0.11, 0.10, 0.04, 0.03, 0.10, 0.04, 0.08, 0.07),
    "room3": (0.10, 0.09, 0.01, 0.05, 0.07, 0.02, 0.05, 0.04, 0.03, 0.04),
    "room4": (0.18, 0.13, 0.04, 0.13, 0.08, 0.02, 0.13, 0.11, 0.26, 0.10),
    "mroom": (0.11, 0.08, 0.06, 0.04, 0.10, 0.02, 0.06, 0.05, 0.02, 0.03),
    "lab": (0.16, 0.07, 0.11, 0.04, 0.10, 0.02, 0.05, 0.06, 0.06, 0.05),
    "office": (0.11, 0.09, 0.11, 0.03, 0.09, 0.02, 0.04, 0.09, 0.04, 0.04),
    "corridor": (0.21, 0.03, 0.11, 0.06, 0.06, 0.04, 0.04, 0.03, 0.03, 0.24),
    "storage": (0.18, 0.15, 0.04, 0.20, 0.07, 0.01, 0.18, 0.03, 0.10, 0.22),
}
#: Table I: mean and standard deviation by room and policy.
TABLE: dict[str, dict[str, tuple[float, float]]] = {
    room: dict(zip(POLICIES, zip(means, _DEVIATIONS[room], strict=True), strict=True)) for room, means in _MEANS.items()
}
#: Reconstruction error, metres: "on average within the range" (page 7).
ERROR = (0.04, 0.07)
#: Time of choosing the view, milliseconds: "around 0.8 s" (page 7).
PLANNING_MS = 800.0


def mean_of(method: str, rooms: tuple[str, ...]) -> float:
    """The mean of a method's column of Table I over some rooms."""
    return sum(TABLE[room][method][0] for room in rooms) / len(rooms)
