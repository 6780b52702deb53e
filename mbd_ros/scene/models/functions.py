"""Functions of one coordinate as a scene writes them."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from mbd_ros.core.model.coupling_functions import CouplingFunction
from mbd_ros.scene.reading.coupling_entries import one_function

Entry = Mapping[str, Any]


class Function(NamedTuple):
    """A function of one coordinate.

    Attributes:
        entry: As a scene writes it: `factor`, `polynomial`, `simm_spline`, ..
        constant: Its value where it does not depend on the coordinate, else None.
    """

    entry: Entry
    constant: float | None = None

    @property
    def slope(self) -> float | None:
        """Of a straight line, else None."""
        return self.entry.get("factor")

    @property
    def offset(self) -> float:
        """Value of a straight line at 0."""
        return float(self.entry.get("offset", 0.0))

    def evaluator(self, where: str) -> CouplingFunction:
        """The function itself.

        Raises:
            SceneError: Its numbers are refused.
        """
        return one_function(where, **self.entry)

    def value(self, q: float, where: str) -> float:
        """f(q)."""
        if self.constant is not None:
            return self.constant
        return float(self.evaluator(where)(float(q))[0])


def constant(value: float) -> Function:
    """f(q) = value."""
    return Function({"polynomial": [value]}, value)


def linear(slope: float, offset: float = 0.0) -> Function:
    """f(q) = slope q + offset."""
    if slope == 0.0:
        return constant(offset)
    return Function({"factor": slope, **({"offset": offset} if offset else {})})


def sine(
    amplitude: float, angular_frequency: float = 1.0, phase: float = 0.0, offset: float = 0.0
) -> Function:
    """f(q) = offset + amplitude sin(angular_frequency q + phase)."""
    if amplitude * angular_frequency == 0.0:
        return constant(amplitude * math.sin(phase) + offset)
    given = {"amplitude": amplitude, "angular_frequency": angular_frequency}
    return Function({"harmonic": {**given, "phase": phase, "offset": offset}})


IDENTITY = linear(1.0)
