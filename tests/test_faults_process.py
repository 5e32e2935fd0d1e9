"""Processes, threads, Ctrl-C and faults of our own: each case in a process of its own under a watchdog, since its failure is a hang."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import nbv_gym  # noqa: F401 (registers the environments)
from nbv_gym.rust_env import Camera, InternalError

#: Seconds after which a case counts as hanging; generous, for busy machines.
WATCHDOG = 120
BEGIN = """
import gc, os, sys, threading, time, warnings
import gymnasium as gym
import numpy as np
import nbv_gym
from nbv_gym.rust_env import Camera, Simulator
warnings.simplefilter("ignore", DeprecationWarning)
QUICK = {"scene": "room:0", "camera": Camera(16, 12, hfov=1.0, near=0.05, far=3.0), "resolution": 0.3}

def make(n, threads=2, **changes):
    kwargs = QUICK | changes
    return gym.make_vec("NBV/SixDirections-v0", num_envs=n, num_threads=threads, vectorization_mode="vector_entry_point", **kwargs)

def run(envs, seed, steps=6):
    observations, _ = envs.reset(seed=seed)
    total = 0.0
    for k in range(steps):
        observations, rewards, *_ = envs.step(np.full(envs.num_envs, k % 6))
        total += rewards.sum()
    return total, float(np.sum(envs.simulator.belief(0).pose))
"""


def script(tmp_path: Path, code: str, *arguments: str) -> str:
    """Output of a script; a file, since `spawn` imports it again."""
    path = tmp_path / "case.py"
    path.write_text(BEGIN + code)
    done = subprocess.run([sys.executable, str(path), *arguments], capture_output=True, text=True, timeout=WATCHDOG)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")
@pytest.mark.parametrize("context", ["fork", "spawn", "forkserver"])
def test_processes_begun_after_stepping_work(tmp_path: Path, context: str) -> None:
    code = """
import multiprocessing
from functools import partial
from gymnasium.vector import AsyncVectorEnv

PARENTS = []

def child(queue, inherits):
    if inherits:
        PARENTS[0].step(np.zeros(3, int))  # the pool of the parent does not exist here
    queue.put(run(make(3), seed=5))

if __name__ == "__main__":
    context = multiprocessing.get_context(sys.argv[1])
    PARENTS.append(make(3))
    expected = run(PARENTS[0], seed=5)
    queue = context.Queue()
    process = context.Process(target=child, args=(queue, sys.argv[1] == "fork"))
    process.start()
    assert queue.get(timeout=60) == expected
    process.join(timeout=60)
    assert process.exitcode == 0
    one = partial(gym.make, "NBV/SixDirections-v0", **QUICK)
    pool = AsyncVectorEnv([one, one], context=sys.argv[1])
    pool.reset(seed=3)
    pooled = [pool.step(np.array([k, k]))[1] for k in range(3)]
    pool.close()
    native = make(2)
    native.reset(seed=3)
    np.testing.assert_array_equal(pooled, [native.step(np.array([k, k]))[1] for k in range(3)])
    assert run(PARENTS[0], seed=5) == expected
    print("fine")
"""
    assert script(tmp_path, code, context) == "fine\n"


def test_threads_step_different_environments_while_others_allocate(tmp_path: Path) -> None:
    code = """
expected = [run(make(2), seed) for seed in (1, 2)]
found = [None, None]

def work(i):
    found[i] = [run(make(2), seed=i + 1) for _ in range(8)]

def rubbish(stop):
    while not stop.is_set():
        ring = [[np.zeros(50)] for _ in range(500)]
        ring[0].append(ring)
        del ring
        gc.collect()

stop = threading.Event()
threads = [threading.Thread(target=work, args=(i,)) for i in range(2)]
other = threading.Thread(target=rubbish, args=(stop,))
for thread in [*threads, other]:
    thread.start()
for thread in threads:
    thread.join()
stop.set()
other.join()
assert found == [[e] * 8 for e in expected], (found, expected)
print("fine")
"""
    assert script(tmp_path, code) == "fine\n"


def test_threads_on_one_environment_get_a_clean_error(tmp_path: Path) -> None:
    code = """
envs = make(32, camera=Camera(64, 48, hfov=1.0, near=0.05, far=3.0))
expected = run(envs, seed=1)
outcomes = []

def hammer():
    for _ in range(30):
        try:
            envs.step(np.zeros(32, int))
            outcomes.append("ok")
        except RuntimeError as error:
            outcomes.append(str(error))

