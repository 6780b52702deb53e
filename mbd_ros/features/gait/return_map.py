"""The map from one event of a gait to the same event a cycle later."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.sensitivities.flow import HybridFlow, Segment
from mbd_ros.core.sensitivities.saltation import (
    landed,
    landing,
    section_reset,
    through,
    transition,
)
from mbd_ros.core.sensitivities.travel import Travel
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import FORGOTTEN


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

    def repeated(self, cycles: int) -> "ReturnMap":
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
