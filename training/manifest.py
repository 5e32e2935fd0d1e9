"""What an evaluation consists of: rows of (task, agent, scene, seed), each with a key that names its configuration."""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..agents import AGENTS, Agent
from ..agents.six_direction import WEIGHTS, SixDirectionPolicy
from ..agents.wang2019 import LEARNT, NEED_VIEW_HISTORY
from .scene_digest import scene_digest

if TYPE_CHECKING:
    from ..envs.env import NbvEnv

#: Raised when episodes come out differently without a new version of the package: rows from before are run again.
BEHAVIOUR = 2
#: The name under which the cheating upper bound is asked for.
ORACLE = "oracle"


@dataclass(frozen=True)
class Row:
    """One episode to run. `agent` is a name, with parameters if wanted: `greedy:metric=entropy:cost_weight=0.5`."""

    task: str
    agent: str
    scene: str | None
    seed: int
    views: int | None = None
    #: Side of a voxel, metres, if not the task's.
    resolution: float | None = None
    #: Kind of the robot, "flying" or "arm", if not the task's.
    robot: str | None = None

    def key(self) -> str:
        """A hash of all that decides the outcome; rows with equal keys need to run only once."""
        return self._key(_scene_state(self.scene))

    def _key(self, scene_sha256: str | None) -> str:
        from .. import __version__
        from ..envs.suite import TASKS

        facts = {**asdict(self), "task_value": repr(TASKS[self.task]), "version": __version__, "behaviour": BEHAVIOUR}
        if scene_sha256 is not None:
            facts["scene_sha256"] = scene_sha256
        facts["weights_sha256"] = weights_digest(self.agent)
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]


def keys(rows: Sequence[Row]) -> list[str]:
    """:meth:`Row.key` of each row; a scene of many rows is read once."""
    states = {scene: _scene_state(scene) for scene in dict.fromkeys(row.scene for row in rows)}
    return [row._key(states[row.scene]) for row in rows]


def _scene_state(scene: str | None) -> str | None:
    """The digest of a scene file, None for other scenes. One that cannot be read has that of its bytes: its rows fail, and are
    tried again."""
    if scene is None or not Path(scene).is_file():
        return None
    try:
        return scene_digest(scene)
    except (OSError, ValueError, RuntimeError):
        return hashlib.sha256(Path(scene).read_bytes()).hexdigest()


def grid(
    tasks: Sequence[str],
    agents: Sequence[str],
    scenes: Sequence[str | None],
    seeds: Sequence[int],
    views: int | None,
    resolution: float | None = None,
) -> list[Row]:
    """All combinations; seeds outermost, so that an interrupted run has seen every agent."""
    rows = [Row(t, a, s, seed, views, resolution) for seed in seeds for t in tasks for s in scenes for a in agents]
    for row in rows[: len(tasks) * len(agents) * len(scenes)]:
        check(row)
    return rows


def check(row: Row) -> None:
    """Look for what can be known to be wrong before anything runs.

    Raises:
        ValueError, OSError: What is wrong; the message names the value, or the checkpoint that is missing or none.
        ImportError: The CNN is asked for and torch is not installed.
    """
    from ..envs.suite import TASKS
    from ..rust_env import SCENE_KINDS

    if row.task not in TASKS:
        raise ValueError(f"there is no task {row.task!r}; known are {', '.join(TASKS)}")
    agent_class(row.agent)
    name, map_ = row.agent.split(":")[0], TASKS[row.task].setup["map"]
    if name in NEED_VIEW_HISTORY and not map_.get("view_history"):
        able = [task for task, value in TASKS.items() if value.setup["map"].get("view_history")]
        raise ValueError(f"agent {name!r} needs a map with a view history, task {row.task!r} has none; tasks with one: {', '.join(able)}")
    if row.resolution is not None and not (math.isfinite(row.resolution) and row.resolution > 0):
        raise ValueError(f"resolution must be finite and > 0 m, got {row.resolution}")
    if row.robot is not None:
        TASKS[row.task].variant(robot=robot_of(row))
    if row.views is not None and row.views < 1:
        raise ValueError(f"views must be >= 1, got {row.views}")
    if row.scene is not None and row.scene.split(":")[0] not in SCENE_KINDS and not Path(row.scene).exists():
        raise FileNotFoundError(f"scene {row.scene!r}: no such file, and no generated kind (those are {', '.join(SCENE_KINDS)})")
    if (weights := weights_of(row.agent)) is not None:
        state = weights.stat()
        _check_weights(weights, state.st_mtime_ns, state.st_size)


