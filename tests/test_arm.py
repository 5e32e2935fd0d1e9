"""The arm on the dome, from outside: joints by a second derivation of the kinematics, surfaces by points on its links."""

from __future__ import annotations

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

from nbv_gym.agents import AGENTS, rollout
from nbv_gym.rust_env import METRICS, Camera, Setup, Simulator

CAMERA = Camera(24, 18, hfov=1.05, near=0.05, far=4.0)
LINK, BALL = 0.06, 0.1
#: An arm too long for most rooms, and its dome.
LONG = {"robot": {"kind": "arm", "upper_arm": 0.8, "forearm": 0.7}, "views": {"kind": "dome", "radius": 1.1}}
CONTACT, TRAVEL, LENGTH, TIME = (METRICS.index(name) for name in ("contact", "travel", "path_length", "time"))


def make(scene, **keywords):
    setup = {"robot": {"kind": "arm"}, "map": {"resolution": 0.1}, "views": {"kind": "dome"}}
    return Setup(scene, CAMERA, **{**setup, **keywords})


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """An empty hall of 6 x 6 x 3 m."""
    corners = [[(0, 6)[k & 1], (0, 6)[k >> 1 & 1], (0, 3)[k >> 2 & 1]] for k in range(8)]
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    lines = ["v {} {} {}".format(*c) for c in corners] + ["f {} {} {} {}".format(*(i + 1 for i in f)) for f in faces]
    path = tmp_path_factory.mktemp("hall") / "hall.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


class Run:
    """Environments stepped by random views."""

    def __init__(self, setup, seeds, threads=1):
        n = len(seeds)
        self.simulator = Simulator(setup, n, threads)
        self.views = np.zeros((n, self.simulator.num_candidates, 7), np.float32)
        self.mask = np.zeros((n, self.simulator.num_candidates), bool)
        self.metrics = np.zeros((n, len(METRICS)))
        self.pose = np.zeros((n, 7), np.float32)
        self.buffers = {"candidates": self.views, "mask": self.mask, "metrics": self.metrics, "pose": self.pose}
        self.simulator.reset(np.ones(n, bool), seeds, self.buffers)

    def go(self, indices):
        goals = self.views[np.arange(len(indices)), indices]
        self.simulator.step(goals, np.zeros(len(indices), bool), self.buffers)

    def shoulder(self, i):
        """Where the optical axes meet: midway between opposite views of a ring, on the height of the axis' level."""
        x, y, z, w = self.views[i, 0, 3:].astype(float)
        axis = np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
        first, opposite = self.views[i, 0, :3].astype(float), self.views[i, 24, :3].astype(float)
        radius = np.linalg.norm((first - opposite)[:2]) / 2 / np.linalg.norm(axis[:2])
        return first - radius * axis


def links(shoulder, hand, upper, fore):
    """Points on upper arm, forearm and in the middle of the ball, and the radius around each; by two circles in the plane."""
    out = hand - shoulder
    distance = np.linalg.norm(out)
    along = out / distance
    level = np.array([out[0], out[1], 0.0])
    up = np.array([0.0, 0.0, 1.0]) - along * along[2]
    up /= np.linalg.norm(up)
    assert abs(np.dot(np.cross(along, up), level)) < 1e-6, "the plane is vertical"
    foot = (distance**2 + upper**2 - fore**2) / (2 * distance)
    elbow = shoulder + along * foot + up * np.sqrt(upper**2 - foot**2)
    t = np.linspace(0, 1, 80)[:, None]
    points = np.concatenate([shoulder + (elbow - shoulder) * t, elbow + (hand - elbow) * t, hand[None]])
    return points, np.array([LINK] * 160 + [BALL])


