"""`nbv-gym demo`: four planners, the same seeds, in a furnished room and in a world of the user's."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from .evaluate import finished, run, write_results
from .manifest import ORACLE, Row, grid
from .report import Witness, per_planner, table, write_pictures
from .terminal import bar

TASK = "dome_room"
#: The room is the same for all seeds, which differ in where the camera starts.
ROOM = "room:35"
AGENTS = ("greedy", "nearest_frontier", "random", ORACLE)
#: The planner whose episode is filmed.
SHOWPIECE = "greedy"
#: Walls and lamps above this height would hide a house with many rooms, metres above the floor.
CEILING = 1.9


def demo(out: Path, scene: str | None, seeds: Sequence[int], views: int | None, console: Console) -> dict[str, Any]:
    """Run the demo; returns the summaries by place.

    Args:
        out: folder for pictures and results, one sub-folder per place.
        scene: a world file for a second part, if any.
        seeds: the same for every planner; the first is drawn and filmed.
        views: views per episode after the first; the task's own number if None.
    """
    places = [("room", ROOM, "a furnished room")]
    if scene is not None:
        places.append((Path(scene).stem.replace(":", "_"), scene, Path(scene).stem.replace("_", " ")))
    plans = [(folder, place, grid([TASK], AGENTS, [source], seeds, views)) for folder, source, place in places]
    summaries: dict[str, Any] = {}
    for folder, place, rows in plans:
        summaries[folder] = _one_place(out / folder, place, rows, console)
    return summaries


def _one_place(out: Path, place: str, rows: Sequence[Row], console: Console) -> Any:
    out.mkdir(parents=True, exist_ok=True)
    witnesses: list[Witness] = []
    shards = out / "results.shards"

    def observe(row: Row) -> Witness | None:
        if row.seed != rows[0].seed:
            return None
        ceiling = None if row.scene == ROOM else CEILING
        witnesses.append(Witness(row.agent, place, out, row.agent == SHOWPIECE, ceiling))
        return witnesses[-1]

    with bar(console) as progress:
        work = progress.add_task(f"Exploring {place}", total=len(rows))
        try:
            records = run(rows, shards, observe=observe, progress=lambda *_: progress.advance(work))
        except KeyboardInterrupt:
            write_results(out / "results.json", finished(shards, rows), interrupted=True)
            raise
        summary = write_results(out / "results.json", records)
        # What was finished is all in the results now.
        shutil.rmtree(shards)
        progress.update(work, description=f"Drawing {place}")
        failed = [r for r in records if r["status"] != "ok"]
        paths = write_pictures(out, place, TASK, summary, witnesses)
    console.print()
    console.print(table(summary, f"{place[0].upper()}{place[1:]}: {per_planner(len(rows) // len(AGENTS))}, {TASK}"))
    for record in failed:
        console.print(f"[red]failed[/red] {record['row']['agent']} seed {record['row']['seed']}: {record['error']}")
    console.print()
    for path in [*paths, out / "results.json"]:
        console.print(f"  {path}", highlight=False)
    console.print()
    return summary
