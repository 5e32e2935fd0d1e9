"""`nbv-gym reproduce wang2019`: small real runs, the report's arithmetic by hand, what goes wrong."""

from __future__ import annotations

import json
import math
import re
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from nbv_gym.training import figures, reproduce_wang2019, wang2019_paper
from nbv_gym.training.cli import app
from nbv_gym.training.evaluate import open_env
from nbv_gym.training.illustrated_report import write_report
from nbv_gym.training.manifest import Row
from nbv_gym.training.reproduce_wang2019 import METHODS, Experiment, results_of
from nbv_gym.training.wang2019_figures import save_table, side_by_side
from nbv_gym.training.wang2019_report import findings, table_line

runner = CliRunner()
TINY = "reproduce wang2019 --quick --rooms room:38 --methods random_neighbour,infogain,oracle --seeds 2 --steps 2 --resolution 0.2".split()
KEYS = ["scene", "method", "metric", "mean", "std", "n", "paper", "paper_std"]


def run(*arguments: str) -> tuple[int, str]:
    result = runner.invoke(app, list(arguments))
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wang2019")
    code, text = run(*TINY, "--out", str(folder))
    assert code == 0, text
    return folder


def test_results_have_a_row_per_room_method_and_metric(out: Path) -> None:
    rows = json.loads((out / "results.json").read_text())
    assert [list(row) for row in rows] == [KEYS] * 9
    assert {(r["scene"], r["method"], r["metric"]) for r in rows} == {
        ("room:38", method, metric)
        for method in ("random_neighbour", "infogain", "oracle")
        for metric in ("coverage", "reconstruction_error", "planning_ms")
    }
    assert all(r["n"] == 2 and r["mean"] >= 0 and r["std"] >= 0 for r in rows)
    coverage = {r["method"]: r for r in rows if r["metric"] == "coverage"}
    assert (coverage["infogain"]["paper"], coverage["infogain"]["paper_std"]) == (0.89, 0.20)
    assert coverage["oracle"]["paper"] is None and coverage["oracle"]["paper_std"] is None
    assert coverage["oracle"]["mean"] > coverage["random_neighbour"]["mean"]
    errors = [r for r in rows if r["metric"] == "reconstruction_error"]
    assert all(0 < r["mean"] < 0.2 and r["paper"] is None for r in errors)
    episodes = json.loads((out / "episodes.json").read_text())["episodes"]
    finals = [e["curves"]["coverage"][-1] for e in episodes if e["row"]["agent"] == "infogain"]
    assert coverage["infogain"]["mean"] == pytest.approx(sum(finals) / 2)
    assert coverage["infogain"]["std"] == pytest.approx(abs(finals[0] - finals[1]) / math.sqrt(2))


def test_the_report_stands_alone(out: Path) -> None:
    page, text = (out / "report.html").read_text(), (out / "report.md").read_text()
    pictures = re.findall(r"\]\((\w+\.png)\)", text)
    assert len(pictures) == 4 and all((out / name).stat().st_size > 5000 for name in pictures)
    assert page.count('src="data:image/png;base64,') == 4
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert "| *paper, room1* | 0.49 (0.20) | 0.89 (0.20) |" in text, "the paper's best, CGain-WA, did not run"
    assert "<strong>" in page
    assert "InfoGain covers more than Random" in text
    assert "| room:38 | 25 |" in text


