"""Wang 2019: the view history through the door, the strategies by hand, the policies at work."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from nbv_gym.agents import rollout
from nbv_gym.agents import wang2019 as w
from nbv_gym.envs.env import NbvEnv
from nbv_gym.envs.suite import TASKS
from nbv_gym.rust_env import Camera, Octree


def decision(t: int, gains: list[float], differ: list[bool]) -> w.Decision:
    return w.Decision(t, lambda: np.array([0.2, 0.8]), lambda: np.array([1.0, 0.0]), gains, differ)


def test_strategies_are_the_equations() -> None:
    falling, steady = [0.9, 0.8, 0.7], [0.9, 0.9, 0.8]
    gain, hint = [0.2, 0.8], [1.0, 0.0]
    assert w.naive_switching(decision(10, [], [])).tolist() == hint
    assert w.naive_switching(decision(11, [], [])).tolist() == gain
    np.testing.assert_allclose(w.weighted_average(decision(1, [], [])), hint)
    np.testing.assert_allclose(w.weighted_average(decision(4, [], [])), [0.75 * 0.2 + 0.25, 0.75 * 0.8])
    assert w.temporal_conditioning(decision(9, falling, [True] * 3)).tolist() == hint
    assert w.temporal_conditioning(decision(9, steady, [True] * 3)).tolist() == gain
    assert w.temporal_conditioning(decision(9, falling, [True, False, True])).tolist() == gain
    assert w.temporal_conditioning(decision(2, falling[:2], [True] * 2)).tolist() == gain, "the window is not full"
    np.testing.assert_allclose(w.weighted_average_then_conditioning(decision(10, falling, [True] * 3)), [0.28, 0.72])
    assert w.weighted_average_then_conditioning(decision(11, falling, [True] * 3)).tolist() == hint


def test_agreement_is_equation_6() -> None:
    # The camera looks along world +x: right is -y, down is -z.
    pose = np.array([1, 2, 3, 0.5, -0.5, 0.5, -0.5], np.float32)
    views = np.repeat(pose[None], 4, axis=0)
    views[0, 0] += 0.3
    views[1, 0] -= 0.3
    views[2, 2] += 0.3
    forward, up = np.array([0, 0, 1.0]), np.array([0, -1.0, 0])
    np.testing.assert_allclose(w.agreement(pose, views, forward), [1, 0, 0.5, 0.5], atol=1e-6)
    np.testing.assert_allclose(w.agreement(pose, views, up), [0.5, 0.5, 1, 0.5], atol=1e-6)


def test_the_history_of_a_map() -> None:
    octree = Octree(0.1, view_history=True)
    octree.insert_points([[1.05, 0.05, 0.05]], [0.05, 0.05, 0.05])
    camera = Camera(8, 8, hfov=0.8, near=0.0, far=4.0)
    pose = [0.05, 0.05, 0.05, 0.5, -0.5, 0.5, -0.5]
    octree.record_view(camera, pose)
    probability, confidence = octree.view_history([[1.05, 0.05, 0.05], [9.0, 9.0, 9.0]])
    assert probability.shape == confidence.shape == (2, 36, 18)
    seen = np.argwhere(~np.isnan(probability[0]))
    assert seen.tolist() == [[18, 9]], "the sensor is seen towards -x, level"
    p = probability[0, 18, 9]
    assert p == pytest.approx(0.7, abs=1e-6)
    assert confidence[0, 18, 9] == pytest.approx(1 + p * math.log2(p) + (1 - p) * math.log2(1 - p), abs=1e-5)
    assert np.isnan(probability[1]).all() and not confidence[1].any()
    with pytest.raises(ValueError, match="view history"):
        Octree(0.1).view_history([[0, 0, 0]])
    with pytest.raises(ValueError, match="view history"):
        Octree(0.1).view_gain([pose], camera, metric="view_history")
    with pytest.raises(ValueError, match="not by both"):
        octree.view_gain([pose], camera, stride=2, angle_step=0.1)


@pytest.fixture(scope="module")
def env() -> NbvEnv:
    task = TASKS["dome_room"].variant(scene="room:7", map={"resolution": 0.1, "view_history": True}, success=None, budget=6)
    return NbvEnv(task)


def test_the_policies_that_ask_for_history_and_network_are_named() -> None:
    pytest.importorskip("torch", reason="the CNN needs torch")
    made = {name: make() for name, make in w.POLICIES.items()}
    assert {n for n, agent in made.items() if getattr(agent, "metric", None) == "view_history"} == w.NEED_VIEW_HISTORY
    assert {n for n, agent in made.items() if getattr(agent, "direction", None) == "cnn"} == w.LEARNT


@pytest.mark.parametrize("name", w.POLICIES)
def test_policies_go_to_neighbours(env: NbvEnv, name: str) -> None:
    if name in w.LEARNT:
        pytest.importorskip("torch", reason="the CNN needs torch")
    allowed: list[set[int]] = []

    def watch(env: NbvEnv, record: object) -> None:
        allowed.append(set(w.neighbours(env.belief).tolist()))

    records = rollout(env, w.POLICIES[name](), seed=3, observer=watch)
    again = rollout(env, w.POLICIES[name](), seed=3)
    assert [r.action for r in records] == [r.action for r in again], "the same seed, the same views"
    for record, near in zip(records[1:], allowed, strict=False):
        assert int(record.action) in near
        assert len(near) <= 8
    assert records[-1].metrics["known_voxels"] > records[0].metrics["known_voxels"]


class Counting:
    """A belief that counts how often it is asked for gains."""

    def __init__(self, belief: Any) -> None:
        self.belief, self.asked = belief, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.belief, name)

    def view_gain(self, *arguments: Any, **more: Any) -> Any:
        self.asked += 1
        return self.belief.view_gain(*arguments, **more)


@pytest.mark.parametrize("strategy", [w.naive_switching, w.weighted_average, w.temporal_conditioning, w.weighted_average_then_conditioning])
def test_only_what_a_strategy_reads_is_computed(env: NbvEnv, strategy: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the choices are those of a policy that always computes both."""
    monkeypatch.setattr(w, "TAU", 2)
    belief = Counting(None)
    hints: list[int] = []
    agreement = w.agreement

    def counted(*arguments: Any) -> w.Scores:
        hints.append(1)
        return agreement(*arguments)

    monkeypatch.setattr(w, "agreement", counted)

    def choices() -> tuple[list[list[float]], int, int]:
        agent = w.Wang2019(strategy, "view_history", "random", seed=4)
        # By the step, so that policies that read u_h at different steps can be compared.
        agent._suggestion = lambda belief: w.DIRECTIONS[agent._t % 6]  # type: ignore[method-assign]
        belief.asked = 0
        hints.clear()
        env.reset(seed=2)
        agent.reset(env.belief)
        chosen = []
        for _ in range(5):
            belief.belief = env.belief
            chosen.append(agent.next_view(belief).tolist())  # type: ignore[arg-type]
            env.step(int(np.argmin(np.abs(env.belief.candidates - chosen[-1]).sum(axis=1))))
        return chosen, belief.asked, len(hints)

    chosen, gains, asked = choices()
    assert (gains, asked) == ((3, 2) if strategy is w.naive_switching else (5, 5))
    monkeypatch.setattr(w, "LOOK_BACK", (strategy,))
    assert choices() == (chosen, 5, 5)


