"""The super-twisting algorithm and an upper bound of its time."""

import numpy as np

from mbd_ros.core.state import Array


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
