"""The command line: help, output, errors."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from nbv_gym.rust_env import SCENE_KINDS, Scene
from nbv_gym.training import benchmark
from nbv_gym.training.cli import app
from nbv_gym.training.voxel_painter import VoxelPainter, uncertainty_colours

runner = CliRunner()


def ok(*arguments: str) -> str:
    result = runner.invoke(app, list(arguments))
    assert result.exit_code == 0, result.output
    return result.output


def refused(*arguments: str) -> str:
    result = runner.invoke(app, list(arguments))
    assert result.exit_code == 2, result.output
    return result.output


@pytest.mark.parametrize(
    "command",
    [
        "demo",
        "evaluate",
        "bench",
        "view",
        "scenes",
        "scenes info",
        "scenes generate",
        "scenes sheet",
        "scenes cache",
        "dataset",
        "dataset six-directions",
        "train",
        "train cnn",
        "reproduce",
        "reproduce wang2019",
    ],
)
def test_help_has_examples(command: str) -> None:
    text = ok(*command.split(), "--help")
    assert "nbv-gym" in text
    assert "--help" in text


def test_help_is_quick_to_import() -> None:
    heavy = "matplotlib PIL torch gymnasium nbv_gym.rust_env.nbv_core".split()
    # The root package registers environments and so imports gymnasium; the command line adds nothing heavy.
    code = (
        "import sys, nbv_gym; before = set(sys.modules); import nbv_gym.training.cli;"
        f"print([m for m in {heavy!r} if m in set(sys.modules) - before])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_version() -> None:
    assert ok("--version").startswith("nbv-gym 0.")


def test_scenes_list_names_every_kind() -> None:
    text = ok("scenes", "list")
    for kind in SCENE_KINDS:
        assert kind in text


def test_scene_info_as_json() -> None:
    facts = json.loads(ok("scenes", "info", "room:7", "--json"))
    scene = Scene.generate("room", 7)
    assert facts["visual"]["triangles"] == len(scene.triangles)
    assert facts["collision"]["triangles"] == len(scene.collision_triangles)
    assert np.allclose(facts["bounds"], scene.bounds, atol=1e-4)
    assert facts["warnings"] == facts["missing"] == []
    for key in ("name", "floor", "instances", "load_milliseconds", "visual_bounds", "collision_bounds"):
        assert key in facts
    for which in ("visual", "collision"):
        assert facts[which]["triangles_read"] >= facts[which]["triangles"]


def test_scene_info_for_people() -> None:
    text = ok("scenes", "info", "room:7")
    assert "triangles" in text
    assert "floor" in text


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_generated_meshes_can_be_read(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"room{suffix}"
    ok("scenes", "generate", "room", "--seed", "3", "--out", str(file))
    read, made = Scene.load(file), Scene.generate("room", 3)
    assert len(read.triangles) == len(made.triangles)
    assert np.allclose(read.bounds, made.bounds, atol=1e-4)
    again = tmp_path / f"again{suffix}"
    ok("scenes", "generate", "room", "--seed", "3", "--out", str(again))
    assert again.read_bytes() == file.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ("scenes info missing.world", "missing.world"),
        ("scenes info room:x", "'x' is not a seed"),
        ("scenes generate castle --out castle.ply", "castle"),
        ("scenes generate room --out room.stl", ".ply or .obj"),
        ("evaluate --agents nobody", "there is no agent 'nobody'"),
        ("evaluate --task nowhere", "there is no task 'nowhere'"),
        ("evaluate --scene missing.world", "missing.world"),
        ("evaluate --agents ,", "at least one task and one agent"),
        ("evaluate --resolution 0", "resolution must be finite and > 0 m, got 0"),
        ("evaluate --agents infogain", "needs a map with a view history"),
        ("demo --scene missing.world", "missing.world"),
        ("view missing.json", "missing.json"),
        ("view room:7 --out room.svg", ".png"),
    ],
)
def test_errors_are_one_line(arguments: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [line for line in refused(*arguments.split()).splitlines() if line.strip()]
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    assert text in lines[0]


def test_debug_shows_where_it_comes_from() -> None:
    result = runner.invoke(app, ["--debug", "evaluate", "--agents", "nobody"])
    assert isinstance(result.exception, ValueError)
    runner.invoke(app, ["--version"])
    assert refused("evaluate", "--agents", "nobody").startswith("error: ")


def test_wrong_options_are_refused() -> None:
    assert "--seeds" in refused("evaluate", "--seeds", "0")


def test_evaluate_writes_what_it_says(tmp_path: Path) -> None:
    out = tmp_path / "out"
    text = ok(*f"evaluate --task tabletop --agents greedy,random --scene tabletop:0 --seeds 2 --views 2 --out {out}".split())
    assert "greedy gain" in text
    content = json.loads((out / "results.json").read_text())
    assert len(content["episodes"]) == 4
    assert [entry["agent"] for entry in content["summary"]] == ["greedy", "random"]
    assert len(content["summary"][0]["curves"]["coverage"]["mean"]) == 3
    assert Image.open(out / "coverage.png").size[0] > 800
    gif = tmp_path / "again.gif"
    ok("view", str(out / "results.json"), "--episode", "1", "--out", str(gif))
    with Image.open(gif) as film:
        assert film.n_frames == 3  # type: ignore[attr-defined]
    assert "there is no 9" in refused("view", str(out / "results.json"), "--episode", "9")


def test_a_failed_episode_is_exit_code_one(tmp_path: Path) -> None:
    broken = tmp_path / "broken.obj"
    broken.write_text("f 1 2 3\n")
    arguments = f"evaluate --task tabletop --agents random --scene {broken} --seeds 1 --json {tmp_path / 'r.json'}"
    result = runner.invoke(app, arguments.split())
    assert result.exit_code == 1
    assert "failed" in result.output


def test_view_draws_a_scene(tmp_path: Path) -> None:
    file = tmp_path / "scene.png"
    ok("view", "room:7", "--out", str(file), "--resolution", "0.1")
    picture = np.asarray(Image.open(file).convert("RGB"))
    assert (picture != 255).any(axis=2).mean() > 0.2, "mostly paper"


def test_demo_writes_every_picture(tmp_path: Path) -> None:
    text = ok("demo", "--seeds", "1", "--views", "2", "--out", str(tmp_path))
    for name in ("greedy gain", "nearest frontier", "random", "oracle"):
        assert name in text
    room = tmp_path / "room"
    for name in ("coverage.png", "plan.png", "depth_images.png", "map.gif", "results.json"):
        assert (room / name).stat().st_size > 1000, name
    with Image.open(room / "map.gif") as film:
        assert film.n_frames == 3  # type: ignore[attr-defined]
    content = json.loads((room / "results.json").read_text())
    assert {entry["agent"] for entry in content["summary"]} == {"greedy", "nearest_frontier", "random", "oracle"}


def test_ratios_are_medians_over_rounds() -> None:
    speeds = iter([9.0, 9.0, 1.0, 4.0, 2.0, 4.0, 3.0, 12.0])
    clock = [0.0]

    def work() -> None:
        clock[0] += next(speeds)

    case = benchmark.Case("case", "units/s", 12.0, {benchmark.OURS: work, "peer": work}, rounds=3)
    original = benchmark.time.process_time
    benchmark.time.process_time = lambda: clock[0]  # type: ignore[assignment]
    try:
        case.run()
    finally:
        benchmark.time.process_time = original
    assert case.rates[benchmark.OURS] == [12.0, 6.0, 4.0]
    assert case.rate("peer") == 3.0
    assert case.ratio("peer") == 4.0


class OneVoxel:
    """A map with one occupied voxel in known free space."""

    def occupied(self) -> np.ndarray:
        return np.array([[0.55, 0.55, 0.55]], np.float32)

    def occupied_uncertainty(self) -> np.ndarray:
        return np.array([0.0], np.float32)

    def classify(self, points: np.ndarray) -> np.ndarray:
        return (np.abs(points - 0.55) < 0.01).all(axis=1).astype(np.int8)


def test_the_painter_puts_a_voxel_where_it_projects() -> None:
    painter = VoxelPainter(np.array([[0.0] * 3, [1.1] * 3]), 0.1, (400, 320))
    picture = np.asarray(painter.paint(OneVoxel()))  # type: ignore[arg-type]
    ink = np.argwhere((picture < 200).any(axis=2))
    x, y = painter.project(np.array([[0.55, 0.55, 0.55]]))[0]
    assert np.allclose(ink.mean(axis=0), [y, x], atol=1.5)
    green = picture[round(y), round(x)].astype(int)
    assert green[1] > green[0] + 40
    assert (picture[0, 0] == 255).all()


def test_colours_run_from_red_to_green() -> None:
    red, green = uncertainty_colours(np.array([1.0, 0.0]))
    assert red[0] > red[1]
    assert green[1] > green[0]
