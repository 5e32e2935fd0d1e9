"""The benchmark: every ratio is there or named as missing, and peers do the same work."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from nbv_gym.envs.env import NbvEnv
from nbv_gym.rust_env import Scene
from nbv_gym.training import benchmark, benchmark_cases, benchmark_peers


def never() -> object:
    raise AssertionError("not to be called")


def case(rates: dict[str, list[float]], **fields: object) -> benchmark.Case:
    made = benchmark.Case("case", "units/s", 1.0, dict.fromkeys(rates, never), **fields)  # type: ignore[arg-type]
    made.rates = rates
    return made


def test_ratio_is_the_median_of_the_rounds() -> None:
    made = case({benchmark.OURS: [10.0, 20.0, 30.0], "peer": [5.0, 5.0, 5.0]}, key="speed")
    assert benchmark.ratios([made]) == {"speed": 4.0}
    assert benchmark.ratios([case({benchmark.OURS: [1.0]}, key="speed")]) == {}


def test_overhead_is_deducted_as_time() -> None:
    # A peer that needs 2 s, 1.5 s of which are overhead, needs 0.5 s without; ours needs 0.1 s.
    made = case({benchmark.OURS: [10.0], "peer": [0.5], "overhead": [1 / 1.5]}, key="speed", overhead="overhead")
    assert benchmark.ratios([made]) == pytest.approx({"speed": 5.0, "speed_with_binding": 20.0})
    made.rates["overhead"] = [0.4]
    assert np.isfinite(made.ratio("peer"))


@pytest.mark.parametrize("peers", [True, False], ids=["with peers", "without"])
def test_every_ratio_is_measured_or_named_as_missing(peers: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def imports(self: benchmark_peers.Peers, module: str, package: str) -> None:
        self.missing[package] = f"no {module} here"

    def small(self: benchmark_cases.Cases, triangles: int) -> Scene:
        return self.scene

    def once(self: benchmark.Case, run: Callable[[benchmark.Case], None] = benchmark.Case.run) -> None:
        self.rounds = 1
        run(self)

    if not peers:
        monkeypatch.setattr(benchmark_peers.Peers, "_import", imports)
    monkeypatch.setattr(benchmark_cases.Cases, "_dense", small)
    monkeypatch.setattr(benchmark.Case, "run", once)
    file = tmp_path / "bench.json"
    console = Console(record=True, width=200, quiet=False, file=(tmp_path / "told").open("w", encoding="utf-8"))
    benchmark.bench(quick=True, json_file=file, seed=0, console=console)
    result = json.loads(file.read_text(encoding="utf-8"))

    ratios, missing = result["ratios"], result["missing"]
    assert all(np.isfinite(value) and value > 0 for value in ratios.values())
    assert set(benchmark_peers.RATIOS) == (set(ratios) & set(benchmark_peers.RATIOS)) | set(missing["ratios"])
    expected = []
    for needs, keys in benchmark_peers.NEEDS.items():
        if any(package.startswith(tuple(needs.split(" and "))) for package in missing["peers"]):
            expected += keys
    assert missing["ratios"] == sorted(expected)
    if not peers:
        assert set(missing["peers"]) == {"octomap-python", "open3d"} and ratios == {}
        assert "no open3d here" in console.export_text()
    # What is drawn from the same scene is the same.
    assert all(share < 1e-3 for share in result["depth_disagreement"].values())
    assert sum(result["stages_microseconds_per_step"].values()) > 0
    assert result["figures"]["dataset: one room, one thread"][benchmark.OURS]["unit"] == "views/s"
    # O_k and C_k take 8 bytes for each direction, and no voxel is seen from more directions than there were views. Blocks are those
    # of whole layers, so that some of a block are of voxels that were not seen.
    assert 8 < result["view_history"]["bytes_per_seen_voxel"] < 8 * 9 * result["view_history"]["views"]
    assert result["view_history"]["seen_voxels"] > 100_000
    told = (tmp_path / "told").read_text(encoding="utf-8")
    assert "bytes per seen voxel" in told and "views/s" in told


def test_the_handrolled_environment_does_the_same_work() -> None:
    for module in ("octomap", "open3d"):
        pytest.importorskip(module, exc_type=ImportError)
    from nbv_gym.training.handrolled_env import HandrolledEnv, Problem

    env = NbvEnv(benchmark_cases.TASK, scene=benchmark_cases.SCENE, success=None)
    ours, info = env.reset(seed=3)
    problem = Problem.of(env)
    start = int(env._vector.action_of(0, ours["pose"]))
    peer, lean = HandrolledEnv(problem), HandrolledEnv(problem, lean=True)
    theirs, peer_info = peer.reset(options={"view": start})
    lean.reset(options={"view": start})
    rng = np.random.default_rng(1)
    for _ in range(6):
        far_off = np.abs(theirs["depth"] - ours["depth"]) > 1e-3
        assert far_off.mean() < 1e-3
        np.testing.assert_allclose(theirs["pose"], ours["pose"], atol=1e-5)
        np.testing.assert_array_equal(theirs["visited"], ours["visited"])
        assert peer_info["known_voxels"] == pytest.approx(info["known_voxels"], abs=5)
        assert peer_info["coverage"] == pytest.approx(info["coverage"], abs=1e-3)
        action = int(rng.integers(len(problem.views)))
        ours, reward, _, _, info = env.step(action)
        theirs, peer_reward, _, _, peer_info = peer.step(action)
        assert peer_reward == pytest.approx(reward, abs=1.0)
        assert lean.step(action)[4] == peer_info
    assert info["known_voxels"] > 10_000


def test_workers_step_all_environments() -> None:
    for module in ("octomap", "open3d"):
        pytest.importorskip(module, exc_type=ImportError)
    from nbv_gym.training.handrolled_env import Problem, Workers

    env = NbvEnv(benchmark_cases.TASK, scene=benchmark_cases.SCENE, success=None)
    env.reset(seed=3)
    workers = Workers(Problem.of(env), 4, 2)
    try:
        first, second = workers.step(np.array([0, 1, 2, 3]))
    finally:
        workers.close()
    assert first[0]["depth"].shape == second[0]["depth"].shape == (2, 48, 64)
    np.testing.assert_array_equal(second[0]["visited"].argmax(axis=1), [2, 3])
    assert all(not worker.is_alive() for worker, _ in workers.workers)
