"""Random streams of an environment's Python side as JSON, for snapshots."""

from __future__ import annotations

from typing import Any

import numpy as np


def describe(owner: Any) -> dict[str, Any]:
    """The streams of an environment (single or vector): ``np_random``, its seed, and that of the action space.

    Raises:
        ValueError: A stream is not of the kind that Gymnasium makes (PCG64).
    """
    return {
        "seed": owner._np_random_seed,
        "np_random": state_of("np_random", owner._np_random),
        "action_space": state_of("action_space", owner.action_space._np_random),
    }


def put_back(owner: Any, streams: dict[str, Any]) -> None:
    """Go on with streams as they were described."""
    owner._np_random_seed = streams["seed"]
    owner._np_random = generator(streams["np_random"])
    owner.action_space._np_random = generator(streams["action_space"])


def state_of(name: str, stream: np.random.Generator | None) -> Any:
    """Where a stream stands; ``None`` for one that was not begun."""
    if stream is None:
        return None
    state = stream.bit_generator.state
    if state["bit_generator"] != "PCG64":
        raise ValueError(f"{name} draws from {state['bit_generator']}; only PCG64 streams can be in a snapshot")
    return state


def generator(state: Any) -> np.random.Generator | None:
    """A stream that stands there.

    Raises:
        ValueError: The state is none.
    """
    if state is None:
        return None
    bits = np.random.PCG64()
    try:
        bits.state = state
    except (KeyError, TypeError, OverflowError) as error:
        raise ValueError(f"snapshot: {state!r} is no state of a random stream") from error
    return np.random.Generator(bits)
