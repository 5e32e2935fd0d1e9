"""Episodes that cannot begin: the environment is named, the others go on as if they were alone, and nothing is begun twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from nbv_gym.envs.env import NbvEnv
from nbv_gym.envs.vector_env import NbvVectorEnv
from nbv_gym.rust_env import Camera

#: In some rooms there is no place for so many boxes: environment 1, with seed 25, draws one of them for its seventh episode.
CROWDED: dict[str, Any] = {
    "scene": "room:0-63",
    "bodies": {"boxes": 9},
    "camera": Camera(8, 6, hfov=1.0, near=0.05, far=3.0),
    "resolution": 0.3,
    "observation": "pose",
    "budget": 1,
    "success": None,
}
NO_ROOM = r'^environment 1: scene "room:36" has no room for box 9 of 9$'
HEALTHY = [0, 2, 3]
STILL = np.zeros(4, int)
SECOND = np.arange(4) == 1


def crowded(mode: AutoresetMode = AutoresetMode.NEXT_STEP, **changes: Any) -> NbvVectorEnv:
    return NbvVectorEnv("dome_room", num_envs=4, autoreset_mode=mode, **(CROWDED | changes))


def poses(envs: NbvVectorEnv, which: list[int]) -> Any:
    return np.array([envs.belief(i).pose for i in which])


def starts(seed: int, episodes: int) -> Any:
    """Where the episodes of a single environment begin."""
    env = NbvEnv("dome_room", **CROWDED)
    return np.array([env.reset(seed=seed if k == 0 else None)[0] for k in range(episodes)])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP], ids=lambda m: m.name)
def test_an_episode_that_cannot_begin_leaves_the_others_theirs(mode: AutoresetMode) -> None:
    envs = crowded(mode)
    envs.reset(seed=24)
    begun = [poses(envs, HEALTHY)]
    for _ in range(5):
        if mode is AutoresetMode.NEXT_STEP:
            assert envs.step(STILL)[3].all()
        envs.step(STILL)
        begun.append(poses(envs, HEALTHY))
    if mode is AutoresetMode.NEXT_STEP:
        envs.step(STILL)
    with pytest.raises(ValueError, match=NO_ROOM):
        envs.step(STILL)
    begun.append(poses(envs, HEALTHY))
    assert envs._begun.tolist() == [True, False, True, True] and not envs._done.any()
    with pytest.raises(ValueError, match="no episode"):
        envs.belief(1)
    with pytest.raises(ResetNeeded, match=r"\[1\]"):
        envs.step(STILL)
    # Its stream goes on behind the seed that failed; the others stay where they are.
    observations, infos = envs.reset(options={"reset_mask": SECOND})
    assert infos["_views"].tolist() == SECOND.tolist()
    np.testing.assert_array_equal(observations[HEALTHY], begun[-1])
    lone = NbvEnv("dome_room", **CROWDED)
    lone.reset(seed=25)
    for _ in range(5):
        lone.reset()
    with pytest.raises(ValueError, match="no room"):
        lone.reset()
    np.testing.assert_array_equal(observations[1], lone.reset()[0])
    # And on.
    assert envs.step(STILL)[3].all()
    if mode is AutoresetMode.NEXT_STEP:
        envs.step(STILL)
    begun.append(poses(envs, HEALTHY))
    for column, i in enumerate(HEALTHY):
        np.testing.assert_array_equal([row[column] for row in begun], starts(24 + i, len(begun)), err_msg=f"environment {i}")


def test_a_step_in_which_another_episode_cannot_begin_still_ends_episodes() -> None:
    envs = crowded(budget=2)
    envs.reset(seed=24)
    envs.step(STILL)
    # From now on environment 0 is a step behind: it takes its last view when the others begin.
    envs.reset(options={"reset_mask": np.arange(4) == 0})
    for _ in range(16):
        envs.step(STILL)
    with pytest.raises(ValueError, match=NO_ROOM):
        envs.step(STILL)
    assert envs._done.tolist() == [True, False, False, False]
    assert envs.simulator.belief(0).trajectory.shape[0] == 3


#: A seed whose first room has no place for twelve boxes.
FAILING = 4


def test_a_first_reset_that_fails_has_begun_the_others() -> None:
    envs = crowded(bodies={"boxes": 12})
    seeds = [0, FAILING, 1, 2]
    with pytest.raises(ValueError, match="^environment 1: scene .* has no room for box"):
        envs.reset(seed=seeds)
    assert envs._begun.tolist() == [True, False, True, True]
    before = poses(envs, HEALTHY)
    with pytest.raises(ResetNeeded, match=r"\[1\]"):
        envs.step(STILL)
    observations, _ = envs.reset(options={"reset_mask": SECOND})
    np.testing.assert_array_equal(observations[HEALTHY], before)
    other = crowded(bodies={"boxes": 12})
    with pytest.raises(ValueError, match="no room"):
        other.reset(seed=seeds)
    np.testing.assert_array_equal(other.reset(options={"reset_mask": SECOND})[0][1], observations[1])


def test_a_snapshot_after_a_failure_goes_on() -> None:
    envs = crowded(bodies={"boxes": 12}, action="viewpoint")
    with pytest.raises(ValueError, match="no room"):
        envs.reset(seed=[0, FAILING, 1, 2])
    other = crowded(bodies={"boxes": 12}, action="viewpoint")
    observations, infos = other.restore(envs.snapshot())
    assert infos["_views"].tolist() == [True, False, True, True] and not observations[1].any()
    for mine, theirs in ((envs, other), (envs.clone(), other.clone())):
        np.testing.assert_array_equal(mine.reset(options={"reset_mask": SECOND})[0], theirs.reset(options={"reset_mask": SECOND})[0])


def test_a_scene_file_that_went_is_named_with_its_environment(tmp_path: Path) -> None:
    corners = "".join(f"v {x} {y} {z}\n" for x, y in [(0, 0), (6, 0), (6, 5), (0, 5)] for z in (0, 3))
    path = tmp_path / "box.obj"
    path.write_text(f"{corners}f 1 3 5 7\nf 2 4 6 8\nf 1 3 4 2\nf 3 5 6 4\nf 5 7 8 6\nf 7 1 2 8\n")
    envs = crowded(scene=str(path), bodies=None)
    envs.reset(seed=0)
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"environment 1: No such file.*box\.obj"):
        envs.reset(options={"reset_mask": SECOND})
    assert envs._begun.tolist() == [True, False, True, True]
