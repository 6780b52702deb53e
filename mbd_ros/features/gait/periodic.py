"""Periodic motions: Newton's method on a return map.

The return map leads from the state just before an event of a gait to the same event a cycle later,
moved back along its travel. A gait is a fixed point of this map, P(y) = y. The eigenvalues of
dP/dy, the Floquet multipliers, tell whether it is stable.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import FORGOTTEN
from mbd_ros.errors import FallError, SolveError
from mbd_ros.methods.sensitivities.flow import HybridFlow, Segment, Travel
from mbd_ros.methods.sensitivities.saltation import (
    move_to_guard,
    propagate_through_event,
    propagate_to_section,
    section_reset,
    transition,
)

_CLOSED = 1.0e-11  # of 1 + the largest entry of the state: smaller residuals are rounding
_ACCEPTED = 1.0e-9  # the same: sufficient where steps gain no more
_MOST_STEPS = 40  # of Newton's method
_SHORTEST = 1.0e-3  # factor of a Newton step
_MOST_CYCLES = 60  # simulated before Newton's method is tried again


def periodic_motion(map_: ReturnMap, y: State) -> PeriodicMotion:
    """Search the periodic motion near a state.

    Newton's method with halved steps is used. Where it fails, the motion is simulated for some
    cycles, which leads to stable gaits, and Newton's method starts from there.

    Args:
        map_: The return map.
        y: Guess: a state near the guard of the section, before the event.

    Raises:
        SolveError: No periodic motion was found; the message tells the residual.
        FallError: Not one cycle can be simulated from the guess.
    """
    passage = map_.passage(y)
    try:
        return newton(map_, passage)
    except SolveError as first:
        for _ in range(_MOST_CYCLES):
            try:
                passage = map_.passage(passage.back)
            except FallError:
                raise first from None
            if _size(passage) < 1.0e-3 * _scale(passage):
                break
        try:
            return newton(map_, passage)
        except SolveError:
            raise first from None


class PeriodicMotion(NamedTuple):
    """A motion that returns to its initial state, apart from its travel.

    Attributes:
        passage: One passage through the return map.
        derivative: Derivative of the return map, shape (n, n).
        multipliers: Floquet multipliers, the largest first, shape (n,), complex.
    """

    passage: Passage
    derivative: Array
    multipliers: Array

    @property
    def state(self) -> State:
        """State just after the event of the section."""
        return self.passage.start.after

    @property
    def residual(self) -> float:
        """Largest entry of the residual of the return map [units of the state]."""
        return float(np.abs(self.passage.residual).max())

    @property
    def is_stable(self) -> bool:
        """Whether small disturbances decay."""
        return bool(abs(self.multipliers[0]) < 1.0)


class Passage(NamedTuple):
    """One passage through the return map.

    Attributes:
        start: Segment that ends with the event of the section, where the map begins.
        segments: Motion from there, over all cycles, up to the same event.
        back: Final state, moved back along the travel.
        residual: Tangent step from the initial state to `back`, shape (n,).
    """

    start: Segment
    segments: tuple[Segment, ...]
    back: State
    residual: Array

    @property
    def begin(self) -> State:
        """State just before the event of the section, where the map begins."""
        return self.start.end

    @property
    def period(self) -> float:
        """Duration of the motion [s]."""
        return self.segments[-1].end.t - self.segments[0].begin.t


def _size(passage: Passage) -> float:
    return float(np.abs(passage.residual).max())


def _scale(passage: Passage) -> float:
    """Return 1 plus the largest velocity or internal state."""
    y = passage.begin
    sizes = (np.abs(values).max(initial=0.0) for values in (y.v, y.z))
    return 1.0 + float(max(sizes))


def newton(map_: ReturnMap, passage: Passage) -> PeriodicMotion:
    """Return the periodic motion near a passage, by Newton's method.

    Raises:
        SolveError: No step reduces the residual.
    """
    for _ in range(_MOST_STEPS):
        derivative = map_.derivative(passage)
        slopes = np.eye(len(derivative)) - derivative
        step = np.asarray(np.linalg.lstsq(slopes, passage.residual)[0], dtype=np.float64)
        better = _damped_step(map_, passage, step)
        if better is None:
            break
        passage = better
        if is_closed(passage):
            break
    if not is_accepted(passage):
        raise SolveError(
            "no periodic motion found near the guess: the state still differs by "
            f"{_size(passage):.3g} after a cycle of {passage.period:.6g} s"
        )
    derivative = map_.derivative(passage)
    return PeriodicMotion(passage, derivative, multipliers(derivative))


def _damped_step(map_: ReturnMap, passage: Passage, step: Array) -> Passage | None:
    """Return the passage after a Newton step, halved until the residual decreases, or None."""
    factor = 1.0
    while factor > _SHORTEST:
        try:
            passage_after = map_.passage(map_.flow.plus(passage.begin, factor * step))
        except (FallError, SolveError):
            factor *= 0.25
            continue
        if _size(passage_after) < (1.0 - 0.1 * factor) * _size(passage):
            return passage_after
        factor *= 0.5
    return None


def is_closed(passage: Passage) -> bool:
    """Return whether the motion returns to its initial state up to rounding."""
    return _size(passage) <= _CLOSED * _scale(passage)


def is_accepted(passage: Passage) -> bool:
    """Return whether the motion returns well enough where no step brings it nearer."""
    return _size(passage) <= _ACCEPTED * _scale(passage)


def multipliers(derivative: Array) -> Array:
    """Return the Floquet multipliers, the largest first, with zeros for a singular derivative.

    The map has no more nonzero multipliers than the rank of its derivative. Eigenvalues are
    computed on its range, since a nilpotent part would turn rounding into multipliers of the size
    of its square root.

    Args:
        derivative: Derivative of a return map, shape (n, n).

    Returns:
        Complex array of shape (n,); positive imaginary parts come before their conjugates.
    """
    left, sizes, right = np.linalg.svd(derivative)
    rank = int(np.sum(sizes > FORGOTTEN * max(1.0, sizes[0])))
    on_range = (sizes[:rank, None] * right[:rank]).dot(left[:, :rank])
    values = np.zeros(len(derivative), complex)
    values[:rank] = np.linalg.eigvals(on_range)
    order = sorted(values, key=lambda m: (-round(abs(m), 12), -m.real, -m.imag))
    return np.array(order)


class ReturnMap:
    """Map from the state before an event to the state before the same event, cycles later.

    States before the event are on its guard, and the reset determines the state after it, so that
    an inaccurate guess remains a state from which the gait can continue.

    Args:
        flow: Motions with events.
        section: Segment that ends with the event of the section.
        travel: Directions along which the motion may begin anywhere.
        cycles: Cycles of the flow that count as one; 2 for motions that repeat every other cycle.
    """

    def __init__(
        self, flow: HybridFlow, section: Segment, travel: Travel, cycles: int = 1
    ) -> None:
        self.flow = flow
        self.section = section
        self.travel = travel
        self.cycles = cycles

    def repeated(self, cycles: int) -> ReturnMap:
        """Return the same map with another number of cycles."""
        return ReturnMap(self.flow, self.section, self.travel, cycles)

    def passage(self, y: State) -> Passage:
        """Return the passage through the map from a state near the guard of the section.

        Raises:
            FallError: The motion does not return to the event.
        """
        flow = self.flow
        y = flow.project(y._replace(t=self.section.end.t))
        y = move_to_guard(flow, self.section, y, flow.rate(y))
        x = flow.reset(self.section, y)
        start, segments = self.section._replace(end=y, after=x), list[Segment]()
        for _ in range(self.cycles):
            segments += flow.cycle(x)
            x = segments[-1].after
        back = self.travel.move_back(flow, segments[-1].end, y)
        return Passage(start, tuple(segments), back, flow.minus(back, y))

    def derivative(self, passage: Passage) -> Array:
        """Return the derivative of the final by the initial state of a passage, shape (n, n).

        It is the product of the transitions of smooth segments and the saltation matrices of
        events, and ends with the landing on the guard. The travel is projected out.

        Raises:
            SolveError: The motion grazes a guard.
        """
        flow, segments = self.flow, passage.segments
        moved, late = section_reset(flow, passage.start), np.zeros(flow.size)
        for segment in segments[:-1]:
            moved, delays = propagate_through_event(
                flow, segment, transition(flow, segment).dot(moved), late
            )
            late = delays if flow.ends_phase(segment) else late
        last = segments[-1]
        moved = propagate_to_section(flow, last, transition(flow, last).dot(moved), late)
        derivative: Array = self.travel.projector(last.end, flow.size).dot(moved)
        return derivative
