"""The octree against OctoMap's own library, brute force and its own laws."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from nbv_gym.rust_env import GAINS, Camera, Octree, Scene

octomap = pytest.importorskip("octomap", reason="octomap-python (extra [test]) is OctoMap's own library")

CAMERA = Camera(64, 48, hfov=np.deg2rad(75), far=8.0)


def random_views(scene: Scene, count: int, seed: int) -> NDArray[np.float32]:
    """Camera poses near the scene's starts, looking anywhere."""
    rng = np.random.default_rng(seed)
    starts = scene.starts[rng.integers(len(scene.starts), size=count)]
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    positions = starts[:, :3] + rng.uniform(-0.2, 0.2, (count, 3))
    return np.concatenate([positions, quaternions], axis=1).astype(np.float32)


def points_of(depth: NDArray[np.float32], camera: Camera, pose: NDArray[np.float32]) -> NDArray[np.float32]:
    """The measured points in the world frame, rays without an echo left out."""
    points = camera.unproject(depth, pose).reshape(-1, 3)
    return points[np.isfinite(points).all(axis=1)]


def leaves(tree: octomap.OcTree, resolution: float) -> NDArray[np.float64]:
    """Every finest voxel of an OctoMap tree: x, y, z, log-odds."""
    rows = []
    for leaf in tree.begin_leafs():
        side = round(leaf.getSize() / resolution)
        offsets = (np.arange(side) - (side - 1) / 2) * resolution
        grid = np.stack(np.meshgrid(offsets, offsets, offsets, indexing="ij"), axis=-1).reshape(-1, 3)
        centers = np.asarray(leaf.getCoordinate()) + grid
        rows.append(np.column_stack([centers, np.full(len(centers), leaf.getValue())]))
    return np.concatenate(rows)


@pytest.mark.parametrize("resolution", [0.1, 0.05])
@pytest.mark.parametrize("name", ["room:3", "room:11", "tabletop:5"])
@pytest.mark.parametrize("discretize", [False, True], ids=["exact", "discretized"])
def test_classes_and_log_odds_equal_octomap(name: str, resolution: float, discretize: bool) -> None:
    kind, seed = name.split(":")
    scene = Scene.generate(kind, int(seed))
    ours, theirs = Octree(resolution), octomap.OcTree(resolution)
    for pose in random_views(scene, 8, seed=int(seed)):
        points = points_of(scene.render_depth(CAMERA, pose), CAMERA, pose)
        ours.insert_points(points, pose[:3], max_range=4.0, integration="discretized" if discretize else "exact")
        theirs.insertPointCloud(points.astype(float), pose[:3].astype(float), maxrange=4.0, discretize=discretize)
    expected = leaves(theirs, resolution)
    log_odds = ours.log_odds(expected[:, :3])
    assert ours.num_known == len(expected) > 1000
    np.testing.assert_array_equal(log_odds, expected[:, 3].astype(np.float32))
    np.testing.assert_array_equal(ours.classify(expected[:, :3]), np.where(expected[:, 3] >= 0, 1, 0))


def test_depth_equals_the_points_it_shows() -> None:
    scene = Scene.generate("room", 2)
    by_depth, by_points = Octree(0.1), Octree(0.1)
    for pose in random_views(scene, 5, seed=0):
        depth = scene.render_depth(CAMERA, pose)
        by_depth.insert_depth(depth, CAMERA, pose, max_range=4.0)
        # A ray without an echo frees space up to max_range: a point far behind it does the same.
        everywhere = np.where(np.isinf(depth), np.float32(8.0), depth)
        by_points.insert_points(CAMERA.unproject(everywhere, pose).reshape(-1, 3), pose[:3], max_range=4.0)
    np.testing.assert_array_equal(by_depth.occupied(), by_points.occupied())
    assert by_depth.num_known == pytest.approx(by_points.num_known, rel=1e-3)


def test_counts_equal_a_recount() -> None:
    scene = Scene.generate("room", 4)
    octree = Octree(0.1)
    for pose in random_views(scene, 6, seed=1):
        octree.insert_depth(scene.render_depth(CAMERA, pose), CAMERA, pose, max_range=4.0)
        assert octree.recount() == (octree.num_known, octree.num_occupied, octree.entropy(), octree.information())
    p = 1 / (1 + np.exp(-octree.log_odds(np.concatenate([octree.occupied(), octree.free()])).astype(float)))
    assert octree.entropy() == pytest.approx(-(p * np.log2(p) + (1 - p) * np.log2(1 - p)).sum(), rel=1e-5)
    assert octree.information() == pytest.approx((1 - octree.occupied_uncertainty().astype(float)).sum(), rel=1e-5)


