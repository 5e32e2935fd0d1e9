"""The door to the Rust core: the explicit list of names that Python may use."""

from .nbv_core import (
    GAINS,
    KERNELS,
    METRICS,
    NOISES,
    SCENE_KINDS,
    STAGES,
    Belief,
    Camera,
    InternalError,
    Octree,
    Scene,
    Setup,
    Simulator,
)

__all__ = [
    "GAINS",
    "KERNELS",
    "METRICS",
    "NOISES",
    "SCENE_KINDS",
    "STAGES",
    "Belief",
    "Camera",
    "InternalError",
    "Octree",
    "Scene",
    "Setup",
    "Simulator",
]
