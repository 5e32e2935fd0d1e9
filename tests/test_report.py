"""The table of a comparison, as the terminal shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from nbv_gym.training.cli import app
from nbv_gym.training.report import per_planner, shortened, table
from nbv_gym.training.terminal import PIPE_WIDTH

FOLDER = "cnn:weights=/home/somebody/experiments/2024/out/cnn/fold"
AGENTS = [f"{FOLDER}0/best.pt", f"{FOLDER}1/best.pt", "infogain", "oracle"]


def entry(agent: str, coverage: float) -> dict[str, Any]:
    def interval(mean: float, half: float) -> dict[str, float]:
        return {"mean": mean, "ci95": half}

    final = {
        "coverage": interval(coverage, 0.123),
        "information": interval(12345.0, 1234.0),
        "entropy": interval(123456.0, 12345.0),
        "views": interval(131.0, 0.0),
        "path_length": interval(15.1, 3.2),
    }
    times = interval(1234.5, 100.25)
    return {"agent": agent, "episodes": 5, "failed": 0, "coverage_of_oracle": 0.5, "planning_ms": times, "final": final}


def drawn(width: int) -> list[str]:
    console = Console(width=width)
    with console.capture() as capture:
        console.print(table([entry(agent, 0.1 + 0.2 * i) for i, agent in enumerate(AGENTS)], "title"))
    return capture.get().splitlines()


def test_names_give_way_to_numbers() -> None:
    _, _, *lines = drawn(PIPE_WIDTH)
    assert len(lines) == 4
    for line in lines:
        assert line.endswith("50 %  12,345 ± 1,234  123.5 ± 12.3  131.0 ± 0.0  15.1 ± 3.2  1,234.5 ± 100.2 ")
    names = [line[:22].strip() for line in lines]
    assert len(set(names)) == 4 and names[0] == "infogain" and names[1].startswith("cnn") and names[1].endswith("1/best.pt)")


@pytest.mark.parametrize("width", [80, 100])
def test_nothing_is_lost_where_it_is_narrow(width: int) -> None:
    text = "".join("".join(drawn(width)).split())
    for digits in ("12,345", "123.5", "131.0", "1,234.5"):
        assert text.count(digits) == 4
    assert max(map(len, drawn(width))) <= width


def test_what_is_cut_stays_distinct() -> None:
    assert shortened("abcdefgh", ["abcdefgh"], 5) == "ab…gh"
    assert shortened("short", ["short", "longer than that"], 5) == "short"
    # They differ where the middle is.
    names = ["weights/a-long-name/1/and-an-end", "weights/a-long-name/2/and-an-end"]
    cut = [shortened(name, names, 24) for name in names]
    assert len(set(cut)) == 2 and all(len(name) == 24 and "…" in name for name in cut)
    assert shortened(names[0], names, 2) == names[0], "too narrow to tell them apart"


def test_one_episode_is_singular(tmp_path: Path) -> None:
    arguments = f"evaluate --task tabletop --scene tabletop:0 --agents random --seeds 1 --views 1 --json {tmp_path}/results.json"
    assert "tabletop in tabletop:0: 1 episode per planner" in " ".join(CliRunner().invoke(app, arguments.split()).output.split())
    assert per_planner(2) == "2 episodes per planner"
