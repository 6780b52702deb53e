"""The contract of a motion with events, as a return map asks for it: x+ = P(x).

A cycle is a sequence of `Segment`s: smooth motion in one mode, and the event that ends it. A
`HybridFlow` follows them; `simulated_flow` is that of a scene.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from mbd_ros.core.state import Array, State


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
