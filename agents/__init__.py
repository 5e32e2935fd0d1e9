"""Planners. A new one is a file here and a line in `AGENTS`; evaluation, tests and the command line pick it up."""

from __future__ import annotations

from .agent import Agent
from .greedy_gain import GreedyGain
from .nearest_frontier import NearestFrontier
from .random_view import RandomView
from .rollout import StepRecord, rollout

#: Agent classes by name.
AGENTS: dict[str, type] = {
    "random": RandomView,
    "nearest_frontier": NearestFrontier,
    "greedy": GreedyGain,
}

__all__ = ["AGENTS", "Agent", "GreedyGain", "NearestFrontier", "RandomView", "StepRecord", "rollout"]
