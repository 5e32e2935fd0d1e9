"""The report on the reproduction of Wang et al. 2019: tables, findings, pictures, the paper's figures beside ours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..rust_env import SCENE_KINDS
from .evaluate import Record, versions
from .manifest import ORACLE
from .scene_commands import open_scene
from .wang2019_figures import method_of, name_of, save_coverage, save_dome, save_table, save_times
from .wang2019_paper import ERROR, NAMES, PLANNING_MS, REAL, ROOMS, STEPS, SYNTHETIC, TABLE, VOXEL, mean_of

#: Fig. 6 shows these methods.
SHOWN = ("random_neighbour", "infogain", "cgain_wa")
#: What is nearer together than this counts as equal in the findings.
TOLERANCE = 0.01

#: mean, standard deviation (NaN for one run), runs
Cell = tuple[float, float, int]
Results = Sequence[dict[str, Any]]


def cells_of(results: Results, metric: str) -> dict[str, dict[str, Cell]]:
    """The figures of one metric by scene and method."""
    table: dict[str, dict[str, Cell]] = {}
    for row in results:
        if row["metric"] == metric:
            deviation = math.nan if row["std"] is None else row["std"]
            table.setdefault(row["scene"], {})[row["method"]] = (row["mean"], deviation, row["n"])
    return table


def draw(out: Path, records: Sequence[Record], results: Results, methods: Sequence[str]) -> dict[str, str]:
    """Write the pictures into `out`; returns their captions by file name, in the order of the report."""
    coverage = cells_of(results, "coverage")
    paper = paper_rooms(list(coverage))
    save_table(out / "coverage_at_the_end.png", [(Path(s).name, ROOMS.get(s), strip(c)) for s, c in coverage.items()], methods)
    save_coverage(out / "coverage.png", records, methods, paper)
    timed = save_times(out / "times.png", records, methods)
    last = list(coverage)[-1]
    there = [m for m in methods if m in coverage[last]]
    shown = [m for m in SHOWN if m in there] or there[:3]
    save_dome(out / "dome.png", [next(r for r in records if r["row"]["scene"] == last and method_of(r) == m) for m in shown])
    return {
        "coverage_at_the_end.png": "As Table I: coverage at the end, by room.",
        "coverage.png": "As Fig. 7 (a): coverage over steps, mean over all rooms and runs.",
        "times.png": f"As Fig. 7 (b): time per step and stage of {timed}, median over all rooms and runs.",
        "dome.png": f"As Fig. 6: selected poses on the dome and reconstruction in {Path(last).name}, first run.",
    }


def paper_rooms(scenes: Sequence[str]) -> tuple[str, ...]:
    """The paper's rooms whose figures belong beside those of our scenes: the ones that these stand for, and its real rooms for
    scenes of the user's."""
    real = REAL if any(is_file(scene) for scene in scenes) else ()
    return tuple(ROOMS[scene] for scene in scenes if scene in ROOMS) + real or SYNTHETIC


def by_kind(scenes: Sequence[str]) -> dict[str, list[str]]:
    """Generated scenes and files, whichever there are: the paper has synthetic rooms and real ones."""
    kinds = {"generated rooms": [s for s in scenes if not is_file(s)], "files": [s for s in scenes if is_file(s)]}
    return {kind: there for kind, there in kinds.items() if there}


def is_file(scene: str) -> bool:
    return scene.split(":")[0] not in SCENE_KINDS


def strip(cells: dict[str, Cell]) -> dict[str, tuple[float, float]]:
    return {method: (mean, deviation) for method, (mean, deviation, _) in cells.items()}


def weights(records: Sequence[Record]) -> str:
    """Which networks decided, if any did."""
    used = sorted({r["weights_sha256"][:12] for r in records if "weights_sha256" in r})
    return f" Weights of the CNN: SHA-256 {', '.join(used)}." if used else ""


