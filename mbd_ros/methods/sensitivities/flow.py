"""Contract of a motion with events (hybrid flow), for return maps x+ = P(x).

A cycle is a sequence of `Segment`s, each a smooth motion in one mode and the event that ends it. A
`HybridFlow` computes them; `simulated_flow` implements it for scenes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from mbd_ros.core.state import Array, State

_UNUSED = 1.0e-9  # share of a coordinate in a direction below which it is rounding


class HybridFlow(Protocol):
    """Smooth motions with events between them; tangent steps have the order q, v, z.

    Attributes:
        size: Dimension of a tangent step.
    """

    size: int

    def plus(self, x: State, d: Array) -> State:
        """Return the state x (+) d, at the time and in the mode of x."""
        ...

    def minus(self, x1: State, x0: State) -> Array:
        """Return the step d with x0 (+) d = x1, shape (size,)."""
        ...

    def basis(self, x: State) -> Array:
        """Return an orthonormal basis of the steps between consistent states, shape (size, d)."""
        ...

    def project(self, x: State) -> State:
        """Return the nearest state that is consistent in the mode of x."""
        ...

    def cycle(self, x: State) -> tuple[Segment, ...]:
        """Return the motion from a state to the end of one cycle, including its last event.

        Raises:
            FallError: The motion does not complete the cycle.
        """
        ...

    def follow(self, segment: Segment, x: State) -> State:
        """Return the end of a smooth motion from x with the steps of a segment, without guards.

        The steps are fixed, so that differences of ends contain no noise from a step control.

        Args:
            segment: Segment with the mode and the steps.
            x: State near the begin of the segment.
        """
        ...

    def rate(self, x: State) -> Array:
        """Return the rate of a state in its mode, in the tangent, shape (size,)."""
        ...

    def value(self, segment: Segment, x: State) -> float:
        """Return the value of the guard of a segment at a state near its end."""
        ...

    def reset(self, segment: Segment, x: State) -> State:
        """Return the state after the event of a segment, from a state on its guard."""
        ...

    def is_timed(self, segment: Segment) -> bool:
        """Return whether the event occurs at a fixed time after the begin of its phase."""
        ...

    def ends_phase(self, segment: Segment) -> bool:
        """Return whether the event begins a phase, whose time counts from there."""
        ...


class Segment(NamedTuple):
    """Smooth motion in one mode, and the event that ends it.

    Attributes:
        begin: Consistent initial state, in the mode of the motion.
        times: Time of the begin and of the ends of all steps [s], shape (n + 1,).
        end: State at which the guard of the event is zero, in the same mode.
        after: State after the event, in the following mode.
        event: Names of the events at the end.
        guard: Data of the guard that the flow needs.
    """

    begin: State
    times: Array
    end: State
    after: State
    event: tuple[str, ...]
    guard: Any = None


class Travel:
    """Directions of travel, along which the dynamics do not depend on the position.

    Args:
        coordinates: Coordinates of travel, m of them.
        directions: Orthonormal combinations of them, shape (k, m); None for each coordinate alone.
    """

    def __init__(
        self, coordinates: Sequence[TravelCoordinate] = (), directions: Array | None = None
    ) -> None:
        self.coordinates = tuple(coordinates)
        self.directions = np.eye(len(self.coordinates)) if directions is None else directions

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates that a direction contains."""
        used = np.abs(self.directions).max(axis=0, initial=0.0) > _UNUSED
        return tuple(c.name for c, is_used in zip(self.coordinates, used, strict=True) if is_used)

    def place(self, x: State) -> Array:
        """Return the position along the directions [m], shape (k,)."""
        values = np.array([coordinate.place(x.q) for coordinate in self.coordinates])
        place: Array = self.directions.dot(values)
        return place

    def tangents(self, x: State, size: int) -> Array:
        """Return the tangent steps along the directions, shape (size, k)."""
        along = [coordinate.tangent(x.q, size) for coordinate in self.coordinates]
        tangents: Array = np.reshape(along, (-1, size)).T.dot(self.directions.T)
        return tangents

    def move_back(self, flow: Any, x: State, origin: State) -> State:
        """Move a state along the directions to the position of another one."""
        if not len(self.directions):
            return x
        distance = self.place(origin) - self.place(x)
        moved: State = flow.plus(x, self.tangents(x, flow.size).dot(distance))
        return moved

    def projector(self, x: State, size: int) -> Array:
        """Return the projector that removes the directions from a tangent step, (size, size)."""
        along = self.tangents(x, size)
        return np.eye(size) - along.dot(along.T)


class TravelCoordinate(NamedTuple):
    """Coordinate that translates everything carried by one joint.

    Attributes:
        name: Name of the coordinate.
        q: Index of the coordinate in q, for a free body of its first one.
        v: Index of its rate in v, for a free body of its first one.
        axis: World axis of a free body, 0 to 2; -1 for a joint with one coordinate.
    """

    name: str
    q: int
    v: int
    axis: int = -1

    def place(self, q: Array) -> float:
        """Return the value of the coordinate [m]."""
        return float(q[self.q + max(self.axis, 0)])

    def tangent(self, q: Array, size: int) -> Array:
        """Return the tangent step along the coordinate, shape (size,)."""
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
