"""A contact that is held closed: it neither opens nor slips."""

from typing import Any

import numpy as np

from mbd_ros.core.contracts import Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.delassus import configurations
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ROUNDED_ROW
from mbd_ros.errors import ModelError


class HeldContact(Constraint):
    """Rows of a rigid contact as bilateral ones: gap = 0, and no slip.

    A round body that is held rolls. Tangents along which no joint moves are left out.

    Args:
        contact: The contact, a constraint with the law `cone`.

    Attributes:
        name: That of the contact, whose multipliers these are.

    Raises:
        ModelError: No joint moves the bodies against each other.
    """

    reads = Reads.DRIFT

    def __init__(self, robot: Robot, contact: Any) -> None:
        self.contact = contact
        self.name = contact.name
        self.reads = contact.reads
        kept = self._kept = np.flatnonzero(_moved(robot, contact))
        if not len(kept):
            raise ModelError(f"contact {contact.name} cannot be held: no joint moves it")
        self.rows = tuple(contact.rows[i] for i in kept)

    def residual(self, k: Kinematics, x: State) -> Array:
        """Gaps [m], and zeros along tangents, shape (m,)."""
        return np.asarray(self.contact.residual(k, x)[self._kept])

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Rows of the contact frames, shape (m, nv)."""
        return np.asarray(self.contact.jacobian(k, x)[self._kept])

    def drift(self, k: Kinematics, x: State) -> Array:
        """J' v, shape (m,)."""
        return np.asarray(self.contact.drift(k, x)[self._kept])

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`, for the places of one."""
        J, drift = self.contact.accelerations(k, x)
        return J[self._kept], drift[self._kept]

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Those of the contact."""
        whole = k.zeros(len(self.contact.rows))
        whole[self._kept] = lam
        found: tuple[Wrench, ...] = self.contact.wrenches(k, x, whole)
        return found


def _moved(robot: Robot, contact: Any) -> Array:
    """Largest entry of each row over configurations, 0 where it is rounding, shape (m,)."""
    k, still = Kinematics(robot), np.zeros(robot.model.nv)
    largest = np.zeros(len(contact.rows))
    for q in configurations(robot):
        k.refresh(q, still, Reads.JACOBIAN)
        rows = np.abs(contact.jacobian(k, State(0.0, q, still)))
        largest = np.maximum(largest, rows.max(axis=1, initial=0.0))
    return np.where(largest > ROUNDED_ROW, largest, 0.0)
