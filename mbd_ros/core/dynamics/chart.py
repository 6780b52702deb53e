"""The chart of a configuration space: q1 = q0 (+) dq, dq = q1 (-) q0.

Configurations add up where the space is flat; free bodies move along screws, in exponential
coordinates.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array, State

_BASE_V = 6  # velocities of a free body
_SMALL_TURN = 1.0e-4  # rad^2; far below it Pinocchio's Jlog6 loses up to 5e-9, the series nothing
_BERNOULLI = (1 / 2, 1 / 12, 0.0, -1 / 720, 0.0, 1 / 30240, 0.0, -1 / 1209600)


class Chart:
    """The map q (+) dq for the configurations of a model.

    Free bodies move along screws of their own frame, [m, rad]; all other coordinates add up.

    Args:
        model: Pinocchio model whose joints have these coordinates.

    Attributes:
        nq: Size of a configuration.
        nv: Size of a step and of a velocity.
        is_flat: Whether configurations are a vector space with q' = v.
        sizes: Errors of steps and velocities that count as one [m, rad, m/s, rad/s].
    """

    sizes: float | Array = 1.0

    def __init__(self, model: Any) -> None:
        self.model = model
        self.nq = int(model.nq)
        self.nv = int(model.nv)
        self.is_flat = self.nq == self.nv
        bases = [int(j.idx_v) for j in model.joints if j.nv == _BASE_V]
        self.bases = tuple(slice(v, v + _BASE_V) for v in bases)

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return the configuration q (+) dq, shape (nq,)."""
        return q + dq if self.is_flat else pin.integrate(self.model, q, dq)

    def difference(self, q0: Array, q1: Array) -> Array:
        """Return the dq with q0 (+) dq = q1, shape (nv,)."""
        return q1 - q0 if self.is_flat else pin.difference(self.model, q0, q1)

    def plus(self, x: State, d: Array) -> State:
        """Return the state x (+) d, at the time and in the mode of x.

        Args:
            d: Step of q, v and z, shape (2 nv + nz,).
        """
        n = self.nv
        return x._replace(q=self.integrate(x.q, d[:n]), v=x.v + d[n : 2 * n], z=x.z + d[2 * n :])

    def minus(self, x1: State, x0: State) -> Array:
        """Return d with x0 (+) d = x1 but for time and mode, shape (2 nv + nz,)."""
        return np.concatenate((self.difference(x0.q, x1.q), x1.v - x0.v, x1.z - x0.z))

    def rate(self, dq: Array, v: Array) -> Array:
        """Return the rate of dq in q = q0 (+) dq while q moves with v, shape (nv,).

        Args:
            dq: Tangent step [m, rad], shape (nv,).
            v: Velocity, that of a free body in its own frame [m/s, rad/s], shape (nv,).

        Source: Iserles et al., Lie-group methods, Acta Numerica 9, 2000, sec. 2.6: the inverse of
        the right Jacobian of SE(3), sum B_k / k! ad^k with the signs of the Bernoulli numbers of a
        right Jacobian.
        """
        if self.is_flat:
            return v
        rate = v.copy()
        for base in self.bases:
            rate[base] = _rate_on_screws(dq[base], v[base])
        return rate


def chart_of(model: Any, velocities: Iterable[int]) -> Chart:
    """Return the chart of some coordinates of a model, whole joints, in the order of the model.

    Args:
        velocities: Where these coordinates stand in v, ascending.
    """
    chosen, single_joint = {int(v) for v in velocities}, pin.Model()
    for joint, name in zip(model.joints, model.names, strict=True):
        if joint.nv and joint.idx_v in chosen:
            is_free = joint.nv == _BASE_V
            kind = pin.JointModelFreeFlyer() if is_free else pin.JointModelPX()
            single_joint.addJoint(0, kind, pin.SE3.Identity(), name)
    return Chart(single_joint)


def _rate_on_screws(dq: Array, v: Array) -> Array:
    if dq[3:].dot(dq[3:]) > _SMALL_TURN:
        turned: Array = pin.Jlog6(pin.exp6(dq)).dot(v)
        return turned
    rate, bent, ad = v.copy(), v, pin.Motion(dq).action
    for weight in _BERNOULLI:
        bent = ad.dot(bent)
        rate += weight * bent
    return rate
