"""Observations: named channels, each with its buffer and its exact space.

One channel is a Box, more are a Dict. Nothing of the truth is among them: coverage is in ``info`` only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .task import Task

Array = NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class Channel:
    """One kind of observation.

    Attributes:
        space: Of one environment.
        encode: Fits what the core wrote into the space, in place.
    """

    space: Callable[[Task], spaces.Box]
    encode: Callable[[Array, Task], None] | None = None


def depth_space(task: Task) -> spaces.Box:
    """(height, width) metres; ``far`` where nothing was measured, 0 where something is nearer than ``near``."""
    camera = task.setup["camera"]
    return spaces.Box(0.0, camera.far, (camera.height, camera.width), np.float32)


def clip_depth(depth: Array, task: Task) -> None:
    np.minimum(depth, np.float32(task.setup["camera"].far), out=depth)


def scan_space(task: Task) -> spaces.Box:
    """(rays,) metres; the lidar's range where nothing was measured, 0 where something is nearer than ``near``."""
    return spaces.Box(0.0, task.setup["lidar"]["range"], (task.build_setup().lidar_rays,), np.float32)


def clip_scan(scan: Array, task: Task) -> None:
    np.minimum(scan, np.float32(task.setup["lidar"]["range"]), out=scan)


#: Metres; the core takes no coordinate beyond it.
FARTHEST = 1e6


def viewpoint_space(shape: tuple[int, ...]) -> spaces.Box:
    bound = np.broadcast_to(np.array([FARTHEST] * 3 + [1.0] * 4, np.float32), shape)
    return spaces.Box(-bound, bound, shape, np.float32)


def clip_quaternions(viewpoints: Array, task: Task) -> None:
    # A unit quaternion may be longer than one by a rounding.
    quaternions = viewpoints[..., 3:]
    np.minimum(quaternions, np.float32(1.0), out=quaternions)
    np.maximum(quaternions, np.float32(-1.0), out=quaternions)


def num_candidates(task: Task) -> int:
    return task.build_setup().num_candidates


def local_map_space(task: Task) -> spaces.Box:
    """(3, size, size, size): probability of occupancy (0.5 = unknown), uncertainty, unknown, in the camera's heading."""
    size = task.build_setup().local_map_size
    return spaces.Box(0.0, 1.0, (3, size, size, size), np.float32)


#: depth: the image. scan: the lidar's. pose: the believed viewpoint. local_map: the egocentric window of the map. visited: how often each
#: candidate was visited. candidates: the views that can be chosen.
CHANNELS: dict[str, Channel] = {
    "depth": Channel(depth_space, clip_depth),
    "scan": Channel(scan_space, clip_scan),
    "pose": Channel(lambda task: viewpoint_space((7,)), clip_quaternions),
    "local_map": Channel(local_map_space),
    "visited": Channel(lambda task: spaces.Box(0.0, task.budget + 1.0, (num_candidates(task),), np.float32)),
    "candidates": Channel(lambda task: viewpoint_space((num_candidates(task), 7)), clip_quaternions),
}


def observation_space(task: Task) -> spaces.Space[Any]:
    """Space of one environment's observation."""
    channels: dict[str, spaces.Space[Any]] = {name: CHANNELS[name].space(task) for name in task.observation}
    return spaces.Dict(channels) if len(channels) > 1 else channels[task.observation[0]]


def encode(buffers: dict[str, Array], task: Task) -> Any:
    """The batch of observations: the buffers of the task's channels themselves, fitted into their spaces in place."""
    for name in task.observation:
        fit = CHANNELS[name].encode
        if fit is not None:
            fit(buffers[name], task)
    channels = {name: buffers[name] for name in task.observation}
    return channels if len(channels) > 1 else channels[task.observation[0]]


def rows(observations: Any, which: Any) -> Any:
    """A copy of some rows of a batch (an index or a mask)."""
    if isinstance(observations, dict):
        return {name: rows(channel, which) for name, channel in observations.items()}
    return np.array(observations[which])
