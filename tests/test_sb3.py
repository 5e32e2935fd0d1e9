"""stable-baselines3 on the native vector environment."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="the extra [train] is not installed")
pytest.importorskip("stable_baselines3", reason="the extra [train] is not installed")

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from nbv_gym.envs.env import NbvEnv
from nbv_gym.training.sb3_vec_env import Sb3VecEnv
from nbv_gym.training.train_rl import Args, parse, train

SETTINGS = {"scene": "room:0", "budget": 5, "success": None, "observation": ("depth", "pose")}


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def test_rows_are_single_environments() -> None:
    venv = Sb3VecEnv("six_directions", 3, **SETTINGS)
    venv.seed(7)
    observations = venv.reset()
    singles = [NbvEnv("six_directions", **SETTINGS) for _ in range(3)]
    firsts = [env.reset(seed=7 + i)[0] for i, env in enumerate(singles)]
    rng = np.random.default_rng(0)
    for step in range(1, 12):
        for key in observations:
            for i in range(3):
                assert np.array_equal(observations[key][i], firsts[i][key]), (step, key)
        actions = rng.integers(6, size=3)
        observations, rewards, dones, infos = venv.step(actions)
        assert dones.all() == (step % 5 == 0)
        for i, env in enumerate(singles):
            single, reward, terminated, truncated, info = env.step(int(actions[i]))
            assert rewards[i] == np.float32(reward)
            assert dones[i] == (terminated or truncated)
            assert infos[i]["TimeLimit.truncated"] == (truncated and not terminated)
            assert infos[i]["coverage"] == info["coverage"]
            assert ("terminal_observation" in infos[i]) == bool(dones[i])
            if dones[i]:
                for key in single:
                    assert np.array_equal(infos[i]["terminal_observation"][key], single[key])
                single, _ = env.reset()
            firsts[i] = single
    venv.close()


def test_attributes_and_methods() -> None:
    venv = Sb3VecEnv("six_directions", 2, render_mode="rgb_array", **SETTINGS)
    venv.seed(0)
    venv.reset()
    masks = venv.env_method("action_masks")
    assert len(masks) == 2
    assert masks[0].shape == (6,)
    assert masks[0].dtype == np.bool_
    assert venv.has_attr("action_masks")
    beliefs = venv.get_attr("belief", indices=[1])
    assert len(beliefs) == 1
    assert len(beliefs[0].candidates) == 6
    assert venv.env_method("action_of", beliefs[0].candidates[4], indices=1) == [4]
    venv.set_attr("budget", 9)
    assert venv.get_attr("budget") == [9, 9]
    with pytest.raises(ValueError, match="shared by all 2"):
        venv.set_attr("budget", 9, indices=0)
    with pytest.raises(AttributeError, match="no_such_method"):
        venv.env_method("no_such_method")
    image = venv.render()
    assert image is not None
    assert image.dtype == np.uint8
    with pytest.raises(TypeError, match="autoreset"):
        Sb3VecEnv("six_directions", 2, autoreset_mode="NextStep")
    venv.close()


@pytest.mark.parametrize("name", ["ppo", "maskable_ppo"])
def test_training_runs(name: str) -> None:
    algorithm = PPO if name == "ppo" else pytest.importorskip("sb3_contrib").MaskablePPO
    venv = VecMonitor(Sb3VecEnv("six_directions", 4, **SETTINGS))
    model = algorithm("MultiInputPolicy", venv, n_steps=32, batch_size=64, n_epochs=2, seed=0)
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(256)
    assert model.num_timesteps == 256
    after = list(model.policy.parameters())
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert all(torch.isfinite(p).all() for p in after)
    assert model.ep_info_buffer[-1]["l"] == 5
    venv.close()


def test_the_script_trains_and_saves(tmp_path: object) -> None:
    pytest.importorskip("sb3_contrib")
    text = f"--scene room:0 --total-steps 64 --num-envs 2 --n-steps 16 --batch-size 32 --out {tmp_path}"
    args = parse(text.split())
    assert args == Args(scene="room:0", total_steps=64, num_envs=2, n_steps=16, batch_size=32, out=str(tmp_path))
    model = train(args)
    assert model.num_timesteps == 64
    assert (type(model).load(f"{tmp_path}/model.zip").policy.action_space.n) == 6
    with pytest.raises(ValueError, match="algorithm must be one of"):
        train(Args(algorithm="a2c", out=str(tmp_path)))
