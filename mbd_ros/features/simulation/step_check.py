"""Warnings of `simulate`: a motion that was too fast for its step."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.events.event import Event
from mbd_ros.core.integration.linear_motion import LinearMotion, linear_motion, longest_step
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY, TOGGLE_RISE
from mbd_ros.errors import SolveError

_LOOKS = 8  # states whose fastest rate is found, and the last one
_FOLD_LOOKS = 2_000  # states whose rows are factorised
_AT_REST = 1.0e-9  # of the velocity of a free fall as long: what does not move
_TURN = 0.5  # change of velocity in a step, of the largest one in the motion


def step_warnings(
    system: System,
    method: Integrator,
    dt: float,
    states: Sequence[State],
    events: Sequence[Event] = (),
) -> Iterator[str]:
    """Warnings of the step; none for methods that choose their steps.

    Args:
        system: The system.
        method: Its integrator.
        dt: Step [s].
        states: States of all joints, one a step.
        events: What happened on the way: a velocity that jumps there is no doubt of the step.
    """
    if method.stable == math.inf or not states:
        return
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if method.is_explicit:
            yield from _stiffness(system, method, dt, states)
        speeds = np.array([x.v for x in states])
        turns = np.abs(np.diff(speeds, axis=0)).max(axis=1, initial=0.0)
        fall = float(np.linalg.norm(system.model.gravity.linear)) * (states[-1].t - states[0].t)
        turns = turns / max(float(np.abs(speeds).max()), _AT_REST * fall, TINY)
        turns[_with_jumps(system, method, states, events)] = 0.0
        k = int(np.argmax(turns)) if len(turns) else 0
        if len(turns) and not turns[k] <= _TURN:
            yield (
                f"velocities change by {turns[k]:.0%} of the largest one in the step to t = "
                f"{states[k + 1].t:.6g} s: the step does not resolve the motion"
            )
        yield from _folds(system, states)


def _with_jumps(
    system: System, method: Integrator, states: Sequence[State], events: Sequence[Event]
) -> Array:
    """Steps in which velocities jump, or may, shape (len(states) - 1,)."""
    times = np.array([x.t for x in states])
    if method.at_velocity_level and system.layout.yielding:
        return np.ones(len(times) - 1, dtype=np.bool_)
    jumps = [event.t for event in events if (event.before.v != event.after.v).any()]
    found = np.zeros(len(times) + 1, dtype=np.bool_)
    for side in ("left", "right"):  # an event at a sample belongs to both of its steps
        found[np.searchsorted(times, jumps, side)] = True  # type: ignore[call-overload]
    return found[1:-1]


def _stiffness(
    system: System, method: Integrator, dt: float, states: Sequence[State]
) -> Iterator[str]:
    some, worst = (*states[:: max(1, len(states) // _LOOKS)], states[-1]), (math.inf, 0.0, 0.0)
    for x in some:
        motion = _motion(system, x)
        if motion is not None:
            worst = min(worst, (longest_step(method, motion, dt), motion.rate, x.t))
    (longest, rate, t), name = worst, method.title
    if not math.isfinite(rate):
        yield f"stiff: forces change too steeply at t = {t:.6g} s for any step of {name}"
    elif longest < math.inf:
        yield (
            f"stiff: fastest rate {rate:.3g} 1/s at t = {t:.6g} s; steps of "
            f"{name} need dt < {longest:.2g} s there"
        )


def _motion(system: System, x: State) -> LinearMotion | None:
    """None where a state nearby has no acceleration and nothing can be told."""
    try:
        return linear_motion(system, system.reduce(x))
    except SolveError:
        return None


def _folds(system: System, states: Sequence[State]) -> Iterator[str]:
    """Where the mechanism nearly folds: beyond, it may be on another branch."""
    if not system.held.rows:
        return
    looked, conditions = states[:: 1 + len(states) // _FOLD_LOOKS], []
    for x in looked:
        y = system.reduce(x)
        factor = system.held.factor_at(y.t, y.q)
        conditions.append(factor.condition)
    known = [c for c in conditions if c < math.inf]
    if known and max(known) > TOGGLE_RISE * min(known):
        t = looked[conditions.index(max(known))].t
        yield (
            f"near a toggle at t = {t:.6g} s: the condition number of the rows rises "
            f"{max(known) / min(known):.0f}-fold; a step too long may leave the branch there, a "
            "smaller dt or a tolerance tells"
        )
