"""Filippov solutions of systems with forces that switch at surfaces."""

import math
from typing import Any, ClassVar

from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.integration.linear_motion import LinearMotion, runge_kutta_growth
from mbd_ros.methods.integration.runge_kutta import check_tolerance, runge_kutta
from mbd_ros.methods.integration.stepping import Integrator, Stepper


class Filippov(Integrator):
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
    dense: ClassVar[bool] = True
    event_driven: ClassVar[bool] = True
    finds_surfaces: ClassVar[bool] = True
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

    def prepare(self, system: Any, dt: float) -> Stepper:
        """The stepper for one system and one step size [s], or with a tolerance first guess."""
        return runge_kutta(system, DOP853, dt, self.tolerance)
