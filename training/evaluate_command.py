"""`nbv-gym evaluate`: the run with its progress bar, table and picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from . import figures
from .evaluate import Record, finished, run, write_results
from .manifest import Row
from .report import per_planner, table
from .terminal import bar


def evaluate_command(rows: Sequence[Row], json_file: Path, out: Path | None, resume: bool, processes: int, console: Console) -> int:
    """Run, print, write; returns how many episodes failed."""
    episodes = len({row.seed for row in rows})
    shards = json_file.with_name(json_file.name + ".shards")
    json_file.parent.mkdir(parents=True, exist_ok=True)
    with bar(console) as progress:
        work = progress.add_task("Episodes", total=len(rows))

        def note(row: Row, record: Record) -> None:
            progress.update(work, advance=1, description=f"{row.agent}, seed {row.seed}")

        try:
            records = run(rows, shards, processes, resume, progress=note)
        except KeyboardInterrupt:
            kept = finished(shards, rows)
            write_results(json_file, kept, interrupted=True)
            console.print(f"{len(kept)} of {len(rows)} episodes are in {json_file}; go on with --resume", highlight=False)
            raise
        progress.update(work, description="Episodes")
    summary = write_results(json_file, records)
    places = list(dict.fromkeys((entry["task"], entry["scene"]) for entry in summary))
    for number, (task, scene) in enumerate(places):
        entries = [entry for entry in summary if (entry["task"], entry["scene"]) == (task, scene)]
        title = task + (f" in {scene}" if scene else "")
        console.print()
        console.print(table(entries, f"{title}: {per_planner(episodes)}, mean ± 95 % confidence interval"))
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            name = "coverage.png" if len(places) == 1 else f"coverage_{number}.png"
            figures.save_curves(out / name, entries, title, f"{per_planner(episodes)}, mean and 95 % interval")
            console.print(f"\n  {out / name}", highlight=False)
    failed = [record for record in records if record["status"] != "ok"]
    for record in failed:
        row = record["row"]
        console.print(f"[red]failed[/red] {row['task']} {row['agent']} seed {row['seed']}: {record['error']}", highlight=False)
    console.print(f"  {json_file}\n", highlight=False)
    return len(failed)
