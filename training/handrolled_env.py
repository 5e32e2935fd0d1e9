"""A peer, not a part of the package: the environment that one would otherwise write.

Open3D's RaycastingScene (Embree) renders, octomap-python maps, NumPy does the rest; a step is the work of a step of
`NBV/DomeRoom-v0`: go to a view in a straight line, stop before what is in the way, render, insert the cloud up to
the maximum range within the exploration bounds, reward the bits of entropy lost, measure coverage, return the same
observation. It is written to be quick: batched calls, lazy evaluation (no pruning, so that the leaves are the known
voxels), log-odds by parsing the serialised map at once (the binding has no batched way), and only the voxels in which
rays ended are looked at for coverage. It does less where the same would cost it more: no action masks, no detours, the
body is a ray. `lean` does still less: the reward is the number of voxels that became known.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
from multiprocessing.connection import Connection
from typing import Any

import gymnasium as gym
import numpy as np
import octomap
import open3d as o3d
from gymnasium import spaces
from gymnasium.vector import SyncVectorEnv
from numpy.typing import NDArray

from ..envs.env import NbvEnv

Floats = NDArray[np.float32]
#: A node of OctoMap's `.ot` format.
NODE = np.dtype([("log_odds", "<f4"), ("children", "u1")])


@dataclasses.dataclass(frozen=True)
class Problem:
    """What an episode is played with; arrays only, so that processes can be given it.

    Attributes:
        triangles: (m, 3, 3) metres.
        bounds: (2, 3) corners of what is to be explored, metres.
        views: (k, 7) viewpoints to choose from.
        surface: (n, 3) centres of the surface voxels that count for coverage.
        rays: (height, width, 3) unit directions of the pixels, in the camera frame.
        near: Depths below are 0, metres.
        far: Depths above are no measurement, and the maximum range of the map, metres.
        resolution: Metres.
        radius: Of the body, metres.
        budget: Steps of an episode.
    """

    triangles: Floats
    bounds: Floats
    views: Floats
    surface: Floats
    rays: Floats
    near: float
    far: float
    resolution: float
    radius: float
    budget: int

    @staticmethod
    def of(env: NbvEnv) -> Problem:
        """The problem of a running environment of the package."""
        camera, setup = env.task.setup["camera"], env.task.setup
        at_origin = np.array([0, 0, 0, 0, 0, 0, 1], np.float32)
        points = np.asarray(camera.unproject(np.ones((camera.height, camera.width), np.float32), at_origin))
        return Problem(
            triangles=np.asarray(env.simulator.scene(0).triangles),
            bounds=np.asarray(env.belief.bounds),
            views=np.asarray(env.belief.candidates),
            surface=np.asarray(env.simulator.truth_surface(0)),
            rays=points / np.linalg.norm(points, axis=-1, keepdims=True),
            near=camera.near,
            far=camera.far,
            resolution=env.belief.resolution,
            radius=setup["robot"]["radius"],
            budget=env.budget,
        )


def raycasting_scene(triangles: Floats) -> Any:
    """Open3D's scene of a mesh (m, 3, 3). One thread builds it; `cast_rays` is told its own number."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    corners = np.ascontiguousarray(triangles, np.float32).reshape(-1, 3)
    indices = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(o3d.core.Tensor(corners), o3d.core.Tensor(indices))
    scene.cast_rays(o3d.core.Tensor(np.array([[0, 0, 0, 0, 0, 1]], np.float32)), nthreads=1)  # builds the hierarchy
    return scene


def rotation(quaternion: Floats) -> Floats:
    """(3, 3) world_from_camera of a unit quaternion (x, y, z, w)."""
    x, y, z, w = (float(v) for v in quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ],
        np.float32,
    )


