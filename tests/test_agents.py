"""Agents: what they choose, on small beliefs made for the purpose and on the real core."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nbv_gym.agents import AGENTS, Agent, GreedyGain, NearestFrontier, RandomView, StepRecord, rollout
from nbv_gym.agents.agent import admissible, visits
from nbv_gym.agents.wang2019 import LEARNT
from nbv_gym.envs.env import NbvEnv
from nbv_gym.envs.suite import TASKS
from nbv_gym.rust_env import METRICS, Camera
from nbv_gym.training.manifest import make_agent

LEVEL = (-0.5, 0.5, -0.5, 0.5)  # looks along +x
BACK = (0.5, 0.5, -0.5, -0.5)  # looks along -x


class EmptyMap:
    """Rays meet nothing."""

    def cast_rays(self, origins: Any, directions: Any, max_range: float, ignore_unknown: bool = False) -> Any:
        return np.full(len(origins), np.inf, np.float32), np.zeros(len(origins), np.int8)


class SmallBelief:
    """Candidates in a row along x, looking along +x unless said otherwise."""

    resolution = 0.1
    camera = Camera(64, 48, hfov=1.0, near=0.05, far=4.0)
    octree = EmptyMap()

    def __init__(self, xs: list[float], gains: list[float] | None = None, turns: list[Any] | None = None) -> None:
        turns = turns or [LEVEL] * len(xs)
        self.candidates = np.array([[x, 0, 0, *q] for x, q in zip(xs, turns, strict=True)], np.float32)
        self.candidate_mask = np.ones(len(xs), bool)
        self.visited = np.zeros(len(xs), np.uint16)
        self.pose = np.array([0, 0, 0, *LEVEL], np.float32)
        self.trajectory = self.pose[None]
        self.gains = np.array(gains or [0.0] * len(xs))
        self.points = np.zeros((0, 3), np.float32)

    def view_gain(self, poses: NDArray[Any], metric: str, stride: int = 1) -> NDArray[np.float64]:
        numbers = [int(np.flatnonzero((self.candidates == p).all(axis=1))[0]) for p in poses]
        return self.gains[numbers]

    def travel_cost(self, poses: NDArray[Any]) -> NDArray[np.float32]:
        return np.linalg.norm(poses[:, :3] - self.pose[:3], axis=1).astype(np.float32)

    def frontiers(self) -> NDArray[np.float32]:
        return self.points

    def go(self, view: NDArray[np.float32]) -> None:
        self.pose = view
        self.trajectory = np.vstack([self.trajectory, view])


def chosen(agent: Any, belief: Any) -> int:
    view = agent.next_view(belief)
    return int(np.flatnonzero((belief.candidates == view).all(axis=1))[0])


def test_greedy_takes_the_largest_gain_and_the_first_of_equals() -> None:
    assert chosen(GreedyGain(), SmallBelief([1, 2, 3, 4], [1, 5, 5, 2])) == 1


def test_greedy_leaves_out_what_the_belief_forbids() -> None:
    belief = SmallBelief([1, 2, 3], [1, 5, 3])
    belief.candidate_mask[1] = False
    assert chosen(GreedyGain(), belief) == 2
    belief.candidate_mask[:] = False
    assert chosen(GreedyGain(), belief) == 1, "boxed in: any candidate is better than none"


def test_greedy_weighs_travel() -> None:
    belief = SmallBelief([1, 3], [1.0, 2.0])
    # 2 exp(-3 w) < exp(-w) for w > ln(2) / 2.
    assert chosen(GreedyGain(cost_weight=0.34), belief) == 1
    assert chosen(GreedyGain(cost_weight=0.36), belief) == 0


def test_greedy_without_any_gain_takes_the_least_visited() -> None:
    belief = SmallBelief([0, 1, 2])
    assert visits(belief).tolist() == [1, 0, 0]
    assert chosen(GreedyGain(), belief) == 1
    belief.go(belief.candidates[1])
    assert chosen(GreedyGain(), belief) == 2


def test_what_touch_taught_is_in_the_mask() -> None:
    """Nothing behind what stopped the robot (60 degrees) and nearer to the goal than it ever came is admissible, unless there is
    nothing else."""
    env, barred_ones, rng = NbvEnv("six_directions", scene="room:3"), 0, np.random.default_rng(0)
    env.reset(seed=2)
    missed: list[tuple[NDArray[np.float32], NDArray[np.float32], float]] = []
    for _ in range(env.budget):
        # Mostly ahead, so that something comes in the way.
        goal = env.belief.candidates[action := int(rng.choice([2, 2, 2, 4, 5]))][:3]
        env.step(action)
        belief, tolerance = env.belief, env.belief.resolution / 2
        here = belief.pose[:3]
        goals = [*missed, (goal, here, np.inf)]
        missed = [(g, stopped, min(nearest, float(np.linalg.norm(g - here)))) for g, stopped, nearest in goals]
        missed = [m for m in missed if m[2] > tolerance]
        barred = np.zeros(6, bool)
        for bad, stopped, nearest in missed:
            way, others = bad - stopped, belief.candidates[:, :3] - stopped
            cosine = others @ way / np.maximum(np.linalg.norm(way) * np.linalg.norm(others, axis=1), 1e-9)
            barred |= (np.linalg.norm(belief.candidates[:, :3] - bad, axis=1) < nearest - 1e-4) & (cosine > 0.5 + 1e-4)
        mask = belief.candidate_mask
        assert not (mask & barred).any() or not mask[~barred].any()
        barred_ones += int(barred.sum())
    assert missed and barred_ones > 0


@pytest.mark.parametrize("robot", ["flying", "arm"])
def test_a_planner_gets_past_what_it_cannot_see(robot: str, tmp_path: Path) -> None:
    """A scaffold whose posts stand nearer to the dome than the camera measures: what stops the robot is not in its map."""
    scene = tmp_path / "scaffold.obj"
    scene.write_text(scaffold())
    task = TASKS["wang2019"]
    env = NbvEnv(task.variant(scene=str(scene), resolution=0.1, robot={**task.setup["robot"], "kind": robot}))
    agent = make_agent("infogain", env, 1)
    steps = rollout(env, agent, 1)
    places = np.array([step.viewpoint[:3] for step in steps])
    still = int((np.linalg.norm(np.diff(places, axis=0), axis=1) < 1e-3).sum())
    contacts = sum(step.metrics["contact"] for step in steps)
    assert contacts > 0, "nothing stopped it"
    # Before, it stood still for 114 of 130 steps: it barred all of the dome, and took views far away for its neighbours.
    assert still < 65, f"{still} of {len(steps) - 1} steps without a way"
    assert len(np.unique(places.round(3), axis=0)) > 50


def scaffold() -> str:
    """A hall of 4.8 x 3.6 x 2.5 m with posts of 4 cm, 64 cm apart, around its middle, and chests along the walls."""
    lines: list[str] = []

    def box(low: tuple[float, ...], high: tuple[float, ...]) -> None:
        first = sum(line.startswith("v") for line in lines) + 1
        corners = [[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)]
        faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
        lines.extend("v {:g} {:g} {:g}".format(*corner) for corner in corners)
        lines.extend("f {} {} {} {}".format(*(first + i for i in face)) for face in faces)

    box((0, 0, 0), (4.8, 3.6, 2.5))
    for i, j in np.ndindex(8, 6):
        x, y = 2.82 + 0.64 * (i - 4), 2.07 + 0.64 * (j - 3)
        box((x - 0.02, y - 0.02, 0), (x + 0.02, y + 0.02, 2.5))
    box((0.05, 0.5, 0), (0.25, 1.5, 1.9))
    box((1.0, 3.35, 0), (2.2, 3.55, 1.0))
    box((4.5, 1.0, 0), (4.75, 2.5, 1.4))
    box((2.5, 0.05, 0), (3.9, 0.25, 0.8))
    box((0.7, 1.0, 0), (1.1, 1.4, 0.5))
    box((3.1, 2.2, 0), (3.5, 2.6, 0.6))
    return "\n".join(lines) + "\n"


def test_nearest_frontier_takes_the_nearest_that_looks_at_it() -> None:
    belief = SmallBelief([0.5, 1.0, 1.5], turns=[BACK, LEVEL, LEVEL])
    belief.points = np.array([[3.0, y, z] for y in (-0.1, 0, 0.1) for z in (-0.1, 0, 0.1)], np.float32)
    # The nearest candidate looks the other way.
    assert chosen(NearestFrontier(), belief) == 1


def test_nearest_frontier_needs_a_good_deal_of_frontier() -> None:
    belief = SmallBelief([0.5, 1.0], turns=[BACK, LEVEL])
    ahead = [[3.0, y, 0] for y in np.linspace(-0.1, 0.1, 9)]
    belief.points = np.array([*ahead, [-1.0, 0, 0], [-1.0, 0.01, 0]], np.float32)
    assert chosen(NearestFrontier(share=0.5), belief) == 1
    assert chosen(NearestFrontier(share=0.2), belief) == 0


def test_nearest_frontier_leaves_views_out_that_were_taken() -> None:
    belief = SmallBelief([0.0, 1.0])
    belief.points = np.array([[2.0, 0, 0]], np.float32)
    assert chosen(NearestFrontier(), belief) == 1


def test_nearest_frontier_without_frontiers_goes_on() -> None:
    assert chosen(NearestFrontier(), SmallBelief([2.0, 1.0])) == 1


def test_random_views_do_not_repeat_and_follow_their_seed() -> None:
    belief, agent = SmallBelief([1, 2, 3, 4, 5]), RandomView(seed=3)
    agent.reset(belief)
    order = []
    for _ in range(5):
        order.append(chosen(agent, belief))
        belief.visited[order[-1]] += 1
    assert sorted(order) == [0, 1, 2, 3, 4]
    belief.visited[:] = 0
    agent.reset(belief)
    assert chosen(agent, belief) == order[0]
    others = {chosen(RandomView(seed=s), belief) for s in range(20)}
    assert len(others) > 1


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: GreedyGain(cost_weight=-1), "cost_weight must be >= 0"),
        (lambda: GreedyGain(cost_weight=float("nan")), "cost_weight must be >= 0"),
        (lambda: NearestFrontier(share=0), "share must lie in"),
        (lambda: NearestFrontier(focus=2), "focus must lie in"),
    ],
)
def test_bad_parameters_are_named(make: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        make()


@pytest.fixture(scope="module")
def env() -> NbvEnv:
    # With a view history, which some agents need.
    return NbvEnv("tabletop", scene="tabletop:0", map={"resolution": 0.02, "view_history": True}, budget=4, success=None)


@pytest.mark.parametrize("name", [*AGENTS, "oracle"])
def test_agents_run_and_repeat(env: NbvEnv, name: str) -> None:
    if name in LEARNT:
        pytest.importorskip("torch", reason="the CNN needs torch")

    def run() -> list[StepRecord]:
        agent = make_agent(name, env, seed=5)
        assert isinstance(agent, Agent)
        return rollout(env, agent, seed=1)

    records, again = run(), run()
    assert len(records) == 5
    assert records[0].action is None
    assert records[-1].truncated
    for a, b in zip(records, again, strict=True):
        assert a.viewpoint.shape == (7,)
        assert a.viewpoint.dtype == np.float32
        assert set(a.metrics) == set(METRICS)
        assert np.array_equal(a.viewpoint, b.viewpoint)
        assert a.metrics == b.metrics
        assert a.action == b.action
    assert records[-1].metrics["coverage"] > records[0].metrics["coverage"]


def test_greedy_is_the_argmax_on_the_real_core(env: NbvEnv) -> None:
    env.reset(seed=2)
    belief = env.belief
    agent = GreedyGain("entropy", stride=3)
    agent.reset(belief)
    gains = belief.view_gain(belief.candidates, "entropy", stride=3)
    allowed = admissible(belief)
    assert chosen(agent, belief) == allowed[np.argmax(gains[allowed])]


def test_an_unknown_metric_is_an_error(env: NbvEnv) -> None:
    env.reset(seed=2)
    with pytest.raises(ValueError, match="no_such_gain"):
        GreedyGain("no_such_gain").next_view(env.belief)


def test_the_observer_sees_every_record(env: NbvEnv) -> None:
    seen: list[StepRecord] = []
    records = rollout(env, RandomView(), seed=0, observer=lambda _, record: seen.append(record))
    assert seen == records
