"""What is remembered from step to step, as a value that can be kept and pickled."""

from typing import Any

import numpy as np

from mbd_ros.core.state import State

Memory = dict[str, Any]


def copied(value: Any) -> Any:
    """A value with arrays of its own, in tuples too."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, State):
        return State(value.t, value.q.copy(), value.v.copy(), value.z.copy(), value.mode)
    if isinstance(value, tuple):
        return _like(value)(map(copied, value))
    return value


def recognised(value: Any, x: State) -> Any:
    """The value; x itself in place of a state with the same bits, as steppers look for it."""
    if isinstance(value, State):
        return x if is_same(value, x) else value
    if isinstance(value, tuple):
        return _like(value)(recognised(each, x) for each in value)
    return value


def is_same(one: State, other: State) -> bool:
    """Whether two states have the same bits."""
    arrays = zip(one[1:4], other[1:4], strict=True)
    return (
        one.t == other.t
        and one.mode == other.mode
        and all(a.tobytes() == b.tobytes() for a, b in arrays)
    )


def _like(value: Any) -> Any:
    """What makes a tuple, or a named one, of the same kind."""
    return getattr(type(value), "_make", tuple)
