"""The environments keep Gymnasium's promises: single, vectorised, in every autoreset mode, with bad input."""

from __future__ import annotations

import copy
import os
import pickle
import signal
import time
import warnings
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from numpy.typing import NDArray

import nbv_gym  # noqa: F401 (registers the environments)
from nbv_gym.envs.action_mask import ActionMaskObservation, VectorActionMaskObservation
from nbv_gym.envs.env import NbvEnv
from nbv_gym.envs.reward import Columns, Reward
from nbv_gym.envs.suite import TASKS
from nbv_gym.envs.vector_env import NbvVectorEnv
from nbv_gym.rust_env import METRICS, Camera

CAMERA = Camera(16, 12, hfov=1.0, near=0.05, far=3.0)
#: What makes an episode quick, in each task.
QUICK: dict[str, dict[str, Any]] = {
    "dome_room": {"scene": "room:0-3", "camera": CAMERA, "resolution": 0.2},
    "six_directions": {"scene": "room:0-1", "camera": CAMERA, "resolution": 0.3},
    "tabletop": {"scene": "tabletop:0-3", "camera": CAMERA, "resolution": 0.05},
    "wang2019": {"scene": "room:0-1", "camera": CAMERA, "resolution": 0.2, "local_map": {"size": 32}},
    "wang2019_kinect": {"scene": "room:0-1", "camera": CAMERA, "resolution": 0.2, "local_map": {"size": 32}},
}
#: Tasks whose reference is an image of each of 672 views: seconds at their own voxel size.
COARSE = {name: {"resolution": 0.1} for name in ("wang2019", "wang2019_kinect")}
ALL_CHANNELS = ("depth", "pose", "local_map", "visited", "candidates")
MODES = list(AutoresetMode)


def make(name: str, **changes: Any) -> gym.Env[Any, Any]:
    return gym.make(TASKS[name].id, **(QUICK[name] | changes))


def make_vec(name: str, num_envs: int, **changes: Any) -> Any:
    kwargs = QUICK[name] | changes
    return gym.make_vec(TASKS[name].id, num_envs=num_envs, vectorization_mode="vector_entry_point", **kwargs)


def assert_same(a: Any, b: Any, where: str = "") -> None:
    """Equal to the last bit, in type, dtype and shape."""
    assert type(a) is type(b), f"{where}: {type(a)} {type(b)}"
    if isinstance(a, dict):
        assert a.keys() == b.keys(), f"{where}: {sorted(a.keys() ^ b.keys())} on one side only"
        for key in a:
            assert_same(a[key], b[key], f"{where}/{key}")
    elif isinstance(a, (tuple, list)):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}[{i}]")
    elif isinstance(a, np.ndarray):
        assert (a.dtype, a.shape) == (b.dtype, b.shape), f"{where}: {a.dtype}{a.shape} {b.dtype}{b.shape}"
        if a.dtype == object:
            for i, (x, y) in enumerate(zip(a, b, strict=True)):
                assert_same(x, y, f"{where}[{i}]")
        else:
            assert np.array_equal(a, b), f"{where} differs in {np.argwhere(a != b)[:5].tolist()}"
    else:
        assert a == b, f"{where}: {a} {b}"


# --- one environment -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TASKS)
def test_gymnasium_checker_finds_nothing(name: str) -> None:
    env = make(name, observation=ALL_CHANNELS, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)


@pytest.mark.parametrize("name", TASKS)
def test_defaults_make_an_episode(name: str) -> None:
    env = gym.make(TASKS[name].id, **COARSE.get(name, {}))
    observation, info = env.reset(seed=3)
    env.action_space.seed(3)
    for _ in range(3):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample(info["action_mask"]))
        assert observation in env.observation_space
        assert isinstance(reward, float) and isinstance(terminated, bool) and isinstance(truncated, bool)
    assert set(METRICS) <= info.keys()
    assert 0 < info["coverage"] <= 1
    env.close()


