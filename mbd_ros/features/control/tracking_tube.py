"""How far a motion may be from a plan and still return to it, within what contacts leave.

The tube is a level of the cost to go, e' S e <= level. Random deviations of a level are simulated
under the gains; the level is halved until all of them return.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.control.contract import EffortBox
from mbd_ros.methods.control.tracking_plan import IndependentSlopes, TrackingPlan
from mbd_ros.methods.events.crossings import Crossing
from mbd_ros.methods.projection.assembly import assemble

Watched = Callable[[Iterable[Any]], Iterable[Any]]
_STEP = 0.2  # of a step, over the fastest rate of the loop
_LONGEST = 5.0e-3  # [s] of a step
_HALVINGS = 40  # of a level, at most
_LOST = 100.0  # times a level, at which a motion is given up
_MARGIN = 0.5  # of the level that every disturbance returned from
_REPEATED_MARGIN = 0.25  # the same of motions that only have to end in the tube
_HELD = 1.0e-3  # share of the level at which a motion has returned to an end at rest


def tube_level(
    disturbed: DisturbedMotion,
    plan: TrackingPlan,
    largest: float,
    fastest: float,
    *,
    rests: bool,
    count: int = 48,
    seed: int = 0,
    watched: Watched = iter,
) -> float:
    """A share of a cost to go from which random disturbances return, each at a random sample.

    Args:
        plan: What it follows.
        largest: Where the search begins; halved until all return.
        fastest: Rate of the loop that steps resolve [1/s].
        rests: Whether motions must come back to the end, which is at rest; else they must end
            in the tube.
        count: Number of disturbances.
        seed: Of their random numbers.
        watched: Passes the disturbances of a level on, for progress.

    Returns:
        The level; 0 where no disturbance returns.
    """
    rng, (n, m) = np.random.default_rng(seed), plan.cost.shape[:2]
    at, ways = rng.integers(0, n - 1, count), rng.normal(size=(count, m))
    level = largest
    for _ in range(_HALVINGS):
        for i, way in watched(zip(at.tolist(), ways, strict=True)):
            e = way * math.sqrt(level / float(way.dot(plan.cost[i]).dot(way)))
            found = disturbed.after(i, e, _LOST * level, fastest)
            if not found.last <= (_HELD if rests else 1.0) * level:
                break
        else:
            return (_MARGIN if rests else _REPEATED_MARGIN) * level
        level *= 0.5
    return 0.0


class DisturbedMotion:
    """Motion under the gains of a plan, from states beside it, with inputs held each step.

    Args:
        system: What is controlled.
        motion: States of what it integrates at the times of the plan.
        slopes: Its joints among the coordinates, and what they say of the others.
        box: Efforts that inputs can have.
        hold: How long the plan holds its end [s].
        demands: Numbers of the forces of contacts that are held, which stay positive.
    """

    def __init__(
        self,
        system: System,
        motion: Sequence[State],
        plan: TrackingPlan,
        slopes: IndependentSlopes,
        box: EffortBox,
        hold: float = 0.0,
        demands: Sequence[Crossing] = (),
    ) -> None:
        self._system, self._motion, self._plan = system, motion, plan
        self._slopes, self._chosen, self._box = slopes, slopes.chosen, box
        self._hold, self._demands = hold, tuple(demands)
        self._accelerate, self._rates = system.accelerator(), np.zeros((4, system.nv))

    def after(self, i: int, e: Array, limit: float, fastest: float) -> Outcome:
        """The motion to the end from sample i with the deviation e, shape (2 d,).

        Args:
            i: Number of the sample at which it is disturbed.
            e: Deviation of the independent coordinates, then of their velocities.
            limit: Cost to go at which the motion is given up.
            fastest: Rate of the loop that steps resolve [1/s].
        """
        y = self._slopes.beside(self._motion[i], e)
        try:
            y = assemble(self._system, y) if self._system.held.rows else y
        except SolveError:
            return Outcome(math.inf, math.inf)
        end = self._plan.end + self._hold
        count = max(1, math.ceil((end - y.t) / min(_LONGEST, _STEP / fastest)))
        h, largest, cost = (end - y.t) / count, 0.0, math.inf
        for _ in range(count + 1):
            cost, u = self._answer(y)
            largest = max(largest, cost)
            if not (largest <= limit and self._is_held(y, u)):
                return Outcome(math.inf, math.inf)
            y = self._stepped(y, u, h)
        return Outcome(largest, cost)

    def _answer(self, y: State) -> tuple[float, Array]:
        """Cost to go, and the efforts."""
        wanted = self._plan.at(y.t)
        e = np.concatenate([y.q[self._chosen] - wanted.q, y.v[self._chosen] - wanted.v])
        u = np.clip(wanted.u - wanted.gain.dot(e), self._box.lower, self._box.upper)
        return float(e.dot(wanted.cost).dot(e)), u

    def _is_held(self, y: State, u: Array) -> bool:
        """Whether contacts that are held push and stick under some efforts."""
        if not self._demands:
            return True
        return bool((held_room(self._system, self._demands, y, u) >= 0.0).all())

    def _stepped(self, y: State, u: Array, h: float) -> State:
        """A classical Runge-Kutta step with held inputs."""
        a, integrate = self._rates, self._system.chart.integrate
        self._accelerate(y.t, y.q, y.v, u, a[0])
        v1 = y.v + 0.5 * h * a[0]
        self._accelerate(y.t, integrate(y.q, 0.5 * h * y.v), v1, u, a[1])
        v2 = y.v + 0.5 * h * a[1]
        self._accelerate(y.t, integrate(y.q, 0.5 * h * v1), v2, u, a[2])
        v3 = y.v + h * a[2]
        self._accelerate(y.t, integrate(y.q, h * v2), v3, u, a[3])
        speed = (y.v + 2.0 * (v1 + v2) + v3) / 6.0
        v = y.v + h / 6.0 * (a[0] + 2.0 * (a[1] + a[2]) + a[3])
        return y._replace(t=y.t + h, q=integrate(y.q, h * speed), v=v)


class Outcome(NamedTuple):
    """What a disturbed motion does.

    Attributes:
        largest: Largest cost to go on its way; inf where it is lost.
        last: Cost to go at its end.
    """

    largest: float
    last: float


def held_room(system: Any, crossings: Sequence[Crossing], y: State, u: Array) -> Array:
    """Numbers of forces at a state of what is integrated, positive while contacts are held.

    Args:
        system: The system that holds them.
        crossings: The numbers, shape (n,).
    """
    x, k = system.expand(y), system.k
    lam, found = system.evaluate(x, u).lam, []
    for crossing in crossings:
        k.refresh(x.q, x.v, crossing.reads)
        found.append(crossing.value(k, x, lam))
    return np.array(found)