def robot_of(row: Row) -> dict[str, Any]:
    """The task's robot as another kind."""
    from ..envs.suite import TASKS

    return {**TASKS[row.task].setup["robot"], "kind": row.robot}


def _parts(text: str) -> tuple[str, list[str]]:
    """`name:key=value:key=value` as name and pairs; a value may hold colons, as paths do, but not `:word=`."""
    name, colon, rest = text.partition(":")
    return name, re.split(r":(?=\w+=)", rest) if colon else []


def agent_class(text: str) -> tuple[Callable[..., Any], dict[str, Any]]:
    """What makes the agent `name:key=value:key=value`, and the parameters. Raises ValueError."""
    name, pairs = _parts(text)
    if name == ORACLE:
        from .oracle import Oracle

        found: Callable[..., Any] = Oracle
    elif name in AGENTS:
        found = AGENTS[name]
    else:
        raise ValueError(f"there is no agent {name!r}; known are {', '.join([*AGENTS, ORACLE])}")
    accepted = {n: p for n, p in inspect.signature(found).parameters.items() if n not in {"env", "seed"}}
    parameters: dict[str, Any] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or key not in accepted:
            known = ", ".join(accepted) or "none"
            raise ValueError(f"agent {text!r}: {pair!r} is no parameter of {name} (key=value; known are {known})")
        parameters[key] = _parse(value, accepted[key].default)
    return found, parameters


@functools.lru_cache(maxsize=16)
def _sha256(path: Path, _mtime_ns: int, _size: int) -> str:
    """Of a file's content; read once for as long as it does not change (AlexNet's weights are 230 MB)."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@functools.lru_cache(maxsize=16)
def _check_weights(path: Path, _mtime_ns: int, _size: int) -> None:
    """Load a checkpoint; once for as long as the file does not change, however many rows name it."""
    SixDirectionPolicy.load(path)


def weights_of(text: str) -> Path | None:
    """The checkpoint that an agent decides by; None for one that has learnt nothing."""
    name, pairs = _parts(text)
    if name not in LEARNT:
        return None
    given = [value for key, _, value in (pair.partition("=") for pair in pairs) if key == "weights" and value]
    return Path(given[-1]) if given else WEIGHTS


def weights_digest(text: str) -> str | None:
    """SHA-256 of an agent's checkpoint; None without one, or where it is not there."""
    weights = weights_of(text)
    if weights is None or not weights.is_file():
        return None
    state = weights.stat()
    return _sha256(weights, state.st_mtime_ns, state.st_size)


def make_agent(text: str, env: NbvEnv, seed: int) -> Agent:
    """An agent from its description; the oracle alone gets to see the environment."""
    found, parameters = agent_class(text)
    accepted = inspect.signature(found).parameters
    if "env" in accepted:
        parameters["env"] = env
    if "seed" in accepted:
        parameters["seed"] = seed
    agent: Agent = found(**parameters)
    return agent


def _parse(text: str, default: Any) -> Any:
    """A parameter's text in the type of its default."""
    if isinstance(default, bool):
        if text.lower() not in {"true", "false"}:
            raise ValueError(f"{text!r} is neither true nor false")
        return text.lower() == "true"
    if isinstance(default, int | float):
        try:
            return type(default)(text)
        except ValueError:
            raise ValueError(f"{text!r} is not a number") from None
    return text