def test_any_scene_file_will_do(tmp_path: Any) -> None:
    slabs = [(2, 1.5, -0.05, 4, 3, 0.1), (2, 1.5, 2.55, 4, 3, 0.1)]
    slabs += [(x, 1.5, 1.25, 0.1, 3, 2.5) for x in (0, 4)] + [(2, y, 1.25, 4, 0.1, 2.5) for y in (0, 3)]
    models = ""
    for i, (x, y, z, *size) in enumerate(slabs):
        box = f"<geometry><box><size>{' '.join(map(str, size))}</size></box></geometry>"
        parts = f"<visual name='v'>{box}</visual><collision name='c'>{box}</collision>"
        models += f"<model name='m{i}'><static>true</static><pose>{x} {y} {z} 0 0 0</pose><link name='l'>{parts}</link></model>"
    path = tmp_path / "empty_room.world"
    path.write_text(f"<sdf version='1.6'><world name='w'>{models}</world></sdf>")
    env = make("dome_room", scene=path, resolution=0.25, success=None)
    env.reset(seed=0)
    low, high = env.unwrapped.belief.bounds
    assert np.allclose(low, 0, atol=0.3) and np.allclose(high, (4, 3, 2.5), atol=0.3)
    for action in range(0, 672, 23):
        _, _, terminated, _, info = env.step(action)
        assert not terminated
    assert info["coverage"] > 0.4


def test_one_channel_is_a_box_and_more_are_a_dict() -> None:
    assert isinstance(make("six_directions", observation="depth").observation_space, gym.spaces.Box)
    assert isinstance(make("six_directions", observation=["depth", "pose"]).observation_space, gym.spaces.Dict)


def test_observations_are_what_the_belief_says() -> None:
    env = make("dome_room", observation=ALL_CHANNELS)
    belief = None
    observation, info = env.reset(seed=5)
    for _ in range(4):
        belief = env.unwrapped.belief
        assert np.array_equal(observation["pose"], belief.pose)
        assert np.array_equal(observation["visited"], belief.visited)
        assert np.array_equal(observation["candidates"], belief.candidates)
        assert np.array_equal(info["action_mask"] > 0, belief.candidate_mask)
        assert np.array_equal(env.unwrapped.action_masks(), belief.candidate_mask)
        assert observation["depth"].max() <= CAMERA.far
        observation, *_, info = env.step(env.action_space.sample(info["action_mask"]))


def test_seed_decides_the_stream_of_episodes() -> None:
    def starts(seed: int) -> list[Any]:
        env = make("six_directions", observation="pose")
        return [env.reset(seed=seed)[0]] + [env.reset()[0] for _ in range(5)]

    assert_same(starts(4), starts(4))
    # Scenes and starts are few, so that some may be the same; never all.
    assert not np.array_equal(starts(4), starts(5))
    assert len({tuple(pose) for pose in starts(4)}) > 1
    unseeded = [make("six_directions", observation="pose").reset()[0] for _ in range(8)]
    assert any(not np.array_equal(unseeded[0], other) for other in unseeded[1:])


def test_truncation_is_the_budget_and_nothing_else() -> None:
    env = make("six_directions", budget=4, success=None)
    assert env.spec is not None and env.spec.max_episode_steps is None
    _, info = env.reset(seed=0)
    for step in range(1, 5):
        *_, terminated, truncated, info = env.step(env.action_space.sample(info["action_mask"]))
        assert (terminated, truncated) == (False, step == 4)
        assert info["views"] == step + 1
    with pytest.raises(ResetNeeded):
        env.step(0)


def test_success_terminates() -> None:
    env = make("dome_room", success=0.01, budget=3)
    env.reset(seed=0)
    *_, terminated, truncated, info = env.step(0)
    assert info["coverage"] >= 0.01
    assert (terminated, truncated) == (True, False)


