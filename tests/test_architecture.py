"""The walls of ARCHITECTURE.md, read from the imports."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
RUST = ROOT / "rust_env" / "src"
#: Lower layers first. A Python package may import packages before it, never after it.
LAYERS = ["rust_env", "envs", "agents", "training"]
#: Files that may name a learning library.
LEARNING = {"six_direction.py"}
FORBIDDEN_NAMES = re.compile(r"(^|_)(utils?|common|helpers?|base|manager)(_|\.|$)")


def crate_paths(file: Path) -> set[str]:
    """First path segments after `crate::` in a Rust file, comments and tests left out."""
    text = re.sub(r"//.*", "", file.read_text())
    text = text.split("#[cfg(test)]")[0]
    found = set(re.findall(r"\bcrate::(\w+)", text))
    for group in re.findall(r"\buse crate::\{([^}]*)\}", text):
        found |= {part.strip().split("::")[0] for part in group.split(",") if part.strip()}
    return found


def rust_files(folder: str) -> list[Path]:
    return sorted((RUST / folder).rglob("*.rs"))


def test_world_and_belief_do_not_know_each_other() -> None:
    worlds, beliefs = rust_files("world"), rust_files("belief")
    assert worlds and beliefs
    for file in worlds:
        assert not crate_paths(file) & {"belief", "episode", "simulator", "python"}, file
    for file in beliefs:
        assert not crate_paths(file) & {"world", "episode", "simulator", "python"}, file


def test_only_the_episode_and_what_stands_above_it_sees_both_wings() -> None:
    above = {"episode.rs", "simulator.rs", "metrics.rs", "setup.rs", "lib.rs"}
    for file in RUST.rglob("*.rs"):
        if file.is_relative_to(RUST / "python") or file.name in above or file.name == "tests.rs":
            continue
        if file.is_relative_to(RUST / "episode"):
            continue
        assert not {"world", "belief"} <= crate_paths(file), file


def test_common_ground_stands_on_nothing() -> None:
    ground = ("geometry.rs", "camera.rs", "capsule.rs", "arm.rs", "robot.rs", "error.rs", "fault.rs", "interrupt.rs")
    for name in ground:
        assert crate_paths(RUST / name) <= {"error", "geometry", "camera", "capsule", "arm"}, name


def test_python_is_named_only_behind_the_door() -> None:
    for file in RUST.rglob("*.rs"):
        if file.is_relative_to(RUST / "python") or file.name == "lib.rs":
            continue
        code = re.sub(r"//.*", "", file.read_text())
        assert not re.search(r"\b(pyo3|numpy)\b", code), file


def imports(file: Path) -> set[str]:
    """Absolute dotted names that a Python file of the package imports."""
    package = ["nbv_gym", *file.relative_to(ROOT).parent.parts]
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            names |= {f"{stem}.{alias.name}" for alias in node.names}
    return names


def python_files() -> list[Path]:
    return [file for layer in LAYERS for file in sorted((ROOT / layer).rglob("*.py"))]


@pytest.mark.parametrize("file", python_files(), ids=lambda f: str(f.relative_to(ROOT)))
def test_python_imports_run_downwards(file: Path) -> None:
    layer = LAYERS.index(file.relative_to(ROOT).parts[0])
    for name in imports(file):
        parts = name.split(".")
        if parts[0] == "nbv_gym" and len(parts) > 1 and parts[1] in LAYERS:
            assert LAYERS.index(parts[1]) <= layer, f"{file} imports {name}"
        if parts[0] in {"torch", "stable_baselines3", "sb3_contrib", "ray"}:
            assert LAYERS[layer] == "training" or file.name in LEARNING, f"{file} imports {name}"


def test_agents_cannot_reach_the_truth() -> None:
    for file in sorted((ROOT / "agents").rglob("*.py")):
        code = file.read_text()
        if file.name == "rollout.py":
            continue
        for truth in ("Simulator", "Scene", "true_gain", "truth_surface"):
            assert truth not in code, f"{file} names {truth}"


def test_names_say_what_a_file_is() -> None:
    files = [*RUST.rglob("*.rs"), *python_files()]
    assert len(files) > 30
    for file in files:
        assert not FORBIDDEN_NAMES.search(file.stem), file


def test_import_stays_light() -> None:
    heavy = "torch stable_baselines3 sb3_contrib ray rerun matplotlib typer rich PIL open3d".split()
    code = f"import sys, nbv_gym; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
