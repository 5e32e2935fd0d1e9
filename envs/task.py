"""A task: what is simulated and what is asked, as one value."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ..rust_env import Setup
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
#: Keywords of :class:`~nbv_gym.rust_env.Setup`.
SETUP_KEYWORDS = ("scene", "camera", "robot", "map", "views", "local_map", "noise", "lidar", "bodies", "truth")


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
        reward: Columns of metrics (n,) -> rewards (n,); or its name in :data:`REWARDS`.
        success: Columns of metrics (n,) -> whether the episode is done (n,); a number is a
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
        settle("observation", tuple(self.observation))
        settle("action", named("action", self.action, ACTIONS))
        settle("reward", named("reward", self.reward, REWARDS))
        if isinstance(self.success, (int, float)) and not isinstance(self.success, bool):
            settle("success", CoverageAtLeast(float(self.success)))

        if not (isinstance(self.setup, Mapping) and all(isinstance(k, str) for k in self.setup)):
            raise TypeError(f"task setup must be a mapping of keywords, got {self.setup!r}")
        settle("setup", dict(self.setup))
        unknown = [name for name in self.setup if name not in SETUP_KEYWORDS]
        if unknown:
            raise TypeError(f"task setup does not know {', '.join(unknown)}; it has {', '.join(SETUP_KEYWORDS)}")
        if not self.observation:
            raise ValueError("task observation needs at least one channel")
        for channel in self.observation:
            if channel not in CHANNELS:
                raise ValueError(f"task observation {channel!r} is not a channel; there are {', '.join(CHANNELS)}")
        if len(set(self.observation)) < len(self.observation):
            raise ValueError(f"task observation names a channel twice: {self.observation}")
        if "local_map" in self.observation and not self.setup.get("local_map"):
            raise ValueError("task observation 'local_map' needs setup local_map, e.g. {'size': 32}")
        if "scan" in self.observation and self.setup.get("lidar") is None:
            raise ValueError("task observation 'scan' needs setup lidar, e.g. {'range': 10.0}")
        if isinstance(self.budget, bool) or not isinstance(self.budget, int):
            raise TypeError(f"task budget must be a whole number of views, got {self.budget!r}")
        if self.budget < 1:
            raise ValueError(f"task budget must be at least one view, got {self.budget}")
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
            TypeError: An unknown keyword.
        """
        fields = [field.name for field in dataclasses.fields(self)]
        known = [*fields, *SETUP_KEYWORDS, "resolution"]
        unknown = [name for name in changes if name not in known]
        if unknown:
            raise TypeError(f"a task does not know {', '.join(unknown)}; it has {', '.join(known)}")
        setup = dict(changes.pop("setup", self.setup))
        setup |= {name: changes.pop(name) for name in SETUP_KEYWORDS if name in changes}
        if "resolution" in changes:
            setup["map"] = {**setup["map"], "resolution": changes.pop("resolution")}
        return dataclasses.replace(self, setup=setup, **changes)


def named(field: str, value: Any, values: Mapping[str, Any]) -> Any:
    """The value that a name stands for; what is no name stands for itself."""
    if not isinstance(value, str):
        return value
    if value not in values:
        raise ValueError(f"task {field} {value!r} is unknown; there are {', '.join(values)}")
    return values[value]