def test_rewards_are_columns_minus_costs() -> None:
    named = {"information_gain": "information_gain_bits", "new_surface": "new_surface_voxels"}
    for name, column in named.items():
        env = make("six_directions", reward=name)
        env.reset(seed=1)
        for action in (0, 2, 4):
            _, reward, _, _, info = env.step(action)
            assert reward == info[column]
    env = make("six_directions", reward=Reward("uncertainty_gain", scale=2, travel_cost=0.5, collision_cost=3))
    env.reset(seed=1)
    for _ in range(8):
        _, reward, _, _, info = env.step(2)
        assert reward == pytest.approx(2 * info["uncertainty_gain"] - 0.5 * info["travel"] - 3 * info["contact"])


def test_gains_add_up_to_the_map() -> None:
    env = make("six_directions")
    _, info = env.reset(seed=1)
    entropy, information = info["entropy"], info["information"]
    gained = np.zeros(2)
    for action in (2, 2, 0, 4, 4):
        *_, info = env.step(action)
        gained += info["information_gain_bits"], info["uncertainty_gain"]
    assert gained == pytest.approx([entropy - info["entropy"], info["information"] - information])
    assert gained[0] > 0


def test_a_viewpoint_and_its_action() -> None:
    env = make("dome_room")
    _, info = env.reset(seed=2)
    for index in np.flatnonzero(info["action_mask"])[::40]:
        assert env.unwrapped.action_of(env.unwrapped.belief.candidates[index]) == index

    env = make("six_directions", action="viewpoint", observation="pose")
    pose, info = env.reset(seed=2)
    assert "action_mask" not in info
    goal = pose + np.array([0.05, -0.05, 0.05, 0, 0, 0, 0], np.float32)
    action = env.unwrapped.action_of(goal)
    assert action in env.action_space
    reached, *_, info = env.step(action)
    assert info["contact"] or np.allclose(reached, goal, atol=1e-4)
    with pytest.raises(TypeError, match="mask"):
        env.unwrapped.action_masks()


def test_mask_wrappers() -> None:
    env = ActionMaskObservation(make("dome_room", observation=("depth", "pose")), key="mask")
    observation, info = env.reset(seed=0)
    assert observation in env.observation_space
    assert observation.keys() == {"observations", "mask"}
    assert np.array_equal(observation["mask"], info["action_mask"])
    observation, *_ = env.step(env.action_space.sample(observation["mask"]))
    assert observation in env.observation_space

    envs = VectorActionMaskObservation(make_vec("dome_room", 2))
    observations, infos = envs.reset(seed=0)
    assert observations in envs.observation_space
    assert np.array_equal(observations["action_mask"], infos["action_mask"])
    with pytest.raises(TypeError, match="Discrete"):
        ActionMaskObservation(make("six_directions", action="viewpoint"))


