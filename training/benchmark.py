"""`nbv-gym bench`: how fast the parts are, where a step's time goes, and how peers compare.

A case is a piece of work with one or more contestants that all do the same. They run in turns, again and again, so
that a busy machine slows all of them; rates are medians over the rounds, a ratio is the median of the rounds' ratios.
A peer is one more contestant of a case: see `benchmark_peers.py`.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from . import benchmark_cases
from .benchmark_peers import RATIOS
from .evaluate import versions
from .shards import write_whole
from .terminal import bar

OURS = "nbv-gym"


@dataclass
class Case:
    """Contestants by name; each call does `work` units and returns nothing. `key` names the JSON file's ratio."""

    name: str
    unit: str
    work: float
    contestants: dict[str, Callable[[], object]]
    #: Ratio of ours to the first peer.
    key: str | None = None
    #: Wall-clock time for work on several threads, else the process' CPU time, which a busy machine disturbs less.
    wall: bool = False
    rounds: int = 9
    #: A contestant whose time is part of the peers' and is deducted from theirs.
    overhead: str | None = None
    #: The share of `work` that slow contestants do in a round.
    shares: dict[str, float] = field(default_factory=dict)
    close: Callable[[], None] | None = None
    rates: dict[str, list[float]] = field(default_factory=dict)

    def run(self) -> None:
        clock = time.perf_counter if self.wall else time.process_time
        self.rates = {name: [] for name in self.contestants}
        for turn in range(self.rounds + 1):
            for name, work in self.contestants.items():
                started = clock()
                work()
                seconds = max(clock() - started, 1e-9)
                # The first turn warms caches up.
                if turn:
                    self.rates[name].append(self.work * self.shares.get(name, 1.0) / seconds)

    def rate(self, name: str) -> float:
        return median(self.rates[name])

    @property
    def peer(self) -> str | None:
        """The first peer."""
        return next((name for name in self.contestants if name not in (OURS, self.overhead)), None)

    def ratio(self, peer: str, deduct: bool = True) -> float:
        theirs = self.rates[peer]
        if deduct and self.overhead is not None:
            # Rates are work per time: 1 / rate is time. Noise may make the rest nothing or less.
            theirs = [1 / max(1 / a - 1 / b, 1e-12) for a, b in zip(theirs, self.rates[self.overhead], strict=True)]
        return median(a / b for a, b in zip(self.rates[OURS], theirs, strict=True))


def bench(quick: bool, json_file: Path | None, seed: int, console: Console) -> dict[str, Any]:
    """Measure, print, and write; returns what is written."""
    cases: list[Case] = []
    with bar(console) as progress:
        work = progress.add_task("Preparing", total=None)
        bench_set = benchmark_cases.Cases(quick, seed)
        makers = bench_set.makers()
        progress.update(work, total=len(makers) + 1)
        for name, make in makers.items():
            progress.update(work, description=name)
            made = make()
            for case in made if isinstance(made, list) else [made]:
                if quick:
                    case.rounds = min(case.rounds, 5)
                try:
                    case.run()
                finally:
                    if case.close is not None:
                        case.close()
                cases.append(case)
            progress.advance(work)
        progress.update(work, description="Stages and memory")
        stages, memory, history = bench_set.stages(), bench_set.memory(), bench_set.view_history()
        progress.advance(work)
    result = {
        "versions": {**versions(), **bench_set.peers.versions},
        "machine": machine(),
        "quick": quick,
        "figures": {c.name: {n: {"rate": c.rate(n), "unit": c.unit} for n in c.contestants} for c in cases},
        "stages_microseconds_per_step": stages,
        "memory": memory,
        "view_history": history,
        "ratios": ratios(cases),
        "missing": missing(bench_set.peers.missing, cases),
        "depth_disagreement": bench_set.disagreement,
    }
    show(result, cases, console)
    if json_file is not None:
        write_whole(json_file, json.dumps(result, indent=1) + "\n")
        console.print(f"  {json_file}", highlight=False)
    return result


def ratios(cases: list[Case]) -> dict[str, float]:
    """Ours to the first peer, by key; with a deducted overhead also without the deduction."""
    found = {}
    for case in cases:
        if case.key is not None and case.peer is not None:
            found[case.key] = case.ratio(case.peer)
            if case.overhead is not None:
                found[f"{case.key}_with_binding"] = case.ratio(case.peer, deduct=False)
    return found


def missing(reasons: dict[str, str], cases: list[Case]) -> dict[str, Any]:
    """Which peers are not there and why, and the ratios that are not there for it."""
    return {"peers": reasons, "ratios": sorted(set(RATIOS) - set(ratios(cases)))}


def show(result: dict[str, Any], cases: list[Case], console: Console) -> None:
    peers = list(dict.fromkeys(name for case in cases for name in case.contestants if name != OURS))
    table = Table(title="Speed, and the size of a view history", title_justify="left", title_style="bold", box=None, padding=(0, 1))
    table.add_column("case", no_wrap=True)
    for name in (OURS, *peers):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    if peers:
        table.add_column("times as fast", justify="right", no_wrap=True)
    for case in cases:
        rates = [f"{case.rate(n):,.3g}" if n in case.contestants else "" for n in (OURS, *peers)]
        rates = [r if "e" not in r else f"{case.rate(n):,.0f}" for r, n in zip(rates, (OURS, *peers), strict=True)]
        times = [f"{case.ratio(case.peer):.1f}"] if case.peer else []
        table.add_row(case.name, *rates, case.unit, *times)
    history = result["view_history"]
    name = f"view history: {history['views']} views, {history['resolution'] * 100:.0f} cm"
    table.add_row(name, f"{history['bytes_per_seen_voxel']:,.3g}", *[""] * len(peers), "bytes per seen voxel")
    console.print()
    console.print(table)
    stages = result["stages_microseconds_per_step"]
    total = sum(stages.values())
    table = Table(title="\nA step of dome_room, by stage", title_justify="left", title_style="bold", box=None, padding=(0, 1))
    table.add_column("stage")
    table.add_column("µs", justify="right")
    table.add_column("share", justify="right")
    for stage, microseconds in stages.items():
        table.add_row(stage, f"{microseconds:.1f}", f"{microseconds / total * 100:.0f} %")
    table.add_row("all", f"{total:.1f}", "", style="bold")
    console.print(table)
    for package, why in result["missing"]["peers"].items():
        console.print(f"[yellow]{package} is missing:[/] {why}", highlight=False)
    for name, share in result["depth_disagreement"].items():
        console.print(f"Depths that differ from Open3D's by over 1 mm, {name}: {share:.2g} of the pixels", highlight=False)
    memory = result["memory"]
    text = f"\nMemory per environment: map {memory['map_bytes'] / 1e6:.2f} MB after {memory['views']} views"
    if memory["process_bytes"] is not None:
        grown = ", ".join(f"{count}: {grown / 1e6:.0f} MB" for count, grown in memory["process_bytes"].items())
        text += f"; a process grows with environments by {grown}"
    console.print(text + "\n", highlight=False)


def machine() -> dict[str, Any]:
    """What figures depend on."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    return {"cpu": model, "cores": os.cpu_count(), "numpy": np.__version__}
