"""The cases of `nbv-gym bench`: what is measured, on which data."""

from __future__ import annotations

import multiprocessing
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from ..agents.six_direction import LABELS
from ..envs.env import NbvEnv
from ..envs.vector_env import NbvVectorEnv
from ..rust_env import Camera, Octree, Scene
from .benchmark_peers import BINDING, Frames, Peers, rays_of
from .dataset import Spec, make_unit
from .mesh_writer import write_mesh

if TYPE_CHECKING:
    from .benchmark import Case

TASK = "dome_room"
#: A large room, in which the median ray from its middle has 3 m.
SCENE_SEED = ("room", 6)
SCENE = f"{SCENE_SEED[0]}:{SCENE_SEED[1]}"
#: As many environments as a vector environment is measured with, and its threads.
ENVS, THREADS = 64, 2
#: Steps of a slow peer's vector in a round.
PEER_STEPS = 5
#: Where the view history is weighed: its paper's camera and dome, views beside each other in two rings, voxels of 5 cm.
HISTORY_TASK, HISTORY_VIEWS, HISTORY_RESOLUTION = "wang2019", 40, 0.05


class Cases:
    """Makes the cases; data are shared and made when first needed."""

    def __init__(self, quick: bool, seed: int) -> None:
        self.quick = quick
        self.rng = np.random.default_rng(seed)
        self.peers = Peers()
        self.scene = Scene.generate(*SCENE_SEED)
        self.poses = self._poses(12)
        #: Share of pixels that differ from Open3D's, by scene.
        self.disagreement: dict[str, float] = {}

    def _poses(self, count: int) -> NDArray[np.float32]:
        """Viewpoints of a dome in the room."""
        env = NbvEnv(TASK, scene=SCENE)
        env.reset(seed=0)
        candidates = env.belief.candidates
        env.close()
        return np.asarray(candidates[np.linspace(0, len(candidates) - 1, count).astype(int)])

    def makers(self) -> dict[str, Callable[[], Case | list[Case]]]:
        return {
            "Environment": self.environment,
            "Vector environment": self.vector,
            "Depth images": self.render,
            "Map": self.integrate,
            "Rays": self.cast,
            "View gain": self.gain,
            "Data set": self.data_set,
        }

    def environment(self) -> list[Case]:
        from .benchmark import OURS, Case

        env = NbvEnv(TASK, scene=SCENE, success=None, budget=30)
        steps = 300 if self.quick else 1500

        def play() -> None:
            env.reset(seed=0)
            rng = np.random.default_rng(0)
            for _ in range(steps):
                if env.step(int(rng.integers(672)))[3]:
                    env.reset()

        cases = []
        for name, key, lean in (
            ("env step, single", "env_vs_handrolled_single", False),
            ("the same, peer counts voxels only", "env_vs_handrolled_single_lean", True),
        ):
            env.reset(seed=0)
            peers = self.peers.environment(env, steps // 10, lean)
            cases.append(Case(name, "steps/s", steps, {OURS: play, **peers}, key, shares=dict.fromkeys(peers, 0.1)))
        return cases

    def vector(self) -> Case:
        from .benchmark import OURS, Case

        envs = self._vector_env(THREADS)
        steps = 10 if self.quick else 40

        rng = np.random.default_rng(0)

        def play() -> None:
            for _ in range(steps):
                envs.step(rng.integers(672, size=ENVS))

        env = NbvEnv(TASK, scene=SCENE, success=None, budget=30)
        env.reset(seed=0)
        peers, close = self.peers.vector(env, ENVS, THREADS, PEER_STEPS)
        return Case(
            f"env step, vector of {ENVS}, {THREADS} threads", "steps/s", steps * ENVS, {OURS: play, **peers},
            "env_vs_handrolled_vector", wall=True, shares=dict.fromkeys(peers, PEER_STEPS / steps), close=close,
        )  # fmt: skip

    def _vector_env(self, threads: int) -> NbvVectorEnv:
        mode = AutoresetMode.SAME_STEP
        envs = NbvVectorEnv(TASK, ENVS, num_threads=threads, scene=SCENE, success=None, autoreset_mode=mode)
        envs.reset(seed=0)
        # A step costs more the more the map holds, above all the peer's: environments of all ages stand side by side.
        rng = np.random.default_rng(0)
        for age in range(envs.budget):
            envs.step(rng.integers(672, size=ENVS))
            envs.reset(options={"reset_mask": np.arange(ENVS) % envs.budget == age})
        return envs

    def render(self) -> list[Case]:
        from .benchmark import OURS, Case

        cases = []
        sizes = ((64, 48), (320, 240)) if self.quick else ((64, 48), (160, 120), (320, 240), (640, 480))
        scenes = {"room": self.scene, "200 k triangles": self._dense(200_000), "1 M triangles": self._dense(1_000_000)}
        for name, scene in scenes.items():
            triangles = np.asarray(scene.triangles)
            for width, height in sizes:
                camera = Camera(width, height, hfov=np.deg2rad(60), far=10.0)

                def draw(scene: Scene = scene, camera: Camera = camera) -> object:
                    return scene.render_depth(camera, self.poses)

                work = len(self.poses) * width * height / 1e6
                key = {"200 k triangles": "render_vs_embree_200k", "1 M triangles": "render_vs_embree_1m"}.get(name)
                peers = self.peers.render(triangles, camera, self.poses)
                case = Case(f"depth {width}x{height}, {name}", "Mrays/s", work, {OURS: draw, **peers}, key if width == 320 else None)
                if width == 320:
                    share = self.peers.disagreement(np.asarray(draw()), triangles, camera, self.poses)
                    if share is not None:
                        self.disagreement[name] = share
                    case.rounds = 5 if self.quick else 9
                cases.append(case)
        return cases

    def _dense(self, triangles: int) -> Scene:
        """The room in many more triangles: the largest are cut across their longest edge until there are enough."""
        mesh = np.asarray(self.scene.triangles, dtype=np.float64)
        while len(mesh) < triangles:
            areas = np.linalg.norm(np.cross(mesh[:, 1] - mesh[:, 0], mesh[:, 2] - mesh[:, 0]), axis=1)
            order = np.argsort(-areas, kind="stable")
            cut, rest = mesh[order[: triangles - len(mesh)]], mesh[order[triangles - len(mesh) :]]
            edges = np.linalg.norm(np.roll(cut, -1, axis=1) - cut, axis=2)
            # Turn each triangle so that its longest edge runs from corner 0 to corner 1.
            turn = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
            a, b, c = np.take_along_axis(cut, turn[:, :, None], axis=1).transpose(1, 0, 2)
            middle = (a + b) / 2
            mesh = np.concatenate([rest, np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "dense.ply"
            write_mesh(path, mesh.astype(np.float32))
            return Scene.load(path)

    def frames(self, camera: Camera, max_range: float) -> tuple[Frames, NDArray[np.float32]]:
        """Depth images of the room, as points for peers that take points, and as images."""
        depths = np.asarray(self.scene.render_depth(camera, self.poses))
        frames = []
        for depth, pose in zip(depths, self.poses, strict=True):
            # Where nothing is near enough a ray still frees space up to the maximum range.
            points = np.asarray(camera.unproject(np.minimum(depth, max_range + 1.0), pose)).reshape(-1, 3)
            frames.append((points[np.isfinite(points).all(axis=1)].astype(np.float64), pose[:3].astype(np.float64)))
        return frames, depths

    def integrate(self) -> list[Case]:
        from .benchmark import OURS, Case

        cases = []
        for width, height, resolution in ((64, 48, 0.1), (320, 240, 0.05)):
            camera = Camera(width, height, hfov=np.deg2rad(60), far=10.0)
            frames, depths = self.frames(camera, 4.0)

            def insert(camera: Camera = camera, depths: NDArray[np.float32] = depths, resolution: float = resolution) -> object:
                octree = Octree(resolution)
                for depth, pose in zip(depths, self.poses, strict=True):
                    octree.insert_depth(depth, camera, pose, max_range=4.0)
                return octree

            peers = self.peers.integrate(frames, resolution, 4.0)
            name = f"integrate {width}x{height}, {resolution * 100:.0f} cm"
            key = f"integrate_vs_octomap_{width}x{height}_{resolution * 100:.0f}cm"
            work = depths.size / 1e6
            rounds = 3 if self.quick and width == 320 else 9
            cases.append(Case(name, "Mpoints/s", work, {OURS: insert, **peers}, key, rounds=rounds))
        return cases

    def _map(self, resolution: float) -> tuple[Octree, Frames]:
        camera = Camera(320, 240, hfov=np.deg2rad(60), far=10.0)
        frames, depths = self.frames(camera, 4.0)
        octree = Octree(resolution)
        for depth, pose in zip(depths, self.poses, strict=True):
            octree.insert_depth(depth, camera, pose, max_range=4.0)
        return octree, frames

    def cast(self) -> list[Case]:
        """The rays of 30 candidate views: to the first occupied voxel, and to the first unknown or occupied one."""
        from .benchmark import OURS, Case

        octree, frames = self._map(0.1)
        rays = rays_of(Camera(48, 36, hfov=np.deg2rad(60), far=4.0), self._poses(30)).reshape(-1, 6)
        origins, directions = np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:])
        cases = []
        for name, key, ignore_unknown in (
            ("cast to occupied, 10 cm", "cast_vs_octomap", True),
            ("cast to unknown or occupied, 10 cm", "cast_vs_octomap_unknown", False),
        ):

            def cast(ignore_unknown: bool = ignore_unknown) -> object:
                return octree.cast_rays(origins, directions, 4.0, ignore_unknown=ignore_unknown)

            peers = self.peers.cast(frames, 0.1, 4.0, origins, directions, ignore_unknown)
            overhead = BINDING if BINDING in peers else None
            cases.append(Case(name, "Mrays/s", len(rays) / 1e6, {OURS: cast, **peers}, key, overhead=overhead))
        return cases

    def gain(self) -> list[Case]:
        """30 views of 48 x 36 rays, as a planner asks for them."""
        from .benchmark import OURS, Case

        octree, _ = self._map(0.1)
        camera = Camera(48, 36, hfov=np.deg2rad(60), far=4.0)
        views = self._poses(30)
        cases = []
        for metric in ("unknown_count", "entropy", "uncertainty", "occlusion_aware"):

            def ask(metric: str = metric) -> object:
                return octree.view_gain(views, camera, metric=metric, max_range=4.0)

            work = len(views) * 48 * 36 / 1e6
            cases.append(Case(f"view gain {metric}, 10 cm", "Mrays/s", work, {OURS: ask}))
        return cases

    def data_set(self) -> Case:
        """One room of the six-direction data set, as `nbv-gym dataset six-directions` makes them: scene, labels, images."""
        from .benchmark import OURS, Case

        spec = Spec()
        views = spec.per_scene * len(LABELS)

        def make() -> None:
            made = len(make_unit(spec, 0)["label"])
            if made != views:
                raise RuntimeError(f"the first room of the data set gives {made} views, {views} were expected")

        return Case("dataset: one room, one thread", "views/s", views, {OURS: make}, rounds=1 if self.quick else 3)

    def view_history(self) -> dict[str, float]:
        """Bytes that the view history adds to a map for each voxel that it has seen, after neighbouring views of a dome."""
        env = NbvEnv(HISTORY_TASK, scene=SCENE, resolution=HISTORY_RESOLUTION)
        env.reset(seed=0)
        camera, per_ring = env.belief.camera, env.task.setup["views"]["per_ring"]
        rings = [env.belief.candidates[ring * per_ring :][: HISTORY_VIEWS // 2] for ring in (10, 11)]
        env.close()
        plain, with_history = Octree(HISTORY_RESOLUTION), Octree(HISTORY_RESOLUTION, view_history=True)
        for view in np.concatenate(rings):
            depth = self.scene.render_depth(camera, view[np.newaxis])[0]
            for octree in (plain, with_history):
                octree.insert_depth(depth, camera, view)
            with_history.record_view(camera, view)
        voxels = np.concatenate([with_history.occupied(), with_history.free()])
        # In parts: 36 x 18 directions of 10^5 voxels take hundreds of megabytes.
        parts = (np.asarray(with_history.view_history(voxels[i : i + 4096])[0]) for i in range(0, len(voxels), 4096))
        seen = sum(int(np.isfinite(part).any(axis=(1, 2)).sum()) for part in parts)
        added = with_history.memory_bytes() - plain.memory_bytes()
        return {"bytes_per_seen_voxel": added / seen, "seen_voxels": seen, "views": HISTORY_VIEWS, "resolution": HISTORY_RESOLUTION}

    def stages(self) -> dict[str, float]:
        """Microseconds per step and stage, in one thread."""
        envs = self._vector_env(1)
        before, steps = envs.simulator.timings(), 10 if self.quick else 60
        rng = np.random.default_rng(0)
        for _ in range(steps):
            envs.step(rng.integers(672, size=ENVS))
        after = envs.simulator.timings()
        envs.close()
        return {stage: (after[stage] - before[stage]) / (steps * ENVS) * 1e6 for stage in after}

    def memory(self) -> dict[str, Any]:
        """What environments take after some views: their maps, and the growth of a process of its own (Linux)."""
        views = 20
        context = multiprocessing.get_context("spawn")
        grown = {}
        for count in (1, ENVS):
            with context.Pool(1) as pool:
                grown[count] = pool.apply(growth, (count, views))
        known = all(bytes_ is not None for bytes_, _ in grown.values())
        return {
            "map_bytes": grown[ENVS][1],
            "process_bytes": {str(count): bytes_ for count, (bytes_, _) in grown.items()} if known else None,
            "views": views,
        }


def growth(count: int, views: int) -> tuple[int | None, float]:
    """Bytes by which this process grows with environments and their common scene, and bytes of a map."""
    before = resident_bytes()
    envs = NbvVectorEnv(TASK, count, scene=SCENE, success=None, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(views):
        envs.step(rng.integers(672, size=count))
    after = resident_bytes()
    maps = [envs.belief(i).octree.memory_bytes() for i in range(count)]
    envs.close()
    return None if before is None or after is None else after - before, float(np.mean(maps))


def resident_bytes() -> int | None:
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    import resource

    return pages * resource.getpagesize()
