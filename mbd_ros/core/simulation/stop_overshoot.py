"""How far joints went beyond the ends that stops keep."""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.memory import Memory, copied, recognised
from mbd_ros.core.model.joints import Joint
from mbd_ros.core.state import Array

_SAID = 1.0e-4  # rad or m; what steps that resolve an impact leave is far below
_KEPT = ("_first", "_worst", "_limit", "_speed", "_when", "_seen")


class Overshoot(NamedTuple):
    """A joint beyond a stop.

    Attributes:
        joint: The joint.
        end: The end that it passed [rad or m].
        size: How far it went [rad or m].
        t: When it was there [s].
        speed: Its largest speed at the start of the steps that took it there [rad/s or m/s].
    """

    joint: Joint
    end: float
    size: float
    t: float
    speed: float

    def __str__(self) -> str:
        unit = "m" if self.joint.kind == "prismatic" else "rad"
        return (
            f"{self.joint.name} passes its stop at {self.end:g} {unit} by {self.size:.3g} {unit}, "
            f"at t = {self.t:.6g} s, coming with up to {self.speed:.3g} {unit}/s"
        )


class Overshoots:
    """The largest overshoot at every end of every stop of a system.

    A stop that acts before its end is reached is not passed. A stop that a step jumps over is.
    Steps in which no bounded row acts cost nothing.

    Args:
        system: The system, with smoothed stops.
    """

    def __init__(self, system: Any) -> None:
        self._system = system
        stops = [stop for block in system.layout.smoothed for stop in block.part.stops]
        self._joints = [stop.joint for stop in stops] * 2
        self._q = np.array([joint.q for joint in self._joints], dtype=np.intp)
        self._v = np.array([joint.v for joint in self._joints], dtype=np.intp)
        self._signs = np.repeat([-1.0, 1.0], len(stops))
        ends = [stop.lower for stop in stops] + [stop.upper for stop in stops]
        self._ends = self._signs * ends
        self._speed, self._when = np.zeros((2, len(ends)))
        self._first = self._worst = np.zeros(len(ends))
        self._limit, self._seen = self._ends + self._worst, None

    def begin(self, y: Any) -> None:
        """Forget all; ends that the first state is beyond do not count."""
        self._first = np.maximum(self._outwards(y) - self._ends, 0.0)
        self._speed, self._when = np.zeros((2, len(self._ends)))
        self._worst, self._limit, self._seen = self._first, self._ends + self._first, y

    def memory(self) -> Memory:
        """What was seen so far, as a value of its own."""
        return {name: copied(getattr(self, name)) for name in _KEPT}

    def recall(self, memory: Memory, y: Any) -> None:
        """Go on from a memory; y is the state from which the next step starts."""
        for name, value in memory.items():
            setattr(self, name, recognised(copied(value), y))

    def look(self, y: Any, y_next: Any) -> None:
        """Look at a step, from one state of the integrated coordinates to the next."""
        if not self._system.bounded.acts:
            return
        if y is not self._seen:  # a stop may act only in the step after that which passed it
            self._compare(y, y)
        self._compare(y_next, y)
        self._seen = y_next

    def found(self) -> list[Overshoot]:
        """Those that are large enough to report: lower ends, then upper ones, as the stops."""
        return [
            Overshoot(
                self._joints[i],
                float(self._signs[i] * self._ends[i]),
                float(self._worst[i]),
                float(self._when[i]),
                float(self._speed[i]),
            )
            for i in np.flatnonzero(self._worst - self._first > _SAID).tolist()
        ]

    def _outwards(self, y: Any) -> Array:
        """Positions of the joints in the direction of every end, shape (2 n,)."""
        outwards: Array = self._signs * self._system.expand(y).q[self._q]
        return outwards

    def _compare(self, y: Any, before: Any) -> None:
        outwards = self._outwards(y)
        if not (outwards > self._limit).any():
            return
        beyond = outwards - self._ends
        further = beyond > self._worst
        speed = np.abs(self._system.expand(before).v[self._v])
        self._when = np.where(further, y.t, self._when)
        self._speed = np.where(further, np.maximum(speed, self._speed), self._speed)
        self._worst = np.where(further, beyond, self._worst)
        self._limit = self._ends + self._worst