def test_uncertainty_is_the_least_of_all_views() -> None:
    """Lluvia 2023, Eq. 2, 8, 9: on the axis u = tanh(|d - 1| / 2) / 2; the best view counts."""
    camera = Camera(1, 1, hfov=0.02, far=8.0)
    octree = Octree(0.1)
    wall = np.array([2.05, 0.05, 0.05], dtype=np.float32)
    look_along_x = [0.5, -0.5, 0.5, -0.5]
    for distance in (2.0, 1.0, 1.5):
        pose = np.array([wall[0] - distance, wall[1], wall[2], *look_along_x], dtype=np.float32)
        octree.insert_depth(np.full((1, 1), distance, np.float32), camera, pose)
    assert octree.classify(wall) == 1
    assert octree.uncertainty(wall) == pytest.approx(0.0, abs=1e-6)
    first = Octree(0.1)
    first.insert_depth(np.full((1, 1), 2.0, np.float32), camera, np.array([0.05, 0.05, 0.05, *look_along_x]))
    assert first.uncertainty(wall) == pytest.approx(np.tanh(0.5) / 2, abs=1e-6)
    assert first.uncertainty([5.0, 5.0, 5.0]) == 1.0


def test_cast_rays_equals_octomap() -> None:
    scene = Scene.generate("room", 6)
    ours, theirs = Octree(0.1), octomap.OcTree(0.1)
    for pose in random_views(scene, 6, seed=3):
        points = points_of(scene.render_depth(CAMERA, pose), CAMERA, pose)
        ours.insert_points(points, pose[:3], max_range=4.0)
        theirs.insertPointCloud(points.astype(float), pose[:3].astype(float), maxrange=4.0)
    rng = np.random.default_rng(0)
    origins = ours.free()[rng.integers(ours.num_known - ours.num_occupied, size=2000)]
    directions = rng.normal(size=origins.shape).astype(np.float32)
    ranges, states = ours.cast_rays(origins, directions, max_range=20.0)
    for origin, direction, distance, state in zip(origins, directions, ranges, states, strict=True):
        end = np.zeros(3)
        hit = theirs.castRay(origin.astype(float), direction.astype(float), end, ignoreUnknownCells=False, maxRange=-1.0)
        assert hit == (state == 1)
        unit = direction / np.linalg.norm(direction)
        # The range is where the ray enters the voxel in which OctoMap's ray ends.
        inside = origin + unit * (distance + 1e-4)
        assert np.abs(inside - end).max() <= 0.05 + 2e-4


@pytest.mark.parametrize("metric", GAINS)
def test_gain_does_not_depend_on_threads(metric: str) -> None:
    scene = Scene.generate("room", 5)
    octree = Octree(0.1, view_history=True)
    views = random_views(scene, 12, seed=2)
    octree.insert_depth(scene.render_depth(CAMERA, views[0]), CAMERA, views[0], max_range=4.0)
    octree.record_view(CAMERA, views[0], max_range=4.0)
    one = octree.view_gain(views, CAMERA, metric=metric, stride=4, max_range=4.0)
    assert one.shape == (12,) and np.isfinite(one).all()
    for threads in (2, 3):
        many = octree.view_gain(views, CAMERA, metric=metric, stride=4, max_range=4.0, num_threads=threads)
        np.testing.assert_array_equal(one, many)


@pytest.mark.parametrize(
    "layout",
    [np.asfortranarray, lambda a: a[::1].astype(np.float64), lambda a: np.repeat(a, 2, 0)[::2], lambda a: a[::-1][::-1].astype(">f4")],
    ids=["fortran", "float64", "strided", "byte-swapped"],
)
def test_any_layout_gives_the_same_map(layout) -> None:  # type: ignore[no-untyped-def]
    points = np.random.default_rng(0).uniform(-2, 2, (500, 3)).astype(np.float32)
    a, b = Octree(0.1), Octree(0.1)
    a.insert_points(points, [0, 0, 0])
    b.insert_points(layout(points), [0, 0, 0])
    np.testing.assert_array_equal(a.occupied(), b.occupied())
    assert a.num_known == b.num_known


