"""Planners. A new one is a file here and a line in `AGENTS`; evaluation, tests and the command line pick it up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import wang2019
from .agent import Agent
from .greedy_gain import GreedyGain
from .nearest_frontier import NearestFrontier
from .random_view import RandomView
from .rollout import StepRecord, rollout

#: What makes an agent, by name: a class or a function. Its parameters may be given on the command line (`greedy:stride=4`).
AGENTS: dict[str, Callable[..., Any]] = {
    "random": RandomView,
    "nearest_frontier": NearestFrontier,
    "greedy": GreedyGain,
    **wang2019.POLICIES,
}

__all__ = ["AGENTS", "Agent", "GreedyGain", "NearestFrontier", "RandomView", "StepRecord", "rollout"]
