"""The experiments of Wang et al. 2019 (RA-L), section VI: rooms x methods x runs, and what came of them beside the paper's figures.

The paper's four synthetic rooms came from SUNCG, which was withdrawn: four generated rooms take their place, with ever more pieces in
them. Its five real rooms were recorded in the authors' institute: scenes of the user's stand for them, with the noise of the
paper's sensor.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from ..agents.wang2019 import LEARNT, POLICIES
from ..rust_env import SCENE_KINDS
from .evaluate import Record, finished, run, write_results
from .illustrated_report import write_report
from .manifest import ORACLE, Row, check
from .shards import write_whole
from .terminal import bar
from .wang2019_figures import method_of, name_of
from .wang2019_paper import ROOMS, TABLE
from .wang2019_report import draw, report

TASK, NOISY_TASK = "wang2019", "wang2019_kinect"
METHODS = (*POLICIES, ORACLE)


@dataclass(frozen=True)
class Size:
    """How much is run."""

    seeds: int
    #: Steps of an episode; None: the task's 130.
    steps: int | None
    #: Side of a voxel, metres; None: the task's 2.5 cm.
    resolution: float | None


FULL = Size(seeds=5, steps=None, resolution=None)
#: A few minutes.
QUICK = Size(seeds=2, steps=40, resolution=0.1)


@dataclass(frozen=True)
class Experiment:
    """What is run.

    Attributes:
        rooms: Generated scenes, without noise.
        scenes: Scene files, with the noise of a Kinect v1.
        methods: Names in :data:`METHODS`.
        seeds: One run each.
        steps: Of an episode; None: the task's.
        resolution: Side of a voxel, metres; None: the task's.
        weights: Checkpoint of the CNN; "": the one that comes with the package.
        robot: "flying", or "arm" as in the paper's real rooms; None: the task's, which flies.
    """

    rooms: tuple[str, ...]
    scenes: tuple[str, ...]
    methods: tuple[str, ...]
    seeds: tuple[int, ...]
    steps: int | None
    resolution: float | None
    weights: str = ""
    robot: str | None = None

    def rows(self) -> list[Row]:
        """One row per scene, method and seed; seeds outermost, so that an interrupted run has seen every scene and method.

        Raises:
            ValueError, OSError: What can be known to be wrong before anything runs; the message names the value.
            ImportError: The CNN is asked for and torch is not installed.
        """
        if not (self.rooms or self.scenes) or not self.methods or not self.seeds:
            raise ValueError("name at least one room or scene, one method and one seed")
        unknown = [m for m in self.methods if m not in METHODS]
        if unknown:
            raise ValueError(f"there is no method {', '.join(unknown)}; known are {', '.join(METHODS)}")
        for room in self.rooms:
            kind, _, number = room.partition(":")
            if room.isdecimal():
                raise ValueError(f"room {room!r} lacks its kind: write room:{room}")
            if kind in SCENE_KINDS and not number.isdecimal():
                raise ValueError(f"room {room!r} must be one scene, such as {kind}:7; all runs share its dome")
        places = [(TASK, room) for room in self.rooms] + [(NOISY_TASK, scene) for scene in self.scenes]
        first = [
            Row(task, self.agent(m), scene, 0, self.steps, self.resolution, self.robot) for task, scene in places for m in self.methods
        ]
        for row in first:
            check(row)
        return [replace(row, seed=seed) for seed in self.seeds for row in first]

    def agent(self, method: str) -> str:
        return f"{method}:weights={self.weights}" if self.weights and method in LEARNT else method


def reproduce(experiment: Experiment, out: Path, resume: bool, processes: int, console: Console) -> int:
    """Run what is not yet in `out`, write `results.json`, `report.md`, `report.html` and the pictures; returns how many episodes failed.

    Episodes are kept in `out/episodes` as they finish. The same episodes give the same results, whatever the number of processes.

    Raises:
        ValueError, OSError, ImportError: See :meth:`Experiment.rows`; nothing has run then.
        OSError: `out` cannot be written.
    """
    rows = experiment.rows()
    out.mkdir(parents=True, exist_ok=True)
    shards = out / "episodes"
    with bar(console) as progress:
        work = progress.add_task("Episodes", total=len(rows))

        def note(row: Row, record: Record) -> None:
            place = Path(row.scene or "").name
            progress.update(work, advance=1, description=f"{place} {name_of(row.agent.split(':')[0])}, seed {row.seed}")

        try:
            records = run(rows, shards, processes, resume, progress=note)
        except KeyboardInterrupt:
            console.print(f"{len(finished(shards, rows))} of {len(rows)} episodes are in {shards}; go on with --resume", highlight=False)
            raise
        progress.update(work, description="Episodes")
    failed = [record for record in records if record["status"] != "ok"]
    for record in failed:
        row = record["row"]
        console.print(f"[red]failed[/red] {row['scene']} {row['agent']} seed {row['seed']}: {record['error']}", highlight=False)
    good = [record for record in records if record["status"] == "ok"]
    if not good:
        raise RuntimeError(f"all {len(records)} episodes failed; the first: {failed[0]['error']}")
    results = results_of(good)
    write_whole(out / "results.json", json.dumps(results, indent=1) + "\n")
    write_results(out / "episodes.json", records)
    pictures = draw(out, good, results, experiment.methods)
    for path in write_report(out, "Wang 2019 reproduced", report(results, good, experiment.methods, pictures)):
        console.print(f"  {path}", highlight=False)
    console.print(f"  {out / 'results.json'}\n", highlight=False)
    return len(failed)


def results_of(records: Sequence[Record]) -> list[dict[str, Any]]:
    """One row per scene, method and metric, in the order of the first record of each.

    Keys: `scene`, `method`, `metric` ("coverage" at the end, 0 to 1; "reconstruction_error", metres; "planning_ms", the median over a
    run's steps, since the first ones warm up), `mean` and `std` over the runs (n - 1; null for one run), `n`, and the paper's `paper` and
    `paper_std` (null where it prints none).
    """
    groups: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        groups.setdefault((record["row"]["scene"], method_of(record)), []).append(record)
    scenes = list(dict.fromkeys(scene for scene, _ in groups))
    methods = list(dict.fromkeys(method for _, method in groups))
    rows = []
    for scene in scenes:
        for method in methods:
            runs = groups.get((scene, method), [])
            values = {
                "coverage": [r["curves"]["coverage"][-1] for r in runs],
                "reconstruction_error": [r["reconstruction_error"] for r in runs if r["reconstruction_error"] is not None],
                "planning_ms": [float(np.median(r["planning_ms"])) for r in runs],
            }
            printed = TABLE[ROOMS[scene]].get(method) if scene in ROOMS else None
            for metric, found in values.items():
                if not found:
                    continue
                paper, paper_std = printed if printed is not None and metric == "coverage" else (None, None)
                rows.append(
                    {
                        "scene": scene,
                        "method": method,
                        "metric": metric,
                        "mean": float(np.mean(found)),
                        "std": float(np.std(found, ddof=1)) if len(found) > 1 else None,
                        "n": len(found),
                        "paper": paper,
                        "paper_std": paper_std,
                    }
                )
    return rows
