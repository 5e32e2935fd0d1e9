"""Tests keep away from the user's cache of scenes."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def cache_of_our_own() -> Iterator[None]:
    with tempfile.TemporaryDirectory(prefix="nbv-gym-cache-") as folder:
        os.environ["NBV_GYM_CACHE"] = folder
        yield
        del os.environ["NBV_GYM_CACHE"]
