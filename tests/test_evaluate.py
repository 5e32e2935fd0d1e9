"""Evaluation: the same result however it is run, nothing lost, failures kept apart."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from nbv_gym.agents.six_direction import WEIGHTS, CheckpointError, SixDirectionPolicy
from nbv_gym.rust_env import STAGES
from nbv_gym.training import evaluate
from nbv_gym.training.cli import app
from nbv_gym.training.evaluate import Record, run, run_row, summarise, write_results
from nbv_gym.training.manifest import Row, agent_class, grid, keys, weights_of
from nbv_gym.training.shards import ShardWriter, read_shards
from nbv_gym.training.statistics import band, estimate, t_quantile

SCENE = "tabletop:0"


def rows(agents: str = "random,greedy", seeds: int = 2, views: int = 2) -> list[Row]:
    return grid(["tabletop"], agents.split(","), [SCENE], range(seeds), views)


def digests(records: list[Record]) -> list[str]:
    return [record["digest"] for record in records]


@pytest.mark.parametrize(("freedom", "quantile"), [(1, 12.7062), (4, 2.7764), (12, 2.1788), (20, 2.0860), (100, 1.9840)])
def test_student_t(freedom: int, quantile: float) -> None:
    assert t_quantile(freedom) == pytest.approx(quantile, rel=1e-3)


def test_estimates() -> None:
    e = estimate([1.0, 2.0, 3.0])
    assert (e.mean, e.count) == (2.0, 3)
    assert e.half == pytest.approx(4.303 / 3**0.5)
    assert estimate([4.0]).text() == "4.0"
    assert estimate([]).text() == "-"


def test_curves_that_end_early_keep_their_last_value() -> None:
    mean, half = band([[1.0, 3.0], [1.0, 1.0, 1.0]])
    assert mean.tolist() == [1.0, 2.0, 2.0]
    assert half[0] == 0.0
    assert half[2] == pytest.approx(12.706 * (2**0.5) / (2**0.5))
    assert band([])[0].tolist() == []


def test_keys_name_the_configuration(tmp_path: Path) -> None:
    row = Row("tabletop", "greedy", SCENE, 0, 2)
    assert row.key() == Row("tabletop", "greedy", SCENE, 0, 2).key()
    others = [
        Row("dome_room", "greedy", SCENE, 0, 2),
        Row("tabletop", "greedy:stride=1", SCENE, 0, 2),
        Row("tabletop", "greedy", "tabletop:1", 0, 2),
        Row("tabletop", "greedy", SCENE, 1, 2),
        Row("tabletop", "greedy", SCENE, 0, 3),
        Row("tabletop", "greedy", SCENE, 0, 2, 0.05),
    ]
    assert len({row.key(), *(other.key() for other in others)}) == 7
    scene = tmp_path / "scene.obj"
    scene.write_text("v 0 0 0\n")
    before = Row("tabletop", "greedy", str(scene), 0).key()
    scene.write_text("v 0 0 1\n")
    assert Row("tabletop", "greedy", str(scene), 0).key() != before


WORLD = """<sdf version="1.6"><world name="w"><model name="m"><static>true</static><link name="l">
<visual name="v"><geometry><mesh><uri>part.obj</uri></mesh></geometry></visual></link></model></world></sdf>"""
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 {}\nf 1 2 3\n"


def test_keys_hold_what_a_world_refers_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world, part = tmp_path / "a.world", tmp_path / "part.obj"
    world.write_text(WORLD)
    rows = [Row("tabletop", agent, scene, 0) for agent in ("greedy", "random") for scene in (str(world), SCENE)]

    part.write_text(TRIANGLE.format(0))
    before = keys(rows)
    assert before == [row.key() for row in rows]
    part.write_text(TRIANGLE.format(1))
    after = keys(rows)
    assert [a != b for a, b in zip(before, after, strict=True)] == [True, False, True, False]
    part.write_text(TRIANGLE.format(0))
    assert keys(rows) == before
    world.write_text("no world")
    assert keys(rows)[1] == before[1] and len({*keys(rows), *before, *after}) == 8


def test_a_scene_of_many_rows_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = tmp_path / "part.obj"
    part.write_text(TRIANGLE.format(0))
    read: list[str] = []

    def digest(path: str) -> str:
        read.append(path)
        return "digest"

    monkeypatch.setattr("nbv_gym.training.manifest.scene_digest", digest)
    keys([Row("tabletop", "greedy", str(part), seed) for seed in range(5)])
    assert read == [str(part)]


def test_weights_are_looked_at_before_anything_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch", reason="the CNN needs torch")
    junk, out = tmp_path / "junk.pt", tmp_path / "out"
    junk.write_text("junk")
    with pytest.raises(CheckpointError, match=r"junk\.pt: not a checkpoint"):
        grid(["wang2019"], ["infogain", f"cgain_wa:weights={junk}"], [SCENE], [0], None)
    arguments = ["evaluate", "--task", "wang2019", "--agents", f"cnn:weights={tmp_path / 'none.pt'}", "--out", str(out)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 2 and "none.pt" in done.output.replace("\n", "")
    assert not out.exists()
    # Once, however many agents and scenes decide by it.
    read: list[Path] = []
    monkeypatch.setattr(SixDirectionPolicy, "load", read.append)
    grid(["wang2019"], [f"cnn:weights={junk}", f"cgain_wa:weights={junk}"], ["room:1", "room:2"], [0, 1], None)
    assert read == [junk]


def test_keys_hold_the_weights(tmp_path: Path) -> None:
    weights = tmp_path / "network.pt"

    def key(agent: str) -> str:
        return Row("wang2019", agent, "room:1", 0).key()

    weights.write_bytes(b"one network")
    before = {agent: key(agent) for agent in ("cnn", f"cnn:weights={weights}", f"cgain_wa:weights={weights}", "infogain")}
    weights.write_bytes(b"another network")
    after = {agent: key(agent) for agent in before}
    assert [after[agent] != before[agent] for agent in before] == [False, True, True, False]
    assert weights_of("cnn") == weights_of(f"cnn:weights={WEIGHTS}") == WEIGHTS


def test_agents_with_parameters() -> None:
    _, parameters = agent_class("greedy:metric=entropy:cost_weight=0.5:stride=4")
    assert parameters == {"metric": "entropy", "cost_weight": 0.5, "stride": 4}
    assert agent_class("oracle:lazy=false")[1] == {"lazy": False}
    # Paths may hold colons.
    assert agent_class("cnn:weights=C:/out/a:b.pt")[1] == {"weights": "C:/out/a:b.pt"}
    assert str(weights_of("cgain_wa:weights=12:30.pt")) == "12:30.pt"


@pytest.mark.parametrize(
    ("agent", "text"),
    [
        ("nobody", "there is no agent 'nobody'; known are random, nearest_frontier, greedy, random_neighbour, .*, oracle"),
        ("greedy:depth=2", "'depth=2' is no parameter of greedy"),
        ("greedy:stride", "'stride' is no parameter of greedy"),
        ("cnn:", "'' is no parameter of cnn"),
        ("greedy:stride=two", "'two' is not a number"),
        ("oracle:lazy=perhaps", "neither true nor false"),
        ("oracle:env=1", "'env=1' is no parameter"),
    ],
)
def test_bad_agents_are_named(agent: str, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        grid(["tabletop"], [agent], [SCENE], [0], None)


def test_bad_rows_are_named() -> None:
    with pytest.raises(ValueError, match="there is no task 'nowhere'"):
        grid(["nowhere"], ["random"], [SCENE], [0], None)
    with pytest.raises(
        ValueError, match="agent 'infogain' needs a map with a view history, task 'tabletop' has none; tasks with one: wang2019"
    ):
        grid(["tabletop"], ["infogain"], [SCENE], [0], None)
    with pytest.raises(ValueError, match=r"resolution must be finite and > 0 m, got -0\.1"):
        grid(["tabletop"], ["random"], [SCENE], [0], None, -0.1)
    with pytest.raises(FileNotFoundError, match=r"missing\.world"):
        grid(["tabletop"], ["random"], ["missing.world"], [0], None)


def test_a_record_holds_everything(tmp_path: Path) -> None:
    record = run_row(rows()[0])
    assert record["status"] == "ok"
    assert record["views"] == 2
    assert record["truncated"] and not record["terminated"]
    assert {len(curve) for curve in record["curves"].values()} == {3}
    assert len(record["actions"]) == len(record["rewards"]) == len(record["planning_ms"]) == 2
    assert len(record["viewpoints"][0]) == 7
    assert set(record["stage_ms"]) == set(STAGES)
    assert all(len(times) == 2 and min(times) >= 0 for times in record["stage_ms"].values())
    assert sum(record["stage_ms"]["integrate"]) > 0
    # Half a voxel (2 cm) off at most, and not all of them exactly on it.
    assert 0 < record["reconstruction_error"] < 0.02
    assert {"nbv-gym", "gymnasium", "numpy", "python"} <= set(record["versions"])
    assert json.loads(json.dumps(record)) == record


def test_any_number_of_processes_gives_the_same(tmp_path: Path) -> None:
    one = run(rows(), tmp_path / "one")
    two = run(rows(), tmp_path / "two", processes=2)
    assert digests(one) == digests(two)
    assert [r["row"] for r in one] == [r["row"] for r in two]
    assert len({r["digest"] for r in one}) == 4


def test_resume_runs_nothing_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run(rows(), tmp_path)

    def never(*_: Any) -> Record:
        raise AssertionError("this row is finished")

    monkeypatch.setattr(evaluate, "run_row", never)
    again = run(rows(), tmp_path, resume=True)
    assert again == first


def test_resume_goes_on_after_a_torn_line(tmp_path: Path) -> None:
    first = run(rows()[:2], tmp_path)
    shard = next(tmp_path.glob("episodes-*.jsonl"))
    whole = shard.read_text().splitlines(keepends=True)
    shard.write_text(whole[0] + whole[1][: len(whole[1]) // 2])
    assert len(list(read_shards(tmp_path))) == 1
    ran: list[Row] = []
    again = run(rows()[:2], tmp_path, resume=True, observe=lambda row: ran.append(row))  # type: ignore[func-returns-value]
    assert len(ran) == 1
    assert digests(again) == digests(first)


def test_without_resume_the_old_episodes_step_aside(tmp_path: Path) -> None:
    run(rows()[:1], tmp_path / "shards")
    run(rows()[:1], tmp_path / "shards")
    assert len(list(read_shards(tmp_path / "shards"))) == 1
    assert len(list(read_shards(tmp_path / "shards.old"))) == 1


def test_a_row_that_fails_stops_no_other(tmp_path: Path) -> None:
    broken = tmp_path / "broken.obj"
    broken.write_text("f 1 2 3\n")
    manifest = [Row("tabletop", "random", str(broken), 0, 2), *rows()[:1]]
    records = run(manifest, tmp_path / "shards")
    assert [r["status"] for r in records] == ["failed", "ok"]
    assert "broken.obj" in records[0]["error"]
    summary = write_results(tmp_path / "results.json", records)
    assert [(entry["episodes"], entry["failed"]) for entry in summary] == [(0, 1), (1, 0)]
    # A failed row is tried again.
    assert run(manifest, tmp_path / "shards", resume=True)[0]["status"] == "failed"


def test_the_summary_relates_to_the_oracle() -> None:
    records = run_all("random,oracle")
    summary = summarise(records)
    by_agent = {entry["agent"]: entry for entry in summary}
    share = by_agent["random"]["coverage_of_oracle"]
    assert by_agent["oracle"]["coverage_of_oracle"] == 1.0
    assert share == by_agent["random"]["final"]["coverage"]["mean"] / by_agent["oracle"]["final"]["coverage"]["mean"]
    assert 0.0 < share <= 1.05


def run_all(agents: str) -> list[Record]:
    return [run_row(row) for row in rows(agents)]


def test_two_writers_never_share_a_file(tmp_path: Path) -> None:
    with ShardWriter(tmp_path) as a, ShardWriter(tmp_path) as b:
        assert a.path != b.path
        a.append({"key": "a"})
        b.append({"key": "b"})
    assert [r["key"] for r in read_shards(tmp_path)] == ["a", "b"]


def command(tmp_path: Path, *more: str) -> list[str]:
    main = "from nbv_gym.training.cli import main; main()"
    arguments = "evaluate --task tabletop --agents random,greedy --seeds 4 --views 3".split()
    target = ["--scene", SCENE, "--json", str(tmp_path / "r.json")]
    return [sys.executable, "-c", main, *arguments, *target, *more]


def stop_after_first(tmp_path: Path, number: signal.Signals) -> int:
    """Start an evaluation, and signal it when the first episode is on disk."""
    process = subprocess.Popen(command(tmp_path), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not list(read_shards(tmp_path / "r.json.shards")):
        assert process.poll() is None, "it ended before it could be stopped"
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(number)
    return process.wait(timeout=60)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_kill_loses_at_most_the_episode_in_flight(tmp_path: Path) -> None:
    stop_after_first(tmp_path, signal.SIGKILL)
    kept = len(list(read_shards(tmp_path / "r.json.shards")))
    assert kept >= 1
    subprocess.run(command(tmp_path, "--resume"), check=True, capture_output=True, timeout=300)
    records = json.loads((tmp_path / "r.json").read_text())["episodes"]
    assert len(records) == 8
    expected = run(grid(["tabletop"], ["random", "greedy"], [SCENE], range(4), 3), tmp_path / "again")
    assert digests(records) == digests(expected)
    assert len(list(read_shards(tmp_path / "r.json.shards"))) == 8, "finished episodes were not run again"


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_interrupt_leaves_readable_results(tmp_path: Path) -> None:
    code = stop_after_first(tmp_path, signal.SIGINT)
    assert code in {130, 0}, "0 only if it was done before the signal arrived"
    content = json.loads((tmp_path / "r.json").read_text())
    assert 1 <= len(content["episodes"]) <= 8
    assert content["summary"]