def test_resume_runs_nothing_twice(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (out / "results.json").read_text()

    def never(*_: Any) -> None:
        raise AssertionError("an episode ran again")

    monkeypatch.setattr("nbv_gym.training.evaluate.run_row", never)
    code, text = run(*TINY, "--out", str(out), "--resume")
    assert code == 0, text
    assert (out / "results.json").read_text() == before


def test_ctrl_c_keeps_what_was_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nbv_gym.training import evaluate

    real, calls = evaluate.run_row, []

    def interrupted(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(evaluate, "run_row", interrupted)
    code, text = run(*TINY, "--methods", "random_neighbour", "--out", str(tmp_path))
    assert code == 130
    assert "1 of 2 episodes are in" in text and "--resume" in text
    assert not (tmp_path / "results.json").exists()
    code, text = run(*TINY, "--methods", "random_neighbour", "--out", str(tmp_path), "--resume")
    assert code == 0, text
    assert len(calls) == 3, "only the row that was interrupted ran again"


def test_scenes_of_the_users_get_a_kinects_noise(tmp_path: Path) -> None:
    wall = "v {0} 0 0\nv {0} 4 0\nv {0} 4 3\nv {0} 0 3\n"
    corners = wall.format(0) + wall.format(4)
    quads = ["1 2 3 4", "5 6 7 8", "1 2 6 5", "4 3 7 8", "1 4 8 5", "2 3 7 6"]
    (tmp_path / "box.obj").write_text(corners + "".join(f"f {q}\n" for q in quads))
    out = tmp_path / "out"
    scene = str(tmp_path / "box.obj")
    tiny = "--methods random_neighbour --seeds 1 --steps 2 --resolution 0.1 --rooms none".split()
    code, text = run("reproduce", "wang2019", *tiny, "--scene", scene, "--out", str(out))
    assert code == 0, text
    rows = {r["metric"]: r for r in json.loads((out / "results.json").read_text())}
    assert rows["coverage"]["scene"] == scene
    assert rows["coverage"]["paper"] is None and rows["coverage"]["std"] is None
    episode = json.loads((out / "episodes.json").read_text())["episodes"][0]
    assert episode["row"]["task"] == "wang2019_kinect"
    assert "| box.obj | 1 | 4.0 × 4.0 × 3.1 |" in (out / "report.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--methods nobody", "there is no method nobody; known are random_neighbour"),
        ("--rooms room:38,nowhere.world", "nowhere.world"),
        ("--scene missing.world", "missing.world"),
        ("--rooms room:0-3", "room 'room:0-3' must be one scene, such as room:7"),
        ("--rooms room:1,38", "room '38' lacks its kind: write room:38"),
        ("--robot legs", "robot kind must be 'flying' or 'arm', got \"legs\""),
        ("--rooms none", "name at least one room or scene"),
        ("--resolution -1", "resolution must be finite and > 0 m, got -1"),
        ("--weights no.pt", "no.pt"),
    ],
)
def test_bad_input_is_named_before_anything_runs(arguments: str, words: str, tmp_path: Path) -> None:
    if "weights" in arguments:
        pytest.importorskip("torch", reason="the CNN needs torch")
    code, text = run("reproduce", "wang2019", "--quick", "--methods", "cnn", *arguments.split(), "--out", str(tmp_path / "out"))
    assert code == 2
    assert words in " ".join(text.split())
    assert not (tmp_path / "out").exists()


def test_the_arm_holds_the_camera_of_every_episode(tmp_path: Path) -> None:
    code, text = run(*TINY, "--methods", "random_neighbour", "--robot", "arm", "--seeds", "1", "--out", str(tmp_path))
    assert code == 0, text
    (episode,) = json.loads((tmp_path / "episodes.json").read_text())["episodes"]
    row = Row(**episode["row"])
    assert row.robot == "arm"
    env = open_env(row)
    assert env.task.setup["robot"] == {"kind": "arm", "radius": 0.1}
    env.close()
    assert "held by an arm" in (tmp_path / "report.md").read_text()


def test_markers_stand_side_by_side_where_they_would_cover_each_other() -> None:
    assert side_by_side([10.0, 11.0, 30.0, 9.0, 13.5], 3.0) == [0, 1, 0, 2, 0]


