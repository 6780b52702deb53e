"""The sliding variable, and the effect of a wrong model on it."""

from typing import NamedTuple

from mbd_ros.core.control.contract import Reference, Response
from mbd_ros.core.control.mobility_factor import MobilityFactor
from mbd_ros.core.state import Array


def sliding_variable(r: Response, ref: Reference, bandwidth: Array) -> tuple[Array, Array]:
    """The sliding variable and the accelerations that keep it constant.

        s = e' + lambda e,   s' = a - a_keep,   a_keep = a_ref - lambda e',   e = q - q_ref

    With |s| <= w the error settles within |e| <= w / lambda and |e'| <= 2 w.

    Args:
        r: The joints.
        ref: Where they should be.
        bandwidth: lambda [1/s], > 0, shape (n,).

    Returns:
        s [rad/s or m/s] and a_keep [rad/s^2 or m/s^2], shapes (n,).

    Source: J.-J. E. Slotine, W. Li, Applied Nonlinear Control, 1991, sec. 7.1.
    """
    rate = r.v - ref.v
    return rate + bandwidth * (r.q - ref.q), ref.a - bandwidth * rate


class Mismatch(NamedTuple):
    """The motion s' = -rho(s) under a wrong model and a disturbance.

        s' = disturbance - effectiveness rho(s)

    Attributes:
        disturbance: [rad/s^2 or m/s^2], shape (n,).
        effectiveness: The identity for the true model, shape (n, n).
    """

    disturbance: Array
    effectiveness: Array


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
