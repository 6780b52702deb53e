"""Motions that repeat: Newton's method on a return map.

The return map leads from the state just before an event of a gait to the same event a cycle later,
moved back along what travels. A gait is its fixed point, P(y) = y; the eigenvalues of dP/dy, the
Floquet multipliers, say whether it is stable.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import FORGOTTEN
from mbd_ros.errors import FallError, SolveError
from mbd_ros.methods.sensitivities.flow import HybridFlow, Segment, Travel
from mbd_ros.methods.sensitivities.saltation import (
    landed,
    landing,
    section_reset,
    through,
    transition,
)

_CLOSED = 1.0e-11  # of 1 + the largest entry of the state: a residual that is none
_ACCEPTED = 1.0e-9  # the same: enough where steps gain no more
_MOST_STEPS = 40  # of Newton's method
_SHORTEST = 1.0e-3  # factor of a Newton step
_STRIDES = 60  # of the motion itself, where Newton's method finds no way


def periodic_motion(way: ReturnMap, y: State) -> PeriodicMotion:
    """The periodic motion near a state.

    Newton's method with halved steps; where it finds no way, the motion itself is followed for
    some cycles, which leads to gaits that are stable, and Newton's method begins there once more.

    Args:
        way: The return map.
        y: Guess: a state near the guard of the section, before the event.

    Raises:
        SolveError: None was found; says how near the search came.
        FallError: Not one cycle can be followed from the guess.
    """
    passage = way.passage(y)
    try:
        return newton(way, passage)
    except SolveError as first:
        for _ in range(_STRIDES):
            try:
                passage = way.passage(passage.back)
            except FallError:
                raise first from None
            if _size(passage) < 1.0e-3 * _scale(passage):
                break
        try:
            return newton(way, passage)
        except SolveError:
            raise first from None


class PeriodicMotion(NamedTuple):
    """A motion that comes back to itself, up to its travel.

    Attributes:
        passage: One way through the return map.
        derivative: Of the map, shape (n, n).
        multipliers: Floquet multipliers, the largest first, shape (n,), complex.
    """

    passage: Passage
    derivative: Array
    multipliers: Array

    @property
    def state(self) -> State:
        """The state just after the event of the section."""
        return self.passage.start.after

    @property
    def residual(self) -> float:
        """Largest entry of what is left of the return map [units of the state]."""
        return float(np.abs(self.passage.residual).max())

    @property
    def is_stable(self) -> bool:
        """Whether small disturbances decay."""
        return bool(abs(self.multipliers[0]) < 1.0)


class Passage(NamedTuple):
    """One way through the return map.

    Attributes:
        start: Segment that ends with the event of the section: its end is where the map begins.
        segments: The motion from there, over all cycles, up to the same event.
        back: Its end, moved back along the travel.
        residual: Tangent from the begin to `back`, shape (n,).
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
        """Time of the motion [s]."""
        return self.segments[-1].end.t - self.segments[0].begin.t


def _size(passage: Passage) -> float:
    return float(np.abs(passage.residual).max())


def _scale(passage: Passage) -> float:
    """One, or the size of velocities and states of parts where these are larger."""
    y = passage.begin
    sizes = (np.abs(values).max(initial=0.0) for values in (y.v, y.z))
    return 1.0 + float(max(sizes))


def newton(way: ReturnMap, passage: Passage) -> PeriodicMotion:
    """The periodic motion near a passage, by Newton's method.

    Raises:
        SolveError: No step makes the residual smaller.
    """
    for _ in range(_MOST_STEPS):
        derivative = way.derivative(passage)
        slopes = np.eye(len(derivative)) - derivative
        step = np.asarray(np.linalg.lstsq(slopes, passage.residual)[0], dtype=np.float64)
        better = _shorter(way, passage, step)
        if better is None:
            break
        passage = better
        if is_closed(passage):
            break
    if not is_accepted(passage):
        raise SolveError(
            "no periodic motion found near the guess: the state is still "
            f"{_size(passage):.3g} off after a cycle of {passage.period:.6g} s"
        )
    derivative = way.derivative(passage)
    return PeriodicMotion(passage, derivative, multipliers(derivative))