threads = [threading.Thread(target=hammer) for _ in range(3)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert len(outcomes) == 90 and "ok" in outcomes
clean = {"ok", "Already borrowed", "Already mutably borrowed"}
assert set(outcomes) <= clean and len(set(outcomes)) > 1, set(outcomes)
assert run(envs, seed=1) == expected
print("fine")
"""
    assert script(tmp_path, code) == "fine\n"


LONG = {
    # Thousands of rooms are furnished; each thread works on its own.
    "reset": "envs = make(4000, threads=1, scene='room:0-1000000'); work = lambda: envs.reset(seed=0)",
    "reset with threads": "envs = make(4000, threads=2, scene='room:0-1000000'); work = lambda: envs.reset(seed=0)",
    # Millions of voxels are looked for.
    "ground truth": "envs = make(1, threads=1, scene='home:0', resolution=0.01); work = lambda: envs.reset(seed=0)",
    "step": "envs = make(256, threads=2); envs.reset(seed=0); work = lambda: [envs.step(np.zeros(256, int)) for _ in range(10**6)]",
    "gains": (
        "envs = make(1, threads=2); envs.reset(seed=0); belief = envs.belief(0);"
        "work = lambda: belief.view_gain(np.tile(belief.pose, (10**6, 1)))"
    ),
    # One view, of millions of rays.
    "one view": (
        "from nbv_gym.rust_env import Octree; octree = Octree(0.05);"
        "camera = Camera(32, 32, hfov=1.5, far=10.0); pose = [0, 0, 1, 0, 0, 0, 1.0];"
        "octree.insert_depth(np.full((32, 32), 8.0), camera, pose);"
        "work = lambda: [octree.view_gain([pose], camera, metric, angle_step=0.001)"
        " for _ in range(9) for metric in ('entropy', 'average_entropy', 'ray_entropy')]"
    ),
    "nearest": (
        "from nbv_gym.rust_env import Octree; octree = Octree(0.05);"
        "[octree.insert_points([at], np.array(at) * 0.99) for at in ([70.0, 70, 20], [-70.0, -70, -20])];"
        "work = lambda: octree.nearest(np.zeros((10**5, 3)))"
    ),
    "rays through a map": (
        "from nbv_gym.rust_env import Octree; octree = Octree(0.05); "
        "[octree.insert_points([at], np.array(at) * 0.99) for at in ([70.0, 70, 20], [-70.0, -70, -20])];"
        "work = lambda: octree.cast_rays(np.zeros((10**6, 3)), np.ones((10**6, 3)), 1500.0, True)"
    ),
    "images": (
        "from nbv_gym.rust_env import Scene; scene = Scene.generate('room', 0);"
        "work = lambda: scene.render_depth(Camera(16, 12, hfov=1.0), np.tile(np.array([0, 0, 1, 0, 0, 0, 1.0]), (10**7, 1)))"
    ),
}


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("what", LONG)
def test_interrupts_are_served_soon(tmp_path: Path, what: str) -> None:
    # A handler of one's own works, too: what it raises is what the caller sees.
    code = f"""
import signal
{LONG[what]}

def handler(number, frame):
    raise KeyboardInterrupt("by hand")

signal.signal(signal.SIGINT, handler)
print("ready", flush=True)
try:
    work()
except KeyboardInterrupt as error:
    assert str(error) == "by hand", error
    print("interrupted", flush=True)
quick = make(2)
run(quick, seed=1)
print("fine", flush=True)
"""
    path = tmp_path / "case.py"
    path.write_text(BEGIN + code)
    process = subprocess.Popen([sys.executable, str(path)], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.3)
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "interrupted\n"
        # A tenth of a second where nothing else runs; minutes if nobody asked.
        assert time.monotonic() - began < 8
        assert process.communicate(timeout=WATCHDOG)[0] == "fine\n"
        assert process.returncode == 0
    finally:
        process.kill()
        process.wait()


def make(n: int, threads: int, **more: Any) -> Any:
    camera = Camera(16, 12, hfov=1.0, near=0.05, far=3.0)
    changes: dict[str, Any] = {"scene": "room:0", "camera": camera, "resolution": 0.3, "num_threads": threads, **more}
    return gym.make_vec("NBV/SixDirections-v0", num_envs=n, vectorization_mode="vector_entry_point", **changes)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_fault_of_our_own_poisons_its_environment_only(threads: int, capfd: pytest.CaptureFixture[str]) -> None:
    envs, reference = make(3, threads), make(3, threads)
    actions = np.array([0, 1, 2])
    for e in (envs, reference):
        e.reset(seed=4)
        e.step(actions)
    envs.simulator._fail_next(1)
    with pytest.raises(InternalError, match=r"environment 1: a fault that a test put here \(.*simulator.rs"):
        envs.step(actions)
    assert issubclass(InternalError, RuntimeError)
    with pytest.raises(InternalError, match="environment 1 failed.*reset it"):
        envs.step(actions)
    with pytest.raises(InternalError, match="environment 1"):
        _ = envs.belief(1).pose
    # The others did their step and go on.
    reference.step(actions)
    for i in (0, 2):
        np.testing.assert_array_equal(envs.belief(i).pose, reference.belief(i).pose)
        assert envs.belief(i).octree.num_known == reference.belief(i).octree.num_known
    only = {"reset_mask": np.array([False, True, False])}
    for e in (envs, reference):
        e.reset(seed=[None, 9, None], options=only)
    ours, theirs = envs.step(actions), reference.step(actions)
    np.testing.assert_array_equal(ours[1], theirs[1])
    assert capfd.readouterr().err == "", "the panic is not printed"


def test_a_fault_in_a_reset_is_healed_by_the_next(capfd: pytest.CaptureFixture[str]) -> None:
    envs = make(2, 1)
    envs.reset(seed=4)
    envs.simulator._fail_next(0)
    with pytest.raises(InternalError, match="environment 0"):
        envs.reset(seed=4)
    ours, _ = envs.reset(seed=4)
    np.testing.assert_array_equal(ours, make(2, 1).reset(seed=4)[0])
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("threads", [1, 2])
def test_a_fault_when_the_next_episode_begins_is_healed_by_the_next_step(threads: int) -> None:
    envs, reference = make(3, threads, budget=1), make(3, threads, budget=1)
    actions = np.array([0, 1, 2])
    for e in (envs, reference):
        e.reset(seed=4)
        e.step(actions)
    envs.simulator._fail_next(1)
    with pytest.raises(InternalError, match="environment 1: a fault that a test put here"):
        envs.step(actions)
    reference.step(actions)
    # It begins now, while the others take their view.
    ours, theirs = envs.step(actions), reference.step(actions)
    assert ours[4]["views"].tolist() == [2, 1, 2]
    for i in (0, 2):
        np.testing.assert_array_equal(ours[0][i], theirs[0][i])
        assert ours[1][i] == theirs[1][i]
