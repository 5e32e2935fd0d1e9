"""Files from strangers: broken, degenerate, endless, or pointing out of their folder. Each is read or refused by name, and soon."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import nbv_gym  # noqa: F401 (registers the environments)
from nbv_gym.rust_env import Camera, Octree, Scene

SCENES = Path(os.environ.get("NBV_GYM_SCENES", Path(__file__).parents[2] / "shared" / "scenes"))
CAMERA = Camera(16, 12, hfov=1.0, near=0.05, far=3.0)
WATCHDOG = 120


def room(more: str = "", faces: str = "") -> str:
    """A closed box of 4 x 4 x 3 m, with more vertices and faces (which count from 9)."""
    corners = [(x, y, z) for z in (0, 3) for y in (0, 4) for x in (0, 4)]
    quads = ["1 2 4 3", "5 6 8 7", "1 2 6 5", "3 4 8 7", "1 3 7 5", "2 4 8 6"]
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + more
    return text + "".join(f"f {q}\n" for q in quads) + faces


#: OBJ files that are odd but may be read.
ODD = {
    "one triangle": "v 0 0 0\nv 3 0 0\nv 0 3 2\nf 1 2 3\n",
    "a needle": "v 0 0 0\nv 100 0 0\nv 100 1e-6 0\nv 0 4 3\nf 1 2 3\nf 1 2 4\n",
    "duplicates": room(faces="f 1 2 4 3\n" * 2000),
    "the same seen from behind": room(faces="f 3 4 2 1\n"),
    "zero area": room(faces="f 1 1 2\nf 1 2 2\nf 3 3 3\n" * 50),
    "a speck": room("v 2 2 1\nv 2.0000001 2 1\nv 2 2.0000001 1\n", "f 9 10 11\n"),
    "a huge triangle": room("v -900 -900 1\nv 900 -900 1\nv 0 900 1\n", "f 9 10 11\n"),
    "far away and unused": room("v 1e30 1e30 1e30\n"),
    "many at one place": room("v 2 2 1\nv 2.1 2 1\nv 2 2.1 1\n", "f 9 10 11\n" * 3000),
    "flat": "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nf 1 2 3 4\n",
    "upright": "v 0 0 0\nv 0 4 0\nv 0 4 4\nv 0 0 4\nf 1 2 3 4\n",
    "tiny": "v 0 0 0\nv 1e-18 0 0\nv 0 1e-18 0\nf 1 2 3\n",
    "small": "v 0 0 0\nv 1e-3 0 0\nv 0 1e-3 0\nf 1 2 3\n",
}
#: And such as hold nothing.
EMPTY = {
    "no bytes": "",
    "no faces": "v 0 0 0\nv 1 0 0\nv 0 1 0\n",
    "only zero area": "v 0 0 0\nv 1 0 0\nf 1 2 2\nf 1 1 1\n",
    "beyond f32": "v 0 0 0\nv 1e39 0 0\nv 0 1e39 0\nf 1 2 3\n",
    "huge coordinates": "v 0 0 0\nv 1e30 0 0\nv 0 1e30 0\nf 1 2 3\n",
    "nan": "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n",
    "inf": "v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n",
}


@pytest.mark.parametrize("name", ODD)
def test_odd_meshes_are_worlds(name: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.obj"
    path.write_text(ODD[name])
    for task, changes in (
        ("NBV/SixDirections-v0", {"resolution": 0.3}),
        ("NBV/DomeRoom-v0", {"resolution": 0.3, "views": {"kind": "dome", "rings": 2, "per_ring": 4}}),
        ("NBV/Tabletop-v0", {"resolution": 0.1}),
    ):
        env = gym.make(task, scene=str(path), camera=CAMERA, **changes)
        refusal = ""
        try:
            env.reset(seed=0)
        except ValueError as error:
            refusal = str(error)
        if refusal:
            # No place for the robot, or too little to explore: it says so with the name of the scene or file.
            assert "odd" in refusal or "bounds" in refusal
            continue
        for action in range(3):
            _, reward, *_, info = env.step(action)
            assert np.isfinite(reward) and 0 <= info["coverage"] <= 1 and np.isfinite(info["path_length"])
        env.close()


@pytest.mark.parametrize("name", EMPTY)
def test_meshes_of_nothing_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "empty.obj"
    path.write_text(EMPTY[name])
    with pytest.raises(ValueError, match="empty.obj"):
        Scene.load(path)
    with pytest.raises(ValueError, match="empty.obj"):
        gym.make("NBV/SixDirections-v0", scene=str(path)).reset(seed=0)


def in_time(code: str, *arguments: object) -> str:
    """What the code prints, in a process of its own that may not hang."""
    begin = "import sys\nfrom nbv_gym.rust_env import Octree, Scene\n"
    command = [sys.executable, "-c", begin + code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WATCHDOG)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_pipes_and_devices_are_no_files(tmp_path: Path) -> None:
    for name in ("x.obj", "x.glb", "x.sdf", "x.bt"):
        os.mkfifo(tmp_path / f"pipe_{name}")
        (tmp_path / f"zero_{name}").symlink_to("/dev/zero")
        (tmp_path / f"folder_{name}").mkdir()
    code = """