def report(results: Results, records: Sequence[Record], methods: Sequence[str], pictures: dict[str, str]) -> str:
    """The report in Markdown."""
    coverage = cells_of(results, "coverage")
    scenes = list(coverage)
    runs = max(n for cells in coverage.values() for _, _, n in cells.values())
    steps = max(len(r["actions"]) for r in records)
    sizes = sorted({resolution_of(r) for r in records})
    lines = [
        "# Wang 2019 reproduced",
        "",
        f"{count(scenes, 'scene')}, {count(methods, 'method')}, {runs} run{'' if runs == 1 else 's'} of {steps} steps, "
        f"the camera {carried(records)}, voxels of "
        f"{', '.join(f'{size * 100:g} cm' for size in sizes)}. {', '.join(f'{k} {v}' for k, v in versions().items())}.{weights(records)}",
        "",
        *comparison(coverage, methods, steps < STEPS or max(sizes) > VOXEL),
        "## Table I: coverage, mean (standard deviation over runs)",
        "",
        "Share of the surface voxels that the views of the whole dome see. The best of a line in bold, the oracle aside: it plans with the "
        "true gain; in the paper's lines the best of its ten methods, also where that is not shown. "
        "Below each room the line of the paper's Table I for the room in whose place it stands.",
        "",
        heading("room", methods),
        *table_one(coverage, methods),
        *mean_lines(coverage, methods),
        "",
        *picture(pictures, "coverage_at_the_end.png"),
        *picture(pictures, "coverage.png"),
        "## Rooms",
        "",
        "The measure of complexity is the number of pieces (furniture and things on it); generated rooms have no noise, files have that of "
        "a Kinect v1.",
        "",
        "| room | pieces | size (m) | triangles | stands for |",
        "|---|---|---|---|---|",
        *[room_line(scene) for scene in scenes],
        "",
        "## Reconstruction error",
        "",
        f"Mean distance of the occupied voxels' centres to the nearest true surface, cm. The paper: {ERROR[0] * 100:g} to "
        f"{ERROR[1] * 100:g} cm for a Kinect v1 in real rooms, against a laser scan, alike for all methods.",
        "",
        heading("room", methods),
        *error_lines(cells_of(results, "reconstruction_error"), methods),
        "",
        "## Time",
        "",
        "Milliseconds to choose a view: the median over a run's steps (the first choice also loads and warms up), mean over runs. "
        f"The paper: about {PLANNING_MS:g} ms on a Core i7.",
        "",
        heading("", methods),
        "| all rooms | " + " | ".join(time_text(results, m) for m in methods) + " |",
        "",
        *picture(pictures, "times.png"),
        "## Poses and reconstruction",
        "",
        *picture(pictures, "dome.png"),
    ]
    return "\n".join(lines)


def comparison(coverage: dict[str, dict[str, Cell]], methods: Sequence[str], lesser: bool) -> list[str]:
    """The section on the paper's findings, nothing where no method that ran is in one.

    Args:
        coverage: Cells by scene and method.
        methods: In the order of the columns.
        lesser: Whether the run was shorter or coarser than the paper's.
    """
    kinds = by_kind(list(coverage))
    lines = []
    for kind, scenes in kinds.items():
        texts = [f"- {text}" for text in findings(means(coverage, scenes, methods), paper_rooms(scenes))]
        if texts:
            lines += [*([f"In {kind}:", ""] if len(kinds) > 1 else []), *texts, ""]
    if not lines:
        return []
    warning = "The paper's figures are after 130 steps with voxels of 2.5 cm: this run is shorter or coarser, and so are its verdicts."
    return ["## What the paper finds, and what we find", "", *([warning, ""] if lesser else []), *lines]


def means(coverage: dict[str, dict[str, Cell]], scenes: Sequence[str], methods: Sequence[str]) -> dict[str, float]:
    """The mean of each method over some scenes; NaN where it ran in none."""
    return {m: average([coverage[s][m][0] for s in scenes if m in coverage[s]]) for m in methods}


def mean_lines(coverage: dict[str, dict[str, Cell]], methods: Sequence[str]) -> list[str]:
    """Of each kind of scenes the mean and the paper's."""
    lines = []
    kinds = by_kind(list(coverage))
    for kind, scenes in kinds.items():
        ours = {m: (value, math.nan) for m, value in means(coverage, scenes, methods).items()}
        lines.append(table_line(f"mean of {kind}" if len(kinds) > 1 else "mean", ours, methods))
        name, rooms = ("real", REAL) if is_file(scenes[0]) else ("synthetic", SYNTHETIC)
        lines.append(paper_line(f"paper, {name}", {m: (mean_of(m, rooms), math.nan) for m in NAMES}, methods))
    return lines


def carried(records: Sequence[Record]) -> str:
    """How the camera moves. All rows of an experiment have the same robot."""
    return "held by an arm" if records[0]["row"].get("robot") == "arm" else "flying"


