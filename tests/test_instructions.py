"""How many instructions the hot loops take: a check for regressions that a busy machine does not disturb.

`make instructions` runs this file alone, `make instructions RENEW=1` writes a new baseline. Counts depend on the
compiler and on the kernels that valgrind's processor runs (AVX2 at best), so that another compiler is no comparison.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import warnings
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BASELINE = ROOT / "rust_env" / "benches" / "instructions.json"
#: What `rust_env/benches/instructions.rs` does between its marks.
PARTS = ("render", "integrate", "view_gain")
#: More than this is a regression; as much less means that the baseline is out of date.
SLACK = 0.10


def run(*command: str, **environment: str) -> str:
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


def compiler() -> str:
    return run("rustc", "--version").strip()


def benchmark() -> str:
    """The benchmark's executable, built as a release is (incremental code is different code)."""
    told = run("cargo", "bench", "--bench", "instructions", "--no-run", CARGO_INCREMENTAL="0")
    found = re.search(r"Executable .*\((.*)\)", told)
    assert found, told
    return str(ROOT / found[1])


def count(folder: Path) -> tuple[str, dict[str, int]]:
    """The kernels that were run, and instructions by part."""
    out = folder / "callgrind"
    marks = "--dump-before=instruction_mark"
    told = run("valgrind", "--tool=callgrind", marks, f"--callgrind-out-file={out}", benchmark())
    sums = [int(found[1]) for i in range(1, 5) if (found := re.search(r"^totals: (\d+)", out.with_suffix(f".{i}").read_text(), re.M))]
    assert len(sums) == 1 + len(PARTS), told
    kernels = re.search(r"^(Portable|Avx2|Avx512)$", told, re.M)
    assert kernels, told
    return kernels[1], dict(zip(PARTS, sums[1:], strict=True))


def changes(counts: dict[str, int], baseline: dict[str, int]) -> dict[str, float]:
    """Relative change of the parts that left the slack."""
    relative = {part: counts[part] / baseline[part] - 1 for part in PARTS}
    return {part: change for part, change in relative.items() if abs(change) > SLACK}


def test_hot_loops_take_as_many_instructions_as_before(tmp_path: Path) -> None:
    for tool in ("cargo", "rustc", "valgrind"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    renew = os.environ.get("NBV_GYM_RENEW_INSTRUCTIONS") == "1"
    baseline = json.loads(BASELINE.read_text(encoding="utf-8"))
    if not renew and compiler() != baseline["rustc"]:
        pytest.skip(f"the baseline is for {baseline['rustc']}, this is {compiler()}")
    kernels, counts = count(tmp_path)
    if renew:
        new = {"rustc": compiler(), "kernels": kernels, "instructions": counts}
        BASELINE.write_text(json.dumps(new, indent=1) + "\n", encoding="utf-8")
        return
    if kernels != baseline["kernels"]:
        pytest.skip(f"the baseline is for {baseline['kernels']} kernels, this processor runs {kernels}")
    changed = changes(counts, baseline["instructions"])
    told = f"{changed}: {counts} against {baseline['instructions']}; to take them as the baseline: make instructions RENEW=1"
    assert all(change < 0 for change in changed.values()), told
    if changed:
        warnings.warn(told, stacklevel=1)


def test_a_tenth_more_is_found() -> None:
    baseline = dict.fromkeys(PARTS, 1000)
    assert changes({**baseline, "render": 1099, "integrate": 901}, baseline) == {}
    assert changes({**baseline, "render": 1101}, baseline).keys() == {"render"}
    assert changes({**baseline, "integrate": 899, "view_gain": 2000}, baseline).keys() == {"integrate", "view_gain"}
