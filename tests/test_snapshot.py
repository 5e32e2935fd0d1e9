"""Snapshots, clones, pickles: what goes on from them goes on bit for bit."""

from __future__ import annotations

import copy
import inspect
import json
import pickle
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import nbv_gym  # noqa: F401 (registers the environments)
from nbv_gym.envs.env import NbvEnv
from nbv_gym.envs.suite import TASKS
from nbv_gym.envs.vector_env import NbvVectorEnv
from nbv_gym.rust_env import Camera, Octree, Scene

#: Small images and rooms: these tests are about state.
SMALL = {
    "dome_room": {"camera": Camera(24, 18, hfov=1.0, near=0.05, far=4.0), "scene": "room:0-3", "resolution": 0.2},
    "six_directions": {"camera": Camera(24, 18, hfov=1.0, near=0.05, far=4.0), "scene": "room:0-3", "resolution": 0.2},
    "tabletop": {"camera": Camera(24, 18, hfov=1.0, near=0.05, far=1.5), "scene": "tabletop:0-3", "resolution": 0.04},
    "wang2019": {"camera": Camera(24, 18, hfov=1.0, near=0.5, far=4.0), "scene": "room:0-1", "resolution": 0.2},
    "wang2019_kinect": {"camera": Camera(24, 18, hfov=1.0, near=0.5, far=4.0), "scene": "room:0-1", "resolution": 0.2},
}
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]


def vector_env(task: str = "dome_room", mode: AutoresetMode = AutoresetMode.NEXT_STEP, **more: Any) -> NbvVectorEnv:
    options = {"num_envs": 3, "max_episode_steps": 4} | more
    return NbvVectorEnv(task, autoreset_mode=mode, **(SMALL[task] | options))


def single_env(task: str = "dome_room", **more: Any) -> NbvEnv:
    return NbvEnv(task, **(SMALL[task] | {"max_episode_steps": 6} | more))


def flat(value: Any) -> list[Any]:
    """Everything in a nested structure, comparable bit by bit."""
    if isinstance(value, dict):
        return [x for key in sorted(value) for x in [key, *flat(value[key])]]
    if isinstance(value, (tuple, list)):
        return [x for item in value for x in flat(item)]
    if isinstance(value, np.ndarray) and value.dtype == object:
        return [x for item in value for x in flat(item)]
    if isinstance(value, (np.ndarray, np.generic)):
        return [(str(value.dtype), value.shape, value.tobytes())]
    return [value]


def play(env: Any, steps: int) -> list[Any]:
    """What comes of random actions, drawn from the action space's and the environment's own streams."""
    trace: list[Any] = []
    for _ in range(steps):
        trace += flat([env.step(env.action_space.sample()), env.np_random.random()])
    return trace


def play_single(env: Any, steps: int) -> list[Any]:
    trace: list[Any] = []
    for _ in range(steps):
        outcome = env.step(env.action_space.sample())
        trace += flat([outcome, env.np_random.random()])
        if outcome[2] or outcome[3]:
            trace += flat(env.reset())
    return trace


def maps(env: NbvVectorEnv) -> list[bytes]:
    return [pickle.dumps(env.belief(i).octree) for i in range(env.num_envs)]


def begun(env: Any, seed: int = 3) -> Any:
    env.reset(seed=seed)
    env.action_space.seed(seed)
    return env


@pytest.mark.parametrize("mode", MODES, ids=lambda m: m.name)
@pytest.mark.parametrize("task", TASKS)
def test_vector_env_goes_on_bit_for_bit(task: str, mode: AutoresetMode) -> None:
    """Through several episodes, so that the seeds of the following ones count, too."""
    env = begun(vector_env(task, mode))
    play(env, 6)
    snapshot, data = env.snapshot(), pickle.dumps(env)
    others = [pickle.loads(data), copy.deepcopy(env), env.clone(), vector_env(task, mode, num_threads=2)]
    observations, infos = others[-1].restore(snapshot)
    assert np.array_equal(infos["views"], env._columns()["views"])
    assert flat(observations) == flat(env._observations())
    expected = play(env, 11)
    for other in others:
        assert play(other, 11) == expected
        assert maps(other) == maps(env)
        assert other.snapshot() == env.snapshot()
    # Back to where the snapshot was taken.
    env.restore(snapshot)
    assert play(env, 11) == expected


