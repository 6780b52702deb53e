"""The method of Moreau and Jean: time-stepping with impacts, stick and stiff loads."""

import math
from typing import Annotated, Any, ClassVar

import numpy as np

from mbd_ros.core.nonsmooth.moreau_jean_step import FreeBodyStep, MoreauJeanStep
from mbd_ros.core.ranges import Within
from mbd_ros.core.state import Array, State
from mbd_ros.methods.integration.stepping import Integrator, Stepper, clip


class MoreauJean(Integrator):
    """Velocities jump within steps of one length, however many impacts fall into one.

        M (v+ - v) = dt f + J' p,   q+ = q (+) dt ((1 - theta) v + theta v+)

    Joint stops, dry friction, limited drives, contacts and bilateral rows are one complementarity
    problem a step, with rates at its end; no time constant of theirs is read, but a limited drive
    returns to its motion with its own. Impacts have Poisson's restitution and divide a step.
    Loads and internal states are implicit: stiff ones do not limit the step. Second order where
    motion is smooth, if theta is 1/2, and first order where rows begin or cease to act.

    Args:
        theta: 1/2 keeps the energy of linear oscillations, 1 damps what a step does not resolve.

    Source: J. J. Moreau, in Nonsmooth Mechanics and Applications, CISM 302, 1988; M. Jean, Comput.
        Methods Appl. Mech. Eng. 177, 1999, 235-257.
    """

    is_explicit: ClassVar[bool] = False
    at_velocity_level: ClassVar[bool] = True
    example: ClassVar[dict[str, Any]] = {"theta": 0.5}

    def __init__(self, *, theta: Annotated[float, Within(0.5, 1.0)] = 0.5) -> None:
        self.theta = theta
        self.order = 2 if theta == 0.5 else 1

    def prepare(self, system: Any, dt: float) -> Stepper:
        """Return the stepper for one system and one step size [s]."""
        return _Steps(system, self.theta, dt)


class _Steps(Stepper):
    checkpoint_fields: ClassVar[tuple[str, ...]] = ("impulses", "shared")

    def __init__(self, system: Any, theta: float, dt: float) -> None:
        step = FreeBodyStep if system.robot.bases else MoreauJeanStep
        self._at = step(system, theta)
        self._dt = dt

    def restart(self) -> None:
        """Forget the impulses and the residuals of earlier steps."""
        self.impulses, self.shared = np.zeros_like(self.impulses), ()
        self._at.row_solver.forces = None
        self.reset_residuals()

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`."""
        h, t = clip(x.t, self._dt, end)
        return x if h <= 0.0 else self._at.step(x, u, h, t)

    @property
    def impulses(self) -> Array:
        """Impulses of contacts in the last step, with which the next one begins."""
        return self._at.row_solver.last

    @impulses.setter
    def impulses(self, impulses: Array) -> None:
        self._at.row_solver.last = impulses

    @property
    def shared(self) -> tuple[Any, ...]:
        """Rows of these impulses and their matrix, where the impulses have the least norm."""
        return self._at.row_solver.shared

    @shared.setter
    def shared(self, shared: tuple[Any, ...]) -> None:
        self._at.row_solver.shared = shared

    @property
    def residuals(self) -> Any:
        """Worst residuals of contacts; None without contacts."""
        return self._at.row_solver.worst

    @property
    def forces(self) -> Array | None:
        """Mean forces of unilateral and bounded rows in the last step; None without contacts."""
        return self._at.row_solver.forces

    def reset_residuals(self) -> None:
        """Set the worst residuals to 0."""
        self._at.row_solver.reset_residuals()
