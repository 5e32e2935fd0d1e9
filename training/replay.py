"""A recorded episode, gone through again from its actions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..envs.env import NbvEnv
from .evaluate import open_env
from .manifest import Row


@contextmanager
def replayed(record: dict[str, Any]) -> Iterator[NbvEnv]:
    """The environment of an evaluation's record as it was after the record's last step: the same map, the same world."""
    row = Row(**record["row"])
    env = open_env(row)
    try:
        env.reset(seed=row.seed)
        for action in record["actions"]:
            env.step(np.asarray(action))
        yield env
    finally:
        env.close()