@pytest.mark.parametrize("task", TASKS)
def test_single_env_goes_on_bit_for_bit(task: str) -> None:
    env = begun(single_env(task))
    play_single(env, 4)
    snapshot = env.snapshot()
    others = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env), env.clone(), single_env(task)]
    observation, info = others[-1].restore(snapshot)
    expected = play_single(env, 9)
    for other in others:
        assert play_single(other, 9) == expected
    observation_again, info_again = env.restore(snapshot)
    assert flat([observation, info]) == flat([observation_again, info_again])
    assert play_single(env, 9) == expected
    assert env.np_random_seed == others[0].np_random_seed == 3


def test_another_process_goes_on_alike(tmp_path: Path) -> None:
    env = begun(vector_env())
    play(env, 3)
    (tmp_path / "env.pickle").write_bytes(pickle.dumps(env))
    script = [
        "from __future__ import annotations",
        "import pickle, sys",
        "from typing import Any",
        "import numpy as np",
        *map(inspect.getsource, (flat, play)),
        "env = pickle.load(open('env.pickle', 'rb'))",
        "pickle.dump((play(env, 6), env.snapshot()), open('outcome.pickle', 'wb'))",
    ]
    subprocess.run([sys.executable, "-c", "\n".join(script)], cwd=tmp_path, check=True, timeout=120)
    assert pickle.loads((tmp_path / "outcome.pickle").read_bytes()) == (play(env, 6), env.snapshot())


def test_wrapped_and_made_by_gymnasium() -> None:
    env = gym.make("NBV/SixDirections-v0", **SMALL["six_directions"])
    begun(env)
    play_single(env, 2)
    other = pickle.loads(pickle.dumps(env))
    assert other.spec == env.spec
    assert play_single(env, 5) == play_single(other, 5)


def test_a_clone_is_independent() -> None:
    env = begun(single_env())
    before = env.snapshot()
    clone = env.clone()
    play_single(clone, 3)
    assert env.snapshot() == before != clone.snapshot()
    clone.close()
    env.step(0)


def test_look_ahead_by_clone_is_what_then_happens() -> None:
    env = begun(single_env("tabletop"))
    foreseen = [env.clone().step(action)[4]["information_gain_bits"] for action in range(3)]
    for action in range(3):
        assert env.simulator.true_gain(0, env.belief.candidates[[action]])[0, 2] == foreseen[action]
    assert env.step(1)[4]["information_gain_bits"] == foreseen[1]


