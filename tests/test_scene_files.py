"""Scene files from Python: search paths of the environment, strict mode, the cache on disk between processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nbv_gym.rust_env import Scene

BOX = "<geometry><box><size>2 4 6</size></box></geometry>"
CRATE = f"<model name='m'><link name='l'><visual name='v'>{BOX}</visual></link></model>"
MODEL = f"<sdf version='1.6'>{CRATE}</sdf>"
MESH = "<visual name='w'><geometry><mesh><uri>model://none/none.dae</uri></mesh></geometry></visual>"


def world(folder: Path, content: str) -> Path:
    file = folder / "worlds" / "a.world"
    file.parent.mkdir(exist_ok=True)
    file.write_text(f"<sdf version='1.6'><world name='w'>{content}</world></sdf>")
    return file


def info(file: Path, *options: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "nbv_gym", "scenes", "info", str(file), "--json", *options]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment}, timeout=120)


def facts(file: Path, **environment: str) -> dict[str, Any]:
    done = info(file, **environment)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("variable", ["GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH"])
def test_models_are_found_by_the_environment(tmp_path: Path, variable: str) -> None:
    model = tmp_path / "elsewhere" / "crate" / "model.sdf"
    model.parent.mkdir(parents=True)
    model.write_text(MODEL)
    file = world(tmp_path, f"<include><uri>model://crate</uri></include>{CRATE}")
    cache = {"NBV_GYM_CACHE": str(tmp_path / "cache")}
    assert facts(file, **cache)["missing"] == ["model://crate"]
    folders = os.pathsep.join([str(tmp_path / "nowhere"), str(tmp_path / "elsewhere")])
    found = facts(file, **cache, **{variable: folders})
    # Another environment is another entry of the cache.
    assert (found["missing"], found["instances"], found["cache"]) == ([], 2, "new")


def test_the_cache_serves_another_process(tmp_path: Path) -> None:
    file = world(tmp_path, CRATE)
    cache = {"NBV_GYM_CACHE": str(tmp_path / "cache")}
    first, second = facts(file, **cache), facts(file, **cache)
    assert (first["cache"], second["cache"]) == ("new", "read")
    for timed in ("cache", "load_milliseconds", "total_milliseconds"):
        del first[timed], second[timed]
    assert first == second
    assert facts(file, NBV_GYM_CACHE="off")["cache"] == ""
    tool = [sys.executable, "-m", "nbv_gym", "scenes", "cache"]
    for options, words in ((["--clear"], "1 entries removed"), ([], "0 entries")):
        done = subprocess.run([*tool, *options], capture_output=True, text=True, env={**os.environ, **cache}, timeout=120)
        assert words in done.stdout, done.stdout + done.stderr


def test_two_processes_may_write_at_once(tmp_path: Path) -> None:
    file = world(tmp_path, CRATE)
    code = f"from nbv_gym.rust_env import Scene; s = Scene.load({str(file)!r}); print(s.triangles.sum(), s.report['cache'])"
    environment = {**os.environ, "NBV_GYM_CACHE": str(tmp_path / "cache")}
    running = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment) for _ in range(3)]
    answers = [process.communicate(timeout=120)[0].split() for process in running]
    assert [process.returncode for process in running] == [0, 0, 0]
    assert len({total for total, _ in answers}) == 1
    assert {note for _, note in answers} <= {"new", "read"}
    assert len(list((tmp_path / "cache").glob("*.nbv"))) == 1
    assert not list((tmp_path / "cache").glob("*.draft"))


def test_strict_makes_an_error_of_what_is_missing(tmp_path: Path) -> None:
    file = world(tmp_path, CRATE.replace("</link>", f"{MESH}</link>"))
    assert Scene.load(file).report["missing"] == ["model://none/none.dae"]
    with pytest.raises(ValueError, match="model://none/none.dae"):
        Scene.load(file, strict=True)
    done = info(file, "--strict")
    assert done.returncode != 0
    assert "model://none/none.dae" in done.stderr + done.stdout


def test_a_loaded_scene_is_shared_until_a_file_changes(tmp_path: Path) -> None:
    mesh = tmp_path / "models" / "crate" / "model.sdf"
    mesh.parent.mkdir(parents=True)
    mesh.write_text(MODEL)
    file = world(tmp_path, "<include><uri>model://crate</uri></include>")
    before = Scene.load(file)
    assert np.ptp(before.triangles[..., 0]) == 2
    # The world file stays as it is.
    mesh.write_text(MODEL.replace("2 4 6", "3 4 6"))
    assert np.ptp(Scene.load(file).triangles[..., 0]) == 3


def test_the_sheet_shows_every_kind(tmp_path: Path) -> None:
    from PIL import Image

    from nbv_gym.training.scene_sheet import GAP, HEAD, SIDE, save_scene_sheet

    save_scene_sheet(tmp_path / "sheet.png", ["room", "tabletop"], [0])
    with Image.open(tmp_path / "sheet.png") as picture:
        assert picture.size == (2 * (SIDE + GAP) + GAP, 2 * (SIDE + GAP + HEAD) + GAP)
        pixels = np.asarray(picture.convert("L"), dtype=float)
    for row in range(2):
        for column in range(2):
            y, x = GAP + HEAD + row * (SIDE + GAP + HEAD), GAP + column * (SIDE + GAP)
            assert pixels[y : y + SIDE, x : x + SIDE].std() > 10, (row, column)
    done = subprocess.run(
        [sys.executable, "-m", "nbv_gym", "scenes", "sheet", "--out", "x.gif"], capture_output=True, text=True, timeout=120
    )
    assert done.returncode != 0
    assert ".png or .jpg" in done.stdout + done.stderr
