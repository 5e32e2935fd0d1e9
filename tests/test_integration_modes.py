"""The named approximate ways of integration: how much they differ from the exact one. (`test_octree.py`: discretized equals OctoMap's.)"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from nbv_gym.envs.env import NbvEnv
from nbv_gym.envs.suite import TASKS
from nbv_gym.rust_env import Camera, Octree, Scene

CAMERA = Camera(160, 120, hfov=np.deg2rad(75), far=8.0)
SCENES = ["room:3", "tabletop:5"]


def frames(name: str, count: int = 6) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Depth images and poses near the scene's starts, looking anywhere."""
    kind, seed = name.split(":")
    scene = Scene.generate(kind, int(seed))
    rng = np.random.default_rng(int(seed))
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    positions = scene.starts[rng.integers(len(scene.starts), size=count), :3] + rng.uniform(-0.2, 0.2, (count, 3))
    poses = np.concatenate([positions, quaternions], axis=1).astype(np.float32)
    return [(scene.render_depth(CAMERA, pose), pose) for pose in poses]


def mapped(name: str, resolution: float, integration: str, count: int = 6) -> Octree:
    octree = Octree(resolution)
    for depth, pose in frames(name, count):
        octree.insert_depth(depth, CAMERA, pose, max_range=4.0, integration=integration)
    return octree


def difference(a: Octree, b: Octree) -> float:
    """Share of the voxels known to either map whose classes differ."""
    centers = np.concatenate([a.occupied(), a.free(), b.occupied(), b.free()])
    keys = np.unique(np.round(centers / a.resolution - 0.5).astype(np.int64), axis=0)
    centers = (keys + 0.5) * a.resolution
    return float(np.mean(a.classify(centers) != b.classify(centers)))


#: The least and the greatest share of differing voxels that is allowed: an approximation, and a good one.
BANDS = {
    ("discretized", 0.1): (1e-4, 0.05),
    ("discretized", 0.05): (1e-4, 0.03),
    ("projective", 0.1): (1e-4, 0.18),
    ("projective", 0.05): (1e-4, 0.10),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(("integration", "resolution"), BANDS)
def test_error_of_the_approximations(name: str, integration: str, resolution: float) -> None:
    exact, approximate = mapped(name, resolution, "exact"), mapped(name, resolution, integration)
    low, high = BANDS[integration, resolution]
    error = difference(exact, approximate)
    assert low <= error <= high
    assert approximate.recount() == (approximate.num_known, approximate.num_occupied, approximate.entropy(), approximate.information())


@pytest.mark.parametrize("resolution", [0.1, 0.05])
def test_projective_hits_are_the_exact_ones_and_free_voxels_lie_in_front(resolution: float) -> None:
    depth, pose = frames("room:3", 1)[0]
    maps = {}
    for integration in ("exact", "projective"):
        maps[integration] = Octree(resolution)
        maps[integration].insert_depth(depth, CAMERA, pose, max_range=4.0, integration=integration)
    exact, projective = maps["exact"], maps["projective"]
    order = np.lexsort(exact.occupied().T), np.lexsort(projective.occupied().T)
    np.testing.assert_array_equal(exact.occupied()[order[0]], projective.occupied()[order[1]])
    np.testing.assert_array_equal(exact.occupied_uncertainty()[order[0]], projective.occupied_uncertainty()[order[1]])
    ranges = np.linalg.norm(projective.free() - pose[:3], axis=1)
    assert ranges.max() <= 4.0 + 1e-4
    # A brute force over all voxels: the nearest pixel's range decides.
    camera_from_world = np.asarray(CAMERA.unproject(np.ones((120, 160), np.float32), pose)).reshape(-1, 3) - pose[:3]
    free = projective.free()
    directions = (free - pose[:3]) / ranges[:, None]
    sample = np.random.default_rng(0).integers(len(free), size=300)
    pixel = np.argmax(directions[sample] @ camera_from_world.T, axis=1)
    measured = np.minimum(np.where(np.isfinite(depth), depth, np.inf).reshape(-1)[pixel], 4.0)
    assert np.mean(ranges[sample] < measured + 1e-4) > 0.97


def test_unknown_ways_are_named() -> None:
    octree = Octree(0.1)
    with pytest.raises(ValueError, match='exact, discretized, projective, got "quick"'):
        octree.insert_points(np.ones((4, 3)), [0, 0, 0], integration="quick")
    with pytest.raises(ValueError, match="projective"):
        octree.insert_points(np.ones((4, 3)), [0, 0, 0], integration="projective")
    assert octree.num_known == 0
    task = TASKS["six_directions"]
    with pytest.raises(ValueError, match="quick"):
        task.variant(map={"resolution": 0.1, "integration": "quick"})


@pytest.mark.parametrize("integration", ["discretized", "projective"])
def test_an_environment_maps_as_its_setup_says(integration: str) -> None:
    task = TASKS["six_directions"]
    known = []
    for way in ("exact", integration):
        env = NbvEnv(task.variant(map={"resolution": 0.1, "integration": way}), scene="room:7")
        env.reset(seed=1)
        known.append(env.belief.octree.num_known)
        env.close()
    assert known[0] != known[1] and known[1] == pytest.approx(known[0], rel=0.2)
