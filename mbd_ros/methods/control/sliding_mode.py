"""Sliding mode control: the sliding variable, reaching laws, super-twisting."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np

from mbd_ros.core.ranges import Gain
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.methods.control.contract import Reference, Response, per_joint
from mbd_ros.methods.control.efforts import MobilityFactor

ReachingName = Literal["constant", "exponential", "power_rate"]
LAWS: tuple[ReachingName, ...] = get_args(ReachingName)
_SAMPLED = 1.3  # for masses wrong by 30 %
_NO_LAYER = 1.0e-300  # a layer without effect: s / _NO_LAYER neither overflows nor divides zeros


def sliding_variable(r: Response, ref: Reference, bandwidth: Array) -> tuple[Array, Array]:
    """The sliding variable and the accelerations that keep it constant.

        s = e' + lambda e,   s' = a - a_keep,   a_keep = a_ref - lambda e',   e = q - q_ref

    With |s| <= w the error settles within |e| <= w / lambda and |e'| <= 2 w.

    Args:
        ref: Where they should be.
        bandwidth: lambda [1/s], > 0, shape (n,).

    Returns:
        s [rad/s or m/s] and a_keep [rad/s^2 or m/s^2], shapes (n,).

    Source: J.-J. E. Slotine, W. Li, Applied Nonlinear Control, 1991, sec. 7.1.
    """
    rate = r.v - ref.v
    return rate + bandwidth * (r.q - ref.q), ref.a - bandwidth * rate


class ReachingLaw:
    """The rho of s' = -rho(s), each joint for itself.

        constant     rho = k sgn s
        exponential  rho = k sgn s + c s
        power_rate   rho = k |s|^p sgn s,  0 < p < 1

    Within a boundary layer |s| < phi the straight line from 0 to rho(phi) takes their place, so
    that rho is continuous; phi = 0 leaves it as it is. In a loop of period h, phi >= k h keeps
    the constant law from overshooting; phi = k h makes its explicit steps those of the implicit
    Euler method for the discontinuous law, which ends in s = 0 without chatter.

    Args:
        n: Number of joints.
        law: One of `LAWS`.
        gain: k [rad/s^2 or m/s^2; power_rate: per (rad/s)^p], > 0, one or one a joint.
        rate: c [1/s], > 0, one or one a joint; read by exponential only.
        power: p; read by power_rate only.
        boundary_layer: phi [rad/s or m/s], >= 0, one or one a joint.

    Raises:
        ModelError: Names the gain, and what is accepted.

    Source: W. Gao, J. C. Hung, IEEE Trans. Ind. Electron. 40, 1993, 45-55 (the laws); J.-J. E.
        Slotine, S. S. Sastry, Int. J. Control 38, 1983, 465-492 (boundary layer); V. Acary,
        B. Brogliato, Syst. Control Lett. 59, 2010, 284-293 (implicit Euler method).
    """

    def __init__(
        self, n: int, law: ReachingName, gain: Gain, rate: Gain, power: float, boundary_layer: Gain
    ) -> None:
        if law not in LAWS:
            raise ModelError(f"law '{law}', accepted: {', '.join(LAWS)}")
        if not 0.0 < power < 1.0:
            raise ModelError(f"power {power:g} must be > 0 and < 1")
        self._gain = per_joint(gain, n, "gain")
        layer = per_joint(boundary_layer, n, "boundary_layer", least=0.0)
        self._layer = np.maximum(layer, _NO_LAYER)
        self._is_exponential = law == "exponential"
        self._rate = per_joint(rate, n, "rate") if self._is_exponential else np.zeros(n)
        self._power = power if law == "power_rate" else 0.0

    def __call__(self, s: Array) -> Array:
        """Value rho(s) [rad/s^2 or m/s^2], shape (n,)."""
        size = np.maximum(np.abs(s), self._layer)
        rho = self._gain * (s / size)
        if self._power:
            rho *= size**self._power
        elif self._is_exponential:
            rho += self._rate * s
        return rho

    def layer(self, period: float) -> Array:
        """Boundary layer [rad/s or m/s], shape (n,); without one what a period makes of it.

        A step of the reaching law leads there: s = 1.3 h k s^p.
        """
        sampled = (_SAMPLED * period * self._gain) ** (1.0 / (1.0 - self._power))
        return np.where(self._layer > _NO_LAYER, self._layer, sampled)

    def slope(self, period: float) -> Array:
        """Return the slope of rho within the boundary layer [1/s], shape (n,)."""
        layer = self.layer(period)
        return self._gain * layer ** (self._power - 1.0) + self._rate

    def width(self, disturbance: Array | float, effectiveness: Array | float = 1.0) -> Array:
        """Where |s| settles under s' = d - g rho(s): rho(width) = disturbance / effectiveness.

        Args:
            disturbance: Bound of |d| [rad/s^2 or m/s^2].
            effectiveness: Least g, > 0.

        Returns:
            [rad/s or m/s], shape (n,); inf where the law cannot withstand the disturbance.
        """
        demand = np.broadcast_to(np.divide(disturbance, effectiveness), self._gain.shape)
        edge = self._gain * self._layer**self._power + self._rate * self._layer
        inside: Array = self._layer * demand / edge
        with np.errstate(divide="ignore"):
            if self._power:
                outside = (demand / self._gain) ** (1.0 / self._power)
            elif self._is_exponential:
                outside = (demand - self._gain) / self._rate
            else:
                outside = np.full_like(demand, np.inf)
        return np.where(demand <= edge, inside, outside)


def super_twisting(s: Array, k1: Array | float, k2: Array | float) -> tuple[Array, Array]:
    """Continuous push and rate of the integral that drive s and s' to zero in finite time.

        s' = push + w + d,   push = -k1 |s|^(1/2) sgn s,   w' = rate = -k2 sgn s

    Args:
        s: Sliding variable [rad/s or m/s], any shape.
        k1: [(rad/s)^(1/2) / s], > 0.
        k2: [rad/s^3 or m/s^3], > 0.

    Returns:
        push [rad/s^2 or m/s^2] and rate [rad/s^3 or m/s^3], as s.

    Source: A. Levant, Int. J. Control 58, 1993, 1247-1263.
    """
    sign = np.sign(s)
    return -k1 * (np.sqrt(np.abs(s)) * sign), -k2 * sign


def reaching_time_bound(
    k1: Array | float,
    k2: Array | float,
    x1: Array | float,
    x2: Array | float,
    disturbance_rate: Array | float = 0.0,
) -> Array:
    """A time within which x1 and x2 become zero for good under any disturbance.

        x1' = -k1 |x1|^(1/2) sgn x1 + x2,   x2' = -k2 sgn x1 + r,   |r| <= L

    For zeta = (|x1|^(1/2) sgn x1, x2) and V = zeta' P zeta,

        P = 1/2 [[4 k2 + k1^2, -k1], [-k1, 2]]
        V' <= -zeta' Q(r) zeta / |x1|^(1/2),
        Q(r) = k1/2 [[2 k2 + k1^2 + 2 r, -k1 - 2 r/k1], [-k1 - 2 r/k1, 1]]

    Q is linear in r, so the least of its eigenvalues over |r| <= L is reached at one end, and

        T <= 2 V0^(1/2) / gamma,   gamma = l_min(P)^(1/2) l_min(Q) / l_max(P)

    A finite time needs k2 > L + 2 L^2 / k1^2.

    Args:
        k1: > 0 [(rad/s)^(1/2) / s].
        k2: > 0 [rad/s^3].
        x1: At the start [rad/s].
        x2: At the start, integral and disturbance together [rad/s^2].
        disturbance_rate: L [rad/s^3], >= 0.

    Returns:
        [s], shape of the arguments broadcast; inf where this V proves nothing.

    Source: J. A. Moreno, M. Osorio, IEEE Trans. Autom. Control 57, 2012, 1035-1040 (P, Q at r = 0
        and gamma); Q(r) follows from r = +-|r| sgn x1 in their V'.
    """
    k1, k2, x1, x2, limit = np.broadcast_arrays(*np.atleast_1d(k1, k2, x1, x2, disturbance_rate))
    least_p, largest_p = _eigenvalues(0.5 * (4.0 * k2 + k1**2), -0.5 * k1, np.ones_like(k1))
    least_q = np.full(k1.shape, np.inf)
    for r in (limit, -limit):
        corner = 0.5 * k1 * (2.0 * k2 + k1**2 + 2.0 * r)
        least_q = np.minimum(least_q, _eigenvalues(corner, -0.5 * k1**2 - r, 0.5 * k1)[0])
    zeta = np.sqrt(np.abs(x1)) * np.sign(x1)
    V = 0.5 * (4.0 * k2 + k1**2) * zeta**2 - k1 * zeta * x2 + x2**2
    with np.errstate(divide="ignore"):
        time = 2.0 * np.sqrt(V) * largest_p / (np.sqrt(least_p) * np.maximum(least_q, 0.0))
    return np.where(V == 0.0, 0.0, time)


def _eigenvalues(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Both of [[a, b], [b, c]], the smaller one without cancellation."""
    middle = 0.5 * (a + c)
    largest = middle + np.hypot(0.5 * (a - c), b)
    return (a * c - b * b) / largest, largest


