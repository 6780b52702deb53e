"""What is asked of a motion: bounds, conditions at ends and goals of each phase, by names."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from mbd_ros.optimal_control.mesh import Mesh

Range = tuple[float, float]
Ranges = Mapping[str, Range]
NOTHING: Mapping[str, Any] = {}


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
