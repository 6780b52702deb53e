"""Saltation matrix: derivative of a motion through an event.

    S = DR + (f+ - DR f- - dR/dt) dg / (dg f- + dg/dt)

is the derivative of the state after an event with respect to the state before it; f- and f+ are
the rates of the state before and after the event, R is the reset, g the guard. With the delay

    tau(d) = -dg d / (dg f- + dg/dt)

it reads S d = DR (d + f- tau) + dR/dt tau - f+ tau. The first two terms are the reset along the
guard, the only states at which it is defined. All derivatives are central differences of order
four.

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

_STEP = 3.0e-4  # difference step of a position [m, rad], whose fourth power is below rounding
_TIME_STEP = 1.0e-4  # difference step for the rate of a guard along a motion [s]
_GRAZING = 1.0e-7  # rate of a guard, relative to the largest one that its gradient allows
_NEWTON_STEPS = 8  # along a motion


def saltation(flow: HybridFlow, segment: Segment) -> Array:
    """Return the derivative of the state after an event with respect to that before it, (n, n).

    Args:
        flow: The motion.
        segment: Segment that ends with the event.

    Raises:
        SolveError: The motion only touches the guard.
    """
    return propagate_through_event(flow, segment, np.eye(flow.size), np.zeros(flow.size))[0]


def propagate_through_event(
    flow: HybridFlow, segment: Segment, derivative_before: Array, delay: Array
) -> tuple[Array, Array]:
    """Propagate the derivatives of a state and of a delay through an event.

    A timed event, at a fixed time after the begin of its phase, has the delay of that begin
    regardless of the state.

    Args:
        flow: The motion.
        segment: Segment that ends with the event.
        derivative_before: Derivative of the state before the event with respect to parameters of
            the start, shape (n, k).
        delay: Derivative of the delay with which its phase began [s], shape (k,).

    Returns:
        Derivative of the state after the event, at the time of the nominal event, and of the delay
        of the event.
    """
    after = flow.rate(segment.after)
    if flow.is_timed(segment):
        delayed = derivative_before + np.outer(flow.rate(segment.end), delay)
        return _reset_anywhere(flow, segment).dot(delayed) - np.outer(after, delay), delay
    before = guard_crossing(flow, segment, segment.end)
    delays = before.delays.dot(derivative_before)
    reset = reset_along_guard(flow, segment, before)
    return reset.dot(derivative_before) - np.outer(after, delays), delays


def _reset_anywhere(flow: HybridFlow, segment: Segment) -> Array:
    """Return the derivative of a reset that is defined at all states."""

    def after(near: State) -> Array:
        return flow.minus(flow.reset(segment, near), segment.after)

    return derivative(flow, after, segment.end)


def section_reset(flow: HybridFlow, segment: Segment) -> Array:
    """Return the derivative of the state after the event of a section, along the section."""
    if flow.is_timed(segment):
        return _reset_anywhere(flow, segment)
    return reset_along_guard(flow, segment, guard_crossing(flow, segment, segment.end))


def propagate_to_section(
    flow: HybridFlow, segment: Segment, derivative_before: Array, delay: Array
) -> Array:
    """Return the derivative of the state on a section from that at a fixed time.

    Args:
        flow: The motion.
        segment: Segment that ends with the event of the section.
        derivative_before: Derivative of the state at the time of the nominal event, shape (n, k).
        delay: Derivative of the delay with which its phase began [s], shape (k,).
    """
    if flow.is_timed(segment):
        return derivative_before + np.outer(flow.rate(segment.end), delay)
    before = guard_crossing(flow, segment, segment.end)
    return derivative_before + np.outer(before.rate, before.delays.dot(derivative_before))


def transition(flow: HybridFlow, segment: Segment) -> Array:
    """Return the derivative of the end of a smooth motion with respect to its begin, (n, n)."""

    def end(near: State) -> Array:
        return flow.minus(flow.follow(segment, near), segment.end)

    return derivative(flow, end, segment.begin)


def guard_crossing(flow: HybridFlow, segment: Segment, x: State) -> GuardCrossing:
    """Linearize how a motion crosses the guard at the end of a segment.

    Args:
        flow: The motion.
        segment: Segment that ends at the guard.
        x: State on the guard, before the event.

    Raises:
        SolveError: The motion only touches the guard, so the event time has no derivative.
    """
    rate = flow.rate(x)
    speed = _speed(flow, segment, x, rate)
    gradient = derivative(flow, lambda near: np.array([flow.value(segment, near)]), x)[0]
    largest = float(np.linalg.norm(gradient) * np.linalg.norm(rate))
    if abs(speed) <= _GRAZING * largest:
        raise SolveError(
            f"t = {x.t:.9g} s: the motion grazes {', '.join(segment.event)}, so the event time "
            "and the return map have no derivative there"
        )
    return GuardCrossing(rate, -gradient / speed)


def _speed(flow: HybridFlow, segment: Segment, x: State, rate: Array) -> float:
    """Return the rate of the guard along a motion."""

    def along(s: float) -> Array:
        return np.array([flow.value(segment, _advance(flow, x, rate, s))])

    return float(slope(along, _TIME_STEP)[0])


def _advance(flow: HybridFlow, x: State, rate: Array, dt: float) -> State:
    return flow.plus(x, dt * rate)._replace(t=x.t + dt)


class GuardCrossing(NamedTuple):
    """Linearized crossing of a guard.

    Attributes:
        rate: Rate of the state before the event, in the tangent, shape (n,).
        delays: Derivative of the event time with respect to the state before it [s], shape (n,).
    """

    rate: Array
    delays: Array


def reset_along_guard(flow: HybridFlow, segment: Segment, before: GuardCrossing) -> Array:
    """Return the derivative of the state after an event, along the guard, shape (n, n)."""

    def after(near: State) -> Array:
        on_guard = move_to_guard(flow, segment, near, before.rate)
        return flow.minus(flow.reset(segment, on_guard), segment.after)

    return derivative(flow, after, segment.end)


def move_to_guard(flow: HybridFlow, segment: Segment, x: State, rate: Array) -> State:
    """Return the state on the guard, reached from a nearby state along a rate.

    Args:
        flow: The motion.
        segment: Segment that ends at the guard.
        x: State near the guard.
        rate: Rate of the state, in the tangent, shape (n,).
    """
    if flow.is_timed(segment):
        return x
    speed = _speed(flow, segment, x, rate)
    best, height = x, abs(flow.value(segment, x))
    for _ in range(_NEWTON_STEPS):
        if height == 0.0:
            break
        near = _advance(flow, best, rate, -flow.value(segment, best) / speed)
        near_height = abs(flow.value(segment, near))
        if not near_height < height:
            break
        best, height = near, near_height
    return best


def derivative(flow: HybridFlow, f: Callable[[State], Array], x: State) -> Array:
    """Return the derivative of a function of a consistent state, shape (.., size).

    Args:
        flow: The motion; its basis spans the consistent directions, across which the result is 0.
        f: Function of a state.
        x: Consistent state.
    """
    basis = flow.basis(x)
    sizes = difference_steps(x, flow.size)
    columns = []
    for direction in basis.T:

        def along(s: float, direction: Array = direction) -> Array:
            return f(flow.plus(x, s * direction))

        columns.append(slope(along, float(1.0 / np.linalg.norm(direction / sizes))))
    result: Array = np.stack(columns, axis=-1).dot(basis.T)
    return result


def difference_steps(x: State, size: int) -> Array:
    """Return the difference step in each direction of the tangent, shape (size,).

    Args:
        x: State.
        size: Dimension of the tangent.
    """
    n = len(x.v)
    speed = max(1.0, float(np.abs(x.v).max(initial=0.0)))
    steps = np.full(size, _STEP)
    steps[n : 2 * n] *= speed
    steps[2 * n :] *= np.maximum(np.abs(x.z), _STEP)
    return steps


def slope(f: Callable[[float], Array], h: float) -> Array:
    """Return the derivative of f at 0 by central differences of order four in h."""
    near, far = f(h) - f(-h), f(2.0 * h) - f(-2.0 * h)
    result: Array = (8.0 * near - far) / (12.0 * h)
    return result
