"""Memory: it does not grow with the number of episodes or environments, and running out of it is an end, not a hang."""

from __future__ import annotations

import subprocess
import sys

import pytest

BEGIN = """
import gc, os, sys
import gymnasium as gym
import numpy as np
import nbv_gym
from nbv_gym.rust_env import Camera, Octree, Scene
QUICK = {"scene": "room:0-3", "camera": Camera(8, 6, hfov=1.0, near=0.05, far=3.0), "resolution": 0.4}

def resident():
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

def make(n):
    return gym.make_vec("NBV/SixDirections-v0", num_envs=n, vectorization_mode="vector_entry_point", **QUICK)
"""
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def script(code: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([sys.executable, "-c", BEGIN + code], capture_output=True, text=True, timeout=240)
    assert not check or done.returncode == 0, done.stderr
    return done


@LINUX
def test_ten_thousand_episodes_take_no_more_memory_than_two() -> None:
    code = """
envs = make(10)
def episodes(count):
    for seed in range(count):
        envs.reset(seed=seed)
        envs.step(np.full(10, seed % 6))
episodes(200)
before = resident()
episodes(1000)
print(resident() - before)
"""
    # 10,000 episodes; an observation of each that were kept would be 2 MB, a map of each 100 MB.
    assert float(script(code).stdout) < 4.0


@LINUX
def test_a_thousand_environments_come_and_go() -> None:
    code = """
def come_and_go(count):
    for seed in range(count):
        envs = make(1)
        envs.reset(seed=seed)
        belief = envs.belief(0)
        octree = belief.octree
        envs.close()
        del envs, belief, octree
come_and_go(100)
before = resident()
come_and_go(1000)
print(resident() - before)
"""
    assert float(script(code).stdout) < 4.0


@LINUX
@pytest.mark.parametrize(
    "work",
    [
        "Scene.load(path)",
        "make(60_000)",
        "Octree(0.002).insert_points(np.random.default_rng(0).uniform(-3, 3, (10**6, 3)), [0, 0, 0])",
        "Scene.generate('room', 0).render_depth(Camera(2000, 2000, hfov=1.0), np.tile(np.array([0, 0, 1, 0, 0, 0, 1.0]), (100, 1)))",
    ],
)
def test_out_of_memory_is_an_end(work: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("memory") / "large.obj"
    if "load" in work:
        path.write_text("".join(f"v {i % 97} {i % 89} {i % 83}\n" for i in range(300_000)) + "f 1 2 3\nf 4 5 6\n" * 600_000)
    code = f"""
import resource
path = {str(path)!r}
with open("/proc/self/statm") as file:
    used = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
resource.setrlimit(resource.RLIMIT_AS, (used + 60_000_000,) * 2)
try:
    {work}
except (MemoryError, OSError, ValueError, RuntimeError) as error:
    print("refused", error)
else:
    print("done")
"""
    done = script(code, check=False)
    # An exception, or Rust's own end of the process (SIGABRT) which says how many bytes there were not.
    if done.returncode == 0:
        assert done.stdout.startswith("refused"), done.stdout
    else:
        assert done.returncode == -6 and "memory allocation of" in done.stderr, done