for path in sys.argv[1:]:
    try:
        (Octree.read if path.endswith("bt") else Scene.load)(path)
    except (ValueError, OSError) as error:
        assert path in str(error), error
    else:
        raise AssertionError(path)
"""
    in_time(code, *sorted(tmp_path.iterdir()))


# --- URIs ---------------------------------------------------------------------------------------------------------

TRIANGLE = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)


def gltf(uri: str) -> str:
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": uri}],
        }
    )


def sdf(uri: str) -> str:
    mesh = f"<geometry><mesh><uri>{uri}</uri></mesh></geometry>"
    return f"<sdf version='1.6'><model name='m'><link name='l'><visual name='v'>{mesh}</visual></link></model></sdf>"


def dae(uri: str) -> str:
    return (
        "<COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema' version='1.4.1'>"
        f"<library_visual_scenes><visual_scene id='w'><node><instance_geometry url='{uri}#g'/><instance_node url='{uri}#n'/></node>"
        "</visual_scene></library_visual_scenes><scene><instance_visual_scene url='#w'/></scene></COLLADA>"
    )


def world(uri: str) -> str:
    return f"<sdf version='1.6'><world name='w'><include><uri>{uri}</uri></include></world></sdf>"


def quad() -> str:
    """A COLLADA file whose geometry `g` and node `n` others may want."""
    return (
        "<COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema' version='1.4.1'><library_geometries><geometry id='g'><mesh>"
        "<source id='s'><float_array id='a' count='9'>0 0 0 1 0 0 0 1 0</float_array><technique_common>"
        "<accessor source='#a' count='3' stride='3'/></technique_common></source><vertices id='v'><input semantic='POSITION' source='#s'/>"
        "</vertices><triangles count='1'><input semantic='VERTEX' source='#v' offset='0'/><p>0 1 2</p></triangles></mesh></geometry>"
        "</library_geometries><library_nodes><node id='n'><instance_geometry url='#g'/></node></library_nodes><library_visual_scenes>"
        "<visual_scene id='w'><node><instance_geometry url='#g'/></node></visual_scene></library_visual_scenes>"
        "<scene><instance_visual_scene url='#w'/></scene></COLLADA>"
    )


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """Assets in `in/assets`, and outside of it what must not be read."""
    assets = tmp_path / "in" / "assets"
    assets.mkdir(parents=True)
    outside = tmp_path / "outside"
    outside.mkdir()
    for folder in (assets, outside):
        (folder / "t.bin").write_bytes(TRIANGLE)
        (folder / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        (folder / "t.dae").write_text(quad())
        (folder / "model.sdf").write_text(sdf("t.obj"))
    return assets


#: Ways out of the folder; {name} is the file wanted.
OUTSIDE = {
    "parent": "../../outside/{name}",
    "hidden parent": "x/../../../outside/{name}",
    "encoded parent": "%2e%2e/%2e%2e/outside/{name}",
    "backslashes": "..\\..\\outside\\{name}",
    "absolute": "{root}/outside/{name}",
    "file": "file://{root}/outside/{name}",
    "file by parent": "file://../../outside/{name}",
    "http": "http://localhost:9/owner/models/nowhere/{name}",
    "https": "https://localhost:9/owner/models/nowhere/files/{name}",
    "model": "model://../../outside/{name}",
    "NUL": "t\0/../../outside/{name}",
}
FORMATS: dict[str, tuple[Callable[[str], str], str]] = {
    "gltf": (gltf, "t.bin"),
    "sdf": (sdf, "t.obj"),
    "world": (world, "model.sdf"),
    "dae": (dae, "t.dae"),
}


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("way", OUTSIDE)
def test_nothing_outside_the_folder_is_read(form: str, way: str, folders: Path) -> None:
    write, wanted = FORMATS[form]
    uri = OUTSIDE[way].format(name=wanted, root=folders.parents[1])
    path = folders / f"a.{form}"
    path.write_text(write(uri))
    with pytest.raises(ValueError, match=f"a.{form}"):
        Scene.load(path)


def test_what_lies_in_the_folder_is_read(folders: Path) -> None:
    for form, (write, wanted) in FORMATS.items():
        if form == "dae":
            continue  # COLLADA's references to other files are never followed
        path = folders / f"a.{form}"
        path.write_text(write(wanted))
        assert len(Scene.load(path).triangles) >= 1


def test_links_out_of_the_folder(folders: Path) -> None:
    """glTF may come from anywhere: its links must not lead out. SDF's folders are the user's own, where links are common."""
    (folders / "link.bin").symlink_to("../../outside/t.bin")
    (folders / "link.obj").symlink_to("../../outside/t.obj")
    (folders / "a.gltf").write_text(gltf("link.bin"))
    with pytest.raises(ValueError, match="a.gltf"):
        Scene.load(folders / "a.gltf")
    (folders / "a.sdf").write_text(sdf("link.obj"))
    assert len(Scene.load(folders / "a.sdf").triangles) == 1


def test_files_beyond_the_cap_are_not_read(tmp_path: Path) -> None:
    for name in ("x.obj", "x.glb", "x.sdf", "x.bt", "x.ot"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(1 << 40)  # takes no room on the disk
        with pytest.raises(ValueError, match=rf"{name}.*bytes"):
            (Octree.read if name[-1] == "t" else Scene.load)(tmp_path / name)


def test_a_short_map_file_does_not_expand_without_end(tmp_path: Path) -> None:
    header = b"# Octomap OcTree binary file\nid OcTree\nsize 9\nres 0.1\ndata\n"
    (tmp_path / "full.bt").write_bytes(header + struct.pack("<H", 0b01_01_01_01_01_01_01_01))
    with pytest.raises(ValueError, match="full.bt.*voxels"):
        Octree.read(tmp_path / "full.bt")


def test_public_malformed_files_are_read_or_refused() -> None:
    if not SCENES.is_dir():
        pytest.skip(f"no public worlds in {SCENES}; set NBV_GYM_SCENES")
    files = [f for f in sorted((SCENES / "malformed").iterdir()) if f.suffix != ".txt"]
    assert len(files) >= 4
    code = """
for path in sys.argv[1:]:
    for strict in (False, True):
        try:
            print(len(Scene.load(path, strict=strict).triangles))
        except (ValueError, OSError) as error:
            assert path.split("/")[-1].split(".")[0] in str(error), error
            print("refused")
"""
    assert len(in_time(code, *files).split()) == 2 * len(files)