class HandrolledEnv(gym.Env[Any, Any]):
    """The environment; several may share one Open3D scene."""

    def __init__(self, problem: Problem, scene: Any = None, lean: bool = False) -> None:
        self.problem = problem
        self.lean = lean
        self.scene = raycasting_scene(problem.triangles) if scene is None else scene
        height, width, _ = problem.rays.shape
        self.directions = problem.rays.reshape(-1, 3)
        self.ray_buffer = np.empty((height * width, 6), np.float32)
        # The surface voxels as a dense grid, so that an end point is one look-up.
        keys = np.floor(problem.surface / problem.resolution).astype(np.int64)
        self.low = keys.min(axis=0)
        self.shape = keys.max(axis=0) - self.low + 1
        self.is_surface = np.zeros(self.shape, bool)
        self.is_surface[tuple((keys - self.low).T)] = True
        self.is_surface = self.is_surface.ravel()
        self.observation_space = spaces.Dict(
            {
                "depth": spaces.Box(0.0, problem.far, (height, width), np.float32),
                "pose": spaces.Box(-np.inf, np.inf, (7,), np.float32),
                "visited": spaces.Box(0.0, problem.budget + 1.0, (len(problem.views),), np.float32),
            }
        )
        self.action_space = spaces.Discrete(len(problem.views))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin at a random view, or at `options["view"]`."""
        super().reset(seed=seed)
        first = (options or {}).get("view")
        self.tree = octomap.OcTree(self.problem.resolution)
        self.tree.setBBXMin(self.problem.bounds[0].astype(np.float64))
        self.tree.setBBXMax(self.problem.bounds[1].astype(np.float64))
        self.tree.useBBXLimit(True)
        self.visited = np.zeros(len(self.problem.views), np.float32)
        self.pose = self.problem.views[int(self.np_random.integers(len(self.visited))) if first is None else first].copy()
        self.covered = np.zeros(len(self.is_surface), bool)
        self.steps = self.known = 0
        self.information = 0.0
        depth = self.look()
        return self.observe(depth), {"coverage": self.coverage(), "known_voxels": self.known}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Go to a view, look, and update the map."""
        self.visited[action] += 1
        self.steps += 1
        contact = self.move(self.problem.views[action])
        known, information = self.known, self.information
        depth = self.look()
        info = {"coverage": self.coverage(), "known_voxels": self.known, "contact": contact}
        reward = self.known - known if self.lean else self.information - information
        return self.observe(depth), float(reward), False, self.steps >= self.problem.budget, info

    def move(self, goal: Floats) -> bool:
        """In a straight line, up to the body's radius before the first surface."""
        way = goal[:3] - self.pose[:3]
        length = float(np.linalg.norm(way))
        self.pose[3:] = goal[3:]
        if length == 0.0:
            return False
        direction = way / length
        ray = np.concatenate([self.pose[:3], direction])[None].astype(np.float32)
        hit = float(self.scene.cast_rays(o3d.core.Tensor(ray), nthreads=1)["t_hit"].numpy()[0])
        free = min(length, max(hit - self.problem.radius, 0.0))
        self.pose[:3] += direction * free
        return free < length

    def look(self) -> Floats:
        """Take an image and put it into the map; (height, width) metres, inf where nothing was met."""
        problem, rays = self.problem, self.ray_buffer
        rays[:, :3] = self.pose[:3]
        np.matmul(self.directions, rotation(self.pose[3:]).T, out=rays[:, 3:])
        depth: Floats = self.scene.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)["t_hit"].numpy()
        depth[depth > problem.far] = np.inf
        depth[depth < problem.near] = 0.0
        measured = depth > 0
        # Rays that met nothing free space up to the maximum range.
        reach = np.minimum(depth, problem.far + 1.0)[measured, None]
        points = rays[measured, :3] + rays[measured, 3:] * reach
        self.tree.insertPointCloud(points.astype(np.float64), self.pose[:3].astype(np.float64), problem.far, True)
        self.count()
        self.cover(points[reach[:, 0] <= problem.far])
        return depth.reshape(problem.rays.shape[:2])

    def count(self) -> None:
        """Known voxels, and the bits that are known of them. Without pruning every known voxel is a leaf."""
        if self.lean:
            self.known = self.tree.getNumLeafNodes()
            return
        text = self.tree.write()
        nodes = np.frombuffer(text, NODE, offset=text.index(b"\ndata\n") + 6)
        log_odds = nodes["log_odds"][nodes["children"] == 0]
        probability = 1.0 / (1.0 + np.exp(-log_odds))
        entropy = -probability * np.log2(probability) - (1.0 - probability) * np.log2(1.0 - probability)
        self.known = len(log_odds)
        self.information = self.known - float(entropy.sum(dtype=np.float64))

    def cover(self, ends: Floats) -> None:
        """Surface voxels can only become occupied where rays ended."""
        keys = np.floor(ends / self.problem.resolution).astype(np.int64) - self.low
        keys = keys[((keys >= 0) & (keys < self.shape)).all(axis=1)]
        flat = np.unique(np.ravel_multi_index(tuple(keys.T), tuple(self.shape)))
        flat = flat[self.is_surface[flat] & ~self.covered[flat]]
        if len(flat):
            voxels = np.stack(np.unravel_index(flat, tuple(self.shape)), axis=1) + self.low
            labels = self.tree.getLabels((voxels + 0.5) * self.problem.resolution)
            self.covered[flat[labels == 1]] = True

    def coverage(self) -> float:
        return float(self.covered.sum()) / len(self.problem.surface)

    def observe(self, depth: Floats) -> dict[str, Floats]:
        return {"depth": np.minimum(depth, np.float32(self.problem.far)), "pose": self.pose.copy(), "visited": self.visited.copy()}


