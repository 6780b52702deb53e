"""Limits of a reference, and how a reference that would leave them is kept or refused."""

import numpy as np

from mbd_ros.core.control.contract import ControlledJoints, Reference
from mbd_ros.core.state import Array
from mbd_ros.errors import MbdError

_ROUNDING = 1.0e-9  # rad or m, and share of a speed limit


class TargetError(MbdError):
    """A reference that is refused: names the joint, its value and what is accepted."""


class ReferenceLimits:
    """Position and velocity limits of joints as references see them.

    Args:
        joints: The controlled joints.

    Attributes:
        fastest: Velocity limits [rad/s or m/s], shape (n,).
    """

    def __init__(self, joints: ControlledJoints) -> None:
        self._names = joints.names
        self._lower = np.array([joint.lower for joint in joints.joints])
        self._upper = np.array([joint.upper for joint in joints.joints])
        self._lowest, self._highest = self._lower, self._upper
        self.fastest = np.array([joint.max_velocity for joint in joints.joints])

    def begin(self, q: Array) -> None:
        """Begin at a measured position; beyond a limit it widens that limit."""
        self._lowest, self._highest = np.minimum(self._lower, q), np.maximum(self._upper, q)

    def nearest(self, q: Array) -> Array:
        """The nearest position within the limits, fresh."""
        return np.minimum(np.maximum(q, self._lower), self._upper)

    def kept(self, ref: Reference) -> Reference:
        """The reference, at rest at a limit that it would leave."""
        q = np.minimum(np.maximum(ref.q, self._lowest), self._highest)
        beyond = q != ref.q
        if not beyond.any():
            return ref
        return Reference(q, np.where(beyond, 0.0, ref.v), np.where(beyond, 0.0, ref.a))

    def check(self, times: Array, q: Array, v: Array) -> None:
        """Refuse motion beyond the limits.

        Args:
            times: [s], shape (k,).
            q: [rad or m], shape (k, n).
            v: [rad/s or m/s], shape (k, n).

        Raises:
            TargetError: Names joint, time, value and what is accepted.
        """
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise TargetError("reference refused: not finite")
        off = (q < self._lower - _ROUNDING) | (q > self._upper + _ROUNDING)
        if off.any():
            i, j = np.argwhere(off)[0]
            raise TargetError(
                f"reference refused: {self._names[j]} at {q[i, j]:.4g} at t = {times[i]:.4g} s; "
                f"accepted: {self._lower[j]:g} to {self._upper[j]:g}"
            )
        fast = np.abs(v) > self.fastest * (1.0 + _ROUNDING)
        if fast.any():
            i, j = np.argwhere(fast)[0]
            raise TargetError(
                f"reference refused: {self._names[j]} at {v[i, j]:.4g}/s at t = {times[i]:.4g} s; "
                f"accepted: up to {self.fastest[j]:g}/s"
            )
