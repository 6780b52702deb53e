"""Derivatives of motions through events: the saltation matrix.

    S = DR + (f+ - DR f- - dR/dt) dg / (dg f- + dg/dt)

is the derivative of the state after an event by the state before it; f- and f+ are the rates of
the state before and after it, R is the reset, g the guard. Written with the delay

    tau(d) = -dg d / (dg f- + dg/dt)

it is S d = DR (d + f- tau) + dR/dt tau - f+ tau: the first two terms are the reset along the
guard, where alone it has a meaning. All derivatives are central differences of order four.

Source: P. C. Müller, Chaos, Solitons and Fractals 5, 1995, 1671-1681; R. Leine, H. Nijmeijer,
Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004, ch. 7.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.sensitivities.flow import HybridFlow, Segment

_STEP = 3.0e-4  # of a position or turn [m, rad]: its fourth power is below rounding over the step
_MOVE = 1.0e-4  # s: for the rate of a guard along a motion
_GRAZING = 1.0e-7  # rate of a guard over the largest rate it could have by its gradient
_LANDINGS = 8  # Newton steps along a motion


def saltation(flow: HybridFlow, segment: Segment) -> Array:
    """Derivative of the state after an event by the state before it, shape (n, n).

    Args:
        segment: Ends with the event.

    Raises:
        SolveError: The motion only touches the guard.
    """
    return through(flow, segment, np.eye(flow.size), np.zeros(flow.size))[0]


def through(flow: HybridFlow, segment: Segment, moved: Array, late: Array) -> tuple[Array, Array]:
    """Derivatives of a state and of a delay, from before an event to after it.

    An event that comes a given time after another one is as late as that was: its delay is no
    function of the state there.

    Args:
        segment: Ends with the event.
        moved: Derivative of the state before it by some start, shape (n, k).
        late: That of the delay with which its phase began [s], shape (k,).

    Returns:
        Those of the state after it, at the time of the nominal event, and of its own delay.
    """
    after = flow.rate(segment.after)
    if flow.is_timed(segment):
        delayed = moved + np.outer(flow.rate(segment.end), late)
        return _reset_anywhere(flow, segment).dot(delayed) - np.outer(after, late), late
    before = crossing(flow, segment, segment.end)
    delays = before.delays.dot(moved)
    return reset_along(flow, segment, before).dot(moved) - np.outer(after, delays), delays


def _reset_anywhere(flow: HybridFlow, segment: Segment) -> Array:
    def after(near: State) -> Array:
        return flow.minus(flow.reset(segment, near), segment.after)

    return derivative(flow, after, segment.end)


def section_reset(flow: HybridFlow, segment: Segment) -> Array:
    """Derivative of the state after the event of a section, wherever a start meets it."""
    if flow.is_timed(segment):
        return _reset_anywhere(flow, segment)
    return reset_along(flow, segment, crossing(flow, segment, segment.end))


def landing(flow: HybridFlow, segment: Segment, moved: Array, late: Array) -> Array:
    """Derivative of the state at which a motion meets the section, from that at a fixed time.

    Args:
        segment: Ends with the event of the section.
        moved: As for `through`.
        late: As for `through`.
    """
    if flow.is_timed(segment):
        return moved + np.outer(flow.rate(segment.end), late)
    before = crossing(flow, segment, segment.end)
    return moved + np.outer(before.rate, before.delays.dot(moved))


def transition(flow: HybridFlow, segment: Segment) -> Array:
    """Derivative of the end of a smooth motion by its begin, over the same time, shape (n, n)."""

    def end(near: State) -> Array:
        return flow.minus(flow.follow(segment, near), segment.end)

    return derivative(flow, end, segment.begin)


def crossing(flow: HybridFlow, segment: Segment, x: State) -> Crossing:
    """How a motion meets the guard at the end of a segment.

    Args:
        segment: Has the guard.
        x: State on it, before the event.

    Raises:
        SolveError: It only touches the guard: the time of the event has no derivative.
    """
    rate = flow.rate(x)
    speed = _speed(flow, segment, x, rate)
    gradient = derivative(flow, lambda near: np.array([flow.value(segment, near)]), x)[0]
    largest = float(np.linalg.norm(gradient) * np.linalg.norm(rate))
    if abs(speed) <= _GRAZING * largest:
        raise SolveError(
            f"t = {x.t:.9g} s: the motion grazes {', '.join(segment.event)}: the time of the "
            "event, and with it the return map, has no derivative there"
        )
    return Crossing(rate, -gradient / speed)


def _speed(flow: HybridFlow, segment: Segment, x: State, rate: Array) -> float:
    """Rate of the guard along a motion."""

    def along(s: float) -> Array:
        return np.array([flow.value(segment, _moved(flow, x, rate, s))])

    return float(slope(along, _MOVE)[0])


def _moved(flow: HybridFlow, x: State, rate: Array, dt: float) -> State:
    return flow.plus(x, dt * rate)._replace(t=x.t + dt)


class Crossing(NamedTuple):
    """A guard where a motion meets it.

    Attributes:
        rate: Of the state before the event, in the tangent, shape (n,).
        delays: How much later a motion is there that starts from x (+) d, by d [s], shape (n,).
    """

    rate: Array
    delays: Array


def reset_along(flow: HybridFlow, segment: Segment, before: Crossing) -> Array:
    """Derivative of the state after an event, wherever the guard is met, shape (n, n)."""

    def after(near: State) -> Array:
        there = landed(flow, segment, near, before.rate)
        return flow.minus(flow.reset(segment, there), segment.after)

    return derivative(flow, after, segment.end)


def landed(flow: HybridFlow, segment: Segment, x: State, rate: Array) -> State:
    """The state where the guard is zero, along a rate from a state near by.

    Args:
        segment: Has the guard.
        rate: Direction, in the tangent, shape (n,).
    """
    if flow.is_timed(segment):
        return x
    speed = _speed(flow, segment, x, rate)
    best, height = x, abs(flow.value(segment, x))
    for _ in range(_LANDINGS):
        if height == 0.0:
            break
        near = _moved(flow, best, rate, -flow.value(segment, best) / speed)
        found = abs(flow.value(segment, near))
        if not found < height:
            break
        best, height = near, found
    return best


def derivative(flow: HybridFlow, f: Callable[[State], Array], x: State) -> Array:
    """Derivative of a function of a consistent state by its tangent, shape (.., size).

    Args:
        flow: Adds tangents, and says which are consistent; it is 0 across these.
    """
    basis = flow.basis(x)
    sizes = difference_steps(x, flow.size)
    columns = []
    for direction in basis.T:

        def along(s: float, direction: Array = direction) -> Array:
            return f(flow.plus(x, s * direction))

        columns.append(slope(along, float(1.0 / np.linalg.norm(direction / sizes))))
    found: Array = np.stack(columns, axis=-1).dot(basis.T)
    return found


def difference_steps(x: State, size: int) -> Array:
    """Length of a difference in each direction of the tangent, shape (size,).

    Args:
        size: Length of a tangent.
    """
    n = len(x.v)
    speed = max(1.0, float(np.abs(x.v).max(initial=0.0)))
    steps = np.full(size, _STEP)
    steps[n : 2 * n] *= speed
    steps[2 * n :] *= np.maximum(np.abs(x.z), _STEP)
    return steps


def slope(f: Callable[[float], Array], h: float) -> Array:
    """Derivative of f at 0, of order four in h."""
    near, far = f(h) - f(-h), f(2.0 * h) - f(-2.0 * h)
    result: Array = (8.0 * near - far) / (12.0 * h)
    return result