def test_in_an_empty_hall_every_view_is_allowed_and_reached(hall):
    run = Run(make(hall), [3])
    rng = np.random.default_rng(1)
    assert run.mask.all()
    for _ in range(40):
        before = run.metrics.copy()
        choice = rng.integers(672, size=1)
        run.go(choice)
        assert run.mask.all() and not run.metrics[0, CONTACT]
        np.testing.assert_array_equal(run.pose[0], run.views[0, choice[0]])
        travel = run.metrics[0, TRAVEL]
        # At most half around the sphere and up or down all its rings; never shorter than a straight line.
        assert travel <= 0.6 * (np.pi + np.radians(95)) + 1e-3
        assert travel >= np.linalg.norm(run.pose[0, :3] - run.simulator.belief(0).trajectory[-2, :3]) - 1e-3
        assert run.metrics[0, LENGTH] == pytest.approx(before[0, LENGTH] + travel)
        assert run.metrics[0, TIME] >= before[0, TIME] + travel / 0.5 - 1e-4


@pytest.mark.parametrize("scene", ["room:0-19", "home:0-19"])
def test_no_part_is_ever_inside_a_surface(scene):
    seeds = list(range(6))
    run = Run(make(scene, **LONG), seeds, threads=2)
    rng = np.random.default_rng(7)
    contacts = 0
    for _ in range(50):
        run.go(rng.integers(672, size=len(seeds)))
        contacts += run.metrics[:, CONTACT].sum()
        for i in range(len(seeds)):
            points, radii = links(run.shoulder(i).astype(float), run.pose[i, :3].astype(float), 0.8, 0.7)
            room = run.simulator.scene(i).clearance(points, 1.0) - radii
            assert room.min() >= -1e-3
    assert contacts > 20


def test_people_stop_the_arm(hall):
    """Somebody walks to and fro before the shoulder: the arm is stopped now and then, and never for good."""
    alone = Run(make(hall), [3])
    x, y, _ = alone.shoulder(0)
    walker = {"path": [(x - 1.5, y + 0.9), (x + 1.5, y + 0.9)], "radius": 0.25}
    run = Run(make(hall, bodies={"walkers": [walker]}), [3])
    np.testing.assert_allclose(run.shoulder(0), alone.shoulder(0))
    rng = np.random.default_rng(4)
    contacts = []
    for choice in rng.integers(672, size=(60, 1)):
        run.go(choice)
        contacts.append(run.metrics[0, CONTACT] > 0)
        assert contacts[-1] or (run.pose[0] == run.views[0, choice[0]]).all()
    assert 0 < sum(contacts) < 40


def test_views_are_masked_where_links_would_be_in_occupied_voxels():
    # The elbow lies far outside the dome, where the camera sees what it would meet.
    robot = {"kind": "arm", "upper_arm": 1.5, "forearm": 1.2}
    run = Run(make("room:0-19", robot=robot), [1, 3])
    rng = np.random.default_rng(7)
    for _ in range(30):
        run.go(rng.integers(672, size=2))
    inside = 0
    for i in range(2):
        belief, shoulder = run.simulator.belief(i), run.shoulder(i).astype(float)
        for view, allowed in zip(run.views[i], run.mask[i], strict=True):
            points, _ = links(shoulder, view[:3].astype(float), 1.5, 1.2)
            # Well away from the camera's ball, which is looked at on its own.
            along = points[np.linalg.norm(points - view[:3], axis=1) > 0.2]
            hit = (belief.octree.classify(along) == 1).any()
            inside += hit
            assert not (hit and allowed)
        np.testing.assert_array_equal(belief.candidate_mask, run.mask[i])
    assert inside > 0


def test_threads_and_neighbours_change_nothing():
    seeds, setup = [5, 6, 7, 8, 9], make("room:0-19", bodies={"walkers": 1})
    runs = [Run(setup, seeds), Run(setup, seeds, threads=3), Run(setup, seeds[2:3])]
    rng = np.random.default_rng(2)
    for _ in range(15):
        choice = rng.integers(672, size=len(seeds))
        for run in runs:
            run.go(choice if len(run.mask) == len(seeds) else choice[2:3])
        for name in ("metrics", "mask", "pose"):
            one, many, alone = (getattr(run, name) for run in runs)
            np.testing.assert_array_equal(one, many)
            np.testing.assert_array_equal(one[2:3], alone)


