"""Orientations that a task gives as four numbers, made exactly of size 1."""

import math
from collections.abc import Mapping, Sequence

from mbd_ros.errors import ModelError
from mbd_ros.optimal_control.problem import Range

_OFF = 1.0e-2  # of the size: what rounding of digits may leave


def with_unit_turns(given: Mapping[str, Range], bodies: Sequence[str]) -> dict[str, Range]:
    """Ranges at an end, with quaternions of size 1 where all four numbers are given.

    Raises:
        ModelError: Four numbers that are no orientation.
    """
    found = dict(given)
    for body in bodies:
        names = [f"{body}.orientation.{axis}" for axis in "xyzw"]
        ranges = [found.get(name, (-math.inf, math.inf)) for name in names]
        if any(low != high for low, high in ranges):
            continue
        values = [low for low, _ in ranges]
        size = math.hypot(*values)
        if abs(size - 1.0) > _OFF:
            raise ModelError(
                f"{body}.orientation: a quaternion (x, y, z, w) of size {size:g}, accepted: 1"
            )
        found |= {name: (one / size, one / size) for name, one in zip(names, values, strict=True)}
    return found
