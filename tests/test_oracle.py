"""The oracle: what it foresees happens, and being lazy changes no choice where gains are known beforehand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nbv_gym.agents import AGENTS, rollout
from nbv_gym.agents.agent import admissible, visits
from nbv_gym.envs.env import NbvEnv
from nbv_gym.training.oracle import SURFACE, Oracle
from nbv_gym.training.surface_ledger import SurfaceLedger

#: A small dome; voxels so large that views share most of them and gains are often equal.
DOME = {"kind": "dome", "rings": 3, "per_ring": 8, "radius": 0.6}


def dome(**changes: Any) -> NbvEnv:
    return NbvEnv("dome_room", **{"scene": "room:4", "resolution": 0.2, "views": DOME, "budget": 40, "success": None, **changes})


@pytest.fixture(scope="module")
def tabletop() -> NbvEnv:
    return NbvEnv("tabletop", scene="tabletop:0", budget=4, success=None)


class Counting(Oracle):
    """Counts the steps that it simulates."""

    simulated = 0

    def true_gain(self, views: NDArray[np.float32]) -> NDArray[np.float64]:
        self.simulated += len(views)
        return super().true_gain(views)


def test_the_oracle_foresees_what_a_step_gives(tabletop: NbvEnv) -> None:
    tabletop.reset(seed=3)
    oracle = Oracle(tabletop)
    views = tabletop.belief.candidates[[2, 7, 11]]
    promised = oracle.true_gain(views)
    assert tabletop.belief.visited.sum() == 0, "nothing moved"
    _, _, _, _, info = tabletop.step(tabletop.action_of(views[1]))
    assert info[SURFACE] == promised[1]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"truth": "images", "map": {"resolution": 0.1, "view_history": True}},
        {"robot": {"kind": "arm"}},
        # A miss outweighs a hit and its half: surfaces that rays graze are lost again and again.
        {"map": {"resolution": 0.15, "hit": 0.6, "miss": 0.2, "max_range": 2.5}},
        {"map": {"resolution": 0.2, "integration": "discretized"}},
        {"map": {"resolution": 0.2, "integration": "projective"}},
    ],
    ids=["sight", "images", "arm", "losses", "discretized", "projective"],
)
def test_the_ledger_knows_the_gain_of_every_simulated_step(changes: dict[str, Any]) -> None:
    env = dome(**changes)
    env.reset(seed=1)
    ledger, oracle, rng = SurfaceLedger(env), Oracle(env), np.random.default_rng(0)
    fell = 0
    for _ in range(12):
        expected = oracle.true_gain(env.belief.candidates)
        allowed = admissible(env.belief)
        np.testing.assert_array_equal(ledger.gains(env.belief)[allowed], expected[allowed])
        fell += int((expected[allowed] < 0).sum())
        env.step(int(rng.choice(allowed)))
    if "hit" in changes.get("map", {}):
        assert fell > 0, "no voxel was lost: this map was to test losses"


@pytest.mark.parametrize("changes", [{}, {"robot": {"kind": "arm"}}, {"resolution": 0.4}], ids=["flying", "arm", "coarse"])
def test_a_lazy_oracle_chooses_as_the_full_one(changes: dict[str, Any]) -> None:
    env = dome(**changes)
    lazy, full = Counting(env), Counting(env, lazy=False)
    chosen = [[step.action for step in rollout(env, oracle, seed=4)] for oracle in (lazy, full)]
    assert chosen[0] == chosen[1]
    assert len(chosen[0]) == 41
    # One simulated step confirms a choice; where nothing is to be gained there is nothing to confirm.
    assert lazy.simulated < 40 < full.simulated


def test_of_equal_gains_the_first_candidate_wins_and_of_none_the_least_visited() -> None:
    env = dome(resolution=0.4)
    env.reset(seed=2)
    oracle = Oracle(env)
    oracle.reset(env.belief)
    ties = idle = 0
    for _ in range(30):
        belief, allowed = env.belief, admissible(env.belief)
        gains = oracle.true_gain(belief.candidates)[allowed]
        counts = visits(belief)[allowed]
        best = allowed[gains.argmax()] if gains.max() > 0 else allowed[counts.argmin()]
        ties += int(gains.max() > 0 and (gains == gains.max()).sum() > 1)
        idle += int(gains.max() <= 0)
        action = env.action_of(oracle.next_view(belief))
        assert action == best
        env.step(action)
    assert ties > 0 and idle > 0, "neither was tested"


def test_what_stops_the_robot_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    # The view that promises most is never reached: a simulated step finds it out, and the next best is taken.
    env = dome()
    env.reset(seed=1)
    oracle = Oracle(env)
    oracle.reset(env.belief)
    candidates = env.belief.candidates
    promised = oracle.true_gain(candidates)
    first, second = admissible(env.belief)[np.argsort(-promised[admissible(env.belief)], kind="stable")[:2]]

    def stopped(self: Oracle, views: NDArray[np.float32]) -> NDArray[np.float64]:
        return np.array([0.0 if (view == candidates[first]).all() else promised[(candidates == view).all(axis=1)][0] for view in views])

    monkeypatch.setattr(Oracle, "true_gain", stopped)
    np.testing.assert_array_equal(oracle.next_view(env.belief), candidates[second])


@pytest.mark.parametrize(
    ("changes", "metric"),
    [({"noise": "kinect_v1"}, SURFACE), ({"bodies": {"walkers": 1}}, SURFACE), ({}, "information_gain_bits")],
    ids=["noise", "bodies", "another metric"],
)
def test_where_gains_are_not_known_beforehand_a_lazy_oracle_is_nearly_the_full_one(changes: dict[str, Any], metric: str) -> None:
    env = dome(budget=10, **changes)
    lazy, full = (Counting(env, metric=metric, lazy=flag) for flag in (True, False))
    runs = [rollout(env, oracle, seed=4) for oracle in (lazy, full)]
    assert runs[0][1].action == runs[1][1].action
    assert runs[0][-1].metrics["coverage"] == pytest.approx(runs[1][-1].metrics["coverage"], abs=0.02)
    assert lazy.simulated < full.simulated


def test_views_that_move_with_the_robot_are_all_simulated() -> None:
    env = NbvEnv("six_directions", scene="room:4", resolution=0.2, budget=3)
    oracle = Counting(env)
    rollout(env, oracle, seed=4)
    assert oracle.simulated > 3


def test_the_oracle_is_no_agent_of_the_list(tabletop: NbvEnv) -> None:
    assert Oracle not in AGENTS.values()
    with pytest.raises(ValueError, match="must be one of"):
        Oracle(tabletop, metric="no_such_metric")