def test_a_viewpoint_out_of_reach_is_approached(hall):
    run = Run(make(hall), [3])
    shoulder = run.shoulder(0)
    goal = run.views[:, 0].copy()
    goal[0, :3] = shoulder + np.array([0.0, 3.0, 0.0])
    run.simulator.step(goal, np.zeros(1, bool), run.buffers)
    np.testing.assert_allclose(run.pose[0, :3], shoulder + np.array([0.0, 0.817, 0.0]), atol=1e-3)
    assert not run.metrics[0, CONTACT]
    belief = run.simulator.belief(0)
    assert np.isinf(belief.travel_cost(goal)).all() and not belief.reachable(goal).any()
    assert belief.reachable(run.views[0]).all() and belief.travel_cost(run.views[0]).max() < 0.6 * 2 * np.pi
    np.testing.assert_array_equal(belief.path_to(run.views[0, 100])[-1], run.views[0, 100, :3])
    run.go(np.array([100]))
    np.testing.assert_array_equal(run.pose[0], run.views[0, 100])


@pytest.mark.parametrize("copied", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "deepcopy"])
def test_a_copied_arm_goes_on_alike(copied):
    env = gym.make("NBV/DomeRoom-v0", scene="room:0-3", bodies={"walkers": 1}, **LONG).unwrapped
    env.reset(seed=2)
    rng = np.random.default_rng(3)
    contacts = 0
    for action in rng.integers(672, size=8):
        contacts += env.step(action)[4]["contact"]
    assert contacts
    twin = copied(env)
    for action in rng.integers(672, size=8):
        (seen, reward, *_, info), (twin_seen, twin_reward, *_, twin_info) = env.step(action), twin.step(action)
        assert reward == twin_reward and info["travel"] == twin_info["travel"] and info["time"] == twin_info["time"]
        for name, channel in seen.items():
            np.testing.assert_array_equal(channel, twin_seen[name])


def test_agents_plan_for_an_arm():
    keywords = {"scene": "home:2", "resolution": 0.2, "success": None, **LONG}
    env = gym.make("NBV/DomeRoom-v0", **keywords).unwrapped
    for name in ("random", "nearest_frontier", "greedy"):
        records = rollout(env, AGENTS[name](), seed=1)
        assert len(records) == 31
    env.close()


@pytest.mark.parametrize(
    ("keywords", "error", "words"),
    [
        ({"robot": {"kind": "crawler"}}, ValueError, "'flying' or 'arm'"),
        ({"robot": {"kind": "arm", "upper_arm": -0.4}}, ValueError, "upper_arm"),
        ({"robot": {"kind": "arm", "forearm": 20.0}}, ValueError, "forearm.*20"),
        ({"robot": {"kind": "arm", "link_radius": float("nan")}}, ValueError, "link_radius"),
        ({"robot": {"kind": "arm", "hand": 1.0}}, TypeError, "hand"),
        ({"robot": {"kind": "flying", "upper_arm": 0.4}}, TypeError, "upper_arm"),
        ({"views": {"kind": "six_directions"}}, ValueError, "'arm'.*dome"),
        ({"views": {"kind": "ring"}}, ValueError, "'arm'.*dome"),
        ({"views": {"kind": "dome", "radius": 0.9}}, ValueError, "0.9 m.*0.425.*0.392"),
        ({"robot": {"kind": "arm", "upper_arm": 0.9, "forearm": 0.2}}, ValueError, "0.6 m.*0.9 m"),
    ],
)
def test_bad_arms_are_named(keywords, error, words):
    with pytest.raises(error, match=words):
        make("room:0", **keywords)
