"""The native vector environment as a stable-baselines3 `VecEnv` (extra `train`).

    venv = VecMonitor(Sb3VecEnv("six_directions", num_envs=16, num_threads=2, scene="room:0-63"))
    MaskablePPO("MultiInputPolicy", venv).learn(100_000)

SB3 expects a finished environment to begin its next episode within the same step, so that is how the native
environment is made here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import Wrapper
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from ..envs.task import Task
from ..envs.vector_env import NbvVectorEnv
from ..rust_env import METRICS


class Sb3VecEnv(VecEnv):  # type: ignore[misc, unused-ignore]
    """n environments of one task.

    Args:
        task: a task, or its name in `nbv_gym.envs.suite.TASKS`.
        num_envs: n.
        **settings: further arguments of `NbvVectorEnv`: num_threads, render_mode, scene, budget, ...

    Info of each environment: the metrics by name, `TimeLimit.truncated`, and after the last step of an episode
    `terminal_observation`. Action masks: `env_method("action_masks")`, which is what `MaskablePPO` asks for.
    """

    def __init__(self, task: Task | str, num_envs: int = 1, **settings: Any) -> None:
        if "autoreset_mode" in settings:
            raise TypeError("stable-baselines3 needs autoreset in the same step; leave autoreset_mode out")
        self.envs = NbvVectorEnv(task, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **settings)
        self._actions: NDArray[Any] | None = None
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> VecEnvObs:
        seeds = self._seeds if any(s is not None for s in self._seeds) else None
        observations, infos = self.envs.reset(seed=seeds)
        self.reset_infos = [self._info(infos, i) for i in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        result: VecEnvObs = observations
        return result

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        dones = terminated | truncated
        rows: list[dict[str, Any]] = []
        for i in range(self.num_envs):
            if dones[i]:
                row = self._info(infos["final_info"], i)
                row["terminal_observation"] = infos["final_obs"][i]
                self.reset_infos[i] = self._info(infos, i)
            else:
                row = self._info(infos, i)
            row["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
            rows.append(row)
        return observations, rewards.astype(np.float32), dones, rows

    def _info(self, infos: dict[str, Any], i: int) -> dict[str, Any]:
        return {name: float(infos[name][i]) for name in METRICS}

    def close(self) -> None:
        self.envs.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        frames = self.envs.render()
        return [None] * self.num_envs if frames is None else frames

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of each environment; `belief` is each one's own, all else is the vector environment's."""
        chosen = list(self._get_indices(indices))
        if attr_name == "belief":
            return [self.envs.belief(i) for i in chosen]
        return [getattr(self.envs, attr_name) for _ in chosen]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute. The environments share theirs, so that it can only be set for all at once."""
        if sorted(self._get_indices(indices)) != list(range(self.num_envs)):
            raise ValueError(f"{attr_name!r} is shared by all {self.num_envs} environments; set it for all of them")
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any) -> list[Any]:
        """Call a method for each environment: action_masks(), action_of(viewpoint) or render()."""
        chosen = list(self._get_indices(indices))
        if method_name == "action_masks":
            masks = self.envs.action_masks()
            return [masks[i] for i in chosen]
        if method_name == "action_of":
            return [self.envs.action_of(i, *method_args, **method_kwargs) for i in chosen]
        if method_name == "render":
            frames = self.get_images()
            return [frames[i] for i in chosen]
        raise AttributeError(f"{type(self).__name__} cannot call {method_name!r} for single environments")

    def env_is_wrapped(self, wrapper_class: type[Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
