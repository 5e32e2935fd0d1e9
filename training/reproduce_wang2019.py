"""`nbv-gym reproduce wang2019`: Table I, Fig. 6 and Fig. 7 of Wang et al. 2019 (RA-L), the paper's figures beside ours.

The paper's four synthetic rooms came from SUNCG, which was withdrawn: four generated rooms of rising complexity take their
place. Its five real rooms were recorded in the authors' institute: any scene of the user's may stand for them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from ..agents.wang2019 import POLICIES
from . import figures
from .evaluate import Record, open_env, run, versions, write_results
from .manifest import ORACLE, Row, check
from .reproduction import write_report
from .statistics import align
from .terminal import bar

TASK, NOISY_TASK = "wang2019", "wang2019_kinect"
#: Generated rooms of rising complexity (triangles, objects and occluded floor grow).
ROOMS = ("room:14", "room:2", "room:35", "room:50")
STEPS, SEEDS = 130, 5
METHODS = (*POLICIES, ORACLE)
#: Names in the paper's Table I.
NAMES = {
    "random_neighbour": "Random", "basegain_p": "BaseGain-P", "basegain_e": "BaseGain-E", "infogain": "InfoGain", "cnn": "CNN",
    "cgain_rand": "CGain-Rand", "cgain_tc": "CGain-TC", "cgain_watc": "CGain-WATC", "cgain_ns": "CGain-NS", "cgain_wa": "CGain-WA",
    ORACLE: "oracle (cheats)",
}  # fmt: skip
#: Table I: coverage after 130 steps, mean and standard deviation; rooms in the paper's order.
PAPER: dict[str, dict[str, tuple[float, float]]] = {
    room: dict(zip(POLICIES, zip(means, deviations, strict=True), strict=True))
    for room, means, deviations in (
        ("room1", (0.49, 0.22, 0.52, 0.89, 0.26, 0.91, 0.89, 0.94, 0.93, 0.99), (0.20, 0.15, 0.10, 0.20, 0.10, 0.02, 0.20, 0.04, 0.04, 0.03)),
        ("room2", (0.53, 0.28, 0.45, 0.83, 0.15, 0.83, 0.83, 0.86, 0.84, 0.87), (0.15, 0.04, 0.11, 0.10, 0.04, 0.03, 0.10, 0.04, 0.08, 0.07)),
        ("room3", (0.52, 0.24, 0.48, 0.89, 0.19, 0.80, 0.86, 0.87, 0.90, 0.83), (0.10, 0.09, 0.01, 0.05, 0.07, 0.02, 0.05, 0.04, 0.03, 0.04)),
        ("room4", (0.58, 0.23, 0.53, 0.84, 0.24, 0.81, 0.85, 0.90, 0.82, 0.90), (0.18, 0.13, 0.04, 0.13, 0.08, 0.02, 0.13, 0.11, 0.26, 0.10)),
        ("mroom", (0.39, 0.32, 0.42, 0.78, 0.29, 0.80, 0.78, 0.82, 0.79, 0.84), (0.11, 0.08, 0.06, 0.04, 0.10, 0.02, 0.06, 0.05, 0.02, 0.03)),
        ("lab", (0.35, 0.49, 0.45, 0.86, 0.25, 0.85, 0.89, 0.79, 0.83, 0.84), (0.16, 0.07, 0.11, 0.04, 0.10, 0.02, 0.05, 0.06, 0.06, 0.05)),
        ("office", (0.49, 0.20, 0.20, 0.87, 0.31, 0.89, 0.89, 0.85, 0.89, 0.89), (0.11, 0.09, 0.11, 0.03, 0.09, 0.02, 0.04, 0.09, 0.04, 0.04)),
        ("corridor", (0.44, 0.10, 0.16, 0.83, 0.43, 0.86, 0.81, 0.83, 0.84, 0.72), (0.21, 0.03, 0.11, 0.06, 0.06, 0.04, 0.04, 0.03, 0.03, 0.24)),
        ("storage", (0.43, 0.29, 0.44, 0.87, 0.40, 0.99, 0.85, 0.97, 0.81, 0.84), (0.18, 0.15, 0.04, 0.20, 0.07, 0.01, 0.18, 0.03, 0.10, 0.22)),
    )
}  # fmt: skip
#: Fig. 6 shows these methods.
SHOWN = ("random_neighbour", "infogain", "cgain_wa")


def rows_of(rooms: Sequence[str], seeds: Sequence[int], steps: int, methods: Sequence[str], noise: bool, weights: str) -> list[Row]:
    """One row per room, method and seed; seeds outermost."""
    task = NOISY_TASK if noise else TASK

    def named(method: str) -> str:
        learnt = method in ("cnn", "cgain_tc", "cgain_watc", "cgain_ns", "cgain_wa")
        return f"{method}:weights={weights}" if weights and learnt else method

    rows = [Row(task, named(m), room, seed, steps) for seed in seeds for room in rooms for m in methods]
    for row in rows[: len(rooms) * len(methods)]:
        check(row)
    return rows


def reproduce(
    out: Path,
    rooms: Sequence[str],
    seeds: Sequence[int],
    steps: int,
    methods: Sequence[str],
    noise: bool,
    weights: str,
    processes: int,
    console: Console,
) -> dict[str, Any]:
    """Run what is not yet in `out`, write the report, return its figures.

    Raises:
        ValueError, OSError: An unknown method or room, weights that cannot be read; nothing has run then.
    """
    unknown = [m for m in methods if m not in METHODS]
    if unknown:
        raise ValueError(f"there is no method {', '.join(unknown)}; known are {', '.join(METHODS)}")
    rows = rows_of(rooms, seeds, steps, methods, noise, weights)
    out.mkdir(parents=True, exist_ok=True)
    with bar(console) as progress:
        work = progress.add_task("Episodes", total=len(rows))

        def note(row: Row, record: Record) -> None:
            progress.update(work, advance=1, description=f"{row.scene} {NAMES[row.agent.split(':')[0]]}, seed {row.seed}")

        records = run(rows, out / "episodes", processes, resume=True, progress=note)
    failed = [record for record in records if record["status"] != "ok"]
    for record in failed:
        console.print(f"[red]failed[/red] {record['row']}: {record['error']}", highlight=False)
    if failed:
        raise RuntimeError(f"{len(failed)} of {len(records)} episodes failed; the others are kept in {out / 'episodes'}")
    result = figures_of(records, rooms, methods)
    write_results(out / "results.json", records, reproduction=result)
    pictures = draw(out, records, rooms, methods, steps)
    errors = reconstruction_errors(records, rooms, methods)
    text = report(result, errors, rooms, methods, seeds, steps, noise, pictures)
    for path in write_report(out, "Wang 2019 reproduced", text):
        console.print(f"  {path}", highlight=False)
    return {**result, "reconstruction_cm": errors}


def method_of(record: Record) -> str:
    return str(record["row"]["agent"]).split(":")[0]


def figures_of(records: Sequence[Record], rooms: Sequence[str], methods: Sequence[str]) -> dict[str, Any]:
    """Table I: coverage at the end, mean and standard deviation over the runs (n - 1), by room and method."""
    table: dict[str, dict[str, dict[str, float]]] = {}
    for room in rooms:
        table[room] = {}
        for method in methods:
            final = [r["curves"]["coverage"][-1] for r in records if r["row"]["scene"] == room and method_of(r) == method]
            deviation = float(np.std(final, ddof=1)) if len(final) > 1 else float("nan")
            table[room][method] = {"mean": float(np.mean(final)), "std": deviation, "runs": len(final)}
    return {"table": table, "mean": {m: float(np.mean([table[r][m]["mean"] for r in rooms])) for m in methods}}


def reconstruction_errors(records: Sequence[Record], rooms: Sequence[str], methods: Sequence[str]) -> dict[str, float]:
    """Mean distance from the map's occupied voxels to the nearest true surface, cm, over the rooms' first runs."""
    errors: dict[str, list[float]] = {}
    for room in rooms:
        for method in methods:
            record = next(r for r in records if r["row"]["scene"] == room and method_of(r) == method)
            with Replay(record) as env:
                cloud = np.asarray(env.belief.octree.occupied())
                distance = np.asarray(env.simulator.scene(0).clearance(cloud, 1.0))
                errors.setdefault(method, []).append(float(distance.mean()) * 100)
    return {method: float(np.mean(values)) for method, values in errors.items()}


class Replay:
    """The environment of a record after its last step, gone through again."""

    def __init__(self, record: Record) -> None:
        self._record = record
        self._env = open_env(Row(**record["row"]))

    def __enter__(self) -> Any:
        self._env.reset(seed=self._record["row"]["seed"])
        for action in self._record["actions"]:
            self._env.step(np.int64(action))
        return self._env

    def __exit__(self, *_: object) -> None:
        self._env.close()


# --- Pictures -----------------------------------------------------------------------------------------------------------------


def draw(out: Path, records: Sequence[Record], rooms: Sequence[str], methods: Sequence[str], steps: int) -> dict[str, str]:
    """Fig. 7 (a), Fig. 7 (b) and Fig. 6; returns captions by file name."""
    save_coverage(out / "coverage.png", records, methods)
    save_times(out / "times.png", records, methods)
    shown = [m for m in SHOWN if m in methods] or list(methods[:3])
    first = [next(r for r in records if r["row"]["scene"] == rooms[-1] and method_of(r) == m) for m in shown]
    save_dome(out / "dome.png", first)
    return {
        "coverage.png": "As Fig. 7 (a): coverage over steps, mean over all rooms and runs.",
        "times.png": "As Fig. 7 (b): time per step and stage, mean over all rooms and runs.",
        "dome.png": f"As Fig. 6: the selected poses on the dome and the reconstruction, in {rooms[-1]}, first run.",
    }


def save_coverage(path: Path, records: Sequence[Record], methods: Sequence[str]) -> None:
    palette = figures.colours(list(methods))
    with figures.canvas(8.2, 4.9) as figure:
        top = figures.headline(figure, "Exploration over steps", "Coverage of the dome's surface voxels, mean over rooms and runs")
        axis = figure.subplots()
        figure.subplots_adjust(left=0.08, right=0.76, bottom=0.11, top=1 - top - 0.02)
        for method in methods:
            curve = align([r["curves"]["coverage"] for r in records if method_of(r) == method]).mean(axis=0)
            style = (0, (4, 2)) if method == ORACLE else "-"
            axis.plot(np.arange(len(curve)), curve * 100, color=palette[method], linestyle=style, label=NAMES[method], linewidth=1.8)
        axis.set_xlabel("step")
        axis.set_ylabel("coverage (%)")
        axis.set_ylim(0, 100)
        axis.set_xlim(left=0)
        order = np.argsort([-line.get_ydata()[-1] for line in axis.lines])  # type: ignore[index]
        handles, names = axis.get_legend_handles_labels()
        axis.legend([handles[i] for i in order], [names[i] for i in order], loc="center left", bbox_to_anchor=(1.01, 0.5))
        figure.savefig(path)


def save_times(path: Path, records: Sequence[Record], methods: Sequence[str]) -> None:
    """Milliseconds per step: choosing the view (of InfoGain and its combinations), and the world's stages."""
    choosing = [r for r in records if method_of(r) == "infogain"] or [r for r in records if method_of(r) in methods]
    curves = {"choosing the view": align([r["planning_ms"] for r in choosing]).mean(axis=0)}
    for stage in ("integrate", "render", "measure"):
        curves[stage] = align([r["stage_ms"][stage] for r in choosing]).mean(axis=0)
    with figures.canvas(8.2, 4.2) as figure:
        top = figures.headline(figure, "Time per step", f"Runs of {NAMES[method_of(choosing[0])]}")
        axis = figure.subplots()
        figure.subplots_adjust(left=0.09, right=0.78, bottom=0.13, top=1 - top - 0.02)
        for (name, curve), colour in zip(curves.items(), figures.colours(list(curves)).values(), strict=True):
            axis.plot(np.arange(1, len(curve) + 1), curve, label=name, color=colour, linewidth=1.8)
        axis.set_xlabel("step")
        axis.set_ylabel("time (ms)")
        axis.set_ylim(bottom=0)
        axis.set_xlim(left=0)
        axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
        figure.savefig(path)