def vector(problem: Problem, count: int, lean: bool = False) -> SyncVectorEnv:
    """`count` of them that share one Open3D scene."""
    scene = raycasting_scene(problem.triangles)
    envs = SyncVectorEnv([lambda: HandrolledEnv(problem, scene, lean)] * count)
    envs.reset(seed=0)
    return envs


def stagger(envs: SyncVectorEnv, budget: int) -> None:
    """Play until the environments are all over their episodes: a step costs more the more the map holds."""
    for i, env in enumerate(envs.envs):
        env.unwrapped.steps = i % budget  # type: ignore[attr-defined]
    rng = np.random.default_rng(0)
    for _ in range(budget):
        envs.step(rng.integers(envs.single_action_space.n, size=envs.num_envs))  # type: ignore[attr-defined]


def serve(pipe: Connection, problem: Problem, count: int, staggered: bool) -> None:
    envs = vector(problem, count)
    if staggered:
        stagger(envs, problem.budget)
    pipe.send(None)
    while (actions := pipe.recv()) is not None:
        pipe.send(envs.step(actions)[:4])


class Workers:
    """Vectors of hand-rolled environments in processes of their own, stepped together.

    Gymnasium's AsyncVectorEnv has one process for each environment, which 64 environments on a few cores suffer from.
    """

    def __init__(self, problem: Problem, count: int, processes: int, staggered: bool = False) -> None:
        # A forked child would have locks and no threads of Embree's.
        context = multiprocessing.get_context("spawn")
        self.workers = []
        for _ in range(processes):
            pipe, theirs = context.Pipe()
            worker = context.Process(target=serve, args=(theirs, problem, count // processes, staggered), daemon=True)
            worker.start()
            self.workers.append((worker, pipe))
        for _, pipe in self.workers:
            pipe.recv()

    def step(self, actions: NDArray[np.int64]) -> list[Any]:
        """One view each; what the processes' vectors return, without infos."""
        for (_, pipe), part in zip(self.workers, np.split(actions, len(self.workers)), strict=True):
            pipe.send(part)
        return [pipe.recv() for _, pipe in self.workers]

    def close(self) -> None:
        for worker, pipe in self.workers:
            pipe.send(None)
            worker.join()
