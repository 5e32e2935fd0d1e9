"""Runs a manifest of episodes, on one or more processes, and sums up what came of it.

The outcome of a row depends on nothing but the row: not on the number of processes, not on the order. Rows that fail
are recorded and do not stop the others.
"""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import platform
import signal
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..agents import StepRecord, rollout
from ..envs.env import NbvEnv
from ..envs.suite import TASKS
from ..rust_env import METRICS, STAGES
from .manifest import ORACLE, Row, keys, make_agent, robot_of, weights_digest
from .shards import ShardWriter, claimed, read_shards, write_whole
from .statistics import band, estimate

#: Version of the layout of records and of the JSON file.
LAYOUT = 1
#: Largest distance of a voxel to the true surface that is told from larger ones, metres.
FAR_OFF = 1.0
#: Seconds without a finished episode after which the workers are looked at.
LIVENESS = 2.0
Record: TypeAlias = dict[str, Any]
Observer: TypeAlias = Callable[[NbvEnv, StepRecord], None]


def open_env(row: Row) -> NbvEnv:
    """The environment of a row."""
    changes: dict[str, Any] = {}
    if row.scene is not None:
        changes["scene"] = row.scene
    if row.views is not None:
        changes["budget"] = row.views
    if row.resolution is not None:
        changes["resolution"] = row.resolution
    if row.robot is not None:
        changes["robot"] = robot_of(row)
    return NbvEnv(TASKS[row.task].variant(**changes))


def versions() -> dict[str, str]:
    """What a result may depend on besides its row."""
    packages = {name: version(name) for name in ("nbv-gym", "gymnasium", "numpy")}
    return {**packages, "python": platform.python_version(), "platform": f"{platform.system()}-{platform.machine()}"}


def run_row(row: Row, key: str | None = None, observer: Observer | None = None) -> Record:
    """Run one episode. Never raises for what goes wrong inside it: the record's `status` is then "failed"."""
    record: Record = {"layout": LAYOUT, "key": key or row.key(), "row": asdict(row), "versions": versions()}
    if (weights := weights_digest(row.agent)) is not None:
        record["weights_sha256"] = weights
    started = time.perf_counter()
    try:
        env = open_env(row)
        try:
            steps = rollout(env, make_agent(row.agent, env, row.seed), row.seed, observer)
            error = reconstruction_error(env)
        finally:
            env.close()
    except Exception as fault:
        text = f"{type(fault).__name__}: {fault}"
        return {**record, "status": "failed", "error": text, "traceback": traceback.format_exc()}
    outcome: Record = {
        "views": len(steps) - 1,
        "terminated": steps[-1].terminated,
        "truncated": steps[-1].truncated,
        "curves": {name: [step.metrics[name] for step in steps] for name in METRICS},
        "rewards": [step.reward for step in steps[1:]],
        "actions": [_plain(step.action) for step in steps[1:]],
        "viewpoints": [[float(x) for x in step.viewpoint] for step in steps],
        "reconstruction_error": error,
    }
    digest = hashlib.sha256(json.dumps(outcome, sort_keys=True).encode()).hexdigest()[:16]
    timing = {
        "planning_ms": [step.planning_ms for step in steps[1:]],
        "stage_ms": {stage: [step.stage_ms[stage] for step in steps[1:]] for stage in STAGES},
        "seconds": time.perf_counter() - started,
    }
    return {**record, "status": "ok", **outcome, "digest": digest, **timing}


def reconstruction_error(env: NbvEnv) -> float | None:
    """Mean distance in metres from the centres of the map's occupied voxels to the nearest true surface (visual or collision
    geometry; what moves does not count), each at most :data:`FAR_OFF`. None for a map without occupied voxels."""
    cloud = env.belief.octree.occupied()
    if not len(cloud):
        return None
    return float(env.simulator.scene(0).clearance(cloud, FAR_OFF).mean(dtype=np.float64))


def _plain(action: Any) -> Any:
    return action.tolist() if hasattr(action, "tolist") else action


