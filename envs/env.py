"""NbvEnv: a vector environment of one."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from ..rust_env import Belief, Simulator
from . import observation
from .task import Task
from .vector_env import NbvVectorEnv


class NbvEnv(gym.Env[Any, Any]):
    """One next-best-view episode after the other: row 0 of a :class:`~nbv_gym.envs.vector_env.NbvVectorEnv`, whose
    docstring describes observation, action, reward, termination and info.

    Args:
        task: A task, or its name in :data:`nbv_gym.envs.suite.TASKS`.
        render_mode: ``None`` or ``"rgb_array"``.
        num_threads: Threads for batched view gains and look-ahead; results do not depend on it.
        **overrides: Values of the task to replace, see :meth:`nbv_gym.envs.task.Task.variant`.
    """

    metadata = NbvVectorEnv.metadata

    def __init__(
        self,
        task: Task | str = "dome_room",
        *,
        render_mode: str | None = None,
        num_threads: int = 1,
        **overrides: Any,
    ) -> None:
        reserved = [name for name in ("num_envs", "autoreset_mode", "copy") if name in overrides]
        if reserved:
            raise TypeError(f"a single environment does not know {', '.join(reserved)}")
        self._vector = NbvVectorEnv(
            task,
            num_envs=1,
            num_threads=num_threads,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode=render_mode,
            copy=False,  # the rows are copied below
            **overrides,
        )
        self.render_mode = render_mode
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin a new episode; ``seed`` begins the stream of episodes anew, ``None`` goes on with it.

        Raises:
            As :meth:`NbvVectorEnv.reset`.
        """
        mask, seeds = self._vector._reset_arguments(None if seed is None else [seed], options)
        super().reset(seed=seeds[0])
        self._vector._begin(self._vector.simulator, mask, seeds)
        return first(self._vector._observations()), self._vector._info(0)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Go to a view, look, and update the map."""
        rewards, terminated, truncated = self._vector._advance(np.asarray(action)[np.newaxis])
        observations = first(self._vector._observations())
        return observations, float(rewards[0]), bool(terminated[0]), bool(truncated[0]), self._vector._info(0)

    def snapshot(self) -> bytes:
        """Everything that decides what comes next; see :meth:`NbvVectorEnv.snapshot`."""
        return self._vector._save(self)

    def restore(self, snapshot: bytes) -> tuple[Any, dict[str, Any]]:
        """Go on, bit for bit, where a snapshot was taken; see :meth:`NbvVectorEnv.restore`.

        Returns:
            Observation and info as they were last.
        """
        self._vector._load(self, snapshot)
        return first(self._vector._observations()), self._vector._info(0)

    def clone(self) -> NbvEnv:
        """An independent environment that goes on from here, e.g. to look ahead; the same as ``copy.deepcopy``."""
        return copy.deepcopy(self)

    def render(self) -> NDArray[np.uint8] | None:
        """A frame (height, width, 3) uint8: depth image, map from above, metrics."""
        frames = self._vector.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        self._vector.close()

    @property
    def task(self) -> Task:
        return self._vector.task

    @property
    def budget(self) -> int:
        """Steps until the episode is truncated."""
        return self._vector.budget

    @property
    def simulator(self) -> Simulator:
        """The core with one environment: for reports, oracles and viewers. It knows the truth."""
        return self._vector.simulator

    @property
    def belief(self) -> Belief:
        """What a planner may see; a live view."""
        return self._vector.belief(0)

    def action_masks(self) -> NDArray[np.bool_]:
        """(K,) which candidate views are admissible by belief; the name is the one that sb3-contrib looks for."""
        return self._vector.action_masks()[0]

    def action_of(self, viewpoint: NDArray[Any]) -> Any:
        """The action that leads to a viewpoint (7,), or as near to it as there is one."""
        return self._vector.action_of(0, viewpoint)


def first(observations: Any) -> Any:
    return observation.rows(observations, 0)