def test_render_and_record_video(tmp_path: Any) -> None:
    env = make("six_directions", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    assert isinstance(before, np.ndarray)
    assert before.dtype == np.uint8 and before.shape == (480, 800, 3)
    env.step(2)
    assert (env.render() != before).any()
    assert make("six_directions").unwrapped.render() is None

    pytest.importorskip("moviepy", reason="RecordVideo needs moviepy")
    env = gym.wrappers.RecordVideo(make("six_directions", render_mode="rgb_array", budget=3), str(tmp_path))
    env.reset(seed=0)
    while not env.step(2)[3]:
        pass
    env.close()
    videos = list(tmp_path.glob("*.mp4"))
    assert len(videos) == 1 and videos[0].stat().st_size > 1000


# --- many at once ----------------------------------------------------------------------------------------------------


def now_and_then(metrics: Columns) -> NDArray[np.bool_]:
    """A success test that some episodes pass and some never do."""
    return metrics["known_voxels"] % 7 == 0


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["dome_room", "six_directions"])
def test_native_vector_env_equals_gymnasiums_own(name: str, mode: AutoresetMode) -> None:
    n = 4
    options = {"success": now_and_then, "budget": 5}
    native = make_vec(name, n, autoreset_mode=mode, num_threads=2, **options)
    reference = gym.make_vec(
        TASKS[name].id,
        num_envs=n,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **(QUICK[name] | options),
    )
    for attribute in ("single_observation_space", "single_action_space", "observation_space", "action_space"):
        assert getattr(native, attribute) == getattr(reference, attribute)
    assert native.metadata["autoreset_mode"] is reference.metadata["autoreset_mode"] is mode

    assert_same(native.reset(seed=7), reference.reset(seed=7), "reset")
    rng = np.random.default_rng(0)
    finished = np.zeros(2, int)
    for step in range(16):
        actions = rng.integers(native.single_action_space.n, size=n)
        ours, theirs = native.step(actions), reference.step(actions)
        assert_same(ours, theirs, f"step {step}")
        assert ours[0] in native.observation_space
        finished += ours[2].sum(), ours[3].sum()
        done = ours[2] | ours[3]
        if mode is AutoresetMode.DISABLED and done.any():
            with pytest.raises(ResetNeeded):  # and nothing is changed
                native.step(actions)
            a, b = (envs.reset(options={"reset_mask": done.copy()}) for envs in (native, reference))
            assert_same(a, b, f"reset after step {step}")
    assert finished.all(), "no episode was terminated, or none truncated; the test shows nothing"
    # A partial reset in the middle, with a seed for one and none for another.
    mask = np.array([True, False, True, False])
    seeds = [11, None, None, None]
    a, b = (envs.reset(seed=list(seeds), options={"reset_mask": mask.copy()}) for envs in (native, reference))
    assert_same(a, b, "partial reset")
    native.close()
    reference.close()


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_sixteen_at_once_are_sixteen_single_episodes(threads: int) -> None:
    n, steps = 16, 5
    envs = make_vec("dome_room", n, observation=ALL_CHANNELS, num_threads=threads)
    actions = np.random.default_rng(1).integers(envs.single_action_space.n, size=(steps, n))
    batches = [envs.reset(seed=100)[0]] + [envs.step(a)[0] for a in actions]
    for i in range(n):
        env = make("dome_room", observation=ALL_CHANNELS)
        single = [env.reset(seed=100 + i)[0]] + [env.step(a)[0] for a in actions[:, i]]
        for batch, observation in zip(batches, single, strict=True):
            assert_same({name: column[i] for name, column in batch.items()}, observation, f"environment {i}")


def test_seeds_of_a_vector_env() -> None:
    envs = make_vec("six_directions", 3, observation="pose")
    by_int, _ = envs.reset(seed=20)
    by_list, _ = envs.reset(seed=[22, 21, 20])
    assert np.array_equal(by_int, by_list[::-1])
    # None goes on with the stream: environment 1 gets what follows its seed 21.
    following, _ = envs.reset(seed=[22, None, 20])
    envs.reset(seed=[None, 21, None])
    again, _ = envs.reset()
    assert np.array_equal(following[1], again[1])
    assert np.array_equal(following[0], by_list[0])
    for bad, error in [([1, 2], ValueError), ([1, 2, -3], ValueError), ([1, 2, 0.5], TypeError), ("123", TypeError)]:
        with pytest.raises(error, match="seed"):
            envs.reset(seed=bad)


def test_partial_reset_leaves_the_others_alone() -> None:
    alone, disturbed = (make_vec("six_directions", 3, autoreset_mode="Disabled", observation="pose") for _ in range(2))
    for envs in (alone, disturbed):
        envs.reset(seed=5)
        envs.step(np.array([2, 2, 2]))
    mask = np.array([False, True, False])
    _, infos = disturbed.reset(options={"reset_mask": mask})
    assert np.array_equal(infos["_coverage"], mask)
    assert infos["views"].tolist() == [0, 1, 0]
    for action in (0, 4, 3):
        a, b = (envs.step(np.full(3, action)) for envs in (alone, disturbed))
        assert np.array_equal(a[0][[0, 2]], b[0][[0, 2]])
        assert np.array_equal(a[1][[0, 2]], b[1][[0, 2]])
    for bad, error in [(mask.astype(int), TypeError), (mask[:2], ValueError), (np.zeros(3, bool), ValueError)]:
        with pytest.raises(error, match="reset_mask"):
            disturbed.reset(options={"reset_mask": bad})
    with pytest.raises(ValueError, match="scene"):
        disturbed.reset(options={"scene": "room"})


