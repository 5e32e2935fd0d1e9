"""What a depth image shows of a scene, and how far surfaces are: known rooms, and brute force over the pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from nbv_gym.rust_env import Camera, Scene

#: Looks along world x, x to the right (world -y).
AHEAD = np.array([0.5, -0.5, 0.5, -0.5])


def obj(path: Path, quads: list[list[tuple[float, float, float]]]) -> Scene:
    lines = [f"v {x} {y} {z}" for quad in quads for x, y, z in quad]
    lines += [f"f {4 * i + 1} {4 * i + 2} {4 * i + 3} {4 * i + 4}" for i in range(len(quads))]
    path.write_text("\n".join(lines) + "\n")
    return Scene.load(path)


def wall(x: float, half: float) -> list[tuple[float, float, float]]:
    return [(x, -half, -half), (x, half, -half), (x, half, half), (x, -half, half)]


def test_a_wall_and_a_plate_by_hand(tmp_path: Path) -> None:
    # 90 degrees square: 2 m x 2 m of the wall at 1 m are seen. The plate, half-way, is 0.25 m x 0.25 m and hides
    # 0.5 m x 0.5 m of it: 2 x 2 voxels of 0.25 m. Surfaces stand in the middle of voxels, pixels' centres off their faces.
    scene = obj(tmp_path / "wall.obj", [wall(1.1, 3.0), wall(0.6, 0.125)])
    camera = Camera(64, 64, hfov=np.pi / 2, vfov=np.pi / 2, near=0.05, far=5.0)
    views = np.array([[0.1, 0.0, 0.0, *AHEAD], [0.1, 0.0, 0.0, *(-AHEAD)], [0.7, 0.0, 0.0, *AHEAD]])
    seen, objects = scene.visible_voxels(camera, views, 0.25)
    assert seen.dtype == objects.dtype == np.int64
    # The plate itself lies in 2 x 2 voxels. From behind it the camera sees 0.8 m x 0.8 m of the wall.
    assert seen.tolist() == [64 - 4 + 4, 64 - 4 + 4, 4 * 4]
    assert objects.tolist() == [2, 2, 1]
    assert sorted(set(scene.objects.tolist())) == [1, 2] and scene.objects.shape == (4,)
    # Beyond `far` and nearer than `near` nothing is seen.
    short = Camera(64, 64, hfov=np.pi / 2, vfov=np.pi / 2, near=0.05, far=0.4)
    assert [int(x) for x in scene.visible_voxels(short, views[0], 0.25)] == [0, 0]
    blind = Camera(64, 64, hfov=np.pi / 2, vfov=np.pi / 2, near=0.8, far=5.0)
    _, objects = scene.visible_voxels(blind, views[0], 0.25)
    assert int(objects) == 1


def counts_by_hand(points: NDArray[np.float64], resolution: float) -> tuple[int, int]:
    """Least and greatest number of voxels: points within a hundredth of a millimetre of a face may fall on either side."""
    at = points / resolution
    doubtful = (np.abs(at - np.rint(at)) * resolution < 1e-5).any(axis=1)
    sure = len(np.unique(np.floor(at[~doubtful]).astype(np.int64), axis=0))
    return sure, sure + int(doubtful.sum())


@pytest.mark.parametrize("kind", ["z", "range"])
def test_voxels_are_those_of_the_unprojected_pixels(kind: str) -> None:
    scene = Scene.generate("room", 4)
    camera = Camera(80, 60, hfov=1.0, near=0.05, far=3.0, kind=kind)
    rng = np.random.default_rng(3)
    for start in scene.starts:
        q = AHEAD + 0.2 * rng.normal(size=4)
        view = np.array([*start[:3], *(q / np.linalg.norm(q))], dtype=np.float32)
        depth = scene.render_depth(camera, view)
        points = camera.unproject(depth, view).reshape(-1, 3).astype(np.float64)
        points = points[(np.isfinite(depth) & (depth > 0)).ravel()]
        low, high = counts_by_hand(points, 0.05)
        seen, objects = scene.visible_voxels(camera, view, 0.05)
        assert low <= int(seen) <= high
        assert low > 100 and high - low < 0.05 * high
        assert 0 <= int(objects) <= scene.report["instances"]


def test_shapes_and_bad_arguments() -> None:
    scene = Scene.generate("room", 0)
    camera = Camera(16, 12, hfov=1.0, far=3.0)
    view = np.array([*scene.starts[0, :3], *AHEAD])
    seen, objects = scene.visible_voxels(camera, np.broadcast_to(view, (2, 3, 7)), 0.1)
    assert seen.shape == objects.shape == (2, 3) and np.unique(seen).size == 1
    none, _ = scene.visible_voxels(camera, np.zeros((0, 7)), 0.1)
    assert none.shape == (0,)
    for resolution in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="resolution"):
            scene.visible_voxels(camera, view, resolution)
    with pytest.raises(ValueError, match=r"poses\[0\]"):
        scene.visible_voxels(camera, view * np.nan, 0.1)
    with pytest.raises(ValueError, match="shape"):
        scene.visible_voxels(camera, view[:3], 0.1)


def test_objects_of_a_world_are_its_models(tmp_path: Path) -> None:
    model = """<model name='{0}'><pose>{1} 0 0 0 0 0</pose><link name='l'><visual name='a'><geometry><box><size>1 1 1</size></box>
    </geometry></visual><visual name='b'><pose>0 0 1 0 0 0</pose><geometry><sphere><radius>0.4</radius></sphere></geometry>
    </visual></link></model>"""
    plane = """<model name='ground'><link name='l'><visual name='v'><geometry><plane><normal>0 0 1</normal><size>100 100</size></plane>
    </geometry></visual></link></model>"""
    path = tmp_path / "two.world"
    models = model.format("left", 3) + plane + model.format("right", 6)
    path.write_text(f"<sdf version='1.6'><world name='w'>{models}</world></sdf>")
    for scene in (Scene.load(path), Scene.load(path)):  # made, and from the cache
        centres = scene.triangles.mean(axis=1)
        numbers = scene.objects
        assert set(numbers[np.abs(centres[:, 0] - 3) < 0.6].tolist()) >= {1}
        assert len(set(numbers.tolist())) == 3
        assert set(numbers[centres[:, 2] > 0.7].tolist()).isdisjoint({0})


def test_clearance(tmp_path: Path) -> None:
    scene = obj(tmp_path / "wall.obj", [wall(1.0, 3.0)])
    points = np.array([[0.0, 0.0, 0.0], [0.9, 1.0, 1.0], [-9.0, 0.0, 0.0], [1.0, 0.0, 4.0], [np.nan, 0.0, 0.0]])
    got = scene.clearance(points, 2.0)
    np.testing.assert_allclose(got, [1.0, 0.1, 2.0, 1.0, np.nan], atol=1e-6)
    for distance in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="max_distance"):
            scene.clearance(points, distance)
