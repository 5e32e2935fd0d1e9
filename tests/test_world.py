"""The world that moves and sensors that err, through the Python door."""

from __future__ import annotations

import numpy as np
import pytest

from nbv_gym.envs.suite import TASKS
from nbv_gym.envs.vector_env import NbvVectorEnv
from nbv_gym.rust_env import METRICS, NOISES, Camera, Scene, Setup, Simulator

CAMERA = Camera(64, 48, hfov=1.2, near=0.0, far=10.0)
OUTSIDE = {"walkers": [{"path": [(1.0, 1.0)]}], "boxes": [{"position": (1.5, 1.0), "size": (0.2, 0.2, 0.2)}]}


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """A closed hall of 8 x 6 x 3 m with its corner in the origin."""
    low, high = (0.0, 0.0, 0.0), (8.0, 6.0, 3.0)
    corners = [[(low, high)[k >> a & 1][a] for a in range(3)] for k in range(8)]
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    path = tmp_path_factory.mktemp("hall") / "hall.obj"
    lines = ["v {} {} {}".format(*c) for c in corners] + ["f {} {} {} {}".format(*(i + 1 for i in f)) for f in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def make(scene, **keywords):
    setup = {"camera": CAMERA, "robot": {"kind": "flying", "radius": 0.2, "speed": 0.5, "turn_rate": 1.0}, "map": {"resolution": 0.1}}
    setup["views"] = {"kind": "six_directions", "step": 0.5}
    return Setup(scene, **{**setup, **keywords})


class One:
    """One environment and its buffers."""

    def __init__(self, setup, seed=1, **buffers):
        self.simulator = Simulator(setup)
        self.buffers = {"metrics": np.zeros((1, len(METRICS))), **buffers}
        self.simulator.reset(np.array([True]), [seed], self.buffers)

    def go(self, viewpoint):
        self.simulator.step(np.array([viewpoint], np.float32), np.array([False]), self.buffers)

    def metric(self, name):
        return self.buffers["metrics"][0, METRICS.index(name)]

    @property
    def pose(self):
        return self.simulator.belief(0).pose


def facing_x(x, y, z):
    """A camera at (x, y, z) that looks along world x."""
    return [x, y, z, -0.5, 0.5, -0.5, 0.5]


def test_a_walker_crosses_the_image_and_stops_the_robot(hall):
    depth = np.zeros((1, 48, 64), np.float32)
    bodies = {"walkers": [{"path": [(4.0, 1.0), (4.0, 5.0)], "speed": 1.0, "radius": 0.3}]}
    one = One(make(hall, bodies=bodies), depth=depth)
    # To the hall's middle axis, while the walker goes up and down.
    one.go(facing_x(1.0, 3.0, 1.2))
    columns = []
    for _ in range(40):
        x, y, z = one.pose[:3]
        one.go(facing_x(x, y, z + (0.1 if z < 1.2 else -0.1)))
        walker = one.simulator.body_poses(0)[0]
        row = depth[0, 24]
        seen = np.flatnonzero(row < 6.0)
        offset = (walker[1] - one.pose[1]) / 3.0
        if abs(offset) < 0.5:
            assert seen.size and abs(np.nanmin(row[seen]) - (np.hypot(3.0, 3.0 * offset) - 0.3)) < 0.05
            columns.append(seen.mean())
        elif abs(offset) > 0.66 + 0.1:
            assert not seen.size
    assert np.ptp(columns) > 20
    triangles = one.simulator.body_triangles(0)
    assert triangles.shape[1:] == (3, 3) and np.isclose(triangles[..., 2].max() - triangles[..., 2].min(), 1.8, atol=0.01)
    # Through the place where the walker stands.
    standing = One(make(hall, bodies={"walkers": [{"path": [(4.0, 3.0)]}]}))
    standing.go(facing_x(1.0, 3.0, 1.2))
    assert standing.metric("contact") == 0
    standing.go(facing_x(3.9, 3.0, 1.2))
    distance = np.hypot(*(standing.pose[:2] - (4.0, 3.0)))
    assert standing.metric("contact") == 1 and distance >= 0.2 + 0.28


def test_a_box_is_pushed(hall):
    one = One(make(hall, bodies={"boxes": [{"position": (4.0, 3.0), "size": (0.4, 0.4, 0.8)}]}))
    one.go(facing_x(2.5, 3.0, 0.4))
    before = one.simulator.body_poses(0)[0]
    assert np.allclose(before[:3], (4.0, 3.0, 0.4), atol=0.01)
    for x in (3.0, 3.5, 4.0, 4.5):
        one.go(facing_x(x, 3.0, 0.4))
    after = one.simulator.body_poses(0)[0]
    assert one.metric("contact") == 0 and after[0] > 4.5 and abs(after[2] - 0.4) < 0.2


def trajectories(seeds, threads, steps=5, **overrides):
    """Depth images, scans and rewards of environments that take the same kind of steps."""
    task = TASKS["six_directions"].variant(observation=("depth", "scan", "pose"), **overrides)
    env = NbvVectorEnv(task, num_envs=len(seeds), num_threads=threads)
    observations, _ = env.reset(seed=seeds)
    rows = [observations]
    for k in range(steps):
        actions = np.full(len(seeds), (2, 4, 3, 5, 2)[k % 5])
        observations, rewards, *_ = env.step(actions)
        rows += [observations, {"reward": rewards}]
    return [
        {name: np.array(value[i]) for row in rows for name, value in ((f"{j}{n}", v) for j, (n, v) in enumerate(row.items()))}
        for i in range(len(seeds))
    ], rows


def test_threads_and_company_change_nothing():
    moving = {
        "scene": "room:0-1",
        "bodies": {"walkers": 2, "boxes": 2},
        "noise": "kinect_v1",
        "lidar": {"range": 5.0, "rays": 90, "sigma": 0.01},
    }
    seeds = [3, 4, 5]
    _, alone = trajectories(seeds, 1, **moving)
    _, threads = trajectories(seeds, 3, **moving)
    singles = [trajectories([s], 1, **moving)[1] for s in seeds]
    for k, row in enumerate(alone):
        for name, values in row.items():
            assert np.array_equal(values, threads[k][name])
            for i in range(len(seeds)):
                assert np.array_equal(values[i], singles[i][k][name][0])
    # Something did move, and something was disturbed.
    _, still = trajectories(seeds, 1, **{**moving, "bodies": None})
    assert any(not np.array_equal(a["scan"], b["scan"]) for a, b in zip(alone, still, strict=True) if "scan" in a)


def test_noise_of_a_scene(hall):
    scene = Scene.load(hall)
    camera = Camera(80, 60, hfov=1.0, far=9.0, kind="z")
    poses = np.array([facing_x(8.0 - z, 3.0, 1.5) for z in (1.0, 2.0, 4.0)], np.float32)
    perfect = scene.render_depth(camera, poses)
    assert np.array_equal(perfect, scene.render_depth(camera, poses, noise=None, seed=5))
    noisy = scene.render_depth(camera, poses, noise="gaussian", seed=1)
    assert np.array_equal(noisy, scene.render_depth(camera, poses, noise={"kind": "gaussian"}, seed=1))
    assert not np.array_equal(noisy, scene.render_depth(camera, poses, noise="gaussian", seed=2))
    for image, truth, z in zip(noisy, perfect, (1.0, 2.0, 4.0), strict=True):
        wall = np.abs(truth - z) < 1e-3
        assert wall.sum() > 800
        sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2
        error = (image - truth)[wall]
        assert abs(error.std() / sigma - 1) < 5 / np.sqrt(2 * wall.sum())
        assert abs(error.mean()) < 5 * sigma / np.sqrt(wall.sum())
    steps = scene.render_depth(camera, poses, noise={"kind": "gaussian", "constant": 0, "growth": 0, "disparity_step": 0.125})
    disparity = 580 * 0.075 / steps / 0.125
    assert np.abs(disparity - disparity.round()).max() < 2e-3
    lost = scene.render_depth(camera, poses, noise="kinect_v1") == 0
    assert not (lost & (np.abs(perfect - poses[:, 0].max()) < 1e-3)).any()
    assert NOISES == ["gaussian", "kinect_v1"]


def test_perfect_sensors_are_as_without_the_keywords():
    plain = {"scene": "room:2", "lidar": {"range": 5.0}}
    _, without = trajectories([7], 1, **plain)
    _, spelled = trajectories([7], 1, noise=None, bodies={}, **plain)
    for a, b in zip(without, spelled, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)


def test_scans_lie_in_their_space(hall):
    task = TASKS["six_directions"].variant(scene=str(hall), lidar={"range": 3.0, "rays": 36}, observation="scan")
    env = NbvVectorEnv(task, num_envs=2)
    scan, _ = env.reset(seed=0)
    assert scan.shape == (2, 36) and scan.dtype == np.float32
    assert env.observation_space.contains(scan) and (scan == 3.0).any()
    # Against the walls, by hand.
    for i in range(2):
        x, y = env.belief(i).pose[:2]
        forward = rotate(env.belief(i).pose[3:], (0.0, 0.0, 1.0))
        bearing = np.arctan2(forward[1], forward[0]) + 2 * np.pi * np.arange(36) / 36
        cos, sin = np.cos(bearing), np.sin(bearing)
        walls = np.minimum(np.where(cos > 0, 8 - x, x) / np.abs(cos), np.where(sin > 0, 6 - y, y) / np.abs(sin))
        assert np.allclose(scan[i], np.minimum(walls, 3.0), atol=1e-3)


def rotate(quaternion, vector):
    u, w = np.array(quaternion[:3], float), float(quaternion[3])
    return 2 * u.dot(vector) * u + (w * w - u.dot(u)) * np.array(vector) + 2 * w * np.cross(u, vector)


@pytest.mark.parametrize(
    ("keywords", "error", "words"),
    [
        ({"noise": "sonar"}, ValueError, "sonar"),
        ({"noise": 3}, TypeError, "noise"),
        ({"noise": {"kind": "gaussian", "growth": -1}}, ValueError, "growth"),
        ({"noise": {"kind": "gaussian", "warp": 1}}, TypeError, "warp"),
        ({"lidar": {}}, TypeError, "range"),
        ({"lidar": {"range": -1.0}}, ValueError, "range"),
        ({"lidar": {"range": 1.0, "rays": 0}}, ValueError, "rays"),
        ({"bodies": {"walkers": -1}}, TypeError, "walkers"),
        ({"bodies": {"walkers": 1000}}, ValueError, "walkers"),
        ({"bodies": {"dogs": 1}}, TypeError, "dogs"),
        ({"bodies": {"walkers": [{"path": []}]}}, ValueError, "path"),
        ({"bodies": {"walkers": [{"path": [(np.nan, 0)]}]}}, ValueError, "path"),
        ({"bodies": {"walkers": [{"speed": 1.0}]}}, TypeError, "path"),
        ({"bodies": {"boxes": [{"position": (0,), "size": (1, 1, 1)}]}}, ValueError, "position"),
        ({"bodies": {"boxes": [{"position": (0, 0), "size": (1, 1, 0)}]}}, ValueError, "size"),
        ({"bodies": {"walkers": 1}, "robot": {"kind": "flying", "speed": 1e-6}}, ValueError, "speed"),
        ({"truth": "map"}, ValueError, "truth"),
        ({"truth": "images", "views": {"kind": "six_directions"}}, ValueError, "truth"),
    ],
)
def test_bad_values_are_named(keywords, error, words):
    with pytest.raises(error, match=words):
        make("room:0", **keywords)


def test_a_scan_needs_a_lidar():
    with pytest.raises(ValueError, match="lidar"):
        TASKS["six_directions"].variant(observation="scan")
    with pytest.raises(ValueError, match="lidar"):
        One(make("room:0"), scan=np.zeros((1, 10), np.float32))