def test_buffers_are_copied_unless_asked_otherwise() -> None:
    for keep in (True, False):
        envs = make_vec("dome_room", 2, copy=keep)
        first, _ = envs.reset(seed=0)
        kept = copy.deepcopy(first)
        second, *_ = envs.step(np.array([5, 300]))
        assert np.shares_memory(first["depth"], second["depth"]) is not keep
        assert np.array_equal(first["depth"], kept["depth"]) is keep
        assert second in envs.observation_space


def test_final_observations_are_copies() -> None:
    envs = make_vec("dome_room", 2, copy=False, autoreset_mode="SameStep", budget=1, success=None)
    envs.reset(seed=0)
    *_, infos = envs.step(np.array([5, 300]))
    last = infos["final_obs"][0]["depth"].copy()
    envs.step(np.array([7, 100]))
    assert np.array_equal(infos["final_obs"][0]["depth"], last)


def test_vector_frames() -> None:
    envs = make_vec("six_directions", 2, render_mode="rgb_array")
    envs.reset(seed=0)
    frames = envs.render()
    assert len(frames) == 2 and (frames[0] != frames[1]).any()


def test_max_episode_steps_of_make_vec_shortens_the_budget() -> None:
    envs = make_vec("six_directions", 2, max_episode_steps=2, success=None)
    envs.reset(seed=0)
    assert not envs.step(np.array([0, 1]))[3].any()
    assert envs.step(np.array([0, 1]))[3].all()


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("action", "bad", "error", "message"),
    [
        ("candidate", [0, 6, 0], ValueError, "environment 1: action 6"),
        ("candidate", [0, 0, -1], ValueError, "environment 2: action -1"),
        ("candidate", [0.0, 1.0, 2.0], TypeError, "float64"),
        ("candidate", [True, False, True], TypeError, "bool"),
        ("candidate", [0, 1], ValueError, r"\(2,\)"),
        ("candidate", ["a", "b", "c"], TypeError, "'a'"),
        ("candidate", None, TypeError, "None"),
        ("viewpoint", np.full((3, 7), np.nan), ValueError, "environment 0.*nan"),
        ("viewpoint", np.full((3, 7), 2.0), ValueError, "environment 0.*2.0"),
        ("viewpoint", np.zeros((3, 7)), ValueError, "environment 0.*quaternion"),
        ("viewpoint", np.ones((3, 6)), ValueError, r"\(3, 6\)"),
        ("viewpoint", np.full((3, 7), 1j), TypeError, "complex"),
    ],
)
def test_bad_actions_are_named_and_change_nothing(action: str, bad: Any, error: type[Exception], message: str) -> None:
    disturbed, quiet = (make_vec("six_directions", 3, action=action) for _ in range(2))
    good = np.array([0, 2, 4]) if action == "candidate" else np.full((3, 7), 0.1, np.float32)
    for envs in (disturbed, quiet):
        envs.reset(seed=0)
    with pytest.raises(error, match=message):
        disturbed.step(bad)
    assert_same(disturbed.step(good), quiet.step(good))


def test_actions_of_environments_that_begin_anew_are_not_looked_at() -> None:
    envs = make_vec("six_directions", 2, budget=1, success=None)
    envs.reset(seed=0)
    assert envs.step(np.array([0, 0]))[3].all()
    _, rewards, _, truncated, infos = envs.step(np.array([-5, 99]))
    assert not truncated.any() and not rewards.any()
    assert infos["views"].tolist() == [1, 1]


