"""A task: what is simulated and what is asked, as one value."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Any

import numpy as np

from ..rust_env import Camera, Setup
from .action import Action, CandidateIndex, FreeViewpoint
from .observation import CHANNELS
from .reward import CoverageAtLeast, Metric, Reward

#: Rewards and actions that may be given by name.
REWARDS: dict[str, Reward] = {
    "information_gain": Reward("information_gain_bits"),
    "uncertainty_gain": Reward("uncertainty_gain"),
    "new_surface": Reward("new_surface_voxels"),
}
ACTIONS: dict[str, Action] = {"candidate": CandidateIndex(), "viewpoint": FreeViewpoint()}
#: Keywords of :class:`~nbv_gym.rust_env.Setup` and what their values are; a mapping becomes a dictionary.
SETUP_TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "scene": ((str, os.PathLike), "a file or the name of a generated kind"),
    "camera": ((Camera,), "a Camera"),
    "robot": ((Mapping,), "a dictionary"),
    "map": ((Mapping,), "a dictionary"),
    "views": ((Mapping,), "a dictionary"),
    "local_map": ((Mapping, type(None)), "a dictionary or None"),
    "noise": ((str, Mapping, type(None)), "the name of a preset, a dictionary or None"),
    "lidar": ((Mapping, type(None)), "a dictionary or None"),
    "bodies": ((Mapping, type(None)), "a dictionary or None"),
    "truth": ((str,), "a name"),
}
SETUP_KEYWORDS = tuple(SETUP_TYPES)


@dataclasses.dataclass(frozen=True)
class Task:
    """What is simulated (``setup``) and what is asked (the rest). A variant is ``dataclasses.replace(task, ...)``, or
    :meth:`variant` for changes inside the setup.

    Attributes:
        id: The Gymnasium id under which it is registered.
        setup: Keywords of :class:`~nbv_gym.rust_env.Setup`; to be read only.
        observation: Names of the channels, see :data:`~nbv_gym.envs.observation.CHANNELS`. One gives a Box, more a
            Dict.
        action: How an action becomes a viewpoint; or its name in :data:`ACTIONS`.
        reward: Columns of metrics (n,) -> rewards (n,), real numbers; or its name in :data:`REWARDS`.
        success: Columns of metrics (n,) -> whether the episode is done (n,), bool; a number is a
            :class:`~nbv_gym.envs.reward.CoverageAtLeast`, ``None`` never ends an episode.
        budget: Steps until the episode is truncated: views after the first, which is taken at the start.

    Raises:
        TypeError: A value of the wrong type, or an unknown keyword of the setup.
        ValueError: A value out of its range; the message names field and value.
        FileNotFoundError: The scene is neither a file nor a generated kind.
    """

    id: str
    setup: Mapping[str, Any]
    observation: tuple[str, ...]
    action: Action
    reward: Metric
    success: Metric | None
    budget: int

    def __post_init__(self) -> None:
        def settle(field: str, value: object) -> None:
            object.__setattr__(self, field, value)

        if isinstance(self.observation, str):
            settle("observation", (self.observation,))
        if not (isinstance(self.observation, Iterable) and all(isinstance(channel, str) for channel in self.observation)):
            raise TypeError(f"task observation must be names of channels, got {self.observation!r}")
        settle("observation", tuple(self.observation))
        settle("action", named("action", self.action, ACTIONS))
        if isinstance(self.action, type) or not isinstance(self.action, Action):
            raise TypeError(f"task action must be one of {', '.join(ACTIONS)} or an Action, got {self.action!r}")
        settle("reward", named("reward", self.reward, REWARDS))
        if isinstance(self.success, Real) and not isinstance(self.success, bool):
            settle("success", CoverageAtLeast(float(self.success)))

        settle("setup", keywords(self.setup))
        unknown = [name for name in self.setup if name not in SETUP_KEYWORDS]
        if unknown:
            raise TypeError(f"task setup does not know {', '.join(unknown)}; it has {', '.join(SETUP_KEYWORDS)}")
        settle("setup", {name: typed(name, value) for name, value in self.setup.items()})
        if not self.observation:
            raise ValueError("task observation needs at least one channel")
        for channel in self.observation:
            if channel not in CHANNELS:
                raise ValueError(f"task observation {channel!r} is not a channel; there are {', '.join(CHANNELS)}")
        if len(set(self.observation)) < len(self.observation):
            raise ValueError(f"task observation names a channel twice: {self.observation}")
        if "local_map" in self.observation and self.setup.get("local_map") is None:
            raise ValueError("task observation 'local_map' needs setup local_map, e.g. {'size': 32}")
        if "scan" in self.observation and self.setup.get("lidar") is None:
            raise ValueError("task observation 'scan' needs setup lidar, e.g. {'range': 10.0}")
        settle("budget", whole("task budget", self.budget))
        if not callable(self.reward):
            raise TypeError(f"task reward must be a function of the metrics, got {self.reward!r}")
        if not (self.success is None or callable(self.success)):
            raise TypeError(f"task success must be a function of the metrics or a coverage, got {self.success!r}")
        self.build_setup()

    def build_setup(self) -> Setup:
        """The core's value of ``setup``, which checks it."""
        return Setup(**self.setup)

    def variant(self, **changes: Any) -> Task:
        """This task with some values replaced.

        Args:
            **changes: Fields of the task (``observation``, ``reward``, ...), keywords of its setup (``scene``,
                ``camera``, ...), or ``resolution``, the side of a voxel in metres.

        Raises:
            TypeError: An unknown keyword, or a dictionary that lacks something: it replaces the task's own as a whole.
        """
        fields = [field.name for field in dataclasses.fields(self)]
        known = [*fields, *SETUP_KEYWORDS, "resolution"]
        unknown = [name for name in changes if name not in known]
        if unknown:
            raise TypeError(f"a task does not know {', '.join(unknown)}; it has {', '.join(known)}")
        setup = keywords(changes.pop("setup", self.setup))
        replaced = [name for name in SETUP_KEYWORDS if name in changes]
        setup |= {name: changes.pop(name) for name in replaced}
        if "resolution" in changes:
            setup["map"] = {**typed("map", setup.get("map")), "resolution": changes.pop("resolution")}
        try:
            return dataclasses.replace(self, setup=setup, **changes)
        except TypeError as error:
            for name in replaced:
                if str(error).startswith(f"{name} needs") and name in self.setup:
                    own = f"the dictionary replaces the task's own, {self.setup[name]!r}"
                    raise TypeError(f"{error}: {own}") from error
            raise


def named(field: str, value: Any, values: Mapping[str, Any]) -> Any:
    """The value that a name stands for; what is no name stands for itself."""
    if not isinstance(value, str):
        return value
    if value not in values:
        raise ValueError(f"task {field} {value!r} is unknown; there are {', '.join(values)}")
    return values[value]


def keywords(setup: Any) -> dict[str, Any]:
    """A setup as a dictionary of its own."""
    if not (isinstance(setup, Mapping) and all(isinstance(k, str) for k in setup)):
        raise TypeError(f"task setup must be a mapping of keywords, got {setup!r}")
    return dict(setup)


def typed(name: str, value: Any) -> Any:
    """The value of a setup's keyword, which must be of the keyword's type."""
    types, what = SETUP_TYPES[name]
    if not isinstance(value, types):
        raise TypeError(f"task setup {name} must be {what}, got {value!r}")
    return dict(value) if isinstance(value, Mapping) else value


def whole(field: str, value: Any) -> int:
    """A number of views, at least one."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{field} must be a whole number of views, got {value!r}")
    if value < 1:
        raise ValueError(f"{field} must be at least one view, got {value}")
    return int(value)
