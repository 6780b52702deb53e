"""What is asked of a motion: bounds, conditions, goals and inputs of each phase."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.mesh import Mesh, Numbers

Range = tuple[float, float]
Ranges = Mapping[str, Range]
NOTHING: Mapping[str, Any] = {}
_WORDS = (
    ("position", "xyz"),
    ("orientation", "xyzw"),
    ("linear_velocity", "xyz"),
    ("angular_velocity", "xyz"),
)


class GivenInputs(NamedTuple):
    """Inputs that are known over time.

    Attributes:
        places: Where they stand in u, shape (k,).
        at: Shares of the duration of a phase, shape (m,) -> values, shape (m, k).
    """

    places: Numbers
    at: Callable[[Array], Array]


NONE_GIVEN = GivenInputs(np.zeros(0, dtype=np.intp), lambda shares: np.zeros((len(shares), 0)))


class PhaseProblem(NamedTuple):
    """What is asked of a phase.

    Attributes:
        name: For messages and tables.
        duration: Shortest and longest [s].
        bounds: Of quantities, all the time.
        start: Of quantities at the beginning.
        end: Of quantities at the end.
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
        kind: Name of the goal.
        weight: What it counts.
        options: Its other arguments, complete.
        name: For messages and tables.
    """

    kind: str
    weight: float = 1.0
    options: Mapping[str, Any] = NOTHING
    name: str = ""


def body_names(body: str) -> list[str]:
    """Names of the seven coordinates and the six velocities of a free body, in its axes."""
    return [f"{body}.{word}.{axis}" for word, axes in _WORDS for axis in axes]