def save_dome(path: Path, records: Sequence[Record]) -> None:
    """Above: all poses of the dome, the selected ones and the way between them. Below: occupied voxels, coloured by height."""
    with figures.canvas(3.6 * len(records), 7.0) as figure:
        top = figures.headline(figure, f"Selected poses and reconstruction, {records[0]['row']['scene']}")
        for column, record in enumerate(records):
            with Replay(record) as env:
                dome, way = np.asarray(env.belief.candidates), np.array(record["viewpoints"])
                cloud = np.asarray(env.belief.octree.occupied())
            title = f"{NAMES[method_of(record)]}: {record['curves']['coverage'][-1] * 100:.0f} %"
            above = figure.add_subplot(2, len(records), column + 1, projection="3d")
            above.scatter(*dome[:, :3].T, s=3, color="#C9CFD6", depthshade=False)
            above.plot(*way[:, :3].T, color="#0072B2", linewidth=0.8)
            above.scatter(*way[:, :3].T, s=9, c=np.arange(len(way)), cmap="viridis", depthshade=False)
            above.set_title(title)
            below = figure.add_subplot(2, len(records), len(records) + column + 1, projection="3d")
            keep = cloud[cloud[:, 2] < np.quantile(cloud[:, 2], 0.97) - 0.05]
            keep = keep[np.linspace(0, len(keep) - 1, min(len(keep), 30_000)).astype(int)]
            below.scatter(*keep.T, s=0.6, c=keep[:, 2], cmap="terrain", depthshade=False, linewidths=0)
            for axis in (above, below):
                axis.set_axis_off()
                axis.view_init(elev=35, azim=-60)
                equal_axes(axis, dome[:, :3] if axis is above else keep)
        figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=1 - top - 0.05, wspace=0.02, hspace=0.06)
        figure.savefig(path)