def count(things: Sequence[str], name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def average(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan


def resolution_of(record: Record) -> float:
    from ..envs.suite import TASKS

    own = record["row"]["resolution"]
    return float(own if own is not None else TASKS[record["row"]["task"]].setup["map"]["resolution"])


def heading(first: str, methods: Sequence[str]) -> str:
    return f"| {first} | " + " | ".join(name_of(m) for m in methods) + " |\n" + "|---" * (len(methods) + 1) + "|"


def table_one(coverage: dict[str, dict[str, Cell]], methods: Sequence[str]) -> list[str]:
    lines = []
    for scene, cells in coverage.items():
        lines.append(table_line(Path(scene).name, strip(cells), methods))
        if scene in ROOMS:
            lines.append(paper_line(f"paper, {ROOMS[scene]}", TABLE[ROOMS[scene]], methods))
    return lines


def table_line(name: str, cells: dict[str, tuple[float, float]], methods: Sequence[str]) -> str:
    """A line of Table I: the best of all cells in bold, as the reader sees the figures (two digits)."""
    figures = {m: round(mean, 2) for m, (mean, _) in cells.items() if m != ORACLE and math.isfinite(mean)}
    best = max(figures.values(), default=math.nan)
    texts = []
    for m in methods:
        mean, deviation = cells.get(m, (math.nan, math.nan))
        text = "" if math.isnan(mean) else f"{mean:.2f}" + (f" ({deviation:.2f})" if math.isfinite(deviation) else "")
        texts.append(f"**{text}**" if figures.get(m) == best else text)
    return f"| {name} | " + " | ".join(texts) + " |"


def paper_line(name: str, cells: dict[str, tuple[float, float]], methods: Sequence[str]) -> str:
    return table_line(f"*{name}*", cells, methods)


def room_line(scene: str) -> str:
    opened = open_scene(scene)
    low, high = np.asarray(opened.bounds, dtype=float)
    size = " × ".join(f"{x:.1f}" for x in high - low)
    stands_for = ROOMS.get(scene, "a real room" if is_file(scene) else "")
    pieces = int(opened.objects.max(initial=0))
    return f"| {Path(scene).name} | {pieces} | {size} | {len(opened.triangles):,} | {stands_for} |"


def error_lines(errors: dict[str, dict[str, Cell]], methods: Sequence[str]) -> list[str]:
    lines = []
    for scene, cells in errors.items():
        texts = [f"{cells[m][0] * 100:.1f}" if m in cells else "" for m in methods]
        lines.append(f"| {Path(scene).name} | " + " | ".join(texts) + " |")
    return lines


def time_text(results: Results, method: str) -> str:
    found = [row["mean"] for row in results if row["metric"] == "planning_ms" and row["method"] == method]
    return f"{average(found):.1f}" if found else ""


def picture(pictures: dict[str, str], name: str) -> list[str]:
    return [f"![{pictures[name]}]({name})", "", pictures[name], ""] if name in pictures else []


def findings(mean: dict[str, float], paper: tuple[str, ...]) -> list[str]:
    """The paper's claims, each with our mean figures and whether they agree. Claims on methods that did not run are left out.

    Args:
        mean: Coverage by method.
        paper: The paper's rooms whose figures are named beside ours.
    """

    def say(holds: bool) -> str:
        return "**holds here**" if holds else "**does not hold here**"

    known = {m: value for m, value in mean.items() if m != ORACLE and math.isfinite(value)}
    texts = []
    if "infogain" in known:
        for rival in ("random_neighbour", "basegain_p", "basegain_e"):
            if rival in known:
                texts.append(
                    f"InfoGain covers more than {NAMES[rival]} (the paper: {mean_of('infogain', paper):.2f} against "
                    f"{mean_of(rival, paper):.2f}): {say(known['infogain'] > known[rival] + TOLERANCE)} "
                    f"({known['infogain']:.2f} against {known[rival]:.2f})."
                )
    rivals = [m for m in ("random_neighbour", "infogain") if m in known]
    if "cnn" in known and rivals:
        least = min(known[m] for m in rivals)
        texts.append(f"CNN alone covers little: {say(known['cnn'] < least)} ({known['cnn']:.2f}).")
    combined = {m: known[m] for m in ("cgain_tc", "cgain_watc", "cgain_ns", "cgain_wa") if m in known}
    if combined and "infogain" in known:
        best = max(combined, key=lambda m: combined[m])
        numbers = ", ".join(f"{NAMES[m]} {value:.2f}" for m, value in combined.items())
        texts.append(
            f"The combinations are at least as good as InfoGain ({known['infogain']:.2f}): "
            f"{say(min(combined.values()) >= known['infogain'] - TOLERANCE)} ({numbers}). The best of them is at least as good: "
            f"{say(combined[best] >= known['infogain'] - TOLERANCE)} ({NAMES[best]})."
        )
    if ORACLE in mean and math.isfinite(mean[ORACLE]) and known:
        texts.append(
            "The oracle, which plans with the true gain over the whole dome, covers "
            f"{mean[ORACLE]:.2f}; the best method {max(known.values()):.2f}."
        )
    return texts
