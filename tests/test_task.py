"""The fields of a task: what they take, and how a wrong one is named before anything runs."""

from __future__ import annotations

import json
from functools import partial
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import nbv_gym  # noqa: F401 (registers the environments)
from nbv_gym.envs.action import CandidateIndex
from nbv_gym.envs.env import NbvEnv
from nbv_gym.envs.suite import TASKS
from nbv_gym.envs.vector_env import NbvVectorEnv
from nbv_gym.rust_env import Camera

#: What makes an episode quick.
QUICK: dict[str, Any] = {"scene": "room:0", "camera": Camera(16, 12, hfov=1.0, near=0.05, far=3.0), "resolution": 0.3}


def test_bad_keywords_are_named(tmp_path: Any) -> None:
    for make_one in (gym.make, partial(gym.make_vec, vectorization_mode="vector_entry_point")):
        with pytest.raises(TypeError, match="warp_factor"):
            make_one("NBV/DomeRoom-v0", warp_factor=9)
        with pytest.raises(ValueError, match="observation 'smell'"):
            make_one("NBV/DomeRoom-v0", observation=("depth", "smell"))
        with pytest.raises(ValueError, match="reward 'money'"):
            make_one("NBV/DomeRoom-v0", reward="money")
        with pytest.raises(ValueError, match="budget.*0"):
            make_one("NBV/DomeRoom-v0", budget=0)
        with pytest.raises(ValueError, match="resolution"):
            make_one("NBV/DomeRoom-v0", resolution=-1.0)
        with pytest.raises(ValueError, match="coverage.*7"):
            make_one("NBV/DomeRoom-v0", success=7)
        with pytest.raises(FileNotFoundError, match=r"nowhere\.world"):
            make_one("NBV/DomeRoom-v0", scene=tmp_path / "nowhere.world")
        with pytest.raises(ValueError, match="num_threads"):
            make_one("NBV/DomeRoom-v0", num_threads=0)
    with pytest.raises(ValueError, match="num_envs"):
        NbvVectorEnv("dome_room", num_envs=0)
    with pytest.raises(ValueError, match="task 'attic'"):
        gym.make("NBV/DomeRoom-v0", task="attic")


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"observation": None}, TypeError, "observation must be names of channels, got None"),
        ({"observation": ("depth", 3)}, TypeError, r"observation .*got \('depth', 3\)"),
        ({"action": 5}, TypeError, "action must be one of candidate, viewpoint .*got 5"),
        ({"action": CandidateIndex}, TypeError, "action must be .*got <class"),
        ({"budget": 2.0}, TypeError, "budget must be a whole number of views, got 2.0"),
        ({"success": True}, TypeError, "success must be .*got True"),
        ({"max_episode_steps": 1.5}, TypeError, "max_episode_steps must be a whole number of views, got 1.5"),
        ({"max_episode_steps": float("nan")}, TypeError, "max_episode_steps .*got nan"),
        ({"max_episode_steps": True}, TypeError, "max_episode_steps .*got True"),
        ({"max_episode_steps": "3"}, TypeError, "max_episode_steps .*got '3'"),
        ({"max_episode_steps": 0}, ValueError, "max_episode_steps must be at least one view, got 0"),
        ({"scene": None}, TypeError, "setup scene must be a file or the name of a generated kind, got None"),
        ({"camera": "x"}, TypeError, "setup camera must be a Camera, got 'x'"),
        ({"robot": 5}, TypeError, "setup robot must be a dictionary, got 5"),
        ({"map": None}, TypeError, "setup map must be a dictionary, got None"),
        ({"map": None, "resolution": 0.1}, TypeError, "setup map must be a dictionary, got None"),
        ({"views": None}, TypeError, "setup views must be a dictionary, got None"),
        ({"local_map": 5}, TypeError, "setup local_map must be a dictionary or None, got 5"),
        ({"lidar": 10.0}, TypeError, "setup lidar must be a dictionary or None, got 10.0"),
        ({"bodies": [3]}, TypeError, r"setup bodies must be a dictionary or None, got \[3\]"),
        ({"noise": 5}, TypeError, "setup noise must be the name of a preset, a dictionary or None, got 5"),
        ({"truth": 5}, TypeError, "setup truth must be a name, got 5"),
        ({"setup": 5}, TypeError, "setup must be a mapping of keywords, got 5"),
        # A dictionary replaces the task's whole one.
        ({"views": {"reach": 2}}, TypeError, "views needs \"kind\": .*replaces the task's own, {'kind': 'dome', 'rings': 14"),
        ({"map": {"hit": 0.8}}, TypeError, "map needs \"resolution\": .*replaces the task's own, {'resolution': 0.1}"),
        ({"views": {"kind": "dome", "rings": 1.5}}, TypeError, "^views rings = 1.5"),
    ],
    ids=str,
)
def test_keywords_of_a_wrong_type_are_named(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        NbvEnv("dome_room", **changes)


def test_numbers_of_numpy_and_any_mapping_will_do() -> None:
    views = MappingProxyType(TASKS["dome_room"].setup["views"])
    plain: dict[str, Any] = {**QUICK, "success": 0.5, "budget": 3, "max_episode_steps": 2}
    wrapped = plain | {"success": np.float32(0.5), "budget": np.int64(3), "max_episode_steps": np.uint8(2), "views": views}
    a, b = NbvVectorEnv("dome_room", **plain), NbvVectorEnv("dome_room", **wrapped)
    assert a.task == b.task and a.budget == b.budget == 2
    json.dumps([b.task.budget, b.budget])
    np.testing.assert_array_equal(a.reset(seed=np.int64(3))[0]["depth"], b.reset(seed=3)[0]["depth"])


def test_a_local_map_without_a_size_has_the_cores() -> None:
    for given in ({"cell": 0.1}, {}):
        env = NbvEnv("six_directions", **QUICK, observation="local_map", local_map=given)
        observation, _ = env.reset(seed=0)
        assert observation in env.observation_space and observation.shape == (3, 32, 32, 32)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"reward": lambda metrics: metrics["coverage"][:1]}, ValueError, r"reward must give shape \(2,\), got \(1,\)"),
        ({"reward": lambda metrics: metrics["smell"]}, ValueError, r"reward fails on metrics of zero: KeyError\('smell'\)"),
        ({"reward": lambda metrics: metrics["coverage"] > 0}, TypeError, "reward must give real numbers, got bool"),
        ({"reward": lambda metrics: ["much", "more"]}, TypeError, "reward must give real numbers, got <U4"),
        ({"reward": lambda metrics: metrics["coverage"] + 0j}, TypeError, "reward must give real numbers, got complex128"),
        ({"success": lambda metrics: metrics["coverage"]}, TypeError, "success must give bool, got float64"),
        ({"success": lambda metrics: True}, ValueError, r"success must give shape \(2,\), got \(\)"),
    ],
)
def test_rewards_and_success_tests_are_tried_before_anything_runs(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        NbvVectorEnv("six_directions", num_envs=2, **(QUICK | changes))