def run(
    rows: Sequence[Row],
    folder: Path,
    processes: int = 1,
    resume: bool = False,
    observe: Callable[[Row], Observer | None] | None = None,
    progress: Callable[[Row, Record], None] | None = None,
) -> list[Record]:
    """Run the rows and keep their records in `folder`.

    Args:
        rows: what to run.
        folder: where the shards stand.
        processes: 1 works in this process, more in spawned ones.
        resume: take finished rows from `folder` instead of running them; failed ones are tried again.
        observe: what watches a row's episode, if anything; for one process only.
        progress: called once per row, in the order in which they finish.

    Returns:
        One record per row, in the order of the rows. An interrupt (Ctrl-C) is raised after everything finished is
        on disk.

    Raises:
        OSError: A record cannot be written; those before it are on disk.
        RuntimeError: Another process is writing to `folder`.
    """
    if processes < 1:
        raise ValueError(f"processes must be >= 1, got {processes}")
    with claimed(folder, fresh=not resume):
        return _run(rows, folder, processes, observe, progress)


def _run(
    rows: Sequence[Row],
    folder: Path,
    processes: int,
    observe: Callable[[Row], Observer | None] | None,
    progress: Callable[[Row, Record], None] | None,
) -> list[Record]:
    wanted = keys(rows)
    done: dict[str, Record] = {}
    for record in read_shards(folder):
        if record["status"] == "ok" and record["key"] in set(wanted):
            done[record["key"]] = record
    work: list[tuple[Row, str]] = []
    for row, key in zip(rows, wanted, strict=True):
        if key in done:
            if progress is not None:
                progress(row, done[key])
        elif key not in {k for _, k in work}:
            work.append((row, key))
    if work:
        with ShardWriter(folder) as shard:
            source = _here(work, observe) if processes == 1 else _spawned(work, processes)
            for row, record in source:
                shard.append(record)
                done[record["key"]] = record
                if progress is not None:
                    progress(row, record)
    return [done[key] for key in wanted]


def _here(work: Iterable[tuple[Row, str]], observe: Callable[[Row], Observer | None] | None) -> Iterator[tuple[Row, Record]]:
    for row, key in work:
        yield row, run_row(row, key, observe(row) if observe else None)


def _ignore_interrupts() -> None:
    # Ctrl-C reaches the whole process group; the parent alone decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _spawned(work: Sequence[tuple[Row, str]], processes: int) -> Iterator[tuple[Row, Record]]:
    """As many rows in flight as there are processes. A row whose process dies is tried once more, alone."""
    context = multiprocessing.get_context("spawn")
    waiting, alone = list(reversed(work)), list[tuple[Row, str]]()
    while waiting or alone:
        lonely = not waiting
        pool = ProcessPoolExecutor(1 if lonely else processes, mp_context=context, initializer=_ignore_interrupts)
        flying: dict[Future[Record], tuple[Row, str]] = {}
        try:
            queue = [alone.pop()] if lonely else waiting
            while queue or flying:
                while queue and len(flying) < processes:
                    item = queue.pop()
                    try:
                        flying[pool.submit(run_row, *item)] = item
                    except (BrokenPipeError, BrokenProcessPool) as error:
                        # Nothing may be lost here: the pool lets a broken pipe through if a worker dies before it has read
                        # what it is to do, and refuses a row if one has died since the last look.
                        flying[Future()] = item
                        raise BrokenProcessPool("a worker died") from error
                finished = wait(flying, timeout=LIVENESS, return_when=FIRST_COMPLETED).done
                if not finished and not all(process.is_alive() for process in _workers(pool)):
                    # The pool does not watch a worker that dies while it is being started, and the others may wait for ever
                    # for a lock that it held.
                    raise BrokenProcessPool("a worker died")
                for future in finished:
                    item = flying[future]
                    record = future.result()
                    del flying[future]
                    yield item[0], record
        except BrokenProcessPool:
            for process in _workers(pool):
                process.kill()
            for row, key in flying.values():
                if lonely:
                    yield row, _died(row, key)
                else:
                    alone.append((row, key))
        except BaseException:
            for process in _workers(pool):
                process.kill()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _workers(pool: ProcessPoolExecutor) -> list[multiprocessing.process.BaseProcess]:
    return list((getattr(pool, "_processes", None) or {}).values())


