"""Figures of an evaluation: coverage over views, a contact sheet of depth images, plans of scene and map.

All figures share one look and one colour per agent, so that they can stand side by side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .manifest import ORACLE
from .voxel_painter import UNCERTAINTY_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .plans import Plan

#: Okabe & Ito's palette, readable with every kind of colour vision.
COLOURS = {"greedy": "#0072B2", "nearest_frontier": "#D55E00", "random": "#8A8A8A", ORACLE: "#1A1A1A"}
MORE_COLOURS = ("#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#B8A000")
LABELS = {"greedy": "greedy gain", "nearest_frontier": "nearest frontier", "random": "random", ORACLE: "oracle (cheats)"}
INK, FAINT, PAPER = "#22272E", "#8B949E", "#FFFFFF"
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "text.color": INK,
    "axes.edgecolor": "#AEB6BF",
    "axes.labelcolor": INK,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E7EAED",
    "grid.linewidth": 0.8,
    "xtick.color": "#57606A",
    "ytick.color": "#57606A",
    "xtick.direction": "out",
    "legend.frameon": False,
    "figure.facecolor": PAPER,
    "savefig.facecolor": PAPER,
    "savefig.dpi": 170,
    "svg.fonttype": "none",
}


#: Length of the lines that show where a camera looks, metres.
SIGHT = 0.25


def label(agent: str) -> str:
    name, _, parameters = agent.partition(":")
    text = LABELS.get(name, name.replace("_", " "))
    return f"{text} ({parameters.replace(':', ', ')})" if parameters else text


def colours(agents: Sequence[str]) -> dict[str, str]:
    """One colour per agent; the known ones always have the same."""
    chosen: dict[str, str] = {}
    more = iter(MORE_COLOURS * (1 + len(agents) // len(MORE_COLOURS)))
    for agent in agents:
        chosen[agent] = COLOURS[agent] if agent in COLOURS else next(more)
    return chosen


@contextmanager
def canvas(width: float, height: float) -> Iterator[Figure]:
    """A figure of so many inches in the common look, without a window and without touching global state."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        FigureCanvasAgg(figure)
        yield figure


def headline(figure: Figure, title: str, subtitle: str = "") -> float:
    """Title and subtitle at the top left; returns the height that they take, as a fraction of the figure."""
    inch = 1.0 / figure.get_size_inches()[1]
    left = 0.14 / figure.get_size_inches()[0]
    figure.text(left, 1 - 0.12 * inch, title, size=13, weight="bold", va="top")
    if subtitle:
        figure.text(left, 1 - 0.40 * inch, subtitle, size=9, color="#57606A", va="top")
    return (0.72 if subtitle else 0.5) * inch


def save_curves(path: Path, summary: Sequence[dict[str, Any]], title: str, subtitle: str) -> None:
    """Coverage over views, information over views and coverage over path length: mean and 95 % interval."""
    from matplotlib.ticker import MaxNLocator

    palette = colours([entry["agent"] for entry in summary])
    with canvas(11.2, 4.3) as figure:
        top = headline(figure, title, subtitle)
        axes = figure.subplots(1, 3, gridspec_kw={"width_ratios": [1.25, 1, 1], "wspace": 0.27})
        figure.subplots_adjust(left=0.062, right=0.985, bottom=0.225, top=1 - top - 0.065)
        panels = (
            (axes[0], "Surface coverage over views", "views", "coverage of reachable surface (%)", "coverage", 100.0),
            (axes[1], "Information over views", "views", "information Σ(1−u)", "information", 1.0),
            (axes[2], "Coverage over path length", "mean path length (m)", "coverage (%)", "coverage", 100.0),
        )
        for entry in summary:
            for number, (axis, _, _, _, metric, scale) in enumerate(panels):
                curve = entry["curves"][metric]
                mean, half = np.array(curve["mean"]) * scale, np.array(curve["ci95"]) * scale
                if not len(mean):
                    continue
                x = np.array(entry["curves"]["path_length"]["mean"]) if number == 2 else np.arange(1, len(mean) + 1)
                cheats = entry["agent"].split(":")[0] == ORACLE
                colour = palette[entry["agent"]]
                axis.fill_between(x, mean - half, mean + half, color=colour, alpha=0.11, linewidth=0)
                axis.plot(
                    x, mean, color=colour, linewidth=1.6 if cheats else 2.1, linestyle=(0, (4, 2)) if cheats else "-",
                    label=label(entry["agent"]), solid_capstyle="round", zorder=3,
                )  # fmt: skip
                axis.plot(x[-1], mean[-1], "o", color=colour, markersize=4.5, zorder=4)
        for axis, heading, x_label, y_label, metric, _ in panels:
            axis.set_title(heading, pad=8)
            axis.set_xlabel(x_label)
            axis.set_ylabel(y_label)
            axis.set_xlim(left=0)
            axis.xaxis.set_major_locator(MaxNLocator(nbins=7, integer=True))
            if metric == "coverage":
                axis.set_ylim(0, 100)
            else:
                axis.set_ylim(bottom=0)
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="lower center", ncols=max(len(names), 1), bbox_to_anchor=(0.5, 0.005), handlelength=2.4)
        figure.savefig(path)


