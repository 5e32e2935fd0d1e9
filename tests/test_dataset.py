"""The six-direction data set: directions, labels, files, what scenes can give."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from nbv_gym.agents.agent import rotation
from nbv_gym.agents.six_direction import DIRECTIONS, LABELS, MIRRORED
from nbv_gym.rust_env import Camera, Scene
from nbv_gym.training import dataset
from nbv_gym.training.cli import app
from nbv_gym.training.dataset import Spec, generate, load, split_scenes

runner = CliRunner()
#: Labels need only be counted, not good.
TINY: dict[str, Any] = {"views": 12, "width": 24, "height": 18, "resolution": 0.1, "per_scene": 1}


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("six") / "set"
    generate(Spec(**{**TINY, "views": 24}), folder)
    return folder


# --- Directions and labels ----------------------------------------------------------------------------------------------------


def test_viewpoints_look_where_they_say() -> None:
    yaw = np.array([0.0, 0.0, np.pi / 2, -2.5, 0.0, 3.0])
    pitch = np.array([0.0, 0.4, 0.0, -0.3, -np.pi / 2 + 0.01, 0.7])
    views = dataset.viewpoints(np.arange(18.0).reshape(6, 3), yaw, pitch)
    assert views.dtype == np.float32
    np.testing.assert_array_equal(views[:, :3], np.arange(18.0).reshape(6, 3))
    for view, y, p in zip(views, yaw, pitch, strict=True):
        axes = rotation(view)
        # As `Pose::from_yaw_pitch` of the core: right, down, forward.
        forward = [np.cos(y) * np.cos(p), np.sin(y) * np.cos(p), np.sin(p)]
        right = [np.sin(y), -np.cos(y), 0.0]
        np.testing.assert_allclose(axes[:, 2], forward, atol=1e-6)
        np.testing.assert_allclose(axes[:, 0], right, atol=1e-6)
        np.testing.assert_allclose(axes[:, 1], np.cross(forward, right), atol=1e-6)


def test_the_core_agrees_on_where_a_viewpoint_looks(tmp_path: Path) -> None:
    # A wall 2 m ahead along +y is seen by a camera whose heading is 90 degrees.
    path = tmp_path / "wall.obj"
    path.write_text("v -9 2 -9\nv 9 2 -9\nv 9 2 9\nv -9 2 9\nf 1 2 3 4\n")
    camera = Camera(9, 9, hfov=0.5, far=5.0, kind="z")
    views = dataset.viewpoints(np.zeros((2, 3)), np.array([np.pi / 2, -np.pi / 2]), np.zeros(2))
    ahead, behind = Scene.load(path).render_depth(camera, views)
    np.testing.assert_allclose(ahead, 2.0, atol=1e-5)
    assert np.isinf(behind).all()


def test_directions_are_those_of_a_level_camera() -> None:
    # Heading along +x: forward is +x, up is +z, right is -y.
    axes = rotation(dataset.viewpoints(np.zeros((1, 3)), np.zeros(1), np.zeros(1))[0])
    world = {label: tuple(np.rint(axes @ d).astype(int)) for label, d in zip(LABELS, DIRECTIONS, strict=True)}
    assert world == {
        "up": (0, 0, 1), "down": (0, 0, -1), "forward": (1, 0, 0), "backward": (-1, 0, 0), "right": (0, -1, 0), "left": (0, 1, 0),
    }  # fmt: skip
    for label, mirrored in enumerate(MIRRORED):
        np.testing.assert_array_equal(DIRECTIONS[mirrored], DIRECTIONS[label] * [-1, 1, 1])


def test_labels_are_the_best_of_six_counts(tiny: Path) -> None:
    data, spec = load(tiny), Spec(**{**TINY, "views": 24})
    camera = spec.camera()
    assert np.bincount(data.label, minlength=6).tolist() == [4] * 6
    scene = {name: Scene.generate("room", int(name.split(":")[1])) for name in np.unique(data.scene)}
    assert all(int(name.split(":")[1]) >= 1000 for name in scene)
    for i in range(0, len(data), 5):
        pose, place = data.pose[i], scene[str(data.scene[i])]
        moved = np.repeat(pose[None], 6, axis=0)
        moved[:, :3] += 0.1 * (rotation(pose) @ DIRECTIONS.T).T
        seen, _ = place.visible_voxels(camera, moved, spec.resolution)
        here, objects = place.visible_voxels(camera, pose, spec.resolution)
        assert int(here) == data.seen[i] and int(objects) >= 3
        # The positions are rounded to float32 in another order.
        assert np.abs(seen - here - data.gain[i]).max() <= 3
        assert data.label[i] == data.gain[i].argmax()
        depth = place.render_depth(camera, pose)
        assert np.abs(np.minimum(depth, 4.0) - data.depth[i] / 1000.0).max() < 6e-4


# --- Files --------------------------------------------------------------------------------------------------------------------


def test_workers_change_nothing(tiny: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    manifest = generate(Spec(**{**TINY, "views": 24}), tmp_path / "two", workers=2, progress=lambda *at: seen.append(at))
    assert manifest == json.loads((tiny / dataset.MANIFEST).read_text())
    assert seen[-1] == (24, 24)
    # Fewer views are a part of the same set, and nothing is made anew.
    before = sorted((path.name, path.stat().st_mtime_ns) for path in tiny.glob("unit-*"))
    whole = load(tiny).digest
    fewer = generate(Spec(**TINY), tiny)
    assert fewer["counts"] == [2] * 6
    # Of one recipe, but not the same data.
    assert fewer["digest"] == manifest["digest"]
    assert (manifest["content"], fewer["content"]) == (whole, load(tiny).digest) and whole != load(tiny).digest
    assert sorted((path.name, path.stat().st_mtime_ns) for path in tiny.glob("unit-*")) == before
    generate(Spec(**{**TINY, "views": 24}), tiny)


def test_a_cut_file_is_named_and_mended(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    spec = Spec(**TINY)
    manifest = generate(spec, folder)
    unit = folder / "unit-000000.npz"
    whole = unit.read_bytes()
    for cut in (0, 10, len(whole) // 2, len(whole) - 1):
        unit.write_bytes(whole[:cut])
        with pytest.raises(ValueError, match=r"unit-000000\.npz: damaged or cut short"):
            load(folder)
    assert generate(spec, folder) == manifest
    assert unit.read_bytes() == whole
    (folder / dataset.MANIFEST).write_text(json.dumps({**manifest, "units": [{**manifest["units"][0], "rows": [0, 999]}]}))
    with pytest.raises(ValueError, match=r"manifest\.json: rows of unit 0"):
        load(folder)
    # One of another set is not touched.
    stranger = dataset.Unit({key: np.zeros(0) for key in ("depth", "pose", "gain", "seen", "objects", "label")})
    dataset.write_unit(folder, 0, "f00", stranger)
    with pytest.raises(ValueError, match="belongs to another data set"):
        generate(spec, folder)
    assert unit.read_bytes() != whole


BOX = "v {0} 0 0\nv {1} 0 0\nv {0} 1 0\nv {0} 0 1\nf -4 -3 -2\nf -4 -2 -1\nf -4 -1 -3\nf -3 -1 -2\n"
WORLD = """<sdf version="1.6"><world name="w"><model name="m"><static>true</static><link name="l">
<visual name="v"><geometry><mesh><uri>part.obj</uri></mesh></geometry></visual></link></model></world></sdf>"""


def test_a_recipe_names_the_meshes_of_its_worlds(tmp_path: Path) -> None:
    world, part = tmp_path / "a.world", tmp_path / "part.obj"
    world.write_text(WORLD)
    part.write_text(BOX.format(0, 1))
    spec = Spec(scenes=(str(world), "room"), min_objects=1)
    before = spec.digest()
    part.write_text(BOX.format(0, 2))
    assert spec.digest() != before
    part.write_text(BOX.format(0, 1))
    assert spec.digest() == before
    world.write_text("no world")
    with pytest.raises(ValueError, match=r"a\.world"):
        generate(spec, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_scenes_that_can_give_no_view_are_refused(tmp_path: Path) -> None:
    scene = tmp_path / "two.obj"
    scene.write_text(BOX.format(0, 1) + BOX.format(3, 4))
    arguments = ["dataset", "six-directions", "--views", "6", "--scene", "room", "--scene", str(scene), "--out", str(tmp_path / "out")]
    done = runner.invoke(app, arguments)
    assert done.exit_code == 2 and "two.obj: the scene has 2 objects, a view must hold 3" in " ".join(done.output.split())
    assert not (tmp_path / "out").exists()
    dataset._check_objects(Spec(scenes=(str(scene),), min_objects=2))


def test_scenes_that_do_not_give_a_direction_are_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []

    def no_view_up(spec: Spec, unit: int) -> dataset.Unit:
        made.append(unit)
        n = 5 if unit == 1 else 1
        arrays = {"depth": np.zeros((n, 18, 24), np.uint16), "pose": np.zeros((n, 7)), "gain": np.zeros((n, 6))}
        return {**arrays, "seen": np.zeros(n), "objects": np.zeros(n), "label": np.arange(1, n + 1)}

    monkeypatch.setattr(dataset, "make_unit", no_view_up)
    monkeypatch.setattr(dataset, "FRUITLESS", 3)
    with pytest.raises(ValueError, match=r"3 units in a row, the last in room:1004, gave no view .*: up \(0 of 2\), forward \(1 of 2\), "):
        generate(Spec(**TINY), tmp_path / "room")
    assert made == [0, 1, 2, 3, 4]
    # Not before every scene had its turn.
    made.clear()
    with pytest.raises(ValueError, match="5 units in a row"):
        generate(Spec(**{**TINY, "scenes": ("room", "office", "home", "shop", "warehouse")}), tmp_path / "five")
    assert made == [0, 1, 2, 3, 4, 5, 6]


def test_the_command_line_sets_how_many_objects_a_view_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[Spec] = []

    def note(spec: Spec, *_: Any) -> dict[str, Any]:
        heard.append(spec)
        return {"units": [], "content": ""}

    monkeypatch.setattr(dataset, "generate", note)
    done = runner.invoke(app, ["dataset", "six-directions", "--min-objects", "1", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert heard == [Spec(min_objects=1)]


def test_foreign_folders_are_left_alone(tiny: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="another data set"):
        generate(Spec(**{**TINY, "seed": 1}), tiny)
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    with pytest.raises(ValueError, match=r"other files \(notes.txt\)"):
        generate(Spec(**TINY), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    with pytest.raises(FileNotFoundError):
        load(tmp_path)
    (tmp_path / dataset.MANIFEST).write_text("{")
    with pytest.raises(ValueError, match=r"manifest.json: not a manifest"):
        load(tmp_path)


def test_too_few_views_and_bad_specs(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="1 scenes gave"):
        generate(Spec(**{**TINY, "views": 600}), tmp_path / "few", max_units=1)
    for name, value in [("views", 0), ("far", 99.0), ("far", float("nan")), ("step", -1.0), ("scenes", ()), ("seed", -1)]:
        with pytest.raises(ValueError, match=name.rstrip("s")):
            Spec(**{name: value})
    with pytest.raises(FileNotFoundError, match="nowhere"):
        Spec(scenes=("nowhere.world",))


def test_scenes_are_not_split() -> None:
    scene = np.array(["a", "a", "b", "c", "c", "c", "d", "e", "e", "e"])
    for seed in range(20):
        train, validate = split_scenes(scene, 0.2, seed)
        assert not set(scene[train]) & set(scene[validate])
        assert sorted([*train, *validate]) == list(range(10)) and len(train) and len(validate)
    with pytest.raises(ValueError, match="two scenes"):
        split_scenes(np.array(["a", "a"]), 0.2, 0)
    with pytest.raises(ValueError, match="share"):
        split_scenes(scene, 1.0, 0)


def test_the_command_line_makes_a_set(tmp_path: Path) -> None:
    arguments = ["dataset", "six-directions", "--views", "6", "--width", "24", "--height", "18", "--resolution", "0.1", "--per-scene", "1"]
    done = runner.invoke(app, [*arguments, "--out", str(tmp_path / "a")])
    assert done.exit_code == 0, done.output
    assert "views/s" in done.output and len(load(tmp_path / "a")) == 6
    done = runner.invoke(app, [*arguments, "--seed", "3", "--out", str(tmp_path / "a")])
    assert done.exit_code == 2 and "another data set" in done.output
    done = runner.invoke(app, ["train", "cnn", "--data", str(tmp_path / "none")])
    assert done.exit_code == 2 and "none" in done.output and "Traceback" not in done.output