def equal_axes(axis: Any, points: NDArray[Any]) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    axis.set_box_aspect(np.maximum(high - low, 1e-3))
    for name, a, b in zip("xyz", low, high, strict=True):
        getattr(axis, f"set_{name}lim")(a, b)


# --- Text ---------------------------------------------------------------------------------------------------------------------


def report(
    result: dict[str, Any],
    errors: dict[str, float],
    rooms: Sequence[str],
    methods: Sequence[str],
    seeds: Sequence[int],
    steps: int,
    noise: bool,
    pictures: dict[str, str],
) -> str:
    """The report in Markdown."""
    table, planners = result["table"], [m for m in methods if m != ORACLE]
    runs = f"{len(seeds)} run{'s' if len(seeds) > 1 else ''}"
    lines = [
        "# Wang 2019 reproduced",
        "",
        f"{len(rooms)} rooms, {len(methods)} methods, {runs} of {steps} steps"
        + (", depth noise of a Kinect v1" if noise else "")
        + f". {', '.join(f'{k} {v}' for k, v in versions().items())}.",
        "",
        "## Table I: coverage, mean (standard deviation)",
        "",
        "Share of the surface voxels that all 672 views of the dome hit together. Best of a row in bold, the oracle aside.",
        "",
        "| room | " + " | ".join(NAMES[m] for m in methods) + " |",
        "|---" * (len(methods) + 1) + "|",
    ]

    def row(name: str, cells: dict[str, tuple[float, float]], shown: Sequence[str]) -> str:
        best = max((round(cells[m][0], 2) for m in shown if m != ORACLE and m in cells), default=math.nan)
        texts = []
        for m in shown:
            if m not in cells:
                texts.append("")
                continue
            mean, deviation = cells[m]
            text = f"{mean:.2f}" + (f" ({deviation:.2f})" if math.isfinite(deviation) else "")
            texts.append(f"**{text}**" if m != ORACLE and round(mean, 2) == best else text)
        return f"| {name} | " + " | ".join(texts) + " |"

    for room in rooms:
        lines.append(row(room, {m: (c["mean"], c["std"]) for m, c in table[room].items()}, methods))
    lines.append(row("mean", {m: (result["mean"][m], math.nan) for m in methods}, methods))
    lines += ["", "The paper's Table I:", "", "| room | " + " | ".join(NAMES[m] for m in POLICIES) + " |", "|---" * (len(POLICIES) + 1) + "|"]
    lines += [row(room, cells, list(POLICIES)) for room, cells in PAPER.items()]
    means = {m: (float(np.mean([cells[m][0] for cells in PAPER.values()])), math.nan) for m in POLICIES}
    lines += [row("mean", means, list(POLICIES)), "", "## What the paper finds, and what we find", ""]
    lines += [f"- {text}" for text in findings(result["mean"], planners)]
    lines += ["", "## Reconstruction error", "", "Mean distance of the occupied voxels to the true surface (the paper: 4 to 7 cm), first run of each room.", ""]
    lines += ["| " + " | ".join(NAMES[m] for m in methods) + " |", "|---" * len(methods) + "|"]
    lines += ["| " + " | ".join(f"{errors[m]:.1f} cm" for m in methods) + " |", ""]
    for name, caption in pictures.items():
        lines += [f"![{caption}]({name})", "", caption, ""]
    return "\n".join(lines)


