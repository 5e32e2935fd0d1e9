"""What is installed is what stands in the repository."""

from __future__ import annotations

import re
from pathlib import Path

import nbv_gym
import nbv_gym.rust_env
from nbv_gym.rust_env import nbv_core

ROOT = Path(__file__).resolve().parent.parent


def test_one_version() -> None:
    manifests = [(ROOT / name).read_text() for name in ("Cargo.toml", "pyproject.toml")]
    found = [re.search(r'^version = "([^"]+)"', text, re.M) for text in manifests]
    versions = {match.group(1) for match in found if match}
    assert versions == {nbv_gym.__version__} == {nbv_core.__version__}


def test_the_door_lists_what_the_core_offers() -> None:
    offered = {name for name in vars(nbv_core) if not name.startswith("_")}
    assert set(nbv_gym.rust_env.__all__) == offered
