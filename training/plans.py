"""Views from straight above: the true scene, and what a map holds of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..agents import StepRecord
from .voxel_painter import uncertainty_colours

if TYPE_CHECKING:
    from ..envs.env import NbvEnv
    from ..rust_env import Scene

#: Pixels of the scene's picture along its longer side.
SCENE_PIXELS = 700
#: What is shown around what can be seen, metres.
MARGIN = 0.3
FREE, UNKNOWN, WALL = (1.0, 1.0, 1.0), (0.788, 0.812, 0.839), (0.16, 0.18, 0.21)


@dataclass
class Plan:
    """One agent's episode from above. Images are (rows y, columns x, 3) in 0..1, the first row at the lowest y."""

    agent: str
    bounds: NDArray[np.float32]
    cut: float
    scene_image: NDArray[np.float64]
    map_image: NDArray[np.float64]
    viewpoints: NDArray[np.float32]
    #: Horizontal part of the direction of sight, (n, 2).
    headings: NDArray[np.float64]
    metrics: dict[str, float]


def region_of(env: NbvEnv) -> NDArray[np.float32]:
    """The box (2, 3) worth drawing: where surface can be seen in this episode, and the views, within the bounds."""
    bounds = np.asarray(env.belief.bounds)
    surface = np.asarray(env.simulator.truth_surface(0)).reshape(-1, 3)
    points = np.vstack([surface, env.belief.candidates[:, :3], env.belief.trajectory[:, :3]])
    region = np.stack([points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN])
    region[:, 2] = bounds[:, 2]
    clipped: NDArray[np.float32] = np.clip(region, bounds[0], bounds[1]).astype(np.float32)
    return clipped


def plan_of(env: NbvEnv, agent: str, records: list[StepRecord], cut_above_floor: float = 1.6) -> Plan:
    """The plan of the episode that just ended in `env`."""
    scene = env.simulator.scene(0)
    bounds = region_of(env)
    cut = min(scene.floor + cut_above_floor, float(bounds[1, 2]) - 0.05)
    views = np.array([record.viewpoint for record in records])
    x, y, z, w = views[:, 3:].T.astype(np.float64)
    # The camera's z axis in the world, seen from above.
    headings = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x)], axis=1)
    return Plan(agent, bounds, cut, scene_image(scene, bounds, cut), map_image(env, bounds, cut), views, headings, records[-1].metrics)


def scene_image(scene: Scene, bounds: NDArray[np.float32], cut: float, pixels: int = SCENE_PIXELS) -> NDArray[np.float64]:
    """What one sees looking straight down from the height `cut`: light is low, dark is high, walls are black."""
    (x0, y0, z0), (x1, y1, _) = bounds.astype(np.float64)
    pixel = max(x1 - x0, y1 - y0) / pixels
    columns, rows = max(1, round((x1 - x0) / pixel)), max(1, round((y1 - y0) / pixel))
    xs, ys = x0 + (np.arange(columns) + 0.5) * pixel, y0 + (np.arange(rows) + 0.5) * pixel
    grid = np.stack([*np.meshgrid(xs, ys), np.full((rows, columns), cut)], axis=-1).reshape(-1, 3).astype(np.float32)
    down = np.broadcast_to(np.array([0, 0, -1], np.float32), grid.shape)
    ranges = np.asarray(scene.cast_rays(grid, np.ascontiguousarray(down), float(cut - z0 + 1.0)))
    height = np.where(np.isfinite(ranges), cut - ranges, z0).reshape(rows, columns) - z0
    share = np.clip(height / max(cut - z0, 1e-6), 0.0, 1.0)[..., None]
    image = (1 - share) * np.array([0.965, 0.955, 0.935]) + share * np.array([0.42, 0.50, 0.60])
    # Light from the upper left brings out edges.
    slope = np.gradient(height, pixel)
    image *= np.clip(1.0 + 0.05 * (slope[1] - slope[0]), 0.72, 1.10)[..., None]
    missing = ~np.isfinite(ranges).reshape(rows, columns)
    image[missing] = (0.93, 0.94, 0.95)
    voxels = np.asarray(scene.surface_voxels(CUT_VOXEL))
    sliced = voxels[np.abs(voxels[:, 2] - cut) <= CUT_VOXEL / 2]
    for dx, dy in np.stack(np.meshgrid(*(np.arange(-CUT_VOXEL / 2, CUT_VOXEL / 2, pixel),) * 2), -1).reshape(-1, 2):
        u = np.floor((sliced[:, 0] + dx - x0) / pixel).astype(int)
        v = np.floor((sliced[:, 1] + dy - y0) / pixel).astype(int)
        inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
        image[v[inside], u[inside]] = WALL
    return np.clip(image, 0.0, 1.0)


#: Voxels that show where walls are cut, metres.
CUT_VOXEL = 0.04


def map_image(env: NbvEnv, bounds: NDArray[np.float32], cut: float) -> NDArray[np.float64]:
    """The map from above: columns with a known free voxel are white, above which the highest occupied voxel below
    `cut` that stands out of the floor shows its uncertainty; unknown columns are grey."""
    octree = env.belief.octree
    resolution = float(octree.resolution)
    first = np.floor(bounds[0].astype(np.float64) / resolution).astype(np.int64)
    last = np.ceil(bounds[1].astype(np.float64) / resolution).astype(np.int64)
    columns, rows = last[:2] - first[:2]
    image = np.empty((rows, columns, 3))
    image[:] = UNKNOWN

    def cells(points: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        keys = np.floor(points.reshape(-1, 3) / resolution).astype(np.int64) - first
        inside = (keys[:, 0] >= 0) & (keys[:, 1] >= 0) & (keys[:, 0] < columns) & (keys[:, 1] < rows)
        return keys, inside & ((keys[:, 2] + first[2]) * resolution < cut)

    keys, inside = cells(np.asarray(octree.free()))
    image[keys[inside, 1], keys[inside, 0]] = FREE
    keys, inside = cells(np.asarray(octree.occupied()))
    keys, shade = keys[inside], uncertainty_colours(np.asarray(octree.occupied_uncertainty())[inside])
    floor = env.simulator.scene(0).floor
    standing = (keys[:, 2] + first[2] + 0.5) * resolution > floor + 1.5 * resolution
    keys, shade = keys[standing], shade[standing]
    order = np.argsort(keys[:, 2], kind="stable")
    image[keys[order, 1], keys[order, 0]] = shade[order]
    return image