def findings(mean: dict[str, float], planners: Sequence[str]) -> list[str]:
    """The paper's claims, each with our figures and whether they agree."""

    def say(holds: bool) -> str:
        return "holds here" if holds else "does not hold here"

    known = {m: mean[m] for m in planners}
    texts = []
    if {"infogain", "random_neighbour", "basegain_p", "basegain_e"} <= set(known):
        rest = max(known["random_neighbour"], known["basegain_p"], known["basegain_e"])
        texts.append(
            f"InfoGain covers more than Random and both BaseGain: {say(known['infogain'] > rest)} "
            f"({known['infogain']:.2f} against {rest:.2f} of the best of the three)."
        )
    if {"cnn", "infogain"} <= set(known):
        texts.append(f"CNN alone covers little: {say(known['cnn'] < known['infogain'])} ({known['cnn']:.2f}).")
    combined = {m: known[m] for m in ("cgain_tc", "cgain_watc", "cgain_ns", "cgain_wa") if m in known}
    if combined and "infogain" in known:
        best = max(combined, key=lambda m: combined[m])
        texts.append(
            f"The combinations are at least as good as InfoGain: {say(min(combined.values()) >= known['infogain'] - 0.005)} "
            f"({', '.join(f'{NAMES[m]} {v:.2f}' for m, v in combined.items())}; best {NAMES[best]})."
        )
    return texts