def _shorter(way: ReturnMap, passage: Passage, step: Array) -> Passage | None:
    """The passage after a Newton step, halved until the residual is smaller; None without any."""
    factor = 1.0
    while factor > _SHORTEST:
        try:
            found = way.passage(way.flow.plus(passage.begin, factor * step))
        except (FallError, SolveError):
            factor *= 0.25
            continue
        if _size(found) < (1.0 - 0.1 * factor) * _size(passage):
            return found
        factor *= 0.5
    return None


def is_closed(passage: Passage) -> bool:
    """Whether the motion comes back to within rounding."""
    return _size(passage) <= _CLOSED * _scale(passage)


def is_accepted(passage: Passage) -> bool:
    """Whether it comes back well enough, where no step brings it nearer."""
    return _size(passage) <= _ACCEPTED * _scale(passage)


def multipliers(derivative: Array) -> Array:
    """Floquet multipliers, the largest first; directions in which the map forgets all are 0.

    The map has no more multipliers than its derivative has ranks: eigenvalues are taken on its
    range, since a nilpotent part would turn rounding into multipliers of its square root.

    Args:
        derivative: Of a return map, shape (n, n).

    Returns:
        Shape (n,), complex; those with a positive imaginary part before their conjugates.
    """
    left, sizes, right = np.linalg.svd(derivative)
    rank = int(np.sum(sizes > FORGOTTEN * max(1.0, sizes[0])))
    on_range = (sizes[:rank, None] * right[:rank]).dot(left[:, :rank])
    found = np.zeros(len(derivative), complex)
    found[:rank] = np.linalg.eigvals(on_range)
    order = sorted(found, key=lambda m: (-round(abs(m), 12), -m.real, -m.imag))
    return np.array(order)


class ReturnMap:
    """State before an event of a cycle -> state before the same event, cycles later.

    States before the event are on its guard, and the reset brings what is free after it: a guess
    that is off stays a state from which the gait can go on.

    Args:
        flow: Motions with events.
        section: Segment that ends with the event of the section.
        travel: Along which the motion may begin anywhere.
        cycles: Cycles of the flow that count as one; 2 for motions that repeat every other one.
    """

    def __init__(
        self, flow: HybridFlow, section: Segment, travel: Travel, cycles: int = 1
    ) -> None:
        self.flow, self.section, self.travel, self.cycles = flow, section, travel, cycles

    def repeated(self, cycles: int) -> ReturnMap:
        """The same map with another number of cycles."""
        return ReturnMap(self.flow, self.section, self.travel, cycles)

    def passage(self, y: State) -> Passage:
        """The way through the map from a state near the guard of the section.

        Raises:
            FallError: The motion does not come back.
        """
        flow = self.flow
        y = flow.onto(y._replace(t=self.section.end.t))
        y = landed(flow, self.section, y, flow.rate(y))
        x = flow.reset(self.section, y)
        start, segments = self.section._replace(end=y, after=x), list[Segment]()
        for _ in range(self.cycles):
            segments += flow.cycle(x)
            x = segments[-1].after
        back = self.travel.back(flow, segments[-1].end, y)
        return Passage(start, tuple(segments), back, flow.minus(back, y))

    def derivative(self, passage: Passage) -> Array:
        """Derivative of where a passage ends by where it begins, shape (n, n).

        Transitions of smooth segments and saltation matrices of events, ended by the landing on
        the guard; what travels away is taken out.

        Raises:
            SolveError: The motion grazes a guard.
        """
        flow, segments = self.flow, passage.segments
        moved, late = section_reset(flow, passage.start), np.zeros(flow.size)
        for segment in segments[:-1]:
            moved, delays = through(flow, segment, transition(flow, segment).dot(moved), late)
            late = delays if flow.ends_phase(segment) else late
        last = segments[-1]
        moved = landing(flow, last, transition(flow, last).dot(moved), late)
        found: Array = self.travel.without(last.end, flow.size).dot(moved)
        return found
