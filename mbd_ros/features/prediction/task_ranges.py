"""Ranges of quantities as a task file has them: a number, `[low, high]`, or `free`."""

import math
from typing import Any

from mbd_ros.core.ranges import LARGEST, SMALLEST
from mbd_ros.errors import SceneError
from mbd_ros.optimal_control.problem import Range
from mbd_ros.scene.schema import schema

FREE = "free"
_LASTS = "a number above 0, or [shortest, longest]"


def duration_of(given: Any, where: str) -> Range:
    """Shortest and longest duration [s]."""
    low, high = range_of(given, where)
    if high == 0.0:
        raise SceneError(
            f"{where}: a phase that lasts no time; accepted: above 0, or leave it out and let the "
            "guard before it lead to the phase after it, with what both reset"
        )
    if not (low >= SMALLEST and high <= LARGEST):
        raise SceneError(f"{where}: {low:g} .. {high:g} s is out of range, accepted: {_LASTS}")
    return low, high


def ranges(given: Any, where: str) -> dict[str, Range]:
    """Quantity -> range."""
    if not isinstance(given, dict):
        raise SceneError(f"{where}: expected quantities with a number or [low, high] each")
    return {str(key): range_of(one, f"{where}.{key}") for key, one in given.items()}


def range_of(given: Any, where: str) -> Range:
    """A number, [low, high] with null for no bound, or `free`."""
    if given == FREE:
        return -math.inf, math.inf
    if isinstance(given, list):
        if len(given) != 2:
            raise SceneError(f"{where}: expected a number or [low, high], got {given}")
        ends = (-math.inf, math.inf)
        pairs = zip(given, ends, strict=True)
        low, high = (end if one is None else schema.value(one, float, where) for one, end in pairs)
        if low > high:
            raise SceneError(f"{where}: lower bound {low:g} is above the upper one {high:g}")
        return low, high
    number = schema.value(given, float, where)
    return number, number


def open_range(given: Any, where: str) -> Range:
    """A range with some width."""
    low, high = range_of(given, where)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise SceneError(f"{where}: expected [low, high] with low < high, got {given}")
    return low, high
