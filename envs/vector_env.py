"""NbvVectorEnv: the one environment; n episodes stepped by Rust."""

from __future__ import annotations

import copy as copying
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..rust_env import METRICS, Belief, Simulator
from . import observation, streams
from .reward import Columns
from .suite import TASKS
from .task import Task, whole


class NbvVectorEnv(VectorEnv[Any, Any, NDArray[Any]]):
    """n next-best-view episodes at once, under one task.

    Environment ``i`` gives bit for bit what a single environment with its seed gives, for any number of threads.

    Observation
        The task's channels (:data:`nbv_gym.envs.observation.CHANNELS`), a Box when there is one and a Dict otherwise.
    Action
        An index into the candidate views, or a viewpoint (:mod:`nbv_gym.envs.action`).
    Reward
        The task's function of the metrics (:mod:`nbv_gym.envs.reward`).
    Termination
        The task's success test; truncation after ``budget`` steps.
    Info
        All of :data:`nbv_gym.rust_env.METRICS` (coverage among them) and, when views are chosen by index,
        ``action_mask`` (n, K) int8; each with its mask ``_key``. In SAME_STEP also ``final_obs`` and ``final_info``.

    Args:
        task: A task, or its name in :data:`nbv_gym.envs.suite.TASKS`.
        num_envs: Number of environments, n.
        num_threads: Threads that step them; results do not depend on it.
        autoreset_mode: When a finished environment begins its next episode.
        render_mode: ``None`` or ``"rgb_array"``.
        copy: Return copies; else observations are the environment's own buffers, which the next call overwrites.
        max_episode_steps: Truncate earlier than the task's budget.
        **overrides: Values of the task to replace, see :meth:`nbv_gym.envs.task.Task.variant`.

    Reward and success test are called once with metrics of zero, so that what they give is checked before anything runs. If one of them
    raises later, in a step, the step has happened; the next one goes on from there.

    Raises:
        TypeError: An unknown keyword, a value of the wrong type, or a reward or success test that gives another dtype.
        ValueError: An unknown task, a value out of its range, or a reward or success test that fails or gives another shape.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012 (as in Gymnasium)

    def __init__(
        self,
        task: Task | str = "dome_room",
        num_envs: int = 1,
        *,
        num_threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        copy: bool = True,
        max_episode_steps: int | None = None,
        **overrides: Any,
    ) -> None:
        if isinstance(task, str):
            if task not in TASKS:
                raise ValueError(f"task {task!r} is unknown; there are {', '.join(TASKS)}")
            task = TASKS[task]
        if not isinstance(task, Task):
            raise TypeError(f"task must be a Task or the name of one, got {task!r}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be None or one of {self.metadata['render_modes']}, got {render_mode!r}")
        if max_episode_steps is not None:
            max_episode_steps = whole("max_episode_steps", max_episode_steps)
        self.task = task.variant(**overrides) if overrides else task
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.copy = copy
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.budget = min(self.task.budget, max_episode_steps or self.task.budget)

        setup = self.task.build_setup()
        self._num_threads = num_threads
        self._simulator: Simulator | None = Simulator(setup, num_envs, num_threads)
        self.single_observation_space = observation.observation_space(self.task)
        self.single_action_space = self.task.action.space(setup.num_candidates)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._buffers = self._make_buffers(setup.num_candidates)
        # Where free viewpoints lie; (n, 2, 3), filled at reset.
        self._bounds = np.zeros((num_envs, 2, 3), np.float32)
        # Whose stream of seeds began; who has an episode in the core; whose episode is over.
        self._seeded = np.zeros(num_envs, bool)
        self._begun = np.zeros(num_envs, bool)
        self._done = np.zeros(num_envs, bool)
        self._probe()

    def snapshot(self) -> bytes:
        """Everything that decides what comes next: worlds, maps, random streams, counters.

        The bytes can be kept in a file and restored in another process; scenes are named in them, not contained.

        Raises:
            ClosedEnvironmentError: The environment was closed.
            ValueError: ``np_random`` or the action space was given a stream that is not Gymnasium's kind (PCG64).
        """
        return self._save(self)

    def restore(self, snapshot: bytes) -> tuple[Any, dict[str, Any]]:
        """Go on, bit for bit, where a snapshot was taken: under the same task and with as many environments; threads may
        differ. Nothing in a snapshot is executed.

        Returns:
            Observations and infos of all environments as they were last; zeros for those without an episode.

        Raises:
            ClosedEnvironmentError: The environment was closed.
            OSError: The scene's file cannot be read.
            ValueError: Damaged bytes, another version, another task, or a scene whose content changed. Nothing was
                changed.
        """
        self._load(self, snapshot)
        return self._observations(), self._infos(self._begun.copy())

    def clone(self) -> NbvVectorEnv:
        """An independent environment that goes on from here, e.g. to look ahead; the same as ``copy.deepcopy``."""
        return copying.deepcopy(self)

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and deepcopy: the core as a snapshot."""
        core = None if self._simulator is None else self._simulator.save()
        return {**self.__dict__, "_simulator": core}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        core = state["_simulator"]
        if core is not None:
            self._simulator = Simulator(self.task.build_setup(), self.num_envs, self._num_threads)
            self._simulator.load(core, {})

    def _save(self, owner: Any) -> bytes:
        """A snapshot with the random streams of `owner`: this, or the single environment in front of it."""
        notes = {
            "task": self._task_notes(),
            "seeded": self._seeded.tolist(),
            "done": self._done.tolist(),
            "streams": streams.describe(owner),
        }
        return self._open().save(json.dumps(notes).encode())

    def _load(self, owner: Any, snapshot: bytes) -> None:
        simulator = self._open()
        data = bytes(memoryview(snapshot))
        text = simulator.read_notes(data)
        try:
            notes = json.loads(text)
            there, streamed = dict(notes["task"]), notes["streams"]
            seeded, done = (flags(notes[name]) for name in ("seeded", "done"))
            for name in ("np_random", "action_space"):
                streams.generator(streamed[name])
            if not isinstance(streamed["seed"], (int, type(None))):
                raise TypeError(f"seed {streamed['seed']!r}")
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"snapshot: it was not taken by an environment ({error!r})") from error
        for name, here in self._task_notes().items():
            if there.get(name) != here:
                raise ValueError(f"snapshot: it was taken under another task: {name} {there.get(name)!r} instead of {here!r}")
        if seeded.shape != (self.num_envs,) or done.shape != seeded.shape:
            raise ValueError(f"snapshot: it holds {len(seeded)} environments, there are {self.num_envs}")
        simulator.load(data, self._buffers)
        begun = np.array([views_of(simulator, i) > 0 for i in range(self.num_envs)])
        self._seeded, self._begun, self._done = seeded, begun, done
        for buffer in self._buffers.values():
            buffer[~begun] = 0
        self._remember_bounds(simulator, begun)
        streams.put_back(owner, streamed)

    def _task_notes(self) -> dict[str, Any]:
        """What of a task is not in the core's setup, as a snapshot compares it."""
        task = self.task
        functions = {"action": task.action, "reward": task.reward, "success": task.success}
        # An address in a text (of an object without a text of its own) is another one in every process.
        names = {name: getattr(f, "__qualname__", None) or re.sub(r" at 0x[0-9a-fA-F]+", "", repr(f)) for name, f in functions.items()}
        return {
            **names,
            "observation": list(task.observation),
            "budget": self.budget,
            "autoreset_mode": self.autoreset_mode.value,
        }

    def _make_buffers(self, num_candidates: int) -> dict[str, NDArray[Any]]:
        """The arrays that the core fills; what nobody reads is not among them."""
        n = self.num_envs
        buffers: dict[str, NDArray[Any]] = {"metrics": np.zeros((n, len(METRICS)))}
        for name in self.task.observation:
            space = observation.CHANNELS[name].space(self.task)
            buffers[name] = np.zeros((n, *space.shape), np.float32)
        if self.task.action.has_mask:
            buffers["mask"] = np.zeros((n, num_candidates), bool)
            buffers.setdefault("candidates", np.zeros((n, num_candidates, 7), np.float32))
        if self.render_mode:
            camera = self.task.setup["camera"]
            buffers.setdefault("depth", np.zeros((n, camera.height, camera.width), np.float32))
        return buffers

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: ``seed + i`` begins environment i's stream of episodes, or one seed each. Where it is ``None``, the
                stream goes on; the first time it begins at random.
            options: ``{"reset_mask": (n,) bool}`` resets some environments and leaves the others as they are.

        Returns:
            Observations of all environments, infos of those that were reset.

        Raises:
            ClosedEnvironmentError: The environment was closed.
            TypeError: A seed or an option of a wrong type. Nothing was changed.
            ValueError: A seed out of its range or an unknown option, and nothing was changed. Or an episode cannot begin, e.g. for want
                of room: the message names the environment, which then has no episode until it is reset; its next seed is another one.
                The others have begun theirs.
            OSError: The same for a scene's file that cannot be read.
        """
        mask, seeds = self._reset_arguments(seed, options)
        if isinstance(seed, (int, np.integer)):
            super().reset(seed=int(seed))
        self._begin(self._open(), mask, seeds)
        return self._observations(), self._infos(mask)

    def step(self, actions: Any) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One view each.

        Args:
            actions: A batch of the action space; those of environments that begin a new episode in this step
                (NEXT_STEP) are not looked at.

        Returns:
            Observations, rewards (n,), terminated (n,), truncated (n,), infos.

        Raises:
            ResetNeeded: An environment has no running episode.
            TypeError: Actions of a wrong dtype.
            ValueError: Actions of a wrong shape or value, named with their environment; nothing was changed. Or the next episode of an
                environment cannot begin: see :meth:`reset`. The others have done their step; what it gave is lost.
            OSError: The same for a scene's file that cannot be read.
        """
        rewards, terminated, truncated = self._advance(actions)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._done.any():
            infos = self._autoreset(self._open())
        else:
            infos = self._infos(np.ones(self.num_envs, bool))
        return self._observations(), rewards, terminated, truncated, infos

    def _advance(self, actions: Any) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        """A step without observations and infos: rewards, terminated, truncated; the rest is in the buffers."""
        simulator = self._open()
        fresh = self._done.copy() if self.autoreset_mode is AutoresetMode.NEXT_STEP else np.zeros_like(self._done)
        stuck = ~self._begun | (self._done & ~fresh)
        if stuck.any():
            raise ResetNeeded(f"environments {np.flatnonzero(stuck).tolist()} have no running episode; call reset first")
        goals = self.task.action.decode(actions, self._candidates(), self._bounds, ~fresh)
        try:
            simulator.step(goals, fresh, self._buffers)
        except BaseException as error:
            named = self._take_stock(simulator, fresh, error)
            self._judge(self._columns(), fresh)
            raise named from None
        self._done = self._done & ~fresh
        self._remember_bounds(simulator, fresh)
        metrics = self._columns()
        terminated, truncated = self._judge(metrics, fresh)
        rewards = np.where(fresh, 0.0, self._checked("reward", self.task.reward(metrics)).astype(np.float64))
        return rewards, terminated, truncated

    def _judge(self, metrics: Columns, fresh: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whose episode is over, those aside that begin one: terminated, truncated."""
        # The first view is taken at the start, before any step.
        spent = (metrics["views"] > self.budget) & ~fresh
        self._done |= spent
        terminated = np.zeros(self.num_envs, bool)
        if self.task.success is not None:
            terminated = self._checked("success", self.task.success(metrics)) & ~fresh
            self._done |= terminated
        return terminated, spent & ~terminated

    def _take_stock(self, simulator: Simulator, fresh: NDArray[np.bool_], error: BaseException) -> BaseException:
        """After a failure of the core: ask it which of the environments that were to begin an episode did so, and which lost theirs.
        Returns the error, which names the first of the latter."""
        lost = None
        for i in map(int, np.flatnonzero(fresh)):
            try:
                views = views_of(simulator, i)
            except RuntimeError:
                continue  # a fault of the core's, an interrupt: it says so itself until a reset, which may be that of the next step
            if views <= 1:  # else the old episode, as nothing was begun
                self._seeded[i], self._begun[i], self._done[i] = True, views == 1, False
            if views == 1:
                self._remember_bounds(simulator, np.arange(self.num_envs) == i)
            if views == 0:
                lost = i if lost is None else lost
                for buffer in self._buffers.values():
                    buffer[i] = 0
        if lost is None or not isinstance(error, (ValueError, OSError)):
            return error
        if isinstance(error, OSError) and error.errno is not None:
            return type(error)(error.errno, f"environment {lost}: {error.strerror}", error.filename)
        return type(error)(f"environment {lost}: {error}")

    def _autoreset(self, simulator: Simulator) -> dict[str, Any]:
        """Begin the next episodes of the environments that are done; their last observations and infos go to infos."""
        done = self._done.copy()
        last = observation.encode(self._buffers, self.task)
        final_obs = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(done):
            final_obs[i] = observation.rows(last, i)
        final_info = self._infos(done)
        self._begin(simulator, done, [None] * self.num_envs)
        final = {"final_obs": final_obs, "_final_obs": done, "final_info": final_info, "_final_info": done.copy()}
        return final | self._infos(np.ones(self.num_envs, bool))

    def _begin(self, simulator: Simulator, mask: NDArray[np.bool_], seeds: list[int | None]) -> None:
        # An environment that never got a seed begins at random, as everywhere in Gymnasium.
        for i in np.flatnonzero(mask & ~self._seeded):
            if seeds[i] is None:
                seeds[i] = int(np.random.SeedSequence().generate_state(1, np.uint64)[0])
        try:
            simulator.reset(mask, seeds, self._buffers)
        except BaseException as error:
            raise self._take_stock(simulator, mask, error) from None
        self._seeded |= mask
        self._begun |= mask
        self._done = self._done & ~mask
        self._remember_bounds(simulator, mask)

    def _remember_bounds(self, simulator: Simulator, fresh: NDArray[np.bool_]) -> None:
        if not self.task.action.has_mask:
            for i in np.flatnonzero(fresh):
                self._bounds[i] = simulator.belief(int(i)).bounds

    def _candidates(self) -> NDArray[np.float32]:
        candidates = self._buffers.get("candidates")
        return np.zeros((self.num_envs, 0, 7), np.float32) if candidates is None else candidates

    def _columns(self) -> dict[str, NDArray[np.float64]]:
        return dict(zip(METRICS, self._buffers["metrics"].T.copy(), strict=True))

    def _probe(self) -> None:
        """Call reward and success test once, so that a wrong one is known before anything runs."""
        for field in ("reward", "success"):
            function = getattr(self.task, field)
            if function is None:
                continue
            try:
                with np.errstate(all="ignore"):
                    values = np.asarray(function(self._columns()))
            except Exception as error:
                raise ValueError(f"task {field} fails on metrics of zero: {error!r}") from error
            self._checked(field, values)

    def _checked(self, field: str, values: Any) -> NDArray[Any]:
        column = np.asarray(values)
        kinds, numbers = ("b", "bool") if field == "success" else ("fiu", "real numbers")
        if column.dtype.kind not in kinds:
            raise TypeError(f"task {field} must give {numbers}, got {column.dtype}")
        if column.shape != (self.num_envs,):
            raise ValueError(f"task {field} must give shape ({self.num_envs},), got {column.shape}")
        return column

    def _observations(self) -> Any:
        observations = observation.encode(self._buffers, self.task)
        return observation.rows(observations, slice(None)) if self.copy else observations

    def _infos(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Infos of the environments in `mask`, as Gymnasium lays them out; zeros for the others."""
        infos: dict[str, Any] = dict(self._columns())
        if self.task.action.has_mask:
            infos["action_mask"] = self._buffers["mask"].astype(np.int8)
        if not mask.all():
            for values in infos.values():
                values[~mask] = 0
        for key in list(infos):
            infos[f"_{key}"] = mask.copy()
        return infos

    def _info(self, number: int) -> dict[str, Any]:
        """The info of one environment, without Gymnasium's masks; numbers as Python's."""
        info: dict[str, Any] = dict(zip(METRICS, self._buffers["metrics"][number].tolist(), strict=True))
        if self.task.action.has_mask:
            info["action_mask"] = self._buffers["mask"][number].astype(np.int8)
        return info

    def _reset_arguments(
        self, seed: int | Sequence[int | None] | None, options: dict[str, Any] | None
    ) -> tuple[NDArray[np.bool_], list[int | None]]:
        """Checked arguments of a reset: which environments (n,), and n seeds. Nothing is changed."""
        self._open()
        return self._reset_mask(options), self._seeds(seed)

    def _reset_mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        if not isinstance(options, (Mapping, type(None))):
            raise TypeError(f"reset options must be a dictionary or None, got {options!r}")
        unknown = [key for key in options or {} if key != "reset_mask"]
        if unknown:
            raise ValueError(f"reset does not know the options {unknown}; there is 'reset_mask'")
        if options is None or "reset_mask" not in options:
            return np.ones(self.num_envs, bool)
        mask = options["reset_mask"]
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(f"options['reset_mask'] must be a numpy array of bool, got {mask!r}")
        if mask.shape != (self.num_envs,):
            raise ValueError(f"options['reset_mask'] must have shape ({self.num_envs},), got {mask.shape}")
        if not mask.any():
            raise ValueError("options['reset_mask'] must name at least one environment")
        return mask.copy()

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        n = self.num_envs
        if seed is None:
            return [None] * n
        if isinstance(seed, (int, np.integer)) and not isinstance(seed, bool):
            seed = [int(seed) + i for i in range(n)]
        if isinstance(seed, np.ndarray):
            seed = seed.tolist()
        if isinstance(seed, (str, bytes, bytearray, memoryview)) or not isinstance(seed, Sequence):
            raise TypeError(f"seed must be a whole number or one per environment, got {seed!r}")
        if len(seed) != n:
            raise ValueError(f"seed has {len(seed)} entries for {n} environments")
        seeds: list[int | None] = []
        for i, s in enumerate(seed):
            if s is not None and (isinstance(s, bool) or not isinstance(s, (int, np.integer))):
                raise TypeError(f"environment {i}: seed must be a whole number or None, got {s!r}")
            if s is not None and not 0 <= s < 2**64:
                raise ValueError(f"environment {i}: seed must lie in 0..2**64 - 1, got {s}")
            seeds.append(None if s is None else int(s))
        return seeds

    def _open(self) -> Simulator:
        if self._simulator is None:
            raise ClosedEnvironmentError("this environment was closed")
        return self._simulator

    @property
    def simulator(self) -> Simulator:
        """The core: for reports, oracles and viewers. It knows the truth."""
        return self._open()

    def belief(self, i: int) -> Belief:
        """What a planner may see of environment ``i``; a live view."""
        return self._open().belief(i)

    def action_masks(self) -> NDArray[np.bool_]:
        """(n, K) which candidate views are admissible by belief: within the bounds, not in occupied space, and not where a
        contact kept the robot away before (see :attr:`Belief.candidate_mask`).

        Raises:
            TypeError: The task's actions are no candidate views.
        """
        if not self.task.action.has_mask:
            raise TypeError(f"{self.task.action} has no action masks")
        return self._buffers["mask"].copy()

    def action_of(self, i: int, viewpoint: NDArray[Any]) -> Any:
        """The action of environment ``i`` that leads to a viewpoint (7,), or as near to it as there is one."""
        return self.task.action.encode(viewpoint, self._candidates()[i], self._bounds[i])

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A frame (height, width, 3) uint8 of each environment: depth image, map from above, metrics."""
        if self.render_mode is None:
            return None
        from .viewer import draw

        self._open()
        metrics = self._columns()
        return tuple(
            draw(
                self.belief(i),
                self._buffers["depth"][i],
                {name: float(column[i]) for name, column in metrics.items()},
                self.budget,
            )
            for i in range(self.num_envs)
        )

    def close_extras(self, **kwargs: Any) -> None:
        """Let go of the core, and with it of scenes, maps and threads."""
        self._simulator = None


def views_of(simulator: Simulator, i: int) -> int:
    """Views that environment i's episode has taken; 0 if it has no episode.

    Raises:
        RuntimeError: The environment must be reset, or another thread is in the core.
    """
    try:
        return len(simulator.belief(i).trajectory)
    except ValueError:
        return 0


def flags(values: Any) -> NDArray[np.bool_]:
    """A list of booleans, as snapshots note them."""
    if not (isinstance(values, list) and all(isinstance(value, bool) for value in values)):
        raise TypeError(f"{values!r} is no list of booleans")
    return np.array(values, bool)