def save_contact_sheet(
    path: Path, depths: Sequence[NDArray[np.floating]], captions: Sequence[str], far: float, title: str, subtitle: str
) -> None:
    """Depth images in the order of the views, in one colour scale; grey where nothing was measured."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    columns = min(6, max(1, math.ceil(math.sqrt(len(depths) * 1.4))))
    rows = math.ceil(len(depths) / columns)
    height, width = np.asarray(depths[0]).shape
    # Inches: images, the gap below each row with the next captions, head, foot, and the colour bar's column.
    wide, gap, head, foot, side = 1.9, 0.27, 1.0, 0.15, 0.95
    high = wide * height / width
    size = (columns * (wide + 0.08) + side, rows * high + (rows - 1) * gap + head + foot)
    measured = [np.where(np.isfinite(d) & (d > 0) & (d <= far), d, np.nan) for d in depths]
    near = min((float(np.nanmin(d)) for d in measured if np.isfinite(d).any()), default=0.0)
    near = math.floor(near * 2) / 2
    with canvas(*size) as figure:
        headline(figure, title, subtitle)
        norm, colormap = Normalize(near, far), depth_colormap()
        axes = figure.subplots(rows, columns, squeeze=False)
        right = 1 - side / size[0]
        figure.subplots_adjust(
            left=0.1 / size[0], right=right, bottom=foot / size[1], top=1 - head / size[1],
            wspace=0.08 / wide, hspace=gap / high,
        )  # fmt: skip
        for axis in axes.flat:
            axis.set_axis_off()
        for axis, depth, caption in zip(axes.flat, measured, captions, strict=False):
            axis.imshow(np.ma.masked_invalid(depth), cmap=colormap, norm=norm, interpolation="nearest", aspect="auto")
            axis.set_title(caption, fontsize=7.8, fontweight="normal", pad=2.5, color="#57606A")
        length = min(2.6 / size[1], 1 - (head + foot) / size[1])
        bar_axis = figure.add_axes((right + 0.16 / size[0], 1 - head / size[1] - length, 0.14 / size[0], length))
        bar = figure.colorbar(ScalarMappable(norm, colormap), cax=bar_axis)
        bar.set_label("range along the ray (m)", size=8.5)
        bar.outline.set_visible(False)
        bar_axis.tick_params(labelsize=8, length=2)
        figure.savefig(path)


def depth_colormap() -> Any:
    """Near is light, far is dark, nothing measured is grey."""
    from matplotlib import colormaps

    return colormaps["YlGnBu"].with_extremes(bad="#DADDE1")


def uncertainty_colormap() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("uncertainty", UNCERTAINTY_COLOURS[::-1])


def save_plans(path: Path, plans: Sequence[Plan], title: str, subtitle: str) -> None:
    """The scene from above, and beside it what each agent's map holds, with the way that the camera went."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    low, high = plans[0].bounds[:, :2]
    aspect = float((high[1] - low[1]) / (high[0] - low[0]))
    panels = len(plans) + 1
    columns = panels if panels <= 3 or aspect > 1.5 else math.ceil(panels / 2)
    rows = math.ceil(panels / columns)
    cell = 3.5
    foot = 0.55 if columns * rows > panels else 0.95
    tall = rows * (cell * aspect + 0.42) + 0.55 + foot
    with canvas(columns * (cell + 0.35) + 0.3, tall) as figure:
        top = headline(figure, title, subtitle)
        axes = figure.subplots(rows, columns, squeeze=False)
        figure.subplots_adjust(left=0.05, right=0.985, bottom=foot / tall, top=1 - top - 0.18 / tall, wspace=0.13, hspace=0.22)
        flat: list[Axes] = list(axes.flat)
        for axis in flat[panels:]:
            axis.set_axis_off()
        extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
        flat[0].imshow(plans[0].scene_image, extent=extent, origin="lower", interpolation="antialiased")
        flat[0].set_title("The scene, cut at " + f"{plans[0].cut:.1f} m")
        for axis, plan in zip(flat[1:], plans, strict=False):
            axis.imshow(plan.map_image, extent=extent, origin="lower", interpolation="nearest")
            _draw_way(axis, plan)
            coverage = plan.metrics["coverage"] * 100
            axis.set_title(f"{label(plan.agent)}: {coverage:.0f} %", color=colours([plan.agent])[plan.agent])
            axis.annotate(
                f"{plan.metrics['views']:.0f} views, {plan.metrics['path_length']:.1f} m", (1, 1), (0, 4),
                xycoords="axes fraction", textcoords="offset points", ha="right", size=8, color="#57606A",
            )  # fmt: skip
        for axis in flat[:panels]:
            axis.grid(False)
            axis.set_xlim(extent[0], extent[1])
            axis.set_ylim(extent[2], extent[3])
            axis.tick_params(labelsize=7.5, length=2.5)
            for spine in axis.spines.values():
                spine.set_visible(True)
        for number, axis in enumerate(flat[:panels]):
            if number + columns >= panels:
                axis.set_xlabel("x (m)", size=8.5)
        for row in axes:
            row[0].set_ylabel("y (m)", size=8.5)
        handles = [
            Patch(facecolor="#FFFFFF", edgecolor="#AEB6BF", label="known free"),
            Patch(facecolor="#C9CFD6", label="unknown"),
            Line2D([], [], color=INK, linewidth=1.4, label="path of the camera, with its direction of sight"),
            Line2D([], [], marker="o", color="none", markerfacecolor="#FFFFFF", markeredgecolor=INK, label="start"),
        ]
        inches = figure.get_size_inches()
        free = flat[panels:]
        if free:
            # The empty place in the grid takes the legend.
            spot = free[-1].get_position()
            figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(spot.x0 - 0.01, spot.y1), fontsize=9, labelspacing=0.9)
            box = (spot.x0 + 0.005, spot.y1 - 1.75 / inches[1], 2.4 / inches[0], 0.13 / inches[1])
        else:
            figure.legend(handles=handles, loc="lower left", ncols=4, bbox_to_anchor=(0.04, 0.01), fontsize=8.5, columnspacing=1.4)
            box = (1 - 2.55 / inches[0], 0.42 / inches[1], 2.3 / inches[0], 0.11 / inches[1])
        bar_axis = figure.add_axes(box)
        bar = figure.colorbar(ScalarMappable(Normalize(0, 1), uncertainty_colormap()), cax=bar_axis, orientation="horizontal")
        bar.set_label("uncertainty u of occupied voxels", size=8.5, labelpad=1)
        bar.outline.set_visible(False)
        bar_axis.invert_xaxis()
        bar_axis.tick_params(labelsize=7.5, length=2)
        figure.savefig(path)


def _draw_way(axis: Axes, plan: Plan) -> None:
    """The way from above: each view a wedge in the direction of sight."""
    from matplotlib.collections import LineCollection

    xy = plan.viewpoints[:, :2]
    axis.plot(xy[:, 0], xy[:, 1], color="#FFFFFF", linewidth=2.6, alpha=0.85, solid_joinstyle="round")
    axis.plot(xy[:, 0], xy[:, 1], color=INK, linewidth=1.2, solid_joinstyle="round")
    ahead = plan.headings / np.maximum(np.linalg.norm(plan.headings, axis=1, keepdims=True), 1e-9)
    colour = colours([plan.agent])[plan.agent]
    segments = np.stack([xy, xy + ahead * SIGHT * np.linalg.norm(plan.headings, axis=1, keepdims=True)], axis=1)
    axis.add_collection(LineCollection(list(segments), colors=colour, linewidths=1.1, alpha=0.9, zorder=4))
    axis.plot(xy[1:, 0], xy[1:, 1], ".", color=colour, markersize=4.5, zorder=5)
    axis.plot(xy[0, 0], xy[0, 1], "o", color="#FFFFFF", markeredgecolor=INK, markersize=6, zorder=6)
