"""Numbers that a constructor takes: ranges and units as annotations of its arguments.

Ranges are checked where a file is read or a parameter is set. The largest number of a scene leaves
room for the powers and products that dynamics makes of it, within 1.8e308.
"""

import math
import typing
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

LARGEST = 1.0e30  # of any number that says nothing else


class Within(NamedTuple):
    """Smallest and largest accepted value."""

    low: float
    high: float


class Unit(str):
    """Unit of an argument, `-` for a number without one."""


Duration = Annotated[float, Within(1.0e-9, 1.0e9), Unit("s")]
Gain = Annotated[float | Sequence[float], Within(0.0, math.inf)]  # one for all joints, or one each
Smoothing = Annotated[float, Within(1.0e-12, 1.0e12), Unit("m/s or rad/s")]
Unlimited = Annotated[float, Within(-math.inf, math.inf)]  # what has a check of its own
Share = Annotated[float, Within(1.0e-6, 1.0)]
ANY_NUMBER = Within(-LARGEST, LARGEST)


class Described(NamedTuple):
    """The contents of an annotation.

    Attributes:
        kind: The type without range and unit.
        within: Its range, None where the annotation states none.
        unit: Its unit, empty where the annotation states none.
    """

    kind: Any
    within: Within | None
    unit: str


def described(annotation: Any) -> Described:
    """Type, range and unit of an annotation; of several ranges or units the outermost one."""
    if typing.get_origin(annotation) is not Annotated:
        return Described(annotation, None, "")
    kind, *extras = typing.get_args(annotation)
    within = [extra for extra in extras if isinstance(extra, Within)]
    units = [str(extra) for extra in extras if isinstance(extra, Unit)]
    return Described(kind, within[-1] if within else None, units[-1] if units else "")
