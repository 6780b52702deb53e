"""Filippov solutions of systems with forces that switch at surfaces."""

from typing import ClassVar

from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.integration.runge_kutta import Tableau
from mbd_ros.methods.integration.tableau_integrator import ExplicitRungeKutta


class Filippov(ExplicitRungeKutta):
    """DOP853 from event to event, with sliding on the surfaces that attract.

    Steps end to rounding where a surface is reached or sliding ends. On a surface that attracts
    from both sides the motion is that of Filippov's convex combination, and stays on the surface
    to rounding; on several at once it is that of the equivalent control. Without switching forces
    it is DOP853.

    It refuses to choose where the solution is not unique (surfaces that repel), where none
    continues, and where events accumulate, each by a SolveError; and, when built, smoothed rows
    beside switching forces. It does not slide where only the second derivative of a height jumps
    (heights of positions alone): it crosses such surfaces.

    Source: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, §4;
    L. Dieci, L. Lopez, SIAM J. Numer. Anal. 47, 2009, 2023-2051.

    Args:
        tolerance: Relative and absolute, 1e-13 .. 0.1, as for `dop853`. None: steps of length dt,
            but for those that end at an event.
    """

    order: ClassVar[int] = 8
    tableau: ClassVar[Tableau] = DOP853
    finds_surfaces: ClassVar[bool] = True
    stable = 5.5
    example = {"tolerance": 1e-9}
