"""The report on the reproduction of Wang et al. 2019: which lines stand in it, and what is bold."""

from __future__ import annotations

import math

from nbv_gym.training.wang2019_paper import TABLE
from nbv_gym.training.wang2019_report import Cell, comparison, mean_lines, paper_line


def cells(**means: float) -> dict[str, Cell]:
    return {method: (mean, math.nan, 1) for method, mean in means.items()}


def test_a_section_without_findings_is_left_out() -> None:
    coverage = {"room:38": cells(cgain_rand=0.8)}
    assert comparison(coverage, ["cgain_rand"], lesser=True) == []
    coverage["room:38"] |= cells(infogain=0.8, cgain_wa=0.9)
    lines = comparison(coverage, ["infogain", "cgain_rand", "cgain_wa"], lesser=True)
    assert lines[0].startswith("## ") and any("so are its verdicts" in line for line in lines) and lines[-1] == ""
    assert not any("verdicts" in line for line in comparison(coverage, ["infogain", "cgain_wa"], lesser=False))


def test_each_kind_of_scenes_has_its_mean_beside_the_papers() -> None:
    methods = ["infogain"]
    generated = {"room:38": cells(infogain=0.8), "room:7": cells(infogain=0.6)}
    file = {"house.world": cells(infogain=0.2)}
    assert mean_lines(generated, methods) == ["| mean | **0.70** |", "| *paper, synthetic* | 0.86 |"]
    assert mean_lines(file, methods) == ["| mean | **0.20** |", "| *paper, real* | 0.84 |"]
    assert mean_lines(file | generated, methods) == [
        "| mean of generated rooms | **0.70** |",
        "| *paper, synthetic* | 0.86 |",
        "| mean of files | **0.20** |",
        "| *paper, real* | 0.84 |",
    ]
    # The verdicts, too, are of one kind each.
    ours = {"room:38": cells(infogain=0.8, random_neighbour=0.5), "house.world": cells(infogain=0.2, random_neighbour=0.5)}
    text = "\n".join(comparison(ours, ["random_neighbour", "infogain"], lesser=False))
    assert "In generated rooms:\n\n- InfoGain covers more than Random (the paper: 0.89 against 0.49): **holds here**" in text
    assert "In files:\n\n- InfoGain covers more than Random (the paper: 0.84 against 0.42): **does not hold here**" in text


def test_bold_in_the_papers_lines_is_the_papers_best_of_all() -> None:
    assert paper_line("paper, room2", TABLE["room2"], ["infogain", "cgain_watc"]) == "| *paper, room2* | 0.83 (0.10) | 0.86 (0.04) |"
    assert paper_line("paper, room2", TABLE["room2"], ["cgain_wa"]) == "| *paper, room2* | **0.87 (0.07)** |"
