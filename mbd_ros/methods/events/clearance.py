"""How far a motion is from all stops and contacts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.rows.constraint import Constraint, Kind
from mbd_ros.core.rows.constraint_rows import RowBlock
from mbd_ros.core.rows.gap_speed_bound import GapSpeed, bodies_of
from mbd_ros.core.state import Array, State

_AHEAD = 4.0  # paths of the last step that several steps at once stay away from a search


class Clearance:
    """The room that joints have before they may be at a stop or in a contact.

    The gap of a stop changes by no more than its joint moves, that of a contact by no more than
    `GapSpeed` says. So no step meets one whose path is shorter than the smallest gap at one of its
    ends:

        path = h (|v0| + |v1|)

    twice the mean of the speeds at both ends, for those in between. Lengths and angles are added
    as they are: that makes the path longer.

    Args:
        dt: Length of a full step [s].

    Attributes:
        serves: Whether stops of joints and contacts of known bodies are all that may happen.
        is_whole: Whether every joint is integrated.
        room: How far all joints together may move before the next look [rad or m]; 0 where every
            step must be searched.
    """

    def __init__(self, system: System, dt: float) -> None:
        blocks = system.layout.event_rows
        stops = [stop for block in blocks for stop in block.part.stops]
        touching = [block for block in blocks if block.law.kind is Kind.CONE]
        self._contacts = _contact_room(system, touching)
        is_known = self._contacts is None or self._contacts.is_known
        others = (block for block in blocks if block.law.kind is not Kind.CONE)
        self.serves = bool(blocks) and is_known and all(block.part.stops for block in others)
        self.is_whole = system.nv == system.model.nv
        self._expand, self._dt = system.expand, dt
        self._q = np.array([stop.joint.q for stop in stops], dtype=np.intp)
        self._lower = np.array([stop.lower for stop in stops])
        self._upper = np.array([stop.upper for stop in stops])
        self.room, self._speed = 0.0, 0.0

    @property
    def known(self) -> tuple[float, float]:
        """Room, and speed of all joints together, on which the next steps depend."""
        return self.room, self._speed

    @known.setter
    def known(self, known: tuple[float, float]) -> None:
        self.room, self._speed = known

    def measure(self, y: State) -> None:
        """Find the room at a state."""
        v = y.v if self.is_whole else self._expand(y).v
        self.room, self._speed = 0.5 * self._gap(y), math.sqrt(v.dot(v))

    def passes(self, y: State, after: State) -> bool:
        """Whether a step meets no stop; it needs a search otherwise."""
        v = after[2] if self.is_whole else self._expand(after).v
        speed = math.sqrt(v.dot(v))
        path = (after[0] - y[0]) * (self._speed + speed)
        self.room, self._speed = self.room - path, speed
        return self.room > 0.0 or self._is_clear(after, path)

    def comes_near(self, v: Array) -> bool:
        """Account for one of several full steps; whether the next ones must be taken singly.

        Args:
            v: Velocity after it, of all joints.
        """
        speed = math.sqrt(v.dot(v))
        path = self._dt * (self._speed + speed)
        self.room, self._speed = self.room - path, speed
        return self.room <= _AHEAD * path

    def moved(self, y0: State, y1: State) -> None:
        """Account for a correction of a state."""
        if self.room > 0.0:
            way = float(np.linalg.norm(self._expand(y1).q - self._expand(y0).q))
            self.room -= way if self._contacts is None else 2.0 * way  # of half angles

    def is_clear(self, y: State) -> bool:
        """Whether the last of several full steps met no stop."""
        return self.room > 0.0 or self._is_clear(y, 2.0 * self._dt * self._speed)

    def _is_clear(self, y: State, path: float) -> bool:
        gap = self._gap(y)
        self.room = 0.5 * gap if gap > path else 0.0
        return self.room > 0.0

    def _gap(self, y: State) -> float:
        """Return the smallest gap, as a way of all joints together [rad or m]."""
        x, gap = self._expand(y), math.inf
        if len(self._q):
            q: Array = x.q[self._q]
            gap = float(min((q - self._lower).min(), (self._upper - q).min()))
        return gap if self._contacts is None else min(gap, self._contacts.shortest(x))


def _contact_room(system: System, blocks: list[RowBlock]) -> ContactRoom | None:
    if not blocks:
        return None

    return ContactRoom(system, [block.part for block in blocks])


class ContactRoom:
    """The room of the contacts of a system; has a `Data` of its own.

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
        """Return a way of all joints together on which no gap closes, at a state of all joints."""
        k = self._k
        k.refresh(x.q, x.v, Reads.POSITION)
        gaps = np.array([part.residual(k, x)[::3].min() for part in self._parts])
        self._speed.measure(self._data)
        return self._speed.shortest(gaps)