def test_bad_arguments_of_a_reset_change_nothing() -> None:
    for reset_of in (NbvEnv, partial(NbvVectorEnv, num_envs=2)):
        env, quiet = (reset_of("six_directions", **QUICK["six_directions"]) for _ in range(2))
        for e in (env, quiet):
            e.reset(seed=5)
        bad: list[tuple[dict[str, Any], type[Exception], str]] = [
            ({"seed": 6, "options": {"bad": 1}}, ValueError, "options.*bad"),
            ({"seed": 6, "options": 5}, TypeError, "options must be a dictionary or None, got 5"),
            ({"seed": 2**64}, ValueError, "seed must lie in"),
            ({"seed": -1}, ValueError, "seed must lie in"),
            ({"seed": True}, TypeError, "seed must be a whole number"),
            ({"seed": b"ab"}, TypeError, "seed must be a whole number"),
            ({"seed": bytearray(b"ab")}, TypeError, "seed must be a whole number"),
            ({"seed": np.array(1.5)}, TypeError, "seed must be a whole number"),
        ]
        for arguments, error, message in bad:
            with pytest.raises(error, match=message):
                env.reset(**arguments)
        assert env.np_random_seed == 5
        assert env.np_random.random() == quiet.np_random.random()
        assert_same(env.reset(), quiet.reset())


def test_a_reward_that_fails_later_leaves_a_step_that_happened() -> None:
    def moody(metrics: Columns) -> NDArray[np.float64]:
        if metrics["views"].max() == 2:
            raise ArithmeticError("not now")
        return metrics["travel"] / metrics["views"]  # no number at the try with zeros

    envs, quiet = make_vec("six_directions", 2, reward=moody, budget=1), make_vec("six_directions", 2, budget=1)
    for e in (envs, quiet):
        e.reset(seed=0)
    with pytest.raises(ArithmeticError, match="not now"):
        envs.step(np.array([0, 2]))
    quiet.step(np.array([0, 2]))
    ours, theirs = envs.step(np.array([2, 4])), quiet.step(np.array([2, 4]))
    assert ours[4]["views"].tolist() == [1, 1], "the step was the last of its episode"
    assert_same([ours[0], *ours[2:]], [theirs[0], *theirs[2:]])


def test_order_of_calls() -> None:
    envs = make_vec("six_directions", 2)
    with pytest.raises(ResetNeeded):
        envs.step(np.array([0, 0]))
    with pytest.raises(ResetNeeded):
        make("six_directions").unwrapped.step(0)
    envs.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match=r"\[1\]"):
        envs.step(np.array([0, 0]))
    envs.close()
    envs.close()
    for call in (envs.reset, partial(envs.step, np.array([0, 0])), partial(envs.belief, 0)):
        with pytest.raises(ClosedEnvironmentError):
            call()


# --- processes -------------------------------------------------------------------------------------------------------


def test_spaces_and_specs_travel() -> None:
    env = make("dome_room", observation=ALL_CHANNELS)
    for travelled in (pickle.loads(pickle.dumps(env.observation_space)), copy.deepcopy(env.observation_space)):
        assert travelled == env.observation_space
    for task in TASKS.values():
        assert pickle.loads(pickle.dumps(task)) == task
        spec = gym.spec(task.id)
        assert gym.envs.registration.EnvSpec.from_json(spec.to_json()) == spec


def test_a_child_forked_after_stepping_steps_on() -> None:
    envs = make_vec("six_directions", 4, num_threads=2)
    envs.reset(seed=0)
    actions = np.zeros(4, int)
    envs.step(actions)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of forking with threads: our very case
        child = os.fork()
    if child == 0:
        try:
            rewards = envs.step(actions)[1]
            os._exit(0 if np.isfinite(rewards).all() else 1)
        except BaseException:
            os._exit(2)
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            assert os.waitstatus_to_exitcode(status) == 0
            break
        time.sleep(0.01)
    else:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        pytest.fail("the child hangs")
    envs.step(actions)


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_gymnasiums_process_pool(context: str) -> None:
    make_one = partial(gym.make, "NBV/SixDirections-v0", **QUICK["six_directions"])
    make_one().reset(seed=0)
    envs = AsyncVectorEnv([make_one, make_one], context=context)
    try:
        envs.reset_async(seed=3)
        ours, _ = envs.reset_wait(timeout=60)
        expected, _ = make_vec("six_directions", 2).reset(seed=3)
        assert_same(ours, expected)
    finally:
        envs.close(terminate=True)
