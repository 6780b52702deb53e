"""Ranges and units of numbers, as annotations of the arguments of constructors.

Ranges are checked where an entry is read or a parameter is set, by the schema: constructors store
and derive, so that they take symbols as well as numbers. The smallest and the largest number of a
scene leave room for the powers and products that dynamics makes of them, within 1.8e308.
"""

import math
import typing
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

from mbd_ros.errors import MbdError

LARGEST = 1.0e30  # of any number that says nothing else
SMALLEST = 1.0e-30  # of a number that must not be 0
SHORTEST_DT, LONGEST_DT = 1.0e-9, 9.0e9  # s: stamps hold whole nanoseconds, in 63 bits


class Within(NamedTuple):
    """Smallest and largest accepted value.

    Attributes:
        low: Smallest value.
        high: Largest value.
        of_size: Whether they bound the absolute value.
    """

    low: float
    high: float
    of_size: bool = False

    def accepts(self, number: float) -> bool:
        """Whether a number lies between them; NaN does not."""
        return self.low <= (abs(number) if self.of_size else number) <= self.high

    def __str__(self) -> str:
        return f"{'a size of ' if self.of_size else ''}{self.low:g} .. {self.high:g}"


class Unit(str):
    """Unit of an argument, `-` for a number without one."""


class Length(int):
    """Number of entries of a list."""


Duration = Annotated[float, Within(1.0e-9, 1.0e9), Unit("s")]
OptionalDuration = Annotated[float | None, Within(1.0e-9, 1.0e9), Unit("s")]
Gain = Annotated[float | Sequence[float], Within(0.0, math.inf)]  # one for all joints, or one each
Smoothing = Annotated[float, Within(1.0e-12, 1.0e12), Unit("m/s or rad/s")]
Unlimited = Annotated[float, Within(-math.inf, math.inf)]  # what has a check of its own
Restitution = Annotated[float, Within(0.0, 1.0)]
Share = Annotated[float, Within(1.0e-6, 1.0)]
NotNegative = Annotated[float, Within(0.0, LARGEST)]
Positive = Annotated[float, Within(SMALLEST, LARGEST)]
NotZero = Annotated[float, Within(SMALLEST, LARGEST, of_size=True)]
Vector = Annotated[Sequence[float], Length(3)]
ANY_NUMBER = Within(-LARGEST, LARGEST)


class Described(NamedTuple):
    """The contents of an annotation.

    Attributes:
        kind: The type without range and unit.
        within: Its range, None where the annotation states none.
        unit: Its unit, empty where the annotation states none.
        length: Number of entries of a list, None where the annotation states none.
    """

    kind: Any
    within: Within | None = None
    unit: str = ""
    length: int | None = None


def described(annotation: Any) -> Described:
    """Return the contents of an annotation; the outermost of several ranges, units or lengths."""
    if typing.get_origin(annotation) is not Annotated:
        return Described(annotation)
    kind, *extras = typing.get_args(annotation)
    contents = Described(kind)
    for extra in extras:
        if isinstance(extra, Within):
            contents = contents._replace(within=extra)
        elif isinstance(extra, Unit):
            contents = contents._replace(unit=str(extra))
        elif isinstance(extra, Length):
            contents = contents._replace(length=int(extra))
    return contents


def is_value(number: Any, value: float) -> bool:
    """Whether a number has a value; a symbol has none."""
    return isinstance(number, int | float) and number == value


def refuse_dt(dt: float, where: str, kind: type[MbdError]) -> None:
    """Refuse a step, and interval of the output, that time stamps cannot resolve.

    Args:
        dt: Step [s].
        where: File and key, or option.
        kind: Class of the error.
    """
    if not 0 < dt < math.inf:
        raise kind(f"{where}: {dt:g} s must be finite and > 0")
    if not SHORTEST_DT <= dt <= LONGEST_DT:
        raise kind(
            f"{where}: {dt:g} s, accepted: {SHORTEST_DT:g} .. {LONGEST_DT:g} s, since stamps hold "
            "whole nanoseconds"
        )