def test_bad_input_is_named_and_changes_nothing() -> None:
    octree = Octree(0.1)
    depth, pose = np.ones((48, 64), np.float32), np.array([0, 0, 0, 0, 0, 0, 1.0])
    for call, match in [
        (lambda: Octree(0.0), "resolution"),
        (lambda: Octree(float("nan")), "resolution"),
        (lambda: Octree(0.1, hit=0.2), "hit"),
        (lambda: octree.insert_depth(depth[:10], CAMERA, pose), "depth"),
        (lambda: octree.insert_depth(depth, CAMERA, pose * np.nan), "pose"),
        (lambda: octree.insert_depth(depth, CAMERA, pose, max_range=-1.0), "max_range"),
        (lambda: octree.insert_depth(depth, CAMERA, pose, integration="fast"), "fast"),
        (lambda: octree.insert_points(np.ones((4, 2)), [0, 0, 0]), "points"),
        (lambda: octree.insert_points(np.ones((4, 3)), [0, np.inf, 0]), "origin"),
        (lambda: octree.insert_points(np.ones((4, 3)), [1e9, 0, 0]), "key space"),
        (lambda: octree.insert_points(np.full((1, 3), 3000.0), [-3000, -3000, -3000]), "max_range"),
        (lambda: octree.view_gain(pose, CAMERA, metric="luck"), "luck"),
        (lambda: octree.view_gain(pose, CAMERA, stride=0), "stride"),
        (lambda: octree.view_gain(pose, CAMERA, num_threads=0), "num_threads"),
    ]:
        with pytest.raises(ValueError, match=match):
            call()
    with pytest.raises(TypeError, match="colour"):
        Octree(0.1, colour=3)
    assert octree.num_known == 0
    # Points that are no numbers are no measurement.
    octree.insert_points(np.full((3, 3), np.nan), [0, 0, 0])
    octree.insert_points(np.empty((0, 3)), [0, 0, 0])
    octree.insert_depth(np.full((48, 64), np.nan), CAMERA, pose)
    assert octree.num_known == 0


def test_octomap_reads_what_we_write_and_we_read_what_it_writes(tmp_path: Path) -> None:
    scene = Scene.generate("room", 8)
    ours = Octree(0.1)
    for pose in random_views(scene, 4, seed=4):
        ours.insert_depth(scene.render_depth(CAMERA, pose), CAMERA, pose, max_range=4.0)
    centers = np.concatenate([ours.occupied(), ours.free()])

    ours.write(tmp_path / "ours.bt")
    theirs = octomap.OcTree(0.1)
    assert theirs.readBinary(str(tmp_path / "ours.bt").encode())
    found = leaves(theirs, 0.1)
    assert len(found) == ours.num_known
    np.testing.assert_array_equal(ours.classify(found[:, :3]), np.where(found[:, 3] >= 0, 1, 0))

    ours.write(tmp_path / "ours.ot")
    theirs = octomap.OcTree.read(str(tmp_path / "ours.ot").encode())
    found = leaves(theirs, 0.1)
    assert len(found) == ours.num_known
    np.testing.assert_array_equal(ours.log_odds(found[:, :3]), found[:, 3].astype(np.float32))

    assert theirs.write(str(tmp_path / "theirs.ot").encode())
    assert theirs.writeBinary(str(tmp_path / "theirs.bt").encode())
    np.testing.assert_array_equal(Octree.read(tmp_path / "theirs.ot").log_odds(centers), ours.log_odds(centers))
    np.testing.assert_array_equal(Octree.read(tmp_path / "theirs.bt").classify(centers), ours.classify(centers))


def seen_room(seed: int, views: int = 4) -> Octree:
    scene = Scene.generate("room", seed)
    octree = Octree(0.1)
    for pose in random_views(scene, views, seed=seed):
        octree.insert_depth(scene.render_depth(CAMERA, pose), CAMERA, pose, max_range=4.0)
    return octree


def test_a_mirror_that_is_told_the_changes_equals_the_map() -> None:
    scene, octree = Scene.generate("room", 9), Octree(0.1)
    mirror: dict[tuple[int, ...], int] = {}
    for step, pose in enumerate(random_views(scene, 6, seed=5)):
        octree.insert_depth(scene.render_depth(CAMERA, pose), CAMERA, pose, max_range=4.0)
        if step == 3:
            octree.clear([pose[:3] - 1, pose[:3] + 1])
        centers, before, after = octree.changed()
        np.testing.assert_array_equal(octree.classify(centers), after)
        for key, old, new in zip(np.floor(centers * 10).astype(int).tolist(), before, after, strict=True):
            assert mirror.get(tuple(key), -1) == old != new
            mirror[tuple(key)] = new
    counts = [list(mirror.values()).count(state) for state in (0, 1)]
    assert counts == [octree.num_known - octree.num_occupied, octree.num_occupied]
    assert [len(a) for a in octree.changed()] == [0, 0, 0]


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int64])
def test_layers_of_points_of_any_shape_and_dtype(dtype: type) -> None:
    octree = seen_room(10)
    points = np.random.default_rng(0).uniform(-3, 3, (4, 5, 3)).astype(dtype)
    log_odds, probability = octree.log_odds(points), octree.probability(points)
    assert log_odds.shape == probability.shape == octree.classify(points).shape == octree.uncertainty(points).shape == (4, 5)
    np.testing.assert_allclose(probability, np.where(np.isnan(log_odds), 0.5, 1 / (1 + np.exp(-log_odds))), atol=1e-6)
    centers, distances = octree.nearest(points, "occupied")
    assert centers.shape == (4, 5, 3) and distances.shape == (4, 5)


