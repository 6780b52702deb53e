"""How far joints may move before a contact can touch."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.gap_speed_bound import GapSpeed, bodies_of
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.state import State


class ContactRoom:
    """The room of the contacts of a system; has a `Data` of its own.

    Args:
        system: The system.
        parts: Its contacts.

    Attributes:
        is_known: Whether it is known how fast all gaps change at most.
    """

    def __init__(self, system: System, parts: Sequence[Constraint]) -> None:
        bodies = [bodies_of(part) for part in parts]
        self.is_known = None not in bodies
        self._parts, self._data = parts, pin.Data(system.model)
        self._k = Kinematics(system.robot, self._data)
        self._speed = GapSpeed(system.robot, bodies)

    def shortest(self, x: State) -> float:
        """A way of all joints together on which no gap closes, at a state of all joints."""
        k = self._k
        k.refresh(x.q, x.v, Reads.POSITION)
        gaps = np.array([part.residual(k, x)[::3].min() for part in self._parts])
        self._speed.measure(self._data)
        return self._speed.shortest(gaps)
