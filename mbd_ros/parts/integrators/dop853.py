"""Explicit Runge-Kutta method of order 8 by Dormand and Prince."""

import math
from typing import Any, ClassVar

from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.integration.linear_motion import LinearMotion, runge_kutta_growth
from mbd_ros.methods.integration.runge_kutta import (
    RungeKutta,
    Tableau,
    check_tolerance,
    runge_kutta,
)
from mbd_ros.methods.integration.stepping import Integrator


class Dop853(Integrator):
    """DOP853: order 8, twelve evaluations a step, dense output of order 7.

    The dense output takes four more evaluations, only where it is asked for; one of them is the
    first of the next step.

    Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.5, II.10.

    Args:
        tolerance: Relative and absolute, 1e-13 .. 0.1: largest error of a step in q [rad or m]
            and v [rad/s or m/s], as the root mean square of e_i / (1 + |y_i|) over y = [q; v].
            The step size follows from it. None: steps of length dt.
    """

    order: ClassVar[int] = 8
    native = "runge_kutta"
    tableau: ClassVar[Tableau] = DOP853
    dense: ClassVar[bool] = True
    event_driven: ClassVar[bool] = True
    stable = 5.5
    example = {"tolerance": 1e-9}

    def __init__(self, *, tolerance: float | None = None) -> None:
        check_tolerance(tolerance)
        self.tolerance = tolerance
        if tolerance is not None:
            self.stable = math.inf

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Factor by which a step multiplies a linear motion at most."""
        return runge_kutta_growth(DOP853, motion, dt)

    def prepare(self, system: Any, dt: float) -> RungeKutta:
        """The stepper for one system and one step size [s], or with a tolerance first guess."""
        return runge_kutta(system, DOP853, dt, self.tolerance)
