"""Action masks inside the observation, as RLlib and others want them."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorObservationWrapper
from gymnasium.vector.utils import batch_space


def masked_space(observations: spaces.Space[Any], actions: spaces.Space[Any], key: str) -> spaces.Dict:
    if not isinstance(actions, spaces.Discrete):
        raise TypeError(f"action masks need a Discrete action space, got {actions}")
    if key == "observations":
        raise ValueError("the key of the action mask must not be 'observations'")
    mask = spaces.Box(0, 1, (int(actions.n),), np.int8)
    return spaces.Dict({"observations": observations, key: mask})


class ActionMaskObservation(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Turns an observation into ``{"observations": observation, key: mask}``.

    The mask (K,) is int8 (1 = admissible), which is what ``Discrete.sample(mask)`` takes.

    Args:
        env: An environment with ``action_masks()``.
        key: Name of the mask; libraries differ.
    """

    def __init__(self, env: gym.Env[Any, Any], key: str = "action_mask") -> None:
        RecordConstructorArgs.__init__(self, key=key)
        gym.ObservationWrapper.__init__(self, env)
        self.key = key
        self.observation_space = masked_space(env.observation_space, env.action_space, key)

    def observation(self, observation: Any) -> dict[str, Any]:
        masks = self.get_wrapper_attr("action_masks")()
        return {"observations": observation, self.key: masks.astype(np.int8)}


class VectorActionMaskObservation(VectorObservationWrapper):
    """The same for a vector environment that resets at the next step or not at all.

    Args:
        env: A :class:`~nbv_gym.envs.vector_env.NbvVectorEnv`.
        key: Name of the mask (n, K).
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], key: str = "action_mask") -> None:
        super().__init__(env)
        self.key = key
        self.single_observation_space = masked_space(env.single_observation_space, env.single_action_space, key)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def observations(self, observations: Any) -> dict[str, Any]:
        masks = self.env.unwrapped.action_masks()  # type: ignore[attr-defined]
        return {"observations": observations, self.key: masks.astype(np.int8)}