@pytest.mark.parametrize("state", ["occupied", "free", "unknown"])
def test_nearest_is_the_nearest_of_all(state: str) -> None:
    octree = seen_room(11)
    around = [octree.bounds[0] - 1, octree.bounds[1] + 1]
    voxels = getattr(octree, state)(around)
    points = np.random.default_rng(1).uniform(*octree.bounds, (60, 3))
    centers, distances = octree.nearest(points, state)
    expected = np.linalg.norm(points[:, None] - voxels[None], axis=2).min(axis=1)
    np.testing.assert_allclose(distances, expected, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(points - centers, axis=1), distances, atol=1e-5)
    near, _ = octree.nearest(points, state, max_range=float(np.median(distances)))
    np.testing.assert_array_equal(np.isnan(near).any(axis=1), distances > np.median(distances))
    nothing, far = octree.nearest([[np.nan, 0, 0]], state)
    assert np.isnan(nothing).all() and np.isinf(far).all()


def test_boxes_split_the_map() -> None:
    octree = seen_room(12)
    low, high = octree.bounds
    counts = np.array(octree.counts_in([low, high]))
    assert counts[1:].tolist() == [octree.num_known - octree.num_occupied, octree.num_occupied]
    assert counts.sum() == np.prod(np.round((high - low) / 0.1))
    middle = np.float32(0.05) + np.round((low + high) / 2, 1)  # a voxel's middle is on one side only
    left = np.array(octree.counts_in([low, [middle[0] + 0.01, *high[1:]]]))
    right = np.array(octree.counts_in([[middle[0] + 0.01, *low[1:]], high]))
    assert (left + right == counts).all() and left.sum() > 0
    box = [low + 0.5, low + 1.5]
    for state, count in zip(("unknown", "free", "occupied"), octree.counts_in(box), strict=True):
        centers = getattr(octree, state)(box)
        assert len(centers) == count
        assert ((centers >= box[0]) & (centers <= box[1])).all()
    cleared = octree.copy()
    cleared.clear(box)
    assert cleared.counts_in(box) == (1000, 0, 0)
    assert cleared.num_known == octree.num_known - sum(octree.counts_in(box)[1:])


def test_decay_halves_and_forgets() -> None:
    octree = seen_room(13)
    before, known = octree.log_odds(octree.occupied()), octree.num_known
    voxels = octree.occupied()
    octree.decay(0.5)
    np.testing.assert_array_equal(octree.log_odds(voxels), before * np.float32(0.5))
    assert octree.num_known == known and octree.recount()[0] == known
    octree.decay(0.5**10)
    assert octree.num_known == octree.num_occupied == 0 == octree.entropy() == octree.information()


def test_what_is_wrong_with_a_box_or_a_state_is_said() -> None:
    octree = seen_room(14, views=1)
    known = octree.num_known
    for call, match in [
        (lambda: octree.clear([[1, 1, 1], [0, 0, 0]]), "bounds"),
        (lambda: octree.clear([[0, 0, np.nan], [1, 1, 1]]), "bounds"),
        (lambda: octree.counts_in([0, 0, 0]), "bounds"),
        (lambda: octree.decay(2.0), "factor"),
        (lambda: octree.decay(0.5, forget_below=0.0), "forget_below"),
        (lambda: octree.nearest([0, 0, 0], "full"), "full"),
        (lambda: octree.nearest([0, 0, 0], max_range=0.0), "max_range"),
        (lambda: octree.unknown(), "bounds"),
        (lambda: octree.unknown([[-3000] * 3, [3000] * 3]), "unknown voxels"),
    ]:
        with pytest.raises(ValueError, match=match):
            call()
    assert octree.num_known == known


def test_files_of_before_1_4_are_read_as_octomap_reads_them(tmp_path: Path) -> None:
    octree = seen_room(15)
    octree.write(tmp_path / "new.bt")
    new = (tmp_path / "new.bt").read_bytes()
    header, data = new.split(b"data\n", 1)
    size = int(header.split(b"size ")[1].split()[0])
    (tmp_path / "old.bt").write_bytes(struct.pack("<idI", 3, 0.1, size) + data)
    ours = Octree.read(tmp_path / "old.bt")
    theirs = octomap.OcTree(0.1)
    assert theirs.readBinary(str(tmp_path / "old.bt").encode())
    found = leaves(theirs, 0.1)
    assert len(found) == ours.num_known == octree.num_known
    np.testing.assert_array_equal(ours.classify(found[:, :3]), np.where(found[:, 3] >= 0, 1, 0))
