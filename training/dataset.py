"""The six-direction data set (Wang et al. 2019, section IV-B): depth images, labelled with the direction that shows most.

A view's label is the direction (up, down, forward, backward, right, left in the camera's frame, by 0.1 m, Eq. 5) from which
the camera sees most occupied surface voxels; G is that number less the number seen from the view itself. A view must hold
three objects, and the six directions occur equally often.

The work is cut into units: one scene (or, of scenes that the user names, one more turn in a scene) with a random stream of
its own. A unit's file does not depend on who made it or when, so that any number of workers gives the same data set, and one
that was interrupted goes on. The manifest then takes, in the order of the units, as many views of each direction as are
wanted.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..agents.agent import rotation
from ..agents.six_direction import DIRECTIONS, LABELS
from ..rust_env import SCENE_KINDS, Camera, Scene
from .scene_digest import scene_digest
from .shards import claimed, write_bytes, write_whole

#: Version of the files' layout.
LAYOUT = 1
MANIFEST = "manifest.json"
#: Units that are looked at before the next ones are begun: the data set is a prefix of the units, whoever makes them.
WAVE = 16
#: Positions that are tried at a time, and in all, before a unit is content with what it has.
BATCH, MAX_TRIES = 64, 512
#: Units in a row that give nothing that is still missing before a data set is given up; not before every scene had its turn.
FRUITLESS = 50
#: Depths are kept in millimetres, 16 bits.
MAX_FAR = 65.0
#: Largest pitch of a view, radians.
PITCH = float(np.deg2rad(40.0))


@dataclasses.dataclass(frozen=True)
class Spec:
    """What a data set consists of; two with equal specs are equal, byte for byte.

    Attributes:
        views: Number of views; the paper has 7,920.
        scenes: Generated kinds (`room`: room:0, room:1, ...) or scene files, taken in turns.
        seed: Of the views.
        first: Seed of the first generated scene; the lower ones are left to tasks, so that no room stands in both.
        width, height: Of the images, pixels.
        hfov: Of the camera, radians; a Kinect's 57 degrees.
        far: Depth that the images reach to, metres.
        step: d_delta, the length of a move, metres.
        resolution: Side of the voxels that are counted, metres.
        min_objects: Objects that a view must hold at least.
        per_scene: Views of each direction that a unit gives at most.
    """

    views: int = 7920
    scenes: tuple[str, ...] = ("room",)
    seed: int = 0
    first: int = 1000
    width: int = 128
    height: int = 96
    hfov: float = float(np.deg2rad(57.0))
    far: float = 4.0
    step: float = 0.1
    resolution: float = 0.025
    min_objects: int = 3
    per_scene: int = 6

    def __post_init__(self) -> None:
        for name in ("views", "width", "height", "per_scene"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("far", "step", "resolution", "hfov"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name} must be finite and > 0, got {getattr(self, name)}")
        for name in ("seed", "first", "min_objects"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        if self.far > MAX_FAR:
            raise ValueError(f"far must be at most {MAX_FAR} m, got {self.far}")
        if not self.scenes:
            raise ValueError("name at least one scene")
        for scene in self.scenes:
            if scene not in SCENE_KINDS and not Path(scene).is_file():
                raise FileNotFoundError(f"scene {scene!r}: no such file, and no generated kind (those are {', '.join(SCENE_KINDS)})")
        self.camera()

    def camera(self) -> Camera:
        return Camera(self.width, self.height, hfov=self.hfov, near=0.05, far=self.far)

    def digest(self) -> str:
        """Names the recipe, that is, everything that a unit depends on besides its number: all but the number of views.

        Raises:
            OSError, ValueError: A scene file cannot be read.
        """
        from .. import __version__

        facts: dict[str, Any] = {**dataclasses.asdict(self), "layout": LAYOUT, "version": __version__}
        del facts["views"]
        facts["files"] = {scene: scene_digest(scene) for scene in self.scenes if scene not in SCENE_KINDS}
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]

    def scene_of(self, unit: int) -> tuple[str, int]:
        """The scene of a unit as `kind` and seed, or as a file and how often it was used before."""
        scene, turn = self.scenes[unit % len(self.scenes)], unit // len(self.scenes)
        return scene, self.first + turn if scene in SCENE_KINDS else turn


Unit = dict[str, NDArray[Any]]


def make_unit(spec: Spec, unit: int) -> Unit:
    """The views of one unit: arrays of equal length.

    `depth` (k, h, w) uint16 millimetres, `far` where nothing was met; `pose` (k, 7); `gain` (k, 6) int32, voxels seen from the
    moved view less those from the view; `seen` (k,) int32, voxels seen from the view; `objects` (k,) int32; `label` (k,) int64.
    """
    name, number = spec.scene_of(unit)
    scene = Scene.generate(name, number) if name in SCENE_KINDS else Scene.load(name)
    rng = np.random.default_rng([spec.seed, unit])
    camera = spec.camera()
    kept: dict[str, list[Any]] = {key: [] for key in ("pose", "gain", "seen", "objects", "label")}
    counts = np.zeros(len(LABELS), dtype=np.int64)
    for _ in range(MAX_TRIES // BATCH):
        if counts.min() >= spec.per_scene:
            break
        poses = draw_views(scene, spec, rng)
        _, objects = scene.visible_voxels(camera, poses, spec.resolution)
        for pose, held in zip(poses, objects, strict=True):
            if held < spec.min_objects:
                continue
            moved = np.repeat(pose[None], 1 + len(LABELS), axis=0)
            moved[1:, :3] += (spec.step * DIRECTIONS @ rotation(pose).T).astype(np.float32)
            seen, _ = scene.visible_voxels(camera, moved, spec.resolution)
            gain = seen[1:].astype(np.int64) - int(seen[0])
            best = np.flatnonzero(gain == gain.max())
            # A tie names no direction.
            if best.size > 1 or counts[best[0]] >= spec.per_scene:
                continue
            label = int(best[0])
            counts[label] += 1
            for key, value in (("pose", pose), ("gain", gain), ("seen", seen[0]), ("objects", held), ("label", label)):
                kept[key].append(value)
    poses = np.array(kept["pose"], dtype=np.float32).reshape(-1, 7)
    depth = scene.render_depth(camera, poses) if len(poses) else np.zeros((0, spec.height, spec.width), np.float32)
    millimetres = np.rint(np.minimum(depth, np.float32(spec.far)) * 1000.0).astype(np.uint16)
    return {
        "depth": millimetres,
        "pose": poses,
        "gain": np.array(kept["gain"], dtype=np.int32).reshape(-1, len(LABELS)),
        "seen": np.array(kept["seen"], dtype=np.int32),
        "objects": np.array(kept["objects"], dtype=np.int32),
        "label": np.array(kept["label"], dtype=np.int64),
    }


def draw_views(scene: Scene, spec: Spec, rng: np.random.Generator) -> NDArray[np.float32]:
    """Random viewpoints (k, 7) in free space, 0.6 to 1.8 m above the floor, with room for each move; level but for a pitch of
    up to 40 degrees."""
    low, high = scene.bounds.astype(np.float64)
    position = rng.uniform([low[0], low[1], scene.floor + 0.6], [high[0], high[1], scene.floor + 1.8], size=(BATCH, 3))
    yaw, pitch = rng.uniform(-np.pi, np.pi, BATCH), rng.uniform(-PITCH, PITCH, BATCH)
    room = scene.clearance(position.astype(np.float32), 2.0 * spec.step) >= 2.0 * spec.step
    return viewpoints(position, yaw, pitch)[room]


def viewpoints(position: NDArray[np.float64], yaw: NDArray[np.float64], pitch: NDArray[np.float64]) -> NDArray[np.float32]:
    """(n, 7) from positions (n, 3), metres, headings and pitches (n,), radians; up is positive."""
    # The camera's axes as columns: right, down, forward. As quaternions: a turn about the world's z after one that lays the
    # optical axis along +x, pitched.
    half = (yaw - np.pi / 2) / 2, (-np.pi / 2 + pitch) / 2
    (cy, cp), (sy, sp) = np.cos(half), np.sin(half)
    quaternion = np.stack([cy * sp, sy * sp, sy * cp, cy * cp], axis=1)
    return np.concatenate([position, quaternion], axis=1).astype(np.float32)


# --- Files --------------------------------------------------------------------------------------------------------------------


def unit_path(folder: Path, unit: int) -> Path:
    return folder / f"unit-{unit:06d}.npz"


def write_unit(folder: Path, unit: int, digest: str, arrays: Unit) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, digest=np.array(digest), **arrays)  # type: ignore[arg-type]
    write_bytes(unit_path(folder, unit), buffer.getvalue())


class Content:
    """Names what a data set holds: the same for the same views, whoever made and packed them."""

    def __init__(self) -> None:
        self._sum = hashlib.sha256()

    def add(self, scene: str, part: Unit) -> None:
        """The views that were taken from the next unit."""
        self._sum.update(scene.encode())
        for key in sorted(part):
            value = np.ascontiguousarray(part[key])
            self._sum.update(f" {key} {value.dtype.str} {value.shape} ".encode())
            self._sum.update(value.data)

    def digest(self) -> str:
        return self._sum.hexdigest()[:16]


class DamagedUnit(ValueError):
    """A file of a data set that is not whole; making the data set once more mends it."""


def read_unit(folder: Path, unit: int, digest: str) -> Unit:
    """The arrays of a unit.

    Raises:
        OSError: The file is not there.
        DamagedUnit: It is cut short or damaged.
        ValueError: It belongs to another data set.
    """
    import zipfile
    import zlib

    path = unit_path(folder, unit)
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, KeyError) as error:
        raise DamagedUnit(f"{path}: damaged or cut short ({error}); run the same `dataset` command again to mend it") from None
    found = str(arrays.pop("digest", ""))
    if found != digest:
        raise ValueError(f"{path}: belongs to another data set ({found or 'no digest'}, expected {digest})")
    lengths = {key: len(value) for key, value in arrays.items()}
    if set(arrays) != {"depth", "pose", "gain", "seen", "objects", "label"} or len(set(lengths.values())) != 1:
        raise DamagedUnit(f"{path}: unexpected arrays {lengths}")
    if arrays["gain"].shape[1:] != (len(LABELS),) or not np.isin(arrays["label"], np.arange(len(LABELS))).all():
        raise DamagedUnit(f"{path}: {arrays['gain'].shape[-1]} classes, expected {len(LABELS)}")
    return arrays


def _work(folder: Path, spec: Spec, digest: str, unit: int) -> int:
    """Make a unit unless it is there, whole; returns its number."""
    try:
        read_unit(folder, unit, digest)
    except (FileNotFoundError, DamagedUnit):
        write_unit(folder, unit, digest, make_unit(spec, unit))
    return unit


def _ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def generate(
    spec: Spec,
    folder: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    max_units: int = 100_000,
) -> dict[str, Any]:
    """Make a data set, or go on with one; returns the manifest.

    Args:
        spec: What it consists of.
        folder: Where it stands; one of another spec is refused.
        workers: Processes; the result does not depend on it.
        progress: Called with the number of views so far and of those wanted.
        max_units: Give up after so many scenes.

    Raises:
        ValueError: The folder holds something else, a scene file is malformed or holds fewer objects than a view must, or the
            scenes do not give enough views.
        OSError: The folder cannot be written, or a scene file not be read.
        RuntimeError: Another process is at work there.
    """
    if workers < 1:
        raise ValueError(f"workers must be >= 1, got {workers}")
    digest = spec.digest()
    _check_objects(spec)
    facts = {"layout": LAYOUT, "digest": digest, "spec": {**dataclasses.asdict(spec), "scenes": list(spec.scenes)}}
    with claimed(folder, fresh=False):
        _sign(folder, facts)
        return _fill(folder, spec, facts, workers, progress, max_units)


def _check_objects(spec: Spec) -> None:
    """Raise ValueError for a scene file that no view can be of."""
    for path in spec.scenes:
        if path not in SCENE_KINDS:
            objects = np.count_nonzero(np.unique(Scene.load(path).objects))
            if objects < spec.min_objects:
                raise ValueError(f"{path}: the scene has {objects} objects, a view must hold {spec.min_objects} (min_objects)")


def _sign(folder: Path, facts: dict[str, Any]) -> None:
    """Make the folder that of this data set, unless it holds something else."""
    marker = folder / "spec.json"
    if marker.exists():
        try:
            there = json.loads(marker.read_text(encoding="utf-8"))
            found = (there["digest"], there["spec"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{marker}: damaged ({error}); remove it only if the folder holds this very data set") from None
        if found[0] != facts["digest"]:
            raise ValueError(f"{folder} holds another data set ({found[1]}); choose another folder")
    elif others := sorted(path.name for path in folder.iterdir() if not path.name.endswith(".part")):
        raise ValueError(f"{folder} holds other files ({', '.join(others[:3])}); choose an empty folder")
    write_whole(marker, json.dumps(facts, indent=1) + "\n")


def _fill(
    folder: Path, spec: Spec, facts: dict[str, Any], workers: int, progress: Callable[[int, int], None] | None, max_units: int
) -> dict[str, Any]:
    """Make what is missing, and name what belongs to the data set."""
    digest = facts["digest"]
    wanted = np.full(len(LABELS), spec.views // len(LABELS))
    wanted[: spec.views % len(LABELS)] += 1
    taken: list[dict[str, Any]] = []
    counts = np.zeros(len(LABELS), dtype=np.int64)
    content = Content()
    fruitless = 0
    with _Workers(folder, spec, digest, workers, max_units) as workshop:
        for unit in range(max_units):
            workshop.finish(unit)
            arrays = read_unit(folder, unit, digest)
            rows = []
            for row, label in enumerate(arrays["label"]):
                if counts[label] < wanted[label]:
                    counts[label] += 1
                    rows.append(row)
            scene, number = spec.scene_of(unit)
            sha = hashlib.sha256(unit_path(folder, unit).read_bytes()).hexdigest()
            name = f"{scene}:{number}" if scene in SCENE_KINDS else scene
            taken.append({"unit": unit, "scene": name, "rows": rows, "sha256": sha})
            content.add(name, {key: value[rows] for key, value in arrays.items()})
            if progress is not None:
                progress(int(counts.sum()), spec.views)
            if (counts == wanted).all():
                break
            fruitless = 0 if rows else fruitless + 1
            if fruitless >= max(FRUITLESS, len(spec.scenes)):
                missing = ", ".join(f"{LABELS[i]} ({counts[i]} of {wanted[i]})" for i in np.flatnonzero(counts < wanted))
                raise ValueError(
                    f"{fruitless} units in a row, the last in {name}, gave no view of the directions that are missing: {missing}; "
                    f"take other scenes, or fewer objects in a view (min_objects, now {spec.min_objects})"
                )
        else:
            raise ValueError(f"{max_units} scenes gave {counts.tolist()} views per direction, {wanted.tolist()} are wanted")
    manifest = {**facts, "content": content.digest(), "labels": list(LABELS), "counts": counts.tolist(), "units": taken}
    write_whole(folder / MANIFEST, json.dumps(manifest) + "\n")
    return manifest


class _Workers:
    """Lets a caller wait for unit after unit, while processes are a wave ahead."""

    def __init__(self, folder: Path, spec: Spec, digest: str, workers: int, max_units: int) -> None:
        self._arguments = (folder, spec, digest)
        self._max_units = max_units
        self._pool: ProcessPoolExecutor | None = None
        if workers > 1:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_ignore_interrupts)
        self._flying: dict[int, Any] = {}
        self._next = 0

    def __enter__(self) -> _Workers:
        return self

    def finish(self, unit: int) -> None:
        """Return once the unit is on disk."""
        if self._pool is None:
            _work(*self._arguments, unit)
            return
        while self._next < min(unit + WAVE, self._max_units):
            self._flying[self._next] = self._pool.submit(_work, *self._arguments, self._next)
            self._next += 1
        self._flying.pop(unit).result()

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)


@dataclasses.dataclass
class DataSet:
    """A data set in memory: arrays of n views, and the scene of each."""

    depth: NDArray[np.uint16]
    pose: NDArray[np.float32]
    gain: NDArray[np.int32]
    seen: NDArray[np.int32]
    label: NDArray[np.int64]
    scene: NDArray[np.str_]
    spec: dict[str, Any]
    #: Of the content; two data sets of one recipe and different numbers of views differ.
    digest: str

    def __len__(self) -> int:
        return len(self.label)


def load(folder: Path) -> DataSet:
    """Read a finished data set.

    Raises:
        OSError: There is none.
        ValueError: A file is damaged, or not the one that the manifest names.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        digest, spec = manifest["digest"], manifest["spec"]
        units = [(int(u["unit"]), str(u["scene"]), str(u["sha256"]), np.array(u["rows"], dtype=np.intp)) for u in manifest["units"]]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: not a manifest ({error})") from None
    if manifest.get("layout") != LAYOUT:
        raise ValueError(f"{path}: layout {manifest.get('layout')!r}, this version reads {LAYOUT}")
    if tuple(manifest.get("labels", ())) != LABELS:
        raise ValueError(f"{path}: classes {manifest.get('labels')}, expected {list(LABELS)}")
    parts: list[Unit] = []
    scenes: list[str] = []
    content = Content()
    for unit, scene, sha, rows in units:
        file = unit_path(folder, unit)
        if hashlib.sha256(file.read_bytes()).hexdigest() != sha:
            raise DamagedUnit(f"{file}: damaged or cut short; run the same `dataset` command again to mend it")
        arrays = read_unit(folder, unit, digest)
        if not np.isin(rows, np.arange(len(arrays["label"]))).all():
            raise ValueError(f"{path}: rows of unit {unit} that its file does not have")
        parts.append({key: value[rows] for key, value in arrays.items()})
        content.add(scene, parts[-1])
        scenes += [scene] * len(rows)
    joined = {key: np.concatenate([part[key] for part in parts]) for key in ("depth", "pose", "gain", "seen", "label")}
    return DataSet(**joined, scene=np.array(scenes), spec=spec, digest=content.digest())


def split_scenes(scene: NDArray[np.str_], share: float, seed: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Training and validation rows; scenes are dealt out, so that no room stands in both.

    Args:
        scene: (n,) the scene of each view.
        share: Of the views that are to validate, in (0, 1).
        seed: Of the deal; another one for each fold.

    Raises:
        ValueError: There are fewer than two scenes, or the share is none.
    """
    if not 0 < share < 1:
        raise ValueError(f"the validation share must lie in (0, 1), got {share}")
    names, first, sizes = np.unique(scene, return_index=True, return_counts=True)
    if len(names) < 2:
        raise ValueError(f"a split needs at least two scenes, there are {len(names)}")
    order = np.random.default_rng(seed).permutation(np.argsort(first))
    below = np.cumsum(sizes[order])
    held = max(1, min(int(np.searchsorted(below, share * len(scene)) + 1), len(names) - 1))
    validation = np.isin(scene, names[order[:held]])
    return np.flatnonzero(~validation), np.flatnonzero(validation)


def batches(order: NDArray[np.intp], size: int) -> Iterator[NDArray[np.intp]]:
    for start in range(0, len(order), size):
        yield order[start : start + size]
