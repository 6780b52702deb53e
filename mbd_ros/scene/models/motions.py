"""Turns and slides between two links, by functions of one coordinate as a scene writes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.reading.coupling_entries import one_function

X, Y, Z = np.eye(3)
Entry = Mapping[str, Any]


class Motion(NamedTuple):
    """A turn about an axis, or a slide along it.

    Attributes:
        name: What it is called where no coordinate gives it a name.
        axis: Of length 1, shape (3,).
        turns: Whether it is a turn.
        function: Angle [rad] or way [m] of the coordinate.
        coordinate: Name of the coordinate, empty where the function is constant.
    """

    name: str
    axis: Array
    turns: bool
    function: Function
    coordinate: str

    def at(self, value: float) -> Any:
        """`pinocchio.SE3` where the function has a value."""
        if self.turns:
            return pin.SE3(pin.AngleAxis(value, self.axis).toRotationMatrix(), np.zeros(3))
        return pin.SE3(np.eye(3), value * self.axis)

    def inverse(self) -> Motion:
        """The motion back."""
        return self._replace(axis=-self.axis)


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

    def value(self, q: float, where: str) -> float:
        """f(q).

        Raises:
            SceneError: The numbers of the function are refused; `where` begins the message.
        """
        if self.constant is not None:
            return self.constant
        return float(one_function(where, **self.entry)(float(q))[0])


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
Step = Motion | pin.SE3
