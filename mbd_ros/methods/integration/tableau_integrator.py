"""Integrators with explicit Runge-Kutta steps: what a part with a tableau need not say."""

import math
from typing import Any, ClassVar

from mbd_ros.methods.integration.linear_motion import LinearMotion, runge_kutta_growth
from mbd_ros.methods.integration.runge_kutta import (
    RungeKutta,
    Tableau,
    check_tolerance,
    runge_kutta,
)
from mbd_ros.methods.integration.stepping import Integrator


class ExplicitRungeKutta(Integrator):
    """Steps of a tableau, of length dt or as long as a tolerance allows.

    Args:
        tolerance: Relative and absolute, 1e-13 .. 0.1; None: steps of length dt.
    """

    tableau: ClassVar[Tableau]
    dense = True
    event_driven = True

    def __init__(self, *, tolerance: float | None = None) -> None:
        check_tolerance(tolerance)
        self.tolerance = tolerance
        if tolerance is not None:
            self.stable = math.inf

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Return the factor by which a step multiplies a linear motion at most."""
        return runge_kutta_growth(self.tableau, motion, dt)

    def prepare(self, system: Any, dt: float) -> RungeKutta:
        """The stepper for one system and one step size [s], or with a tolerance first guess."""
        return runge_kutta(system, self.tableau, dt, self.tolerance)