def test_changes_go_on_too() -> None:
    env = begun(single_env())
    centers, before, after = env.belief.octree.changed()
    assert len(centers) == env.belief.octree.num_known and (before == -1).all()
    env.step(5)
    other = env.clone()
    for mine, theirs in zip(env.belief.octree.changed(), other.belief.octree.changed(), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert (after >= 0).all() and len(env.belief.octree.changed()[0]) == 0


def test_what_was_never_begun_or_closed() -> None:
    env = vector_env()
    other = pickle.loads(pickle.dumps(env))
    assert flat(other.reset(seed=1)) == flat(env.reset(seed=1))
    mask = np.array([True, False, True])
    half = vector_env(mode=AutoresetMode.DISABLED)
    half.reset(seed=5, options={"reset_mask": mask})
    full = begun(vector_env(mode=AutoresetMode.DISABLED))
    observations, infos = full.restore(half.snapshot())
    assert infos["_views"].tolist() == mask.tolist()
    assert not observations["depth"][1].any()
    with pytest.raises(gym.error.ResetNeeded):
        full.step(full.action_space.sample())
    env.close()
    assert pickle.loads(pickle.dumps(env))._simulator is None
    with pytest.raises(ClosedEnvironmentError):
        env.snapshot()
    with pytest.raises(ClosedEnvironmentError):
        env.restore(b"")


def test_what_does_not_fit_is_named_and_changes_nothing() -> None:
    env = begun(vector_env("six_directions"))
    play(env, 2)
    before = env.snapshot()

    def taken(task: str = "six_directions", **more: Any) -> bytes:
        return begun(vector_env(task, **more)).snapshot()

    flipped = bytearray(before)
    flipped[len(before) // 2] ^= 1
    newer = before[:8] + b"\x63\0\0\0" + before[12:]
    without_notes = env.simulator.save()
    for snapshot, match in [
        (taken("dome_room"), "another task"),
        (taken(max_episode_steps=5), "budget 5 instead of 4"),
        (taken(reward="new_surface"), "reward"),
        (taken(mode=AutoresetMode.SAME_STEP), "autoreset_mode"),
        (taken(num_envs=2), "2 environments, there are 3"),
        (taken(resolution=0.25), "another setup: resolution: 0.25"),
        (bytes(flipped), "damaged"),
        (newer, "version 99 is newer"),
        (before[: len(before) // 2], "damaged"),
        (b"", "too early"),
        (pickle.dumps(env), "do not begin with NBVSNAP"),
        (without_notes, "not taken by an environment"),
    ]:
        with pytest.raises(ValueError, match=match):
            env.restore(snapshot)
        assert env.snapshot() == before
    with pytest.raises(TypeError):
        env.restore("text")  # type: ignore[arg-type]
    env.np_random = np.random.Generator(np.random.MT19937(1))
    with pytest.raises(ValueError, match="MT19937"):
        env.snapshot()


class Weighted:
    """A reward without a text of its own: Python's holds its address."""

    def __call__(self, metrics: Any) -> Any:
        return 2 * metrics["coverage"]


def scaled() -> Any:
    """A function whose text holds that of another, which is made anew."""
    return partial(lambda metrics, scale: scale * metrics["coverage"], scale=2.0)


@pytest.mark.parametrize("make", [Weighted, scaled])
def test_equal_rewards_fit_whatever_their_addresses(make: Any) -> None:
    kept = [make(), make()]
    env, other = (begun(vector_env("six_directions", reward=reward)) for reward in kept)
    play(env, 2)
    other.restore(env.snapshot())
    assert play(other, 3) == play(env, 3)
    with pytest.raises(ValueError, match="another task: reward"):
        vector_env("six_directions").restore(env.snapshot())


def test_notes_of_somebody_else_are_named() -> None:
    env = begun(vector_env("six_directions"))
    good = json.loads(env.simulator.read_notes(env.snapshot()))
    odd: list[Any] = [
        5,
        [],
        {},
        {**good, "task": 5},
        {**good, "task": "ab"},
        {**good, "done": "x"},
        {**good, "done": [0, 0, 0]},
        {**good, "seeded": None},
        {**good, "streams": 5},
        {**good, "streams": {**good["streams"], "seed": "x"}},
        {**good, "streams": {**good["streams"], "np_random": 5}},
        {**good, "streams": {**good["streams"], "np_random": {"bit_generator": "PCG64", "state": 5}}},
    ]
    before = env.snapshot()
    for notes in [b"\xff\xfe\xfa", b"\x00", b"[" * 100_000, *(json.dumps(o).encode() for o in odd)]:
        with pytest.raises(ValueError, match="not taken by an environment"):
            env.restore(env.simulator.save(notes))
    # Who has an episode is what the core says.
    env.restore(env.simulator.save(json.dumps({**good, "begun": [False] * 3}).encode()))
    assert env.snapshot() == before


def triangle_room(path: Path, x: float) -> None:
    corners = "".join(f"v {a} {b} {z}\n" for a, b in [(0, 0), (6, 0), (6, 5), (0, 5)] for z in (0, 3))
    wall = "".join(f"v {x} {a} {b}\n" for a, b in [(0, 0), (0, 1), (1, 1)])
    path.write_text(f"{corners}{wall}f 1 3 5 7\nf 2 4 6 8\nf 1 3 4 2\nf 3 5 6 4\nf 5 7 8 6\nf 7 1 2 8\nf 9 10 11\n")


def test_a_scene_file_that_changed_is_named(tmp_path: Path) -> None:
    path = tmp_path / "boxes.obj"
    triangle_room(path, 4.0)
    env = begun(single_env("six_directions", scene=str(path)))
    snapshot = env.snapshot()
    other = single_env("six_directions", scene=str(path))
    other.restore(snapshot)
    assert play_single(other, 3) == play_single(env, 3)
    triangle_room(path, 4.0625)
    with pytest.raises(ValueError, match="boxes.obj.*content changed"):
        env.restore(snapshot)
    path.unlink()
    with pytest.raises(OSError, match="boxes.obj"):
        env.restore(snapshot)


def lit(seed: int, count: int = 4) -> tuple[Octree, NDArray[np.float32]]:
    """A map of a room after some views."""
    scene, camera = Scene.generate("room", seed), Camera(64, 48, hfov=1.0, far=8.0)
    octree = Octree(0.1)
    for yaw in np.linspace(0, 5, count):
        c, s = np.cos(yaw / 2), np.sin(yaw / 2)
        # The camera that looks along +x, turned about z.
        x, y, z, w = 0.5 * (c + s), 0.5 * (s - c), 0.5 * (c - s), -0.5 * (c + s)
        pose = np.array([*scene.starts[0, :3], x, y, z, w], np.float32)
        octree.insert_depth(scene.render_depth(camera, pose), camera, pose, max_range=4.0)
    return octree, scene.starts[0, :3]


def test_maps_are_copied_and_pickled_and_kept_in_files(tmp_path: Path) -> None:
    octree, _ = lit(1)
    path = tmp_path / "room.nbvmap"
    octree.write(path)
    points = np.concatenate([octree.occupied(), octree.free(), octree.unknown(octree.bounds)[:1000]])
    for other in (octree.copy(), copy.copy(octree), copy.deepcopy(octree), pickle.loads(pickle.dumps(octree)), Octree.read(path)):
        for layer in ("classify", "log_odds", "uncertainty", "probability"):
            np.testing.assert_array_equal(getattr(other, layer)(points), getattr(octree, layer)(points))
        np.testing.assert_array_equal(other.occupied(), octree.occupied())
        assert other.recount() == octree.recount() == (other.num_known, other.num_occupied, other.entropy(), other.information())
        other.clear()
        assert octree.num_known > 0 == other.num_known
    assert [f.name for f in tmp_path.iterdir()] == ["room.nbvmap"], "no draft is left"

    data = path.read_bytes()
    for changed, match in [
        (data[:8] + b"\x07" + data[9:], "version 7 of the format is newer"),
        (data[:900] + bytes([data[900] ^ 1]) + data[901:], "checksum"),
        (data[:900], "too early"),
        (b"", "not an .nbvmap file"),
    ]:
        path.write_bytes(changed)
        with pytest.raises(ValueError, match=f"room.nbvmap.*{match}"):
            Octree.read(path)
    with pytest.raises(ValueError, match="sensor model"):
        Octree.read(path, hit=0.8)
    with pytest.raises(ValueError, match=".nbvmap, .bt or .ot"):
        octree.write(tmp_path / "room.pcd")
    with pytest.raises(OSError, match="nowhere"):
        octree.write(tmp_path / "nowhere" / "room.nbvmap")
