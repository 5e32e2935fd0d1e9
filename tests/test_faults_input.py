"""Arrays of any layout and dtype, values out of range: read correctly or refused by name, and nothing is cast in silence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import nbv_gym  # noqa: F401 (registers the environments)
from nbv_gym.envs.env import NbvEnv
from nbv_gym.rust_env import METRICS, Camera, Octree, Scene, Setup, Simulator

CAMERA = Camera(8, 6, hfov=1.0, near=0.05, far=3.0)
SCENE = Scene.generate("room", 0)
QUICK: dict[str, Any] = {"scene": "room:0", "camera": CAMERA, "resolution": 0.3}
Array = NDArray[Any]


def strided(a: Array) -> Array:
    wide = np.zeros((*a.shape[:-1], 2 * a.shape[-1]), a.dtype)
    wide[..., ::2] = a
    return wide[..., ::2]


def misaligned(a: Array) -> Array:
    raw = np.zeros(a.nbytes + 1, np.uint8)
    out = np.ndarray(a.shape, a.dtype, raw.data, offset=1)
    out[...] = a
    assert not out.flags.aligned
    return out


def read_only(a: Array) -> Array:
    a = a.copy()
    a.flags.writeable = False
    return a


#: The same numbers, laid out otherwise. The numbers are small and whole, so that every dtype holds them.
LAYOUTS: dict[str, Callable[[Array], Any]] = {
    "f32": lambda a: a.astype(np.float32),
    "f64": lambda a: a.astype(np.float64),
    "f16": lambda a: a.astype(np.float16),
    "i64": lambda a: a.astype(np.int64),
    "u8": lambda a: a.astype(np.uint8),
    "fortran": lambda a: np.asfortranarray(a.astype(np.float32)),
    "strided": lambda a: strided(a.astype(np.float32)),
    "negative stride": lambda a: a.astype(np.float32)[::-1].copy()[::-1],
    "read-only": lambda a: read_only(a.astype(np.float32)),
    "misaligned": lambda a: misaligned(a.astype(np.float32)),
    "misaligned f64": lambda a: misaligned(a.astype(np.float64)),
    "byte-swapped": lambda a: a.astype(">f4"),
    "byte-swapped f64": lambda a: a.astype(">f8"),
    "list": lambda a: a.tolist(),
}
#: Dtypes of which NumPy would make numbers if it were let to.
NO_NUMBERS: dict[str, Callable[[Array], Any]] = {
    "complex": lambda a: a + 0j,
    "bool": lambda a: a.astype(bool),
    "text": lambda a: a.astype(str),
    "object": lambda a: a.astype(object),
    "time": lambda a: a.astype("datetime64[s]"),
    "structured": lambda a: np.zeros(a.shape, [("x", np.float32)]),
}

POSES = np.array([[1, 1, 1, 0, 0, 0, 1], [2, 1, 1, 1, 0, 0, 0], [1, 2, 1, 0, 1, 0, 0]])
POINTS = np.array([[1, 1, 1], [2, 2, 1], [0, 1, 2], [3, 0, 0]])
DEPTH = np.full((6, 8), 2)


def map_of(insert: Callable[[Octree], object]) -> Array:
    octree = Octree(0.2)
    insert(octree)
    return np.concatenate([octree.occupied(), octree.free()])


@pytest.fixture(scope="module")
def env() -> NbvEnv:
    env = gym.make("NBV/SixDirections-v0", **QUICK).unwrapped
    assert isinstance(env, NbvEnv)
    env.reset(seed=0)
    return env


@pytest.fixture(scope="module")
def octree() -> Octree:
    octree = Octree(0.2)
    octree.insert_points(POINTS, [0, 0, 0])
    return octree


#: Each array argument of the public API: name, right value, call.
ARGUMENTS: dict[str, tuple[str, Array, Callable[[Any, NbvEnv, Octree], Any]]] = {
    "Scene.render_depth": ("poses", POSES, lambda a, env, octree: SCENE.render_depth(CAMERA, a)),
    "Scene.cast_rays origins": ("origins", POINTS, lambda a, env, octree: SCENE.cast_rays(a, np.ones((4, 3)), 3.0)),
    "Scene.cast_rays directions": ("directions", POINTS, lambda a, env, octree: SCENE.cast_rays(np.ones((4, 3)), a, 3.0)),
    "Camera.unproject": ("depth", DEPTH, lambda a, env, octree: CAMERA.unproject(a, POSES[0])),
    "Octree.insert_depth": ("depth", DEPTH, lambda a, env, octree: map_of(lambda o: o.insert_depth(a, CAMERA, POSES[0]))),
    "Octree.insert_points": ("points", POINTS, lambda a, env, octree: map_of(lambda o: o.insert_points(a, [0, 0, 0]))),
    "Octree.log_odds": ("points", POINTS, lambda a, env, octree: octree.log_odds(a)),
    "Octree.classify": ("points", POINTS, lambda a, env, octree: octree.classify(a)),
    "Octree.uncertainty": ("points", POINTS, lambda a, env, octree: octree.uncertainty(a)),
    "Octree.cast_rays": ("origins", POINTS, lambda a, env, octree: octree.cast_rays(a, np.ones((4, 3)), 3.0)[0]),
    "Octree.view_gain": ("poses", POSES, lambda a, env, octree: octree.view_gain(a, CAMERA)),
    "Octree.slice": ("bounds", POINTS[:2], lambda a, env, octree: octree.slice(0.0, 1.0, a)[0]),
    "Belief.view_gain": ("poses", POSES, lambda a, env, octree: env.belief.view_gain(a)),
    "Belief.travel_cost": ("poses", POSES, lambda a, env, octree: env.belief.travel_cost(a)),
    "Belief.reachable": ("poses", POSES, lambda a, env, octree: env.belief.reachable(a)),
    "Simulator.true_gain": ("poses", POSES, lambda a, env, octree: env.simulator.true_gain(0, a)),
}


@pytest.mark.parametrize("argument", ARGUMENTS)
def test_every_layout_is_read_correctly(argument: str, env: NbvEnv, octree: Octree) -> None:
    _, right, call = ARGUMENTS[argument]
    expected = call(right, env, octree)
    for layout, change in LAYOUTS.items():
        np.testing.assert_array_equal(call(change(right), env, octree), expected, err_msg=layout)


@pytest.mark.parametrize("argument", ARGUMENTS)
def test_what_is_no_array_of_numbers_is_refused(argument: str, env: NbvEnv, octree: Octree) -> None:
    name, right, call = ARGUMENTS[argument]
    for change in NO_NUMBERS.values():
        with pytest.raises(TypeError, match=f"(?s)real numbers.*{name}"):
            call(change(right), env, octree)
    wide = np.zeros((*right.shape, 3))[..., :2]
    for wrong in (right[..., :-1], wide, np.float32(1.0), np.zeros((1,) * 17), [[1.0], [1.0, 2.0]], object()):
        with pytest.raises((TypeError, ValueError)):
            call(wrong, env, octree)
    # No memory is taken for what only looks large.
    huge = np.broadcast_to(np.float32(1.0), (1 << 29, *right.shape[1:]))
    with pytest.raises(ValueError, match="too large|shape"):
        call(huge, env, octree)


def test_nothing_is_a_valid_batch(octree: Octree) -> None:
    none = np.zeros((0, 3))
    assert octree.classify(none).shape == (0,)
    assert octree.cast_rays(none, none, 1.0)[0].shape == (0,)
    assert SCENE.cast_rays(none, none, 1.0).shape == (0,)
    assert SCENE.render_depth(CAMERA, np.zeros((0, 7))).shape == (0, 6, 8)
    assert octree.view_gain(np.zeros((0, 7)), CAMERA).shape == (0,)


BAD_POSES = {
    "nan": [0, 0, np.nan, 0, 0, 0, 1],
    "inf": [np.inf, 0, 0, 0, 0, 0, 1],
    "far": [0, 1e30, 0, 0, 0, 0, 1],
    "beyond f32": [0, 1e300, 0, 0, 0, 0, 1],
    "no direction": [0, 0, 0, 0, 0, 0, 0],
    "overflowing norm": [0, 0, 0, 1e30, 0, 0, 1e30],
    "nan rotation": [0, 0, 0, 0, 0, 0, np.nan],
}


@pytest.mark.parametrize("bad", BAD_POSES)
def test_poses_that_are_none_are_refused(bad: str, env: NbvEnv, octree: Octree) -> None:
    pose = np.array([BAD_POSES[bad]])
    before = octree.num_known
    with np.errstate(over="ignore"):  # of numbers beyond float32
        for call in (
            lambda: SCENE.render_depth(CAMERA, pose),
            lambda: octree.insert_depth(DEPTH, CAMERA, pose[0]),
            lambda: octree.view_gain(pose, CAMERA),
            lambda: env.belief.view_gain(pose),
            lambda: env.belief.travel_cost(pose),
            lambda: env.belief.path_to(pose[0]),
            lambda: env.simulator.true_gain(0, pose),
        ):
            with pytest.raises(ValueError, match="pose|viewpoint"):
                call()
        if bad != "far":  # the nearest candidate to a far goal is one
            with pytest.raises(ValueError, match="viewpoint"):
                env.action_of(pose[0])
    assert octree.num_known == before


def test_far_poses_are_answered(env: NbvEnv, octree: Octree) -> None:
    far = np.array([[9e5, -9e5, 9e5, 0, 0, 0, 1.0]])
    assert np.isinf(SCENE.render_depth(CAMERA, far)).all()
    assert env.belief.view_gain(far)[0] == 0
    assert not env.belief.reachable(far).any()
    assert np.isinf(env.belief.travel_cost(far)).all()
    assert np.isfinite(env.belief.path_to(far[0])).all()
    assert octree.classify(far[:, :3])[0] == -1
    for value in (np.nan, np.inf, 1e30, -1e30):
        assert octree.classify(np.full(3, value)) == -1
        assert np.isnan(octree.log_odds(np.full(3, value)))
        ranges, states = octree.cast_rays(np.full((1, 3), value), np.ones((1, 3)), 3.0)
        if np.isfinite(value):  # outside of what a map can hold
            assert (ranges[0], states[0]) == (3, 0)
        else:  # no ray
            assert np.isnan(ranges[0]) and states[0] == -1


# --- the simulator's own arrays -----------------------------------------------------------------------------------


def simulator(n: int = 2) -> Simulator:
    setup = Setup("room:0", CAMERA, {"kind": "flying"}, {"resolution": 0.3}, {"kind": "six_directions"})
    simulator = Simulator(setup, n)
    simulator.reset(np.ones(n, bool), [0] * n, {})
    return simulator


def test_commands_are_never_cast() -> None:
    s, no = simulator(), np.zeros(2, bool)
    at = np.array([s.belief(i).pose for i in range(2)], np.float32)
    for change in (np.asfortranarray, strided, read_only, lambda a: a[::-1].copy()[::-1]):
        s.step(change(at), no, {})
    for wrong in (at.astype(np.float64), at.astype(">f4"), at.astype(int), at.astype(object), at.tolist(), at[0], None):
        with pytest.raises(TypeError):
            s.step(wrong, no, {})
    for wrong in (at[:1], at[:, :6], np.zeros((0, 7), np.float32), misaligned(at)):
        with pytest.raises(ValueError, match="commands"):
            s.step(wrong, no, {})
    for value in (np.nan, np.inf, 1e30):
        bad = at.copy()
        bad[1, 0] = value
        with pytest.raises(ValueError, match="environment 1"):
            s.step(bad, no, {})
    for wrong in (no.astype(int), no.tolist(), np.zeros((2, 1), bool)):
        with pytest.raises(TypeError):
            s.step(at, wrong, {})
    with pytest.raises(ValueError, match="reset_mask"):
        s.step(at, np.zeros(3, bool), {})
    for seeds in ([0], [0, 1, 2]):
        with pytest.raises(ValueError, match="seeds"):
            s.reset(~no, seeds, {})
    for seeds in ([0, -1], [0, 2**64], [0, 1.5], ["0", "1"], None):
        with pytest.raises((TypeError, ValueError, OverflowError)):
            s.reset(~no, seeds, {})
    assert s.belief(0).trajectory.shape == (5, 7), "what was refused moved nothing"


def test_buffers_are_checked_before_anything_changes() -> None:
    s, no = simulator(), np.zeros(2, bool)
    at = np.array([s.belief(i).pose for i in range(2)], np.float32)
    metrics = np.zeros((2, len(METRICS)))
    shared = np.zeros((2, 7), np.float32)
    cases: list[tuple[Any, type[Exception]]] = [
        ({"pose": np.zeros((2, 7))}, TypeError),
        ({"pose": np.zeros((2, 7), ">f4")}, TypeError),
        ({"pose": [[0.0] * 7] * 2}, TypeError),
        ({"pose": np.zeros((7, 2), np.float32).T}, ValueError),
        ({"pose": np.zeros((3, 7), np.float32)}, ValueError),
        ({"pose": read_only(np.zeros((2, 7), np.float32))}, ValueError),
        ({"pose": misaligned(np.zeros((2, 7), np.float32))}, (TypeError, ValueError)),
        ({"metrics": metrics[:, ::-1]}, ValueError),
        ({"local_map": np.zeros((2, 3, 8, 8, 8), np.float32)}, ValueError),
        ({"colour": metrics}, KeyError),
        ({7: metrics}, TypeError),
        (None, TypeError),
    ]
    for buffers, error in cases:
        with pytest.raises(error):
            s.step(at, no, buffers)
        with pytest.raises(error):
            s.reset(~no, [0, 0], buffers)
    # The commands are one of the buffers: refused, since both would be borrowed.
    shared[:] = at
    with pytest.raises((TypeError, ValueError)):
        s.step(shared, no, {"pose": shared})
    assert s.belief(0).trajectory.shape == (1, 7)
    s.step(at, no, {"metrics": metrics})
    assert metrics[0, METRICS.index("views")] == 2


def test_actions_of_any_integer_layout_and_no_other() -> None:
    def fresh() -> Any:
        envs = gym.make_vec("NBV/SixDirections-v0", num_envs=3, vectorization_mode="vector_entry_point", **QUICK)
        envs.reset(seed=0)
        return envs

    actions = np.array([2, 3, 2])
    expected = fresh().step(actions)[1]
    wide = np.array([2, 9, 3, 9, 2, 9])
    for layout in (actions.astype(np.uint8), actions.astype(">i8"), wide[::2], actions[::-1].copy()[::-1], read_only(actions), [2, 3, 2]):
        np.testing.assert_array_equal(fresh().step(layout)[1], expected)
    np.testing.assert_array_equal(fresh().step(misaligned(actions))[1], expected)
    envs = fresh()
    for wrong in (
        actions * 1.0,
        actions > 2,
        actions.astype(str),
        actions.astype(object),
        actions + 0j,
        None,
        [2**70, 0, 0],
        [[1], [2, 3], 4],
    ):
        with pytest.raises((TypeError, ValueError)):
            envs.step(wrong)
    for wrong in (np.array([0, 0, 2**63], np.uint64), np.array([-1, 0, 0]), actions[:2], actions[None], np.zeros(0, int)):
        with pytest.raises(ValueError, match="action"):
            envs.step(wrong)
    np.testing.assert_array_equal(envs.step(actions)[1], expected)


def test_free_viewpoints_of_any_layout() -> None:
    def fresh() -> Any:
        make: Any = {"action": "viewpoint", "num_envs": 2, "vectorization_mode": "vector_entry_point"}
        envs = gym.make_vec("NBV/SixDirections-v0", **QUICK, **make)
        envs.reset(seed=0)
        return envs

    actions = np.array([[0, 0, 0, 0, 0, 0, 1], [0, 0, 0, 1, 0, 0, 0]])
    expected = fresh().step(actions.astype(np.float32))[1]
    for layout, change in LAYOUTS.items():
        np.testing.assert_array_equal(fresh().step(change(actions))[1], expected, err_msg=layout)
    envs = fresh()
    for change in NO_NUMBERS.values():
        with pytest.raises(TypeError):
            envs.step(change(actions))
    for value in (np.nan, np.inf, -np.inf, 1.1, 1e30, 1e300):
        bad = actions.astype(float)
        bad[1, 2] = value
        with np.errstate(over="ignore"), pytest.raises(ValueError, match="environment 1"):
            envs.step(bad)


# --- values at the edge of their range ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        {"width": 0},
        {"width": -1},
        {"width": 2**70},
        {"width": 4097},
        {"height": 4097},
        {"hfov": 0.0},
        {"hfov": np.pi},
        {"hfov": np.nan},
        {"hfov": 1e-9},
        {"vfov": -1.0},
        {"near": np.nan},
        {"near": -1.0},
        {"near": 4.0},
        {"near": 4.0 - 1e-12},
        {"far": np.inf},
        {"far": 1e300},
        {"far": 1e-300},
        {"kind": "colour"},
        {"width": 1.5},
    ],
    ids=str,
)
def test_cameras_that_cannot_be(wrong: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError, OverflowError)):
        Camera(**({"width": 8, "height": 6, "hfov": 1.0, "far": 4.0} | wrong))


@pytest.mark.parametrize(
    "extreme",
    [
        {"width": 1, "height": 1},
        {"hfov": 3.09, "vfov": 3.09},
        {"hfov": 0.0011, "vfov": 0.0011},
        {"width": 4096, "height": 1, "vfov": 0.01},
        {"width": 1, "height": 4096, "vfov": 2.0},
        {"far": 1e30, "near": 1e-30},
        {"far": 1e-30},
        {"hfov": 3.09, "vfov": 0.0011},
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", ["range", "z"])
def test_extreme_cameras_see(extreme: dict[str, Any], kind: str) -> None:
    camera = Camera(**({"width": 8, "height": 6, "hfov": 1.0, "far": 4.0, "kind": kind} | extreme))
    pose = np.array([*SCENE.starts[0, :3], 0.5, -0.5, 0.5, -0.5])
    image = SCENE.render_depth(camera, pose)
    assert image.shape == (camera.height, camera.width)
    assert not np.isnan(image).any() and (image >= 0).all()
    octree = Octree(0.2)
    octree.insert_depth(image, camera, pose, max_range=4.0)
    assert np.isfinite(octree.entropy())
    assert np.isfinite(octree.view_gain(pose[None], camera, max_range=4.0)).all()


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("robot", {"radius": 1e300}),
        ("robot", {"radius": np.nan}),
        ("robot", {"speed": 1e-300}),
        ("robot", {"turn_rate": np.inf}),
        ("map", {"resolution": 1e-300}),
        ("map", {"resolution": -1.0}),
        ("map", {"resolution": np.nan}),
        ("map", {"resolution": 1e-4}),
        ("map", {"max_range": np.inf}),
        ("map", {"hit": 2.0}),
        ("views", {"kind": "dome", "rings": 2**33, "per_ring": 2**33}),
        ("views", {"kind": "dome", "rings": 0}),
        ("views", {"kind": "dome", "radius": np.nan}),
        ("views", {"kind": "ring", "positions": 2**40, "pitches": [0.0]}),
        ("views", {"kind": "ring", "pitches": [9.0]}),
        ("views", {"kind": "six_directions", "step": 0.0}),
        ("local_map", {"size": 257}),
        ("local_map", {"size": 2**40}),
        ("local_map", {"cell": np.inf}),
        ("local_map", {"colour": 1}),
    ],
    ids=str,
)
def test_setups_that_cannot_be(field: str, values: dict[str, Any]) -> None:
    setup: dict[str, Any] = {
        "scene": "room:0",
        "camera": CAMERA,
        "robot": {"kind": "flying"},
        "map": {"resolution": 0.3},
        "views": {"kind": "six_directions"},
        "local_map": {},
    }
    setup[field] = setup[field] | values
    with pytest.raises((TypeError, ValueError)):
        Setup(**setup)


@pytest.mark.parametrize(
    "changes",
    [
        {"resolution": 0.001, "map": {"resolution": 0.001}},
        {"views": {"kind": "dome", "radius": 1e30}},
        {"views": {"kind": "dome", "radius": 1000.0}},
        {"views": {"kind": "ring", "radius": 1000.0}},
        {"views": {"kind": "six_directions", "step": 1000.0}},
        {"robot": {"kind": "flying", "radius": 1e6}},
        {"robot": {"kind": "flying", "speed": 1e-30}},
        {"robot": {"kind": "arm", "link_radius": 1e6}, "views": {"kind": "dome"}},
        {"robot": {"kind": "arm", "upper_arm": 10.0, "forearm": 10.0}, "views": {"kind": "dome", "radius": 1e-3}},
        {"robot": {"kind": "arm", "upper_arm": 1e-30, "forearm": 0.6}, "views": {"kind": "dome"}},
        {"robot": {"kind": "arm", "upper_arm": 1e-6, "forearm": 0.6, "speed": 1e-30}, "views": {"kind": "dome"}},
        {"robot": {"kind": "arm"}, "views": {"kind": "dome", "min_pitch": -1.5707, "max_pitch": 1.5707}},
        {"camera": Camera(8, 6, hfov=1.0, far=1e30), "map": {"resolution": 0.3, "max_range": 4.0}},
        {"map": {"resolution": 1e6}},
        {"map": {"resolution": 900.0, "max_range": 3e6}, "camera": Camera(8, 6, hfov=1.0, far=3e6)},
        {"map": {"resolution": 0.3, "max_range": 1e-6}},
        {"local_map": {"size": 8, "cell": 1e30}},
    ],
    ids=str,
)
def test_extreme_setups_run_or_are_refused(changes: dict[str, Any]) -> None:
    quick = {"scene": "room:0", "camera": CAMERA} if "map" in changes else QUICK
    changes = {**quick, "observation": ("depth", "local_map"), **changes}
    refusal = "nothing"
    try:
        env = gym.make("NBV/SixDirections-v0", **changes)
        env.reset(seed=0)
        for action in range(6):
            observation, reward, *_, info = env.step(action)
            assert np.isfinite(reward) and np.isfinite(info["coverage"]) and np.isfinite(info["path_length"])
            assert not any(np.isnan(channel).any() for channel in observation.values())
    except ValueError as error:
        refusal = str(error)
    assert refusal


@pytest.mark.parametrize(("n", "threads"), [(0, 1), (-1, 1), (2**16 + 1, 1), (2**63, 1), (1, 0), (1, 1025), (1, -1)])
def test_numbers_of_environments_and_threads_have_limits(n: int, threads: int) -> None:
    with pytest.raises((ValueError, OverflowError)):
        gym.make_vec("NBV/SixDirections-v0", num_envs=n, num_threads=threads, vectorization_mode="vector_entry_point", **QUICK)


def test_images_beyond_memory_are_refused() -> None:
    large = Camera(4096, 4096, hfov=1.0)
    poses = np.tile(POSES[0], (200, 1))
    with pytest.raises(ValueError, match="too many"):
        SCENE.render_depth(large, poses)
    with pytest.raises((MemoryError, ValueError)):
        gym.make_vec("NBV/SixDirections-v0", num_envs=2**16, vectorization_mode="vector_entry_point", **(QUICK | {"camera": large}))
    env = NbvEnv("six_directions", **QUICK)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="count"):
        env.belief.sample_free(10**9, 0)
    octree = Octree(1e-4)
    with pytest.raises(ValueError, match="voxels|bounds|max_range|map"):
        octree.insert_points(np.array([[3.0, 3.0, 3.0]]), [0, 0, 0], max_range=10.0)
    with pytest.raises(ValueError, match="too large"):
        SCENE.surface_voxels(1e-5)
    with pytest.raises(ValueError, match="bounds|slice|cells"):
        Octree(0.01).slice(0.0, 1.0, [[-1e6, -1e6, 0], [1e6, 1e6, 1]])
