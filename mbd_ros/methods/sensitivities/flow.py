"""The contract of a motion with events, as a return map asks for it: x+ = P(x).

A cycle is a sequence of `Segment`s: smooth motion in one mode, and the event that ends it. A
`HybridFlow` follows them; `simulated_flow` is that of a scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from mbd_ros.core.state import Array, State

_UNUSED = 1.0e-9  # part of a coordinate in a direction: rounding


class HybridFlow(Protocol):
    """Smooth motions with events between them; tangents have the order q, v, z.

    Attributes:
        size: Length of a tangent.
    """

    size: int

    def plus(self, x: State, d: Array) -> State:
        """The state x (+) d, at the time and in the mode of x."""
        ...

    def minus(self, x1: State, x0: State) -> Array:
        """The d with x0 (+) d = x1, shape (size,)."""
        ...

    def basis(self, x: State) -> Array:
        """Orthonormal tangents along which a consistent state stays so, shape (size, d)."""
        ...

    def onto(self, x: State) -> State:
        """The nearest state that is consistent in the mode of x."""
        ...

    def cycle(self, x: State) -> tuple[Segment, ...]:
        """The motion from a state to the end of one cycle, that event included.

        Raises:
            FallError: It does not come to its end.
        """
        ...

    def follow(self, segment: Segment, x: State) -> State:
        """The end of a smooth motion from x with the steps of a segment, guards ignored.

        Args:
            segment: Gives mode and lengths of steps, which are not chosen anew: differences of
                ends have no noise of a step control.
            x: Near the begin of the segment.
        """
        ...

    def rate(self, x: State) -> Array:
        """Rate of a state in its mode, in the tangent, shape (size,)."""
        ...

    def value(self, segment: Segment, x: State) -> float:
        """The guard at the end of a segment, at a state near that end."""
        ...

    def reset(self, segment: Segment, x: State) -> State:
        """The state after the event at the end of a segment, from one at which its guard is 0."""
        ...

    def is_timed(self, segment: Segment) -> bool:
        """Whether the event at the end comes a given time after the begin of its phase."""
        ...

    def ends_phase(self, segment: Segment) -> bool:
        """Whether the event at the end begins a phase, whose time counts from there."""
        ...


class Segment(NamedTuple):
    """Smooth motion, and the event that ends it.

    Attributes:
        begin: Consistent state, in the mode of the motion.
        times: Ends of its steps, the begin first [s], shape (n + 1,).
        end: State at which the guard of the event is zero, in the same mode.
        after: State after the event, in the mode that follows.
        event: Names of what happens at its end.
        guard: Whatever the flow needs to know of the guard.
    """

    begin: State
    times: Array
    end: State
    after: State
    event: tuple[str, ...]
    guard: Any = None


class Travel:
    """Directions along which a motion may begin anywhere.

    Args:
        coordinates: The coordinates, m of them.
        directions: Orthonormal combinations of them, shape (k, m); None for each by itself.
    """

    def __init__(
        self, coordinates: Sequence[TravelCoordinate] = (), directions: Array | None = None
    ) -> None:
        self.coordinates = tuple(coordinates)
        self.directions = np.eye(len(self.coordinates)) if directions is None else directions

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coordinates that any direction has a part of."""
        used = np.abs(self.directions).max(axis=0, initial=0.0) > _UNUSED
        return tuple(c.name for c, is_used in zip(self.coordinates, used, strict=True) if is_used)

    def place(self, x: State) -> Array:
        """Place along the directions [m], shape (k,)."""
        values = np.array([one.place(x.q) for one in self.coordinates])
        place: Array = self.directions.dot(values)
        return place

    def tangents(self, x: State, size: int) -> Array:
        """Tangents along the directions, shape (size, k)."""
        along = [one.tangent(x.q, size) for one in self.coordinates]
        tangents: Array = np.reshape(along, (-1, size)).T.dot(self.directions.T)
        return tangents

    def back(self, flow: Any, x: State, origin: State) -> State:
        """The state moved along the directions to the place of another one."""
        if not len(self.directions):
            return x
        moved = self.place(origin) - self.place(x)
        back: State = flow.plus(x, self.tangents(x, flow.size).dot(moved))
        return back

    def without(self, x: State, size: int) -> Array:
        """Projector of tangents along the directions to a fixed place, shape (size, size)."""
        along = self.tangents(x, size)
        return np.eye(size) - along.dot(along.T)


class TravelCoordinate(NamedTuple):
    """A translation of everything that moves with one joint.

    Attributes:
        q: Where its coordinate is in q; the place of a free body, its first.
        v: Where its rate is in v; that of a free body, its first.
        axis: Of the world, 0 to 2, for a free body; -1 for a joint of one coordinate.
    """

    name: str
    q: int
    v: int
    axis: int = -1

    def place(self, q: Array) -> float:
        """Its value [m]."""
        return float(q[self.q + max(self.axis, 0)])

    def tangent(self, q: Array, size: int) -> Array:
        """The tangent along it, shape (size,)."""
        along = np.zeros(size)
        if self.axis < 0:
            along[self.v] = 1.0
        else:  # row of the rotation from the body to the world
            x, y, z, w = q[self.q + 3 : self.q + 7]
            rotation = (
                (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
                (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
                (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
            )
            along[self.v : self.v + 3] = rotation[self.axis]
        return along
