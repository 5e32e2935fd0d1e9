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
        # Clamps nearer than a first hit or miss.
        {"map": {"resolution": 0.15, "hit": 0.9, "miss": 0.1, "clamp_max": 0.7}},
        {"map": {"resolution": 0.15, "miss": 0.05, "clamp_min": 0.4}},
        {"map": {"resolution": 0.2, "integration": "discretized"}},
        {"map": {"resolution": 0.2, "integration": "projective"}},
    ],
    ids=["sight", "images", "arm", "losses", "clamped hits", "clamped misses", "discretized", "projective"],
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
    if changes.get("map", {}).get("hit") == 0.6:
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


@pytest.mark.parametrize(("room", "radius"), [(1, 1.2), (5, 2.0), (6, 2.0)])
def test_so_it_does_where_contacts_stop_the_robot(room: int, radius: float) -> None:
    env = dome(scene=f"room:{room}", views={**DOME, "radius": radius}, budget=14)
    runs = [rollout(env, Oracle(env, lazy=flag), seed=1) for flag in (True, False)]
    chosen = [[step.action for step in run] for run in runs]
    assert chosen[0] == chosen[1]
    env.reset(seed=1)
    assert np.asarray(env.simulator.true_contact(0, env.belief.candidates)).any(), "nothing stopped it"


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


def test_contacts_are_foreseen() -> None:
    env = dome(scene="room:5", views={**DOME, "radius": 2.0})
    env.reset(seed=1)
    rng, seen = np.random.default_rng(0), {True: 0, False: 0}
    for _ in range(25):
        action = int(rng.integers(len(env.belief.candidates)))
        expected = bool(env.simulator.true_contact(0, env.belief.candidates[[action]])[0])
        assert bool(env.step(action)[4]["contact"]) == expected
        seen[expected] += 1
    assert min(seen.values()) > 0, seen


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
