"""What the pages show works."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gymnasium as gym

import nbv_gym  # noqa: F401 (registers the environments)

DOCS = Path(__file__).parent.parent / "docs"


def example(page: str, word: str) -> gym.Env[Any, Any]:
    """The environment that the page's example with this word makes, on its first episode."""
    blocks = re.findall(r"^```python\n(.*?)^```$", (DOCS / page).read_text(), re.DOTALL | re.MULTILINE)
    (code,) = [block for block in blocks if word in block and "gym.make" in block]
    names: dict[str, Any] = {"gym": gym}
    exec(code, names)
    env: gym.Env[Any, Any] = names["env"]
    env.reset(seed=0)
    return env


def test_a_lidar_is_observed() -> None:
    env = example("world.md", "lidar")
    assert env.step(0)[0]["scan"].shape == (720,)


def test_a_longer_reach_keeps_the_dome() -> None:
    belief = example("environments/dome_room.md", "reach").unwrapped.belief  # type: ignore[attr-defined]
    assert len(belief.candidates) == 672 and 8 < len(belief.neighbours()) <= 24


def test_another_integration_keeps_the_resolution() -> None:
    assert example("map.md", "integration").unwrapped.belief.resolution == 0.1  # type: ignore[attr-defined]
