"""The same results for any number of threads and environments, and from version to version.

A digest of a small fixed run of each task stands in `golden_digests.json`. A change that means to change results writes
the file anew: ``NBV_GYM_WRITE_GOLDEN=1 pytest tests/test_golden.py``, and says so in CHANGELOG.md.

The map's arithmetic is the same bits on every processor (`belief::integrate` tests every kind of lanes against scalar
code). Depth images may differ in the last bit between the kernels of instruction sets (fused multiply-adds round once) and
between libraries' sines, so that digests of whole runs are kept for each of these, see `platform_key`.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nbv_gym.envs.suite import TASKS
from nbv_gym.envs.vector_env import NbvVectorEnv
from nbv_gym.rust_env import KERNELS, Camera, Octree

GOLDEN = Path(__file__).with_name("golden_digests.json")
CAMERAS = {"dome_room": 4.0, "six_directions": 4.0, "tabletop": 1.5, "wang2019": 4.0, "wang2019_kinect": 4.0}
#: Tasks that are too fine for a test.
RESOLUTIONS = {"wang2019": 0.1, "wang2019_kinect": 0.1}
SEEDS = (0, 7, 100, 2**40)
STEPS = 5


def platform_key() -> str:
    """Where results are the same bits: processor, system, kernels of the renderer and of the map."""
    return " ".join([platform.machine().lower(), platform.system().lower(), *KERNELS])


def digests(task: str, seeds: tuple[int, ...], threads: int) -> list[str]:
    """A digest for each environment: all observations, rewards, infos and the map at the end."""
    camera = Camera(32, 24, hfov=1.0, near=0.05, far=CAMERAS[task])
    changes = {"resolution": RESOLUTIONS[task]} if task in RESOLUTIONS else {}
    env = NbvVectorEnv(task, num_envs=len(seeds), num_threads=threads, camera=camera, max_episode_steps=3, **changes)
    hashes = [hashlib.sha256() for _ in seeds]

    def note(values: Any, i: int) -> None:
        if isinstance(values, dict):
            for key in sorted(values):
                hashes[i].update(key.encode())
                note(values[key], i)
        else:
            hashes[i].update(np.ascontiguousarray(values[i]).tobytes())

    observations, infos = env.reset(seed=list(seeds))
    for step in range(STEPS):
        for i in range(len(seeds)):
            note(observations, i)
            note(infos, i)
        masks = infos["action_mask"]
        choices = [np.flatnonzero(mask) if mask.any() else np.arange(len(mask)) for mask in masks]
        actions = np.array([c[(step * 31 + 5) % len(c)] for c in choices])
        observations, rewards, terminated, truncated, infos = env.step(actions)
        for i in range(len(seeds)):
            for values in (rewards, terminated, truncated):
                note(values, i)
    for i in range(len(seeds)):
        note(observations, i)
        hashes[i].update(env.belief(i).octree.__reduce__()[1][0])
    return [h.hexdigest()[:16] for h in hashes]


@pytest.mark.parametrize("task", TASKS)
def test_neither_threads_nor_company_change_results(task: str) -> None:
    alone = [digests(task, (seed,), threads=1)[0] for seed in SEEDS]
    for threads in (1, 2, 3, 8):
        assert digests(task, SEEDS, threads) == alone, f"{threads} threads"


@pytest.mark.parametrize("task", TASKS)
def test_results_are_those_of_the_golden_file(task: str) -> None:
    compare(task, digests(task, SEEDS, threads=2), platform_key())


def test_the_map_is_the_same_everywhere() -> None:
    """Points and a few exactly representable origins: no sine, no renderer, and no key of a platform."""
    rng = np.random.default_rng(5)
    octree = Octree(0.05)
    for _ in range(4):
        origin = rng.integers(-8, 8, 3) / 16
        octree.insert_points(origin + rng.integers(-256, 256, (3000, 3)) / 64, origin, max_range=3.0)
    octree.decay(0.75)
    octree.clear([[0, 0, 0], [0.5, 0.5, 0.5]])
    voxels = np.concatenate([octree.occupied(), octree.free()])
    layers = voxels.tobytes() + octree.log_odds(voxels).tobytes()
    compare("map", [hashlib.sha256(layers).hexdigest()[:16]], "every platform")


def compare(name: str, found: list[str], key: str) -> None:
    golden = json.loads(GOLDEN.read_text()) if GOLDEN.exists() else {}
    if os.environ.get("NBV_GYM_WRITE_GOLDEN"):
        golden.setdefault(key, {})[name] = found
        GOLDEN.write_text(json.dumps(golden, indent=1, sort_keys=True) + "\n")
        return
    if key not in golden:
        pytest.skip(f"no digests are kept for {key!r}; there are those for {', '.join(golden)}")
    assert golden[key][name] == found
