"""Everything that is written about a comparison: figures, film, recording, results. One folder per place."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from ..agents import StepRecord
from . import figures
from .film import Film, film_title, fine_camera
from .manifest import ORACLE
from .plans import Plan, plan_of
from .recording import Recording, rerun_installed
from .statistics import Estimate

if TYPE_CHECKING:
    from ..envs.env import NbvEnv

#: Width of the depth images on the contact sheet, pixels. They are rendered again, finer than the planner saw them.
SHEET_PIXELS = 240
#: At most so many images on a contact sheet.
SHEET_IMAGES = 24


class Witness:
    """Watches one episode for the report: plan, depth images and, for the showpiece, film and recording."""

    def __init__(self, agent: str, place: str, out: Path, showpiece: bool, ceiling: float | None) -> None:
        self.agent = agent
        self.records: list[StepRecord] = []
        self.depths: list[NDArray[np.float32]] = []
        self.far = 0.0
        self.plan: Plan | None = None
        self.film = Film(film_title(agent, place), ceiling) if showpiece else None
        self.recording = Recording(out / "recording.rrd") if showpiece and rerun_installed() else None

    def __call__(self, env: NbvEnv, record: StepRecord) -> None:
        self.records.append(record)
        if self.film is not None:
            self.film(env, record)
            camera, view = fine_camera(env, record.viewpoint, SHEET_PIXELS)
            self.depths.append(np.asarray(env.simulator.scene(0).render_depth(camera, view)))
            self.far = camera.far
        if self.recording is not None:
            self.recording(env, record)
        if record.terminated or record.truncated:
            self.plan = plan_of(env, self.agent, self.records)


def write_pictures(out: Path, place: str, task: str, summary: Sequence[dict[str, Any]], witnesses: Sequence[Witness]) -> list[Path]:
    """Write all figures of one place; returns their paths."""
    out.mkdir(parents=True, exist_ok=True)
    written = [out / "coverage.png"]
    episodes = max((entry["episodes"] for entry in summary), default=0)
    band = ", mean and 95 % confidence interval" if episodes > 1 else ""
    figures.save_curves(written[0], summary, f"Exploring {place}", f"Task {task}, {per_planner(episodes)}{band}")
    plans = [w.plan for w in witnesses if w.plan is not None]
    if plans:
        written.append(out / "plan.png")
        figures.save_plans(written[-1], plans, f"What each planner knows of {place}", "Maps from above after the last view, first seed")
    for witness in witnesses:
        if witness.film is None or not witness.film.frames:
            continue
        written.append(out / "depth_images.png")
        chosen = np.unique(np.linspace(0, len(witness.depths) - 1, min(len(witness.depths), SHEET_IMAGES)).astype(int))
        captions = [f"view {i + 1} · {witness.records[i].metrics['coverage'] * 100:.0f} % covered" for i in chosen]
        figures.save_contact_sheet(
            written[-1], [witness.depths[i] for i in chosen], captions, witness.far,
            f"What the camera saw: {film_title(witness.agent, place)}", "Depth images in the order of the views",
        )  # fmt: skip
        written.append(out / "map.gif")
        witness.film.save(written[-1])
        if witness.recording is not None:
            witness.recording.close()
            written.append(witness.recording.path)
    return written


def per_planner(episodes: int) -> str:
    return f"{episodes} episode{'' if episodes == 1 else 's'} per planner"


class Name:
    """One of the names in a column, cut in the middle to whatever width is left for it."""

    def __init__(self, name: str, names: Sequence[str]) -> None:
        self.name = name
        self.names = names

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(1, len(self.name))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield Text(shortened(self.name, self.names, options.max_width), overflow="fold")


def shortened(name: str, names: Sequence[str], width: int) -> str:
    """A name in at most so many letters: without its middle, or what is nearest to it and leaves the name another than all others that
    are cut there; whole, if that is nowhere."""

    def cut(text: str, head: int) -> str:
        return text if len(text) <= width else f"{text[:head]}…{text[len(text) - width + 1 + head :]}"

    for head in sorted(range(width), key=lambda head: abs(head - width // 2)):
        if all(cut(other, head) != cut(name, head) for other in names if other != name):
            return cut(name, head)
    return name


def table(summary: Sequence[dict[str, Any]], title: str) -> Table:
    """The comparison as a table for the terminal, best coverage first except for the oracle, which comes last."""
    grid = Table(title=title, title_justify="left", title_style="bold", header_style="bold", box=None, padding=(0, 1))
    # Where it is narrow, the widest column gives way first: names, until no number is shorter. Then numbers take two lines.
    grid.add_column("planner")
    for name in ("coverage %", "of oracle", "information", "entropy kbit", "views", "travel m", "plan ms"):
        grid.add_column(name, justify="right", overflow="fold")
    names = [figures.label(entry["agent"]) for entry in summary]
    if any(entry["failed"] for entry in summary):
        grid.add_column("failed", justify="right", style="red")

    def order(entry: dict[str, Any]) -> tuple[bool, float]:
        return entry["agent"].split(":")[0] == ORACLE, -(entry["final"]["coverage"]["mean"] or 0.0)

    for entry in sorted(summary, key=order):
        final, share = entry["final"], entry["coverage_of_oracle"]
        cells: list[Name | str] = [
            Name(figures.label(entry["agent"]), names),
            text(final["coverage"], 1, 100.0),
            "-" if share is None else f"{share * 100:.0f} %",
            text(final["information"], 0),
            text(final["entropy"], 1, 1e-3),
            text(final["views"], 1),
            text(final["path_length"], 1),
            text(entry["planning_ms"], 1),
        ]
        if len(grid.columns) > len(cells):
            cells.append(str(entry["failed"]))
        cheats = entry["agent"].split(":")[0] == ORACLE
        grid.add_row(*cells, style="dim" if cheats else None)
    return grid


def text(interval: dict[str, float | None], digits: int, scale: float = 1.0) -> str:
    nan = float("nan")
    mean, half = (nan if v is None else v for v in (interval["mean"], interval["ci95"]))
    return Estimate(mean, half, 0).text(digits, scale)
