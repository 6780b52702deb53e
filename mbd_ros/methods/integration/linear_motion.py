"""The motion around a state as a linear one, and the steps that keep it bounded."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.constraint_rows import RowBlock
from mbd_ros.core.state import Array, State
from mbd_ros.methods.integration.runge_kutta import Tableau
from mbd_ros.methods.integration.stepping import Integrator

_GROWTH = 1.0e-6  # of a step: what rounding adds, and methods that grow slowly
_SLACK = 1.0e-9  # relative
_HALVINGS = 12  # of the interval in which the longest step is


class LinearMotion:
    """The motion dq'' = stiffness dq + damping dq'; internal states stand beside velocities.

    Args:
        stiffness: [1/s^2], shape (n, n).
        damping: [1/s], shape (n, n).
    """

    def __init__(self, stiffness: Array, damping: Array) -> None:
        self.stiffness, self.damping = stiffness, damping

    @cached_property
    def eigenvalues(self) -> Array:
        """Complex rates of the motion [1/s], shape (2 n,); inf where it has none."""
        n = len(self.stiffness)
        first_order = np.block([[np.zeros((n, n)), np.eye(n)], [self.stiffness, self.damping]])
        if not np.isfinite(first_order).all():
            return np.full(2 * n, np.inf)
        eigenvalues: Array = np.linalg.eigvals(first_order)
        return eigenvalues

    @property
    def rate(self) -> float:
        """Largest absolute eigenvalue [1/s]."""
        return float(np.abs(self.eigenvalues).max(initial=0.0))

    def growth(self, dt: float) -> float:
        """Largest factor by which the motion itself grows in dt [s]; 1 where nothing grows."""
        return math.exp(min(dt * float(self.eigenvalues.real.max(initial=0.0)), 700.0))


def linear_motion(system: System, x: State) -> LinearMotion:
    """Return the motion around a state.

    Smoothed rows and drives count with their time constants, whether they act or not. A force that
    switches counts with its side at the state: across the surface a difference quotient is no
    rate.

    Args:
        x: Consistent state of its integrated coordinates.
    """
    full = system.expand(x)
    system.k.refresh(full.q, full.v, system.loads.reads)
    loads = system.loads.beside(system.k, full)
    smooth = system if loads is system.loads else system.with_loads(loads)
    linear = smooth.derivatives(x, inputs=False)
    blocks = [block for block in system.layout.yielding if _follows(block)]
    gains = [pair for block in blocks for pair in dict.fromkeys(zip(*block.gains, strict=True))]
    n = system.nv + system.internals.nz
    stiffness, damping = np.zeros((2, n + len(gains), n + len(gains)))
    stiffness[:n, :n], damping[:n, :n] = linear.of_velocities
    for i, (kp, kd) in enumerate(gains, n):
        stiffness[i, i], damping[i, i] = -kp, -kd
    return LinearMotion(stiffness, damping)


def _follows(block: RowBlock) -> bool:
    from mbd_ros.core.contact_modes.row_distances import Reach, reach_of

    return block.smoothed or reach_of(block) is Reach.DEMAND


def fastest_rate(system: System, x: State) -> float:
    """Largest absolute eigenvalue of the motion around a state [1/s]; as `linear_motion`.

    It bounds stiffness, oscillation and divergence at the state.
    """
    return linear_motion(system, x).rate


def longest_step(method: Integrator, motion: LinearMotion, dt: float) -> float:
    """Longest step that lets no mode grow which does not grow by itself [s]; inf if dt does.

    Args:
        motion: What it integrates.
        dt: Step in question [s].
    """
    if not method.is_explicit or motion.rate * dt <= method.stable * (1.0 + _SLACK):
        return math.inf
    short, long = method.stable / motion.rate, dt
    if not short > 0.0 or not _grows_not(method, motion, short):
        return short
    if _grows_not(method, motion, dt):
        return math.inf
    for _ in range(_HALVINGS):
        middle = math.sqrt(short * long)
        if _grows_not(method, motion, middle):
            short = middle
        else:
            long = middle
    return short


def _grows_not(method: Integrator, motion: LinearMotion, dt: float) -> bool:
    return method.growth(motion, dt) <= motion.growth(dt) * (1.0 + _GROWTH)


def is_bounded(method: Integrator, motion: LinearMotion, dt: float) -> bool:
    """Whether a step lets no mode grow which does not grow by itself; arguments as above."""
    if not method.is_explicit or _grows_not(method, motion, dt):
        return True
    return motion.rate * dt <= method.stable * (1.0 + _SLACK)


def spectral_radius(step: Array) -> float:
    """Return the largest absolute eigenvalue of the matrix of a step."""
    if not np.isfinite(step).all():
        return math.inf
    return float(np.abs(np.linalg.eigvals(step)).max(initial=0.0))


def runge_kutta_growth(tableau: Tableau, motion: LinearMotion, dt: float) -> float:
    """Return the largest |R(lambda dt)|, with the stability function R of a method.

    Source: Hairer, Wanner, Solving Ordinary Differential Equations II, 1996, IV.2.

    Args:
        motion: What it integrates.
        dt: Length of the step [s].
    """
    z, n = motion.eigenvalues * dt, tableau.stages
    rates = np.zeros((n, len(z)), dtype=np.complex128)
    for i, row in enumerate(tableau.a[:n]):
        rates[i] = z * (1.0 + row[:n].dot(rates))
    after = 1.0 + tableau.a[n][:n].dot(rates)
    return float(np.abs(after).max(initial=0.0))


class SpringMotion(LinearMotion):
    """Motion on springs, dampers and bristles; their deflections stand beside velocities.

        y'' = -K y - C y' - T' k z,   z' = T y'

    The motion is symmetric, and nothing in it grows by itself. All bristles together are springs
    of the stiffness T' k T, as z - T y stays what it is.

    Args:
        springs: The K [1/s^2], symmetric, shape (n, n).
        dampers: The C [1/s], symmetric, shape (n, n).
        tips: The T, shape (m, n).
        bends: The k of each bristle [N/m], shape (m,).

    Attributes:
        bristles: Their T' k T [1/s^2], shape (n, n).
    """

    def __init__(self, springs: Array, dampers: Array, tips: Array, bends: Array) -> None:
        r, n = len(springs), len(springs) + len(tips)
        stiffness, damping = np.zeros((2, n, n))
        stiffness[:r, :r], damping[:r, :r] = -springs, -dampers
        damping[:r, r:], damping[r:, :r] = -(tips.T * bends), tips
        super().__init__(stiffness, damping)
        self.springs, self.dampers, self.bristles = springs, dampers, (tips.T * bends).dot(tips)

    @cached_property
    def eigenvalues(self) -> Array:
        """Complex rates of the motion [1/s], those apart which are 0; inf where it has none."""
        stiffness = self.springs + self.bristles
        if not self.dampers.any() and np.isfinite(stiffness).all():
            squares = np.maximum(np.linalg.eigvalsh(stiffness), 0.0)
            rates: Array = np.emath.sqrt(-squares)
            return rates
        return LinearMotion(-stiffness, -self.dampers).eigenvalues

    def growth(self, dt: float) -> float:
        """Return the largest factor by which the motion itself grows in dt [s], which is 1."""
        return 1.0
