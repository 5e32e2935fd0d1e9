"""Odd rays, views and images at the map's door: right answers, or an error before anything changed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from nbv_gym.envs.suite import TASKS
from nbv_gym.rust_env import Camera, Octree, Scene, Setup, Simulator


def test_rays_of_any_length_are_rays_and_others_are_told_apart() -> None:
    octree = Octree(0.1)
    octree.insert_points([[0.0, 0.0, 2.05]], [0.05, 0.05, 0.05])
    scene = Scene.generate("room", 0)
    lengths = np.array([1e-45, 1e-25, 1e-20, 1e-3, 1.0, 1e5, 1e20, 3e38])
    # Few rays go one by one, many in lockstep.
    for times in (1, 100):
        directions = np.tile(np.array([0.0, 0.0, 1.0]) * lengths[:, None], (times, 1))
        origins = np.tile([0.05, 0.05, 0.05], (len(directions), 1))
        ranges, states = octree.cast_rays(origins, directions, 5.0, True)
        np.testing.assert_array_equal(states, 1)
        np.testing.assert_array_equal(ranges, np.float32(1.95))
        assert np.ptp(scene.cast_rays(origins + np.array([0, 0, 1.0]), directions, 9.0)) == 0
        for origin, direction in (
            ([0, 0, 0], [0, 0, 0]),
            ([0, 0, 0], [np.nan, 0, 1]),
            ([0, np.nan, 0], [0, 0, 1]),
            ([0, 0, 0], [0, 0, np.inf]),
        ):
            many = (np.tile(origin, (times * 8, 1)), np.tile(direction, (times * 8, 1)))
            ranges, states = octree.cast_rays(*many, 5.0, True)
            assert np.isnan(ranges).all() and (states == -1).all()
            assert np.isnan(scene.cast_rays(*many, 5.0)).all()


def test_a_view_gains_by_itself_what_it_gains_among_others() -> None:
    # Each view's rays span fewer voxels than a window may hold, both together more.
    octree, camera = Octree(0.025), Camera(20, 20, hfov=np.pi / 2, near=0.05, far=7.3)
    views = np.array([[0, 0, 1, 0, 0, 0, 1.0], [0, 6, 1, 0, 0, 0, 1.0]])
    octree.insert_depth(np.full((20, 20), 3.0), camera, views[0])
    alone = [octree.view_gain([view], camera)[0] for view in views]
    np.testing.assert_array_equal(octree.view_gain(views, camera), alone)


@pytest.mark.parametrize("step", [2.0**-32, 1e-20, 1e-45, 1e-10, 1e-4])
def test_too_many_rays_are_refused_and_counted_right(step: float) -> None:
    with pytest.raises(ValueError, match=r"angle_step .* gives .* rays a view, more than 4194304"):
        Octree(0.1).view_gain([[0, 0, 1, 0, 0, 0, 1.0]], Camera(32, 32, hfov=1.0, vfov=1.0), angle_step=step)


def test_an_image_that_changes_too_much_is_refused_before_anything_changed() -> None:
    octree = Octree(0.05)
    with pytest.raises(ValueError, match=r"spread over \d+ bricks of 0.4 m, more than 1048576: use a max_range"):
        octree.insert_depth(
            np.full((24, 32), np.inf), Camera(32, 24, hfov=1.0, far=66.0), [0, 0, 1, 0, 0, 0, 1.0], integration="projective"
        )
    assert octree.num_known == 0


def test_voxels_too_small_to_be_counted_are_refused() -> None:
    with pytest.raises(ValueError, match=r"resolution must lie in \[1e-4, 1e3\] m, got 1e-9"):
        Scene.generate("room", 0).visible_voxels(Camera(8, 6, hfov=1.0), [0, 0, 1, 0, 0, 0, 1.0], 1e-9)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("num_envs", lambda: make_simulator(-1, 1)),
        ("num_threads", lambda: make_simulator(1, -1)),
        ("stride", lambda: Octree(0.1).view_gain([[0, 0, 1, 0, 0, 0, 1.0]], Camera(8, 6, hfov=1.0), stride=-1)),
        ("width", lambda: Camera(-1, 6, hfov=1.0)),
        ("height", lambda: Camera(8, -1, hfov=1.0)),
        ("seed", lambda: Scene.generate("room", -1)),
    ],
)
def test_negative_whole_numbers_are_told_by_name(name: str, call: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match=rf"{name} must be a whole number from 0 to 2\^64 - 1, got -1"):
        call()


def make_simulator(num_envs: int, num_threads: int) -> Simulator:
    task = TASKS["six_directions"]
    return Simulator(Setup(**task.setup), num_envs, num_threads)
