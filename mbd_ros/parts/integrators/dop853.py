"""Explicit Runge-Kutta method of order 8 by Dormand and Prince."""

from typing import ClassVar

from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.integration.runge_kutta import Tableau
from mbd_ros.methods.integration.tableau_integrator import ExplicitRungeKutta


class Dop853(ExplicitRungeKutta):
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
    stable = 5.5
    example = {"tolerance": 1e-9}
