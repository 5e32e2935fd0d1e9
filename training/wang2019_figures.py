"""Pictures of the reproduction of Wang et al. 2019: Fig. 6, Fig. 7 (a) and Fig. 7 (b)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import figures
from .manifest import ORACLE
from .replay import replayed
from .statistics import align
from .wang2019_paper import NAMES, TABLE, mean_of

Record = dict[str, Any]

#: Okabe & Ito's colours and three of the same kind; a family of methods shares a hue's neighbourhood.
COLOURS = {
    "random_neighbour": "#8A8A8A",
    "basegain_p": "#D8B365",
    "basegain_e": "#A6611A",
    "infogain": "#0072B2",
    "cnn": "#CC79A7",
    "cgain_rand": "#56B4E9",
    "cgain_tc": "#009E73",
    "cgain_watc": "#7FBF3F",
    "cgain_ns": "#E69F00",
    "cgain_wa": "#D55E00",
    ORACLE: "#1A1A1A",
}
#: What Fig. 7 (b) calls a stage, and ours; the stages are those of `STAGES`.
STAGES = {"integrate": "map update", "render": "depth image", "measure": "measuring", "plan": "path", "move": "motion"}
#: Most points of a cloud that are drawn.
POINTS = 40_000
#: Share of the cloud's height, from above, that is left out, so that one looks into the room.
LID = 0.08


def method_of(record: Record) -> str:
    return str(record["row"]["agent"]).split(":")[0]


def name_of(method: str) -> str:
    return NAMES.get(method, "oracle")


def save_coverage(path: Path, records: Sequence[Record], methods: Sequence[str], paper: tuple[str, ...]) -> None:
    """As Fig. 7 (a): coverage over steps, the mean over scenes and runs. At the right edge what the paper's Table I says of the
    rooms `paper`."""
    from matplotlib.ticker import MaxNLocator

    with figures.canvas(9.4, 5.2) as figure:
        top = figures.headline(
            figure, "Exploration over steps", "Coverage, mean over all rooms and runs; diamonds: the paper's Table I after 130 steps"
        )
        axis = figure.subplots()
        figure.subplots_adjust(left=0.075, right=0.76, bottom=0.11, top=1 - top - 0.02)
        last = 0
        lines = []
        for method in methods:
            curves = [r["curves"]["coverage"] for r in records if method_of(r) == method]
            if not curves:
                continue
            curve = align(curves).mean(axis=0) * 100
            style: Any = (0, (4, 2)) if method == ORACLE else "-"
            (line,) = axis.plot(np.arange(len(curve)), curve, color=COLOURS[method], linestyle=style, linewidth=1.8)
            lines.append((float(curve[-1]), line, name_of(method)))
            last = max(last, len(curve) - 1)
        printed = {method: mean_of(method, paper) * 100 for method in methods if method in NAMES}
        for (method, value), column in zip(printed.items(), side_by_side(list(printed.values()), 3.0), strict=True):
            x = 1.02 + 0.018 * column
            axis.plot(x, value, "D", color=COLOURS[method], markersize=5.5, clip_on=False, transform=axis.get_yaxis_transform())
        axis.set_xlabel("step")
        axis.set_ylabel("coverage (%)")
        axis.set_ylim(0, 100)
        axis.set_xlim(0, max(last, 1))
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        lines.sort(key=lambda entry: -entry[0])
        axis.legend(
            [line for _, line, _ in lines],
            [f"{name} {value:.0f} %" for value, _, name in lines],
            loc="center left",
            bbox_to_anchor=(1.09, 0.5),
        )
        figure.savefig(path)


def side_by_side(values: Sequence[float], height: float) -> list[int]:
    """A column for each marker of a height, so that none covers another: the first one that is free at its value."""
    placed: list[tuple[float, int]] = []
    for value in values:
        taken = {column for other, column in placed if abs(other - value) < height}
        placed.append((value, next(c for c in range(len(values)) if c not in taken)))
    return [column for _, column in placed]


def save_times(path: Path, records: Sequence[Record], methods: Sequence[str]) -> str:
    """As Fig. 7 (b): milliseconds per step and stage, the median over scenes and runs (a mean would show what else the machine did). Of
    InfoGain, or the first method there is; returns its name."""
    there = [m for m in methods if any(method_of(r) == m for r in records)]
    method = "infogain" if "infogain" in there else there[0]
    chosen = [r for r in records if method_of(r) == method]
    curves = {"choosing the view": np.median(align([r["planning_ms"] for r in chosen]), axis=0)}
    for stage, name in STAGES.items():
        curves[name] = np.median(align([r["stage_ms"][stage] for r in chosen]), axis=0)
    with figures.canvas(9.4, 4.2) as figure:
        top = figures.headline(
            figure, "Time per step and stage", f"{name_of(method)}, median over all rooms and runs; beside the names: over the steps, too"
        )
        axis = figure.subplots()
        figure.subplots_adjust(left=0.085, right=0.72, bottom=0.13, top=1 - top - 0.02)
        shades = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#8A8A8A")
        for (name, curve), colour in zip(curves.items(), shades, strict=True):
            axis.plot(np.arange(1, len(curve) + 1), curve, label=f"{name} {np.median(curve):.2g} ms", color=colour, linewidth=1.8)
        axis.set_xlabel("step")
        axis.set_ylabel("time (ms)")
        axis.set_yscale("log")
        axis.set_xlim(left=0)
        axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
        figure.savefig(path)
    return name_of(method)


def save_table(path: Path, rows: Sequence[tuple[str, str | None, dict[str, tuple[float, float]]]], methods: Sequence[str]) -> None:
    """Final coverage by scene and method as dots with standard deviations; hollow: the paper's room beside it.

    Args:
        path: PNG.
        rows: Scene, the paper's room that it stands for, and (mean, standard deviation) by method.
        methods: In the order of the columns.
    """
    with figures.canvas(11.2, 1.1 + 1.7 * len(rows)) as figure:
        top = figures.headline(figure, "Coverage at the end", "Dots: here, mean and standard deviation; hollow: Table I")
        axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        figure.subplots_adjust(left=0.06, right=0.985, bottom=0.6 / figure.get_size_inches()[1], top=1 - top - 0.03, hspace=0.42)
        for axis, (scene, room, cells) in zip(axes, rows, strict=True):
            ends = [0.0, 1.0]
            for x, method in enumerate(methods):
                if room is not None and method in NAMES:
                    mean, deviation = TABLE[room][method]
                    axis.errorbar(
                        x + 0.14,
                        mean * 100,
                        deviation * 100,
                        fmt="o",
                        color=COLOURS[method],
                        markerfacecolor="white",
                        markersize=6,
                    )
                    ends += [mean - deviation, mean + deviation]
                if method in cells:
                    mean, deviation = cells[method]
                    deviation = np.nan_to_num(deviation)
                    axis.errorbar(x - 0.14, mean * 100, deviation * 100, fmt="o", color=COLOURS[method], markersize=6)
                    ends += [mean - deviation, mean + deviation]
            # A deviation may reach beyond what a coverage can be; its bar is shown whole.
            axis.set_ylim(min(ends) * 100 - 5, max(ends) * 100 + 5)
            axis.set_yticks([0, 50, 100])
            axis.set_title(scene + (f" (hollow: the paper's {room})" if room else ""), fontsize=9.5)
        axes[-1].set_xlim(-0.5, len(methods) - 0.5)
        axes[-1].set_xticks(range(len(methods)), [name_of(m) for m in methods], fontsize=8.5)
        figure.supylabel("coverage (%)", fontsize=9, x=0.008)
        figure.savefig(path)


def save_dome(path: Path, records: Sequence[Record]) -> None:
    """As Fig. 6. Above: all poses of the dome, the selected ones in the order from dark to light, and the way between them. Below:
    the occupied voxels, coloured by height."""
    with figures.canvas(3.7 * len(records), 7.2) as figure:
        steps = len(records[0]["actions"])
        top = figures.headline(
            figure, f"Selected poses and reconstruction, {Path(records[0]['row']['scene']).name}", f"After {steps} steps"
        )
        for column, record in enumerate(records):
            with replayed(record) as env:
                dome = np.asarray(env.belief.candidates)[:, :3]
                cloud = np.asarray(env.belief.octree.occupied())
                seen = np.asarray(env.simulator.truth_surface(0)).reshape(-1, 3)
            way = np.array(record["viewpoints"])[:, :3]
            title = f"{name_of(method_of(record))}: {record['curves']['coverage'][-1] * 100:.0f} %"
            above = figure.add_subplot(2, len(records), column + 1, projection="3d")
            above.scatter(*dome.T, s=3, color="#C9CFD6", depthshade=False)
            above.plot(*way.T, color="#0072B2", linewidth=0.8)
            above.scatter(*way.T, s=9, c=np.arange(len(way)), cmap="viridis", depthshade=False)
            above.set_title(title)
            below = figure.add_subplot(2, len(records), len(records) + column + 1, projection="3d")
            frame = np.stack([seen.min(axis=0), seen.max(axis=0)]) if len(seen) else np.stack([dome.min(axis=0), dome.max(axis=0)])
            cut = frame[1, 2] - LID * (frame[1, 2] - frame[0, 2])
            kept = cloud[(cloud >= frame[0] - 0.1).all(axis=1) & (cloud <= frame[1] + 0.1).all(axis=1) & (cloud[:, 2] < cut)]
            kept = kept[np.unique(np.linspace(0, max(len(kept) - 1, 0), min(len(kept), POINTS)).astype(int))]
            below.scatter(*kept.T, s=0.6, c=kept[:, 2], cmap="viridis", depthshade=False, linewidths=0)
            for axis, points in ((above, dome), (below, frame)):
                axis.set_axis_off()
                axis.view_init(elev=38, azim=-60)
                equal_axes(axis, points)
        figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=1 - top - 0.05, wspace=0.02, hspace=0.06)
        figure.savefig(path, dpi=110)  # many points make large files


def equal_axes(axis: Any, points: NDArray[Any]) -> None:
    """The same scale along x, y and z, just around the points (n, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    axis.set_box_aspect(np.maximum(high - low, 1e-3), zoom=1.25)
    for name, a, b in zip("xyz", low, high, strict=True):
        getattr(axis, f"set_{name}lim")(a, b)
