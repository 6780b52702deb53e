"""The classical Runge-Kutta method."""

from typing import Any, ClassVar

from mbd_ros.methods.integration.linear_motion import LinearMotion, runge_kutta_growth
from mbd_ros.methods.integration.runge_kutta import RK4, RungeKutta, Tableau
from mbd_ros.methods.integration.stepping import Integrator


class Rk4(Integrator):
    """Explicit Runge-Kutta method of order 4 with four evaluations a step of length dt.

    Dense output of order 3, by the cubic through both ends of a step.
    """

    order: ClassVar[int] = 4
    native = "runge_kutta"
    tableau: ClassVar[Tableau] = RK4
    dense: ClassVar[bool] = True
    event_driven: ClassVar[bool] = True
    example: ClassVar[dict[str, Any]] = {}

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Return the factor by which a step multiplies a linear motion at most."""
        return runge_kutta_growth(RK4, motion, dt)

    def prepare(self, system: Any, dt: float) -> RungeKutta:
        """Return the stepper for one system and one step size [s]."""
        return RungeKutta(system, RK4, dt)
