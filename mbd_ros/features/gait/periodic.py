"""Motions that repeat: Newton's method on a return map."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import FallError, SolveError
from mbd_ros.features.gait.return_map import Passage, ReturnMap, multipliers

_CLOSED = 1.0e-11  # of 1 + the largest entry of the state: a residual that is none
_ACCEPTED = 1.0e-9  # the same: enough where steps gain no more
_MOST_STEPS = 40
_SHORTEST = 1.0e-3  # of a Newton step
_STRIDES = 60  # of the motion itself, where Newton's method finds no way


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


def is_closed(passage: Passage) -> bool:
    """Whether the motion comes back to within rounding."""
    return _size(passage) <= _CLOSED * _scale(passage)


def is_accepted(passage: Passage) -> bool:
    """Whether it comes back well enough, where no step brings it nearer."""
    return _size(passage) <= _ACCEPTED * _scale(passage)


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


def _size(passage: Passage) -> float:
    return float(np.abs(passage.residual).max())


def _scale(passage: Passage) -> float:
    """One, or the size of velocities and states of parts where these are larger."""
    y = passage.begin
    sizes = (np.abs(values).max(initial=0.0) for values in (y.v, y.z))
    return 1.0 + float(max(sizes))
