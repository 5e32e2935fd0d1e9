"""One episode: an agent at work in an environment, and what came of every step."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..rust_env import METRICS
from .agent import Agent

if TYPE_CHECKING:
    from ..envs.env import NbvEnv


@dataclass
class StepRecord:
    """What is known after one view. Record 0 is the view from the start, before any decision."""

    #: Where the camera believes to be, (7,) `tx ty tz qx qy qz qw`.
    viewpoint: NDArray[np.float32]
    #: The environment's metrics by name (`METRICS`).
    metrics: dict[str, float]
    #: The action that led here, None at the start.
    action: Any = None
    reward: float = 0.0
    #: Wall-clock milliseconds that the agent thought. This and `stage_ms` alone differ from run to run.
    planning_ms: float = 0.0
    terminated: bool = False
    truncated: bool = False
    #: Wall-clock milliseconds of the step by stage, see `STAGES`.
    stage_ms: dict[str, float] = field(default_factory=dict)
    #: What the observer of the rollout adds, if anything.
    extra: dict[str, Any] = field(default_factory=dict)


def rollout(
    env: NbvEnv,
    agent: Agent,
    seed: int | None = 0,
    observer: Callable[[NbvEnv, StepRecord], None] | None = None,
) -> list[StepRecord]:
    """Run one episode.

    Args:
        env: a single environment of this package (`gym.make(...).unwrapped`).
        agent: decides; sees `env.belief` only.
        seed: given to `env.reset`; None goes on with the environment's stream.
        observer: called after the reset and after each step, with the environment and the new record.

    Returns:
        One record per view, the start's first.
    """
    _, info = env.reset(seed=seed)
    belief = env.belief
    agent.reset(belief)
    records: list[StepRecord] = []
    before = env.simulator.timings()

    def note(record: StepRecord) -> bool:
        records.append(record)
        if observer is not None:
            observer(env, record)
        return record.terminated or record.truncated

    done = note(StepRecord(belief.pose, _metrics(info)))
    while not done:
        started = time.perf_counter()
        view = agent.next_view(belief)
        planning_ms = (time.perf_counter() - started) * 1e3
        action = env.action_of(view)
        _, reward, terminated, truncated, info = env.step(action)
        now = env.simulator.timings()
        stage_ms = {stage: (now[stage] - before[stage]) * 1e3 for stage in now}
        before = now
        outcome = (action, float(reward), planning_ms, bool(terminated), bool(truncated), stage_ms)
        done = note(StepRecord(belief.pose, _metrics(info), *outcome))
    return records


def _metrics(info: dict[str, Any]) -> dict[str, float]:
    return {name: float(info[name]) for name in METRICS}