def test_the_history_goes_with_snapshots(env: NbvEnv) -> None:
    env.reset(seed=5)
    env.step(int(env.belief.neighbours()[0]))
    copy = env.clone()
    views = env.belief.candidates[:20]
    expected = env.belief.view_gain(views, "view_history", angle_step=0.05)
    np.testing.assert_array_equal(copy.belief.view_gain(views, "view_history", angle_step=0.05), expected)
    action = int(env.belief.neighbours()[1])
    env.step(action)
    copy.step(action)
    np.testing.assert_array_equal(
        copy.belief.view_gain(views, "view_history", angle_step=0.05), env.belief.view_gain(views, "view_history", angle_step=0.05)
    )
    assert env.belief.depth.shape == (env.belief.camera.height, env.belief.camera.width)


def test_the_dome_of_the_task_keeps_80_percent_between_neighbours() -> None:
    """By angle, in both directions of the grid."""
    setup = TASKS["wang2019"].setup
    camera, dome = setup["camera"], setup["views"]
    assert dome["rings"] * dome["per_ring"] == 672
    heading = 2 * math.pi / dome["per_ring"]
    pitch = (dome["max_pitch"] - dome["min_pitch"]) / (dome["rings"] - 1)
    assert 0.80 <= 1 - heading / camera.hfov < 0.82
    assert 0.80 <= 1 - pitch / camera.vfov < 0.82
    assert TASKS["wang2019_kinect"].setup == {**setup, "noise": "kinect_v1"}
