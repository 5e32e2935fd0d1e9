"""An evaluation that is killed, starved or crowded loses at most the episode in flight, and its results stay whole."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nbv_gym.rust_env import Octree
from nbv_gym.training import evaluate
from nbv_gym.training.evaluate import run
from nbv_gym.training.manifest import grid
from nbv_gym.training.shards import claimed, read_shards

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")
SCENE = "tabletop:0"
SEEDS = 3


def command(target: Path, *more: str) -> list[str]:
    main = "from nbv_gym.training.cli import main; main()"
    arguments = f"evaluate --task tabletop --agents random,greedy --seeds {SEEDS} --views 2 --scene {SCENE}".split()
    return [sys.executable, "-c", main, *arguments, "--json", str(target), *more]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("expected")
    return [r["digest"] for r in run(grid(["tabletop"], ["random", "greedy"], [SCENE], range(SEEDS), 2), folder)]


def digests(target: Path) -> list[str]:
    return [record["digest"] for record in json.loads(target.read_text())["episodes"]]


def wait_for(what: Any, process: subprocess.Popen[Any]) -> Any:
    deadline = time.monotonic() + 120
    while not (found := what()):
        assert process.poll() is None, "it ended too early"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return found


def workers(parent: int) -> list[int]:
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [int(c) for c in children if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_killed_worker_costs_nothing(tmp_path: Path, expected: list[str]) -> None:
    target = tmp_path / "r.json"
    process = subprocess.Popen(command(target, "--processes", "2"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        os.kill(wait_for(lambda: workers(process.pid), process)[0], signal.SIGKILL)
        assert process.wait(timeout=240) == 0
    finally:
        process.kill()
        process.wait()
    assert digests(target) == expected


@pytest.mark.parametrize("error", [BrokenPipeError, BrokenProcessPool])
@pytest.mark.parametrize("call", [0, 1, 3])
def test_a_worker_that_dies_while_it_starts_costs_nothing(
    error: type[Exception], call: int, tmp_path: Path, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pool raises where a row is handed over; which of the errors depends on the instant of the death."""
    calls = itertools.count()

    class Dying(ProcessPoolExecutor):
        def submit(self, *args: Any, **kwargs: Any) -> Any:
            if next(calls) == call:
                raise error("a worker died")
            return super().submit(*args, **kwargs)

    monkeypatch.setattr(evaluate, "ProcessPoolExecutor", Dying)
    rows = grid(["tabletop"], ["random", "greedy"], [SCENE], range(SEEDS), 2)
    assert [r["digest"] for r in run(rows, tmp_path, processes=2)] == expected


def limited(target: Path, size: int, *more: str) -> subprocess.CompletedProcess[str]:
    """The evaluation on a disk on which no file may grow beyond `size` bytes."""
    import resource

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return subprocess.run(command(target, *more), capture_output=True, text=True, timeout=240, preexec_fn=limit)


def test_a_full_disk_is_said_and_damages_nothing(tmp_path: Path, expected: list[str]) -> None:
    target = tmp_path / "r.json"
    target.write_text("an earlier result")
    line = run(grid(["tabletop"], ["random"], [SCENE], [0], 2), tmp_path / "one")
    assert line[0]["digest"] == expected[0]
    size = next((tmp_path / "one").glob("*.jsonl")).stat().st_size
    done = limited(target, int(2.5 * size))
    assert done.returncode == 2, done
    assert done.stderr.strip().splitlines()[-1].startswith("error:") and "too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert target.read_text() == "an earlier result"
    kept = len(list(read_shards(tmp_path / "r.json.shards")))
    assert 1 <= kept < 2 * SEEDS
    subprocess.run(command(target, "--resume"), check=True, capture_output=True, timeout=240)
    assert digests(target) == expected
    assert len(list(read_shards(tmp_path / "r.json.shards"))) == 2 * SEEDS, "what was finished is not run again"
    # The summary itself does not fit: the old one stays.
    before = target.read_text()
    assert limited(target, size, "--resume").returncode == 2
    assert target.read_text() == before
    assert not list(tmp_path.glob(".*part"))


def test_a_map_that_does_not_fit_leaves_the_old_one(tmp_path: Path) -> None:
    octree = Octree(0.05)
    octree.insert_points(np.random.default_rng(0).uniform(-2, 2, (3000, 3)), [0, 0, 0])
    octree.write(tmp_path / "map.ot")
    before = (tmp_path / "map.ot").read_bytes()
    code = f"""
import resource
from nbv_gym.rust_env import Octree
octree = Octree.read({str(tmp_path / "map.ot")!r})
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
try:
    octree.write({str(tmp_path / "map.ot")!r})
except OSError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "map.ot" in done.stdout and "too large" in done.stdout, done
    assert (tmp_path / "map.ot").read_bytes() == before
    assert [f.name for f in tmp_path.iterdir()] == ["map.ot"]


@pytest.mark.parametrize("where", ["file/r.json", "/proc/nbv/r.json"])
def test_a_folder_that_cannot_be_written_is_named(where: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    if where.startswith("/proc") and sys.platform != "linux":
        pytest.skip("there is no /proc")
    target = tmp_path / where
    done = subprocess.run(command(target), capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert str(target.parent) in " ".join(done.stderr.split()), done.stderr


def test_two_evaluations_do_not_share_a_folder(tmp_path: Path, expected: list[str]) -> None:
    target = tmp_path / "r.json"
    shards = tmp_path / "r.json.shards"
    rows = grid(["tabletop"], ["random"], [SCENE], [0], 2)
    with claimed(shards, fresh=True):
        for more in ((), ("--resume",)):
            done = subprocess.run(command(target, *more), capture_output=True, text=True, timeout=120)
            assert done.returncode == 2 and "another process" in " ".join(done.stderr.split())
        with pytest.raises(RuntimeError, match="another process"):
            run(rows, shards)
    # The claim ends with its holder, and also when that one is killed.
    process = subprocess.Popen(command(target), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_for(lambda: list(read_shards(shards)), process)
    process.kill()
    process.wait()
    kept = list(read_shards(shards))
    subprocess.run(command(target, "--resume"), check=True, capture_output=True, timeout=240)
    assert digests(target) == expected
    assert [r["digest"] for r in read_shards(shards)].count(kept[0]["digest"]) == 1