def test_every_bar_is_within_its_axis(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []
    canvas = figures.canvas

    @contextmanager
    def kept(width: float, height: float) -> Any:
        with canvas(width, height) as figure:
            yield figure
            drawn.append(figure)

    monkeypatch.setattr(figures, "canvas", kept)
    cells = {"infogain": (0.95, 0.4), "cgain_ns": (0.05, 0.2), "cnn": (0.5, math.nan)}
    save_table(tmp_path / "table.png", [("room:50", "room4", cells)], ["infogain", "cgain_ns", "cnn"])
    (axis,) = drawn[0].axes
    low, high = axis.get_ylim()
    ends = [y for container in axis.containers for bar in container[2] for segment in bar.get_segments() for _, y in segment]
    assert len(ends) == 12 and low < min(ends) < -14 and 134 < max(ends) < high


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    code, text = run(*TINY, "--out", str(tmp_path / "file" / "out"))
    assert code == 2
    assert str(tmp_path / "file") in text.replace("\n", "")


def test_an_experiment_is_all_combinations() -> None:
    pytest.importorskip("torch", reason="the CNN needs torch")
    experiment = Experiment(("room:1", "room:2"), (), METHODS, (3, 4), None, None, "")
    rows = experiment.rows()
    assert len({row.key() for row in rows}) == len(rows) == 2 * 11 * 2
    assert [row.seed for row in rows] == [3] * 22 + [4] * 22, "an interrupted run has seen every method"
    assert reproduce_wang2019.Size(5, None, None) == reproduce_wang2019.FULL


def test_the_papers_table_agrees_with_its_text() -> None:
    """Page 6: InfoGain covers 85 % on average, 86 % in synthetic rooms and 84 % in real ones; at most 10 % more by combining."""
    paper = wang2019_paper
    assert round(paper.mean_of("infogain", paper.SYNTHETIC), 2) == 0.86
    assert round(paper.mean_of("infogain", paper.REAL), 2) == 0.84
    assert round(paper.mean_of("infogain", paper.SYNTHETIC + paper.REAL), 2) == 0.85
    gains = [cells["cgain_wa"][0] - cells["infogain"][0] for cells in paper.TABLE.values()]
    assert max(gains) == pytest.approx(0.10)
    assert set(paper.ROOMS.values()) == set(paper.SYNTHETIC) and set(paper.NAMES) < set(METHODS)


def test_the_best_as_printed_are_bold_and_the_oracle_is_not() -> None:
    cells = {"infogain": (0.893, 0.1), "cgain_wa": (0.894, math.nan), "cnn": (0.2, 0.0), "oracle": (0.99, 0.0)}
    assert (
        table_line("x", cells, ["infogain", "cgain_wa", "cnn", "oracle"])
        == "| x | **0.89 (0.10)** | **0.89** | 0.20 (0.00) | 0.99 (0.00) |"
    )


def test_findings_say_what_the_figures_say() -> None:
    rooms = wang2019_paper.SYNTHETIC
    as_printed = {m: wang2019_paper.mean_of(m, rooms) for m in wang2019_paper.NAMES}
    assert not any("not hold" in text for text in findings(as_printed, rooms)), "the paper's own figures"
    assert len(findings(as_printed, rooms)) == 5
    turned = findings({"infogain": 0.3, "random_neighbour": 0.4, "cnn": 0.9, "cgain_wa": 0.2, "oracle": 1.0}, rooms)
    assert [("does not hold" in text) for text in turned] == [True, True, True, False]


def test_results_of_a_cell_that_failed_are_left_out() -> None:
    def record(scene: str, method: str, coverage: float) -> dict[str, Any]:
        row = {"scene": scene, "agent": method}
        return {
            "row": row,
            "curves": {"coverage": [0.0, coverage]},
            "reconstruction_error": None,
            "planning_ms": [900.0, 1.0, 3.0, 2.0, 2.0],
        }

    rows = results_of([record("a", "cnn", 0.5), record("b", "infogain", 0.25)])
    assert [(r["scene"], r["method"], r["metric"], r["mean"]) for r in rows] == [
        ("a", "cnn", "coverage", 0.5),
        ("a", "cnn", "planning_ms", 2.0),
        ("b", "infogain", "coverage", 0.25),
        ("b", "infogain", "planning_ms", 2.0),
    ]


def test_a_report_whose_picture_is_missing_replaces_nothing(tmp_path: Path) -> None:
    write_report(tmp_path, "old", "old")
    with pytest.raises(OSError, match="gone.png"):
        write_report(tmp_path, "new", "![x](gone.png)")
    assert (tmp_path / "report.md").read_text() == "old"
