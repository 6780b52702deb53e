"""Motions of one phase that begin anew at its end: what becomes of deviations at the strike."""

from typing import Any

import numpy as np

from mbd_ros.core.control.independent_slopes import IndependentSlopes
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DataError, SolveError
from mbd_ros.features.regulator.riccati import riccati_backwards
from mbd_ros.scene.built_scene import Scene

BEFORE = 4  # samples before the end, from which deviations are followed through the strike
_STEP = 1.0e-4  # of a deviation
_AGAIN = 1.0e-2  # deviation with which a motion counts as one that begins anew
_PARTS = 4  # of an interval between samples, in each of which efforts are held
_LATE = 1.2  # durations until a strike must have come
_SETTLED, _MOST = 1.0e-6, 200  # change of costs, relative, and iterations


def strike_slope(
    scene: Scene, times: Array, states: list[State], u: Array, slopes: IndependentSlopes
) -> Array:
    """Deviations with which a step begins by those near the end of the one before.

    The step begins when the foot strikes, whenever that is: shape (2 d, 2 d), by central
    differences of simulations from a few samples before the end, efforts as planned.

    Raises:
        DataError: The motion does not begin anew at its end.
    """
    simulation, first = scene.simulation(), states[-BEFORE]
    d = len(slopes.chosen)

    def after(e: Array) -> Array:
        x = _struck(simulation, times, u, slopes.beside(first, e))
        at = slopes.chosen
        return np.concatenate([(x.q - states[0].q)[at], (x.v - states[0].v)[at]])

    if np.abs(after(np.zeros(2 * d))).max() > _AGAIN:
        raise DataError("the motion does not begin anew where its phase ends")
    ways = _STEP * np.eye(2 * d)
    return np.stack([(after(e) - after(-e)) / (2.0 * _STEP) for e in ways], axis=1)


def repeating_cost(times: Array, A: Array, B: Array, Q: Array, R: Array, strike: Array) -> Array:
    """Cost to go of a motion that repeats for ever, shape (n, 2 d, 2 d).

    Backwards from S(end) = strike' S(begin) strike, until it repeats too.

    Raises:
        SolveError: It does not settle: the inputs cannot make the motion stable.
    """
    n, S_end = len(times) - BEFORE + 1, Q
    for _ in range(_MOST):
        S = riccati_backwards(times[:n], A[:n], B[:n], Q, R, S_end)
        before, S_end = S_end, strike.T.dot(S[0]).dot(strike)
        if np.abs(S_end - before).max() <= _SETTLED * np.abs(S_end).max():
            return np.concatenate([S, np.repeat(S[-1:], BEFORE - 1, axis=0)])
    raise SolveError("no gains make the motion stable from step to step")


def _struck(simulation: Any, times: Array, u: Array, y: State) -> State:
    """The state just after the strike, of what is integrated, under planned efforts."""
    period = float(times[-1] - times[-2]) / _PARTS
    y = simulation.start(simulation.system.systems[0].expand(y))
    simulation.stepper.take_events()
    while y.t < _LATE * times[-1]:
        middle = y.t + 0.5 * period
        held = np.array([np.interp(middle, times, one) for one in u.T])
        y = simulation.advance(y, held, y.t + period)
        for event in simulation.stepper.take_events():
            after: State = event.after
            return after
    raise DataError("the phase of the motion does not come to its end")
