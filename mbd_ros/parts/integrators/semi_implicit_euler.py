"""The semi-implicit Euler method."""

import math
from typing import Any, ClassVar, Literal

import numpy as np

from mbd_ros.core.dynamics.linearization import Linearization
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError
from mbd_ros.methods.integration.linear_motion import LinearMotion, SpringMotion, spectral_radius
from mbd_ros.methods.integration.stepping import Integrator, Stepper, clip

_ROUNDED = 1.0e-12  # Of the largest eigenvalue.


class SemiImplicitEuler(Integrator):
    """Velocity first, then the configuration with the new velocity.

        v+ = v + dt a(t, q, v, u),   q+ = q (+) dt v+

    It is symplectic where M is constant and forces do not depend on v: the energy error stays
    bounded. A spring and a damper with a = k dt^2/m and b = c dt/m are stable for a + 2 b < 4.
    Implicit damping takes dampers at the new velocity, to first order: (1 - dt a_v)(v+ - v) = dt a
    with the slopes a_v = da/dv by nv differences. It is stable for a < 4 + 2 b.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, I.1.2 and VI.3.

    Args:
        damping: `explicit`, or `implicit` where dampers are stiff, at nv more evaluations a step.
    """

    order: ClassVar[int] = 1
    native = "semi_implicit_euler"
    stable = 0.8  # critical damping; 2 without damping
    example: ClassVar[dict[str, Any]] = {"damping": "implicit"}

    def __init__(self, *, damping: Literal["explicit", "implicit"] = "explicit") -> None:
        self.damping = damping
        if damping == "implicit":
            self.native = ""
            self.stable = 2.0  # without damping; more with any

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Factor by which a step multiplies a linear motion at most; inf for any beyond 1."""
        if isinstance(motion, SpringMotion):
            return self._growth_on_springs(motion, dt)
        unit = np.eye(len(motion.stiffness))
        velocity = np.hstack([dt * motion.stiffness, unit + dt * motion.damping])
        if self.damping == "implicit":
            velocity[:, len(unit) :] = unit
            velocity = np.linalg.solve(unit - dt * motion.damping, velocity)
        position = np.hstack([unit, 0.0 * unit]) + dt * velocity
        return spectral_radius(np.vstack([position, velocity]))

    def _growth_on_springs(self, motion: SpringMotion, dt: float) -> float:
        """Return the same without eigenvalues of an unsymmetric matrix, where that tells.

        With A = K dt^2, B = C dt and T = dt^2 times the stiffness of bristles, which lag one step
        behind velocities, a power z of a step solves, implicitly damped and explicitly,

            x'((1 + B + T) z^2 + (A - B - 2) z + 1) x = 0
            x'(z^2 + (A + B - 2) z + 1 - B + T) x = 0.

        At z = -1 these matrices are positive definite or some z is below -1; where they are, and B
        is no less than T in the latter, all z of all x are in the unit circle.
        """
        A, B, T = dt * dt * motion.springs, dt * motion.dampers, dt * dt * motion.bristles
        unit = np.eye(len(A))
        is_implicit = self.damping == "implicit"
        left = 4.0 * unit - A + (2.0 * B + T if is_implicit else T - 2.0 * B)
        if not _is_positive(left):
            return math.inf
        if is_implicit or not T.any() or _is_positive(B - T):
            return 1.0
        velocity = np.hstack([-(A + T), unit - B + T])  # times dt
        return spectral_radius(np.vstack([np.hstack([unit, 0.0 * unit]) + velocity, velocity]))

    def prepare(self, system: Any, dt: float) -> "SemiImplicitEulerStepper":
        """Return the stepper for one system and one step size [s]."""
        if self.damping == "implicit":
            return ImplicitDampingStepper(system, dt)
        return SemiImplicitEulerStepper(system, dt)


def _is_positive(matrix: Array) -> bool:
    """Whether no eigenvalue is below 0, but for rounding."""
    if not np.isfinite(matrix).all():
        return False
    sizes = np.linalg.eigvalsh(matrix)
    return bool((sizes >= -_ROUNDED * np.abs(sizes).max(initial=0.0)).all())


class SemiImplicitEulerStepper(Stepper):
    """Steps of the semi-implicit Euler method.

    Args:
        dt: Length of a step [s].
    """

    def __init__(self, system: Any, dt: float) -> None:
        self._chart = system.chart
        self._accelerate = system.accelerator()
        self._dt = dt
        self._a = np.zeros(int(system.nv))

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`."""
        h, t = clip(x.t, self._dt, end)
        if h <= 0.0:
            return x
        self._accelerate(x.t, x.q, x.v, u, self._a)
        v = x.v + h * self._a
        return State(t, self._chart.integrate(x.q, h * v), v)


class ImplicitDampingStepper(SemiImplicitEulerStepper):
    """Semi-implicit Euler steps with dampers at the new velocity.

    Args:
        dt: Length of a step [s].
    """

    def __init__(self, system: Any, dt: float) -> None:
        super().__init__(system, dt)
        self._linearization = Linearization(system)
        self._unit = np.eye(system.nv)

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`.

        Raises:
            DivergedError: Accelerations are not finite, or grow too steeply with velocities.
        """
        h, t = clip(x.t, self._dt, end)
        if h <= 0.0:
            return x
        a, slope = self._linearization.by_velocity(self._accelerate, x.t, x.q, x.v, u)
        if not np.isfinite(slope).all():
            raise DivergedError(f"accelerations at t = {x.t:.9g} s are not finite")
        try:
            v = x.v + np.linalg.solve(self._unit - h * slope, h * a)
        except np.linalg.LinAlgError as error:
            raise DivergedError(
                f"velocities after t = {x.t:.9g} s: forces grow with them so steeply that a step "
                f"of {h:.3g} s has no end; a shorter dt has one"
            ) from error
        return State(t, self._chart.integrate(x.q, h * v), v)
