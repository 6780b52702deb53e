"""The problem of a motion: bounds, conditions, goals and prescribed inputs of each phase."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.mesh import Mesh, Numbers

Range = tuple[float, float]
Ranges = Mapping[str, Range]
NOTHING: Mapping[str, Any] = {}
_BODY_QUANTITIES = (
    ("position", "xyz"),
    ("orientation", "xyzw"),
    ("linear_velocity", "xyz"),
    ("angular_velocity", "xyz"),
)


class PrescribedInputs(NamedTuple):
    """Inputs that are prescribed over time.

    Attributes:
        places: Indices in u, shape (k,).
        at: Function from shares of the duration of a phase, shape (m,), to values, shape (m, k).
    """

    places: Numbers
    at: Callable[[Array], Array]


NO_PRESCRIBED_INPUTS = PrescribedInputs(
    np.zeros(0, dtype=np.intp), lambda shares: np.zeros((len(shares), 0))
)


class PhaseProblem(NamedTuple):
    """The problem of one phase.

    Attributes:
        name: Name for messages and tables.
        duration: Shortest and longest duration [s].
        bounds: Ranges of quantities at all times.
        start: Ranges of quantities at the beginning.
        end: Ranges of quantities at the end.
        goals: Terms of the cost.
        mesh: The first mesh.
    """

    name: str
    duration: Range
    bounds: Ranges
    start: Ranges
    end: Ranges
    goals: tuple[Goal, ...]
    mesh: Mesh


class Goal(NamedTuple):
    """A term of the cost.

    Attributes:
        kind: Type of the goal.
        weight: Weight in the cost.
        options: All other arguments.
        name: Name for messages and tables.
    """

    kind: str
    weight: float = 1.0
    options: Mapping[str, Any] = NOTHING
    name: str = ""


def body_names(body: str) -> list[str]:
    """Return the names of the seven coordinates and six velocities of a free body."""
    return [f"{body}.{word}.{axis}" for word, axes in _BODY_QUANTITIES for axis in axes]
