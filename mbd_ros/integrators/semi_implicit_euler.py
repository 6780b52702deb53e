"""The semi-implicit Euler method."""

import math
from typing import Any, ClassVar

import numpy as np

from mbd_ros.core.integration.linear_motion import LinearMotion, spectral_radius
from mbd_ros.core.integration.step_length import clip
from mbd_ros.core.integration.stepping import Integrator, Stepper
from mbd_ros.core.state import Array, State


class SemiImplicitEuler(Integrator):
    """Velocity first, then the configuration with the new velocity.

        v+ = v + dt a(t, q, v, u),   q+ = q (+) dt v+

    It is symplectic where M is constant and forces do not depend on v: the energy error stays
    bounded.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, I.1.2 and VI.3.
    """

    order: ClassVar[int] = 1
    stable = 0.8  # critical damping; 2 without damping
    example: ClassVar[dict[str, Any]] = {}

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Factor by which a step multiplies a linear motion at most."""
        unit = np.eye(len(motion.stiffness))
        velocity = np.hstack([dt * motion.stiffness, unit + dt * motion.damping])
        position = np.hstack([unit, 0.0 * unit]) + dt * velocity
        return spectral_radius(np.vstack([position, velocity]))

    def prepare(self, system: Any, dt: float) -> "SemiImplicitEulerStepper":
        """The stepper for one system and one step size [s]."""
        return SemiImplicitEulerStepper(system, dt)


class SemiImplicitEulerStepper(Stepper):
    """Steps of the semi-implicit Euler method.

    Args:
        system: The system.
        dt: Length of a step [s].
    """

    def __init__(self, system: Any, dt: float) -> None:
        self._chart, self._accelerate, self._dt = system.chart, system.accelerator(), dt
        self._a = np.zeros(int(system.nv))

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`."""
        h, t = clip(x.t, self._dt, end)
        if h <= 0.0:
            return x
        self._accelerate(x.t, x.q, x.v, u, self._a)
        v = x.v + h * self._a
        return State(t, self._chart.integrate(x.q, h * v), v)
