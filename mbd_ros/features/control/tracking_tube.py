"""The tube of a plan: deviations from which the gains lead back to it.

The tube is a level set of the cost to go, e' S e <= level. Random deviations of a level are
simulated under the gains and the limits of contacts; the level is halved until all of them return.
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

PassOn = Callable[[Iterable[Any]], Iterable[Any]]
_STEP = 0.2  # length of a step times the fastest rate of the loop
_LONGEST = 5.0e-3  # [s] of a step
_HALVINGS = 40  # of a level, at most
_LOST = 100.0  # times a level, at which a motion counts as lost
_MARGIN = 0.5  # of the level that every disturbance returned from
_REPEATED_MARGIN = 0.25  # the same for motions that only have to end in the tube
_RETURNED = 1.0e-3  # share of the level at which a motion has returned to rest


def tube_level(
    disturbed: DisturbedMotion,
    plan: TrackingPlan,
    largest: float,
    fastest: float,
    *,
    rests: bool,
    count: int = 48,
    seed: int = 0,
    with_progress: PassOn = iter,
) -> float:
    """Find a level of the cost to go from which random disturbances return.

    Each disturbance acts at a random sample of the plan.

    Args:
        disturbed: Simulation of motions beside the plan.
        plan: The plan.
        largest: Level at which the search starts; it is halved until all disturbances return.
        fastest: Fastest rate of the loop [1/s], which steps resolve.
        rests: Whether motions must come to rest at the end; otherwise they must end in the tube.
        count: Number of disturbances.
        seed: Seed of the random numbers.
        with_progress: Function that passes the disturbances of a level on, to show progress.

    Returns:
        The level; 0 if no disturbance returns.
    """
    rng, (n, m) = np.random.default_rng(seed), plan.cost.shape[:2]
    at, directions = rng.integers(0, n - 1, count), rng.normal(size=(count, m))
    level = largest
    for _ in range(_HALVINGS):
        for i, d in with_progress(zip(at.tolist(), directions, strict=True)):
            e = d * math.sqrt(level / float(d.dot(plan.cost[i]).dot(d)))
            outcome = disturbed.after(i, e, _LOST * level, fastest)
            if not outcome.last <= (_RETURNED if rests else 1.0) * level:
                break
        else:
            return (_MARGIN if rests else _REPEATED_MARGIN) * level
        level *= 0.5
    return 0.0


class DisturbedMotion:
    """Simulation under the gains of a plan, from states beside it, with inputs constant in a step.

    Args:
        system: The controlled system.
        motion: States that the system integrates, at the times of the plan.
        plan: The plan.
        slopes: Derivatives in the independent coordinates.
        box: Accepted efforts.
        hold: Time for which the plan holds its end [s].
        demands: Functions of the contact forces that must stay positive.
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
        """Simulate to the end from a sample with a deviation.

        Args:
            i: Index of the sample.
            e: Deviation of the independent coordinates, then of their velocities, shape (2 d,).
            limit: Cost to go at which the motion counts as lost.
            fastest: Fastest rate of the loop [1/s], which steps resolve.
        """
        y = self._slopes.beside(self._motion[i], e)
        try:
            y = assemble(self._system, y) if self._system.bilateral.rows else y
        except SolveError:
            return Outcome(math.inf, math.inf)
        end = self._plan.end + self._hold
        count = max(1, math.ceil((end - y.t) / min(_LONGEST, _STEP / fastest)))
        h, largest, cost = (end - y.t) / count, 0.0, math.inf
        for _ in range(count + 1):
            cost, u = self._cost_and_efforts(y)
            largest = max(largest, cost)
            if not (largest <= limit and self._keeps_contacts(y, u)):
                return Outcome(math.inf, math.inf)
            y = self._step(y, u, h)
        return Outcome(largest, cost)

    def _cost_and_efforts(self, y: State) -> tuple[float, Array]:
        """Return the cost to go, and the efforts of the gains."""
        wanted = self._plan.at(y.t)
        e = np.concatenate([y.q[self._chosen] - wanted.q, y.v[self._chosen] - wanted.v])
        u = np.clip(wanted.u - wanted.gain.dot(e), self._box.lower, self._box.upper)
        return float(e.dot(wanted.cost).dot(e)), u

    def _keeps_contacts(self, y: State, u: Array) -> bool:
        """Return whether closed contacts push and stick under these efforts."""
        if not self._demands:
            return True
        return bool((contact_clearance(self._system, self._demands, y, u) >= 0.0).all())

    def _step(self, y: State, u: Array, h: float) -> State:
        """Take a classical Runge-Kutta step with constant inputs."""
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
    """Result of a disturbed motion.

    Attributes:
        largest: Largest cost to go during the motion; inf if it is lost.
        last: Cost to go at its end; inf if it is lost.
    """

    largest: float
    last: float


def contact_clearance(system: Any, crossings: Sequence[Crossing], y: State, u: Array) -> Array:
    """Evaluate functions of the contact forces that are positive while contacts stay closed.

    Args:
        system: System that closes the contacts.
        crossings: The n functions.
        y: State that the system integrates.
        u: Inputs.

    Returns:
        Values of the functions, shape (n,).
    """
    x, k = system.expand(y), system.k
    lam, values = system.evaluate(x, u).lam, []
    for crossing in crossings:
        k.refresh(x.q, x.v, crossing.reads)
        values.append(crossing.value(k, x, lam))
    return np.array(values)
