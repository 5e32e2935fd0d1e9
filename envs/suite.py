"""The tasks, one under the other."""

from __future__ import annotations

import dataclasses
from math import radians

from ..rust_env import Camera
from .action import CandidateIndex
from .reward import CoverageAtLeast, Reward
from .task import Task

TASKS: dict[str, Task] = {
    # A camera on a dome of views in the middle of a furnished room (the view space of Wang 2019: 14 rings of 48).
    "dome_room": Task(
        id="NBV/DomeRoom-v0",
        setup={
            "scene": "room",
            "camera": Camera(64, 48, hfov=radians(60), near=0.05, far=4.0),
            "robot": {"kind": "flying", "radius": 0.1},
            "map": {"resolution": 0.1},
            "views": {"kind": "dome", "rings": 14, "per_ring": 48, "radius": 0.6},
            "local_map": {"size": 32},
        },
        observation=("depth", "pose", "visited"),
        action=CandidateIndex(),
        reward=Reward("information_gain_bits"),
        success=CoverageAtLeast(0.95),
        budget=30,
    ),
    # A camera that flies freely: up, down, forward, backward, right, left.
    "six_directions": Task(
        id="NBV/SixDirections-v0",
        setup={
            "scene": "room",
            "camera": Camera(64, 48, hfov=radians(60), near=0.05, far=4.0),
            "robot": {"kind": "flying", "radius": 0.1},
            "map": {"resolution": 0.1},
            "views": {"kind": "six_directions", "step": 0.3},
            "local_map": {"size": 32},
        },
        observation=("depth",),
        action=CandidateIndex(),
        reward=Reward("information_gain_bits"),
        success=None,  # a fixed heading cannot see everything
        budget=40,
    ),
    # A ring of views around the things on a table: ten positions at three pitches.
    "tabletop": Task(
        id="NBV/Tabletop-v0",
        setup={
            "scene": "tabletop",
            "camera": Camera(64, 48, hfov=radians(60), near=0.05, far=1.5),
            "robot": {"kind": "flying", "radius": 0.05},
            "map": {"resolution": 0.02},
            "views": {"kind": "ring", "positions": 10, "radius": 0.6, "pitches": [radians(p) for p in (15, 35, 55)]},
            "local_map": {"size": 32},
        },
        observation=("depth", "pose", "visited"),
        action=CandidateIndex(),
        reward=Reward("new_surface_voxels"),
        success=CoverageAtLeast(0.95),
        budget=10,
    ),
    # The experiments of Wang 2019: fine voxels, a Kinect's image, a map that remembers from where it was seen. The widest steps
    # with which neighbouring views overlap by 80 % (11.25 of 57 and 8.8 of 44 degrees) let 672 poses see the complete room.
    "wang2019": Task(
        id="NBV/Wang2019-v0",
        setup={
            "scene": "room",
            # A Kinect v1 measures from 0.5 m on, and 5.5 m is as far as the authors' sequel, ExHistCNN, looks. Pixels 0.36 degrees
            # apart meet every voxel of 2.5 cm up to 4 m.
            "camera": Camera(160, 120, hfov=radians(57), near=0.5, far=5.5),
            "robot": {"kind": "flying", "radius": 0.1},
            "map": {"resolution": 0.025, "view_history": True},
            "views": {
                "kind": "dome",
                "rings": 21,
                "per_ring": 32,
                "radius": 0.6,
                "min_pitch": radians(-88),
                "max_pitch": radians(88),
            },
            "truth": "images",  # what the full dome path shows is 100 %
        },
        observation=("depth", "pose", "visited"),
        action=CandidateIndex(),
        reward=Reward("new_surface_voxels"),
        success=None,  # the paper compares after a fixed number of steps
        budget=130,
    ),
}
# The same with the errors of the paper's sensor, for what stands in the place of its real rooms.
TASKS["wang2019_kinect"] = dataclasses.replace(
    TASKS["wang2019"], id="NBV/Wang2019Kinect-v0", setup={**TASKS["wang2019"].setup, "noise": "kinect_v1"}
)
