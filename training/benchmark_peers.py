"""Peers, where they are installed: each function does what a case of `benchmark_cases.py` asks of every contestant."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs.env import NbvEnv
from ..rust_env import Camera

#: Frames of a sequence: points (n, 3) in the world, free end points among them, and where they were seen from.
Frames = list[tuple[NDArray[np.float64], NDArray[np.float64]]]
Contestants = dict[str, Callable[[], object]]
OCTOMAP, OPEN3D, HANDROLLED = "OctoMap", "Open3D", "hand-rolled"
#: Calls of the binding that return at once.
BINDING = "binding"
#: The ratios that each package is needed for.
NEEDS = {
    "octomap": ("integrate_vs_octomap_64x48_10cm", "integrate_vs_octomap_320x240_5cm", "cast_vs_octomap", "cast_vs_octomap_unknown"),
    "open3d": ("render_vs_embree_200k", "render_vs_embree_1m"),
    "open3d and octomap": ("env_vs_handrolled_single", "env_vs_handrolled_vector"),
}
RATIOS = tuple(key for keys in NEEDS.values() for key in keys)


class Peers:
    """The peers that can be imported; `missing` says why the others cannot."""

    def __init__(self) -> None:
        self.versions: dict[str, str] = {}
        self.missing: dict[str, str] = {}
        #: The mesh that Open3D last got, and its scene.
        self._last: tuple[NDArray[np.float32] | None, Any] = (None, None)
        self.octomap = self._import("octomap", "octomap-python")
        self.open3d = self._import("open3d", "open3d")

    def _import(self, module: str, package: str) -> Any:
        try:
            found = importlib.import_module(module)
        # Open3D raises OSError where a library of the system is missing.
        except (ImportError, OSError) as error:
            self.missing[package] = f"{error} (pip install 'nbv-gym[bench]')"
            return None
        self.versions[package] = version(package)
        return found

    def render(self, triangles: NDArray[np.float32], camera: Camera, poses: NDArray[np.float32]) -> Contestants:
        """Depth images, in one thread. The rays are made beforehand: ours are made within the measured time."""
        if self.open3d is None:
            return {}
        scene, rays = self._scene(triangles), self.open3d.core.Tensor(rays_of(camera, poses))
        return {OPEN3D: lambda: scene.cast_rays(rays, nthreads=1)["t_hit"]}

    def disagreement(
        self, ours: NDArray[np.float32], triangles: NDArray[np.float32], camera: Camera, poses: NDArray[np.float32]
    ) -> float | None:
        """Share of the pixels whose depths differ by more than 1 mm; None without Open3D."""
        if self.open3d is None:
            return None
        rays = self.open3d.core.Tensor(rays_of(camera, poses))
        theirs = self._scene(triangles).cast_rays(rays, nthreads=1)["t_hit"].numpy()
        theirs[theirs > camera.far] = np.inf
        # Infinite depths are equal, and their difference is not a number.
        with np.errstate(invalid="ignore"):
            same = (ours == theirs) | (np.abs(ours - theirs) <= 1e-3)
        return float(1.0 - same.mean())

    def _scene(self, triangles: NDArray[np.float32]) -> Any:
        from .handrolled_env import raycasting_scene

        if self._last[0] is not triangles:
            self._last = (triangles, raycasting_scene(triangles))
        return self._last[1]

    def integrate(self, frames: Frames, resolution: float, max_range: float) -> Contestants:
        """Insert all frames into a fresh map."""
        if self.octomap is None:
            return {}
        return {OCTOMAP: lambda: self._tree(frames, resolution, max_range)}

    def _tree(self, frames: Frames, resolution: float, max_range: float) -> Any:
        tree = self.octomap.OcTree(resolution)
        for points, origin in frames:
            tree.insertPointCloud(points, origin, maxrange=max_range)
        return tree

    def cast(
        self,
        frames: Frames,
        resolution: float,
        max_range: float,
        origins: NDArray[Any],
        directions: NDArray[Any],
        ignore_unknown: bool,
    ) -> Contestants:
        """Cast rays to the first occupied voxel of the map of these frames, or to the first occupied or unknown one.

        The bindings (octomap-python, pyoctomap) take one ray a call. A second contestant casts the same rays from far outside
        the map, where the first voxel, unknown, ends them: the binding's own time (and one look-up), which is deducted.
        """
        if self.octomap is None:
            return {}
        tree = self._tree(frames, resolution, max_range)
        starts, ways = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        end = np.zeros(3)

        def cast(starts: NDArray[np.float64], ignore_unknown: bool) -> None:
            for start, way in zip(starts, ways, strict=True):
                tree.castRay(start, way, end, ignoreUnknownCells=ignore_unknown, maxRange=max_range)

        outside = starts + 500.0
        return {OCTOMAP: lambda: cast(starts, ignore_unknown), BINDING: lambda: cast(outside, False)}

    def environment(self, env: NbvEnv, steps: int, lean: bool = False) -> Contestants:
        """`steps` steps of one hand-rolled environment."""
        if self.octomap is None or self.open3d is None:
            return {}
        from .handrolled_env import HandrolledEnv, Problem

        peer = HandrolledEnv(Problem.of(env), lean=lean)

        def play() -> None:
            peer.reset(seed=0)
            rng = np.random.default_rng(0)
            for _ in range(steps):
                if peer.step(int(rng.integers(len(peer.problem.views))))[3]:
                    peer.reset()

        return {HANDROLLED: play}

    def vector(self, env: NbvEnv, envs: int, processes: int, steps: int) -> tuple[Contestants, Callable[[], None]]:
        """`steps` steps of each of `envs` hand-rolled environments, staggered, and how to end their processes."""
        if self.octomap is None or self.open3d is None:
            return {}, lambda: None
        from .handrolled_env import Problem, Workers

        problem = Problem.of(env)
        workers = Workers(problem, envs, processes, staggered=True)

        rng = np.random.default_rng(0)

        def play() -> None:
            for _ in range(steps):
                workers.step(rng.integers(len(problem.views), size=envs))

        return {HANDROLLED: play}, workers.close


def rays_of(camera: Camera, poses: NDArray[np.float32]) -> NDArray[np.float32]:
    """(k, height, width, 6) origins and unit directions."""
    ones = np.ones((len(poses), camera.height, camera.width), np.float32)
    points = np.stack([np.asarray(camera.unproject(one, pose)) for one, pose in zip(ones, poses, strict=True)])
    origins = np.broadcast_to(poses[:, None, None, :3], points.shape)
    ways = points - origins
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    return np.concatenate([origins, ways], axis=-1).astype(np.float32)
