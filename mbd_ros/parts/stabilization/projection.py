"""Projection of position and velocity onto the constraints after every step."""

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import State
from mbd_ros.methods.projection.assembly import Stabilization, project


class Projection(Stabilization):
    """Projection of every state onto the constraints, by the smallest step in the mass metric.

    Violations stay at the level of rounding errors.

    Source: E. Eich, SIAM J. Numer. Anal. 30 (1993).
    """

    projects = True
    example: dict[str, float] = {}

    def correct(self, system: System, x: State) -> State:
        """Return the nearest state with g = 0 and g' = 0."""
        return project(system, x)
