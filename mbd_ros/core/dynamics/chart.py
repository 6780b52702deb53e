"""Exponential coordinates around a configuration of a robot with a floating base."""

import pinocchio as pin

from mbd_ros.core.state import Array

_BASE = slice(0, 6)
_SMALL_TURN = 1.0e-4  # rad^2; far below it Pinocchio's Jlog6 loses up to 5e-9, the series nothing
_BERNOULLI = (1 / 2, 1 / 12, 0.0, -1 / 720, 0.0, 1 / 30240, 0.0, -1 / 1209600)


def chart_rate(dq: Array, v: Array) -> Array:
    """Rate of dq in q = q0 (+) dq while q moves with v, a free base in the first six coordinates.

    Args:
        dq: Tangent step [m, rad], shape (nv,).
        v: Velocity, that of the base in its own frame [m/s, rad/s], shape (nv,).

    Source: Iserles et al., Lie-group methods, Acta Numerica 9, 2000, sec. 2.6: the inverse of the
    right Jacobian of SE(3), sum B_k / k! ad^k with the signs of the Bernoulli numbers of a right
    Jacobian.
    """
    rate, base = v.copy(), dq[_BASE]
    if base[3:].dot(base[3:]) > _SMALL_TURN:
        rate[_BASE] = pin.Jlog6(pin.exp6(base)).dot(v[_BASE])
        return rate
    bent, ad = v[_BASE], pin.Motion(base).action
    for weight in _BERNOULLI:
        bent = ad.dot(bent)
        rate[_BASE] += weight * bent
    return rate