def mismatch(truth: Response, model: Response, a_keep: Array, added: Array) -> Mismatch:
    """How a control with the equivalent effort of a model acts on the true joints.

    With tau = A_m^-1 (a_keep - a_free_m - rho) and a = a_free + A (tau + added),

        effectiveness = A A_m^-1
        disturbance = effectiveness (a_keep - a_free_m) + a_free + A added - a_keep

    Args:
        truth: Response of the true joints.
        model: Response in the controller's model, with a regular mobility.
        a_keep: Accelerations that keep s, see `sliding_variable`, shape (n,).
        added: Efforts that the controller does not know of [N·m or N], shape (n,).

    Source: V. Utkin, J. Guldner, J. Shi, Sliding Mode Control in Electro-Mechanical Systems,
        2nd ed., 2009, sec. 2.3 (equivalent control).
    """
    effectiveness = MobilityFactor(model.mobility).solve(truth.mobility).T  # both symmetric
    reached = effectiveness.dot(a_keep - model.a_free) + truth.a_free
    return Mismatch(reached + truth.mobility.dot(added) - a_keep, effectiveness)


class Mismatch(NamedTuple):
    """The motion s' = -rho(s) under a wrong model and a disturbance.

        s' = disturbance - effectiveness rho(s)

    Attributes:
        disturbance: [rad/s^2 or m/s^2], shape (n,).
        effectiveness: The identity for the true model, shape (n, n).
    """

    disturbance: Array
    effectiveness: Array