def _died(row: Row, key: str) -> Record:
    error = "the process that ran this episode died (out of memory, or killed)"
    return {
        "layout": LAYOUT,
        "key": key,
        "row": asdict(row),
        "versions": versions(),
        "status": "failed",
        "error": error,
    }


#: Columns of the table: name, metric of the last view or of the record, unit, factor, digits.
COLUMNS = (
    ("coverage", "coverage", "%", 100.0, 1),
    ("information", "information", "Σ(1-u)", 1.0, 0),
    ("entropy", "entropy", "kbit", 1e-3, 1),
    ("views", "views", "", 1.0, 1),
    ("travel", "path_length", "m", 1.0, 1),
)


def summarise(records: Sequence[Record]) -> list[Record]:
    """One entry per task, scene and agent, in the order of their first record: means, 95 % intervals, curves."""
    groups: dict[tuple[str, str | None, str], list[Record]] = {}
    for record in records:
        row = record["row"]
        groups.setdefault((row["task"], row["scene"], row["agent"]), []).append(record)
    summary = []
    for (task, scene, agent), members in groups.items():
        good = [r for r in members if r["status"] == "ok"]
        final = {name: estimate([r["curves"][name][-1] for r in good]) for name in METRICS}
        thinking = [ms for r in good for ms in r["planning_ms"]]
        entry: Record = {
            "task": task,
            "scene": scene,
            "agent": agent,
            "episodes": len(good),
            "failed": len(members) - len(good),
            "final": {name: _interval(e.mean, e.half) for name, e in final.items()},
            "return": _interval(*_mean_half([sum(r["rewards"]) for r in good])),
            "planning_ms": _interval(*_mean_half([sum(r["planning_ms"]) / max(len(r["planning_ms"]), 1) for r in good])),
            "planning_ms_max": max(thinking, default=None),
            "curves": {},
        }
        for name in ("coverage", "entropy", "information", "path_length"):
            mean, half = band([r["curves"][name] for r in good])
            entry["curves"][name] = {"mean": mean.tolist(), "ci95": half.tolist()}
        coverage = entry["curves"]["coverage"]["mean"]
        entry["mean_coverage_over_views"] = sum(coverage) / len(coverage) if coverage else None
        summary.append(entry)
    _relate_to_oracle(summary)
    return summary


def _relate_to_oracle(summary: list[Record]) -> None:
    best = {(e["task"], e["scene"]): e["final"]["coverage"]["mean"] for e in summary if e["agent"].split(":")[0] == ORACLE}
    for entry in summary:
        bound, own = best.get((entry["task"], entry["scene"])), entry["final"]["coverage"]["mean"]
        entry["coverage_of_oracle"] = own / bound if bound and own is not None else None


def _mean_half(values: Sequence[float]) -> tuple[float, float]:
    e = estimate(values)
    return e.mean, e.half


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _interval(mean: float, half: float) -> dict[str, float | None]:
    return {"mean": _finite(mean), "ci95": _finite(half)}


def write_results(path: Path, records: Sequence[Record], **facts: Any) -> list[Record]:
    """Write summary and episodes as one JSON file; returns the summary."""
    summary = summarise(records)
    content = {"layout": LAYOUT, "versions": versions(), **facts, "summary": summary, "episodes": list(records)}
    write_whole(path, json.dumps(content, indent=1) + "\n")
    return summary


def finished(folder: Path, rows: Sequence[Row]) -> list[Record]:
    """What is on disk for these rows, in their order; for results after an interrupt."""
    found = {record["key"]: record for record in read_shards(folder)}
    return [found[key] for key in keys(rows) if key in found]
