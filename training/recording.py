"""Recordings for the Rerun viewer (https://rerun.io), where `rerun-sdk` is installed (extra `viz`)."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..agents import StepRecord
from .voxel_painter import uncertainty_colours

if TYPE_CHECKING:
    from ..envs.env import NbvEnv


def rerun_installed() -> bool:
    return find_spec("rerun") is not None


class Recording:
    """An observer of a rollout that writes an .rrd file: map, frontiers, camera with depth image, way and metrics."""

    def __init__(self, path: Path) -> None:
        import rerun

        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self._way: list[NDArray[np.float32]] = []
        self._stream = rerun.RecordingStream("nbv-gym")
        self._stream.save(path)
        self._stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def __call__(self, env: NbvEnv, record: StepRecord) -> None:
        import rerun

        belief, stream = env.belief, self._stream
        if not self._way:
            low, high = np.asarray(belief.bounds)
            box = rerun.Boxes3D(mins=[low], sizes=[high - low], colors=[0x8B949EFF])
            stream.log("world/bounds", box, static=True)
        stream.set_time("view", sequence=len(self._way))
        self._way.append(np.asarray(record.viewpoint[:3]))
        octree = belief.octree
        centers = np.asarray(octree.occupied())
        colours = (uncertainty_colours(np.asarray(octree.occupied_uncertainty())) * 255).astype(np.uint8)
        half = np.full((len(centers), 3), belief.resolution / 2, np.float32)
        stream.log("world/map/occupied", rerun.Boxes3D(centers=centers, half_sizes=half, colors=colours, fill_mode="solid"))
        stream.log("world/map/frontiers", rerun.Points3D(belief.frontiers(), radii=belief.resolution / 5, colors=[0x56B4E9FF]))
        stream.log("world/way", rerun.LineStrips3D([np.array(self._way)], colors=[0x22272EFF], radii=0.01))
        camera, view = belief.camera, np.asarray(record.viewpoint)
        pose = rerun.Transform3D(translation=view[:3], quaternion=rerun.Quaternion(xyzw=view[3:]))
        stream.log("world/camera", pose)
        pinhole = rerun.Pinhole(
            focal_length=[camera.fx, camera.fy], principal_point=[camera.cx, camera.cy],
            width=camera.width, height=camera.height, camera_xyz=rerun.ViewCoordinates.RDF, image_plane_distance=0.4,
        )  # fmt: skip
        stream.log("world/camera/image", pinhole)
        depth = np.asarray(env.simulator.scene(0).render_depth(camera, view))
        stream.log("world/camera/image/depth", rerun.DepthImage(z_depth(depth, camera), meter=1.0))
        for name, value in record.metrics.items():
            stream.log(f"metrics/{name}", rerun.Scalars(value))

    def close(self) -> None:
        self._stream.flush()
        self._stream.disconnect()


def z_depth(depth: NDArray[np.float32], camera: object) -> NDArray[np.float32]:
    """Rerun's depth images hold the distance from the image plane; 0 where nothing was measured."""
    c: Any = camera
    depth = np.where(np.isfinite(depth), depth, 0).astype(np.float32)
    if c.kind == "z":
        return depth
    u, v = np.meshgrid(np.arange(c.width) + 0.5, np.arange(c.height) + 0.5)
    ray = np.sqrt(((u - c.cx) / c.fx) ** 2 + ((v - c.cy) / c.fy) ** 2 + 1.0)
    return (depth / ray).astype(np.float32)
