"""The arm on the dome, from outside: joints by a second derivation of the kinematics, surfaces by points on its links."""

from __future__ import annotations

import numpy as np
import pytest
from nbv_gym.rust_env import METRICS, Camera, Setup, Simulator

CAMERA = Camera(24, 18, hfov=1.05, near=0.05, far=4.0)
UPPER, FORE, LINK, BALL = 0.425, 0.392, 0.06, 0.1
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
        """Where the optical axes of all views meet."""
        first, last = self.views[i, 0], self.views[i, -24]
        return (axis_meets(first) + axis_meets(last)) / 2


def axis_meets(view, radius=0.6):
    x, y, z, w = view[3:]
    return view[:3] - radius * np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])


def links(shoulder, hand):
    """Points on upper arm, forearm and in the middle of the ball, and the radius around each; by two circles in the plane."""
    out = hand - shoulder
    distance = np.linalg.norm(out)
    along = out / distance
    level = np.array([out[0], out[1], 0.0])
    up = np.array([0.0, 0.0, 1.0]) - along * along[2]
    up /= np.linalg.norm(up)
    assert abs(np.dot(np.cross(along, up), level)) < 1e-6, "the plane is vertical"
    foot = (distance**2 + UPPER**2 - FORE**2) / (2 * distance)
    elbow = shoulder + along * foot + up * np.sqrt(UPPER**2 - foot**2)
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


@pytest.mark.parametrize("bodies", [None, {"walkers": 2, "boxes": 1}], ids=["alone", "among people"])
def test_no_part_is_ever_inside_a_surface(bodies):
    seeds = list(range(6))
    run = Run(make("room:0-19", bodies=bodies), seeds, threads=2)
    rng = np.random.default_rng(7)
    contacts = 0
    for _ in range(60):
        run.go(rng.integers(672, size=len(seeds)))
        contacts += run.metrics[:, CONTACT].sum()
        for i in range(len(seeds)):
            points, radii = links(run.shoulder(i).astype(float), run.pose[i, :3].astype(float))
            room = run.simulator.scene(i).clearance(points, 1.0) - radii
            assert room.min() >= -1e-3
    assert contacts > 0 or bodies is None


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
