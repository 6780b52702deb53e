"""Motion that two families of methods agree on, and for how long it can be told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from mbd_ros.applications.report.stability.scene_text import Entry, LoadedScene
from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError, SolveError
from mbd_ros.methods.integration.linear_motion import LinearMotion, fastest_rate, linear_motion
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation


class Grid(NamedTuple):
    """Times at which motions are compared: 0, interval, .., count * interval [s]."""

    interval: float
    count: int

    @property
    def span(self) -> float:
        """Last time [s]."""
        return self.interval * self.count


class Motion(NamedTuple):
    """A run.

    Attributes:
        states: Those on the grid.
        reason: Why there are not more of them; empty if there are all.
        every: All states, one a step.
    """

    states: list[State]
    reason: str
    every: Sequence[State] = ()


Known = Callable[[Grid], Motion]
_PRECISE = 1.0e-12
_FIRST = {"type": "dop853"}
_SECOND = {"type": "gauss_legendre", "stages": 3}
_THIRD = {"type": "dopri5", "tolerance": 1.0e-7}  # where Newton finds no stops
_LONG = {"type": "dopri5", "tolerance": 1.0e-9}  # where motions are long, and smooth
_TOLERANCES = (1.0e-9, 1.0e-7)  # rows that jump may not allow the first
_GROWTH = {"type": "dopri5", "tolerance": 1.0e-6}
FINE = 4
_ON_TIME = 1.0e-6  # of a quarter of an interval
AGREED = 1.0e-4  # difference of the two, relative, up to which errors of cells can be told
_NEAR = 100.0  # times as much, from where a tolerance that much smaller is worth its time
_TOLD = 1.0e3  # growth of a perturbation up to which a motion is compared
_PERTURBATION = 1.0e-4
_PER_RATE = 0.4  # first step of the second method, in 1 / rate
LEAST_RATE = 1.0e-3  # [1/s], of a scene in which nothing has one
_STEPS = 2_000  # more than that are not made for a second opinion


class Reference(NamedTuple):
    """A motion, and how far it can be trusted.

    Attributes:
        states: States of all joints, fewer than times if it stopped.
        fine: The same at a quarter of the interval.
        horizon: How many of them can be compared with: up to there both methods agree, and a
            perturbation does not grow beyond 1e3.
        uncertain: Largest relative difference of both methods up to there.
        growth: Growth of a perturbation at the horizon.
        second: Type of the method that agrees.
        size: Size of the motion: largest change of a position, largest velocity.
        reason: Why it stopped; empty if it did not.
        rates: Fastest rates at the start and anywhere on the grid [1/s].
    """

    grid: Grid
    states: list[State]
    fine: list[State]
    horizon: int
    uncertain: float
    growth: float
    second: str
    size: tuple[float, float]
    reason: str
    rates: tuple[float, float]

    @property
    def known(self) -> list[State]:
        """States that can be compared with, at every quarter of an interval."""
        return self.fine[: FINE * (self.horizon - 1) + 1] if self.horizon else []

    def quarter(self, x: State) -> int | None:
        """How many quarters of an interval a state is after the start; None between them."""
        quarters = (x.t - self.fine[0].t) * FINE / self.grid.interval
        return round(quarters) if abs(quarters - round(quarters)) < _ON_TIME else None


def reference(scene: Scene, grid: Grid, known: Known | None = None) -> Reference:
    """The reference motion of a scene.

    Args:
        known: Gives the motion by other equations than those of the scene.

    Raises:
        MbdError: It cannot even begin.
    """
    rate = starting_rate(scene)
    fine = Grid(grid.interval / FINE, FINE * grid.count)
    longest_motion = first(scene, fine) if known is None else known(fine)
    if not longest_motion.states:
        raise SolveError(f"the reference does not begin: {longest_motion.reason}")
    states = longest_motion.states[::FINE]
    rates = rate, _largest_rate(scene, states, rate)
    size = _size(scene, states)
    growth = _growth(scene, grid, states, size)
    tame = sum(g <= _TOLD for g in growth)  # it never falls
    shorter = Grid(grid.interval, max(1, tame - 1))
    difference, second = _second(scene, shorter, states[:tame], size, rates[1])
    told = [d <= AGREED for d in difference[:tame]]
    horizon = told.index(False) if False in told else len(told)
    return Reference(
        grid=grid,
        states=states,
        fine=longest_motion.states,
        horizon=horizon,
        uncertain=max(difference[:horizon], default=np.inf),
        growth=growth[horizon - 1] if horizon else np.inf,
        second=second,
        size=size,
        reason=longest_motion.reason,
        rates=rates,
    )


def _largest_rate(scene: Scene, states: list[State], rate: float) -> float:
    system = scene.system()
    for x in states[:: max(1, len(states) // 4)]:
        rate = max(rate, fastest_rate(system, system.reduce(x)))
    return rate


def _size(scene: Scene, states: list[State]) -> tuple[float, float]:
    model = scene.robot.model
    moved = [float(np.abs(pin.difference(model, states[0].q, x.q)).max()) for x in states]
    speed = [float(np.abs(x.v).max()) for x in states]
    return max(1.0e-4, *moved), max(1.0e-3, *speed)


def _growth(
    scene: Scene, grid: Grid, states: list[State], size: tuple[float, float]
) -> list[float]:
    """How much a perturbation of the first velocities grows, at every time."""
    x = scene.initial
    signs: Array = np.where(np.arange(len(x.v)) % 3 == 0, -1.0, 1.0)
    v = x.v + _PERTURBATION * size[1] * signs
    near = motion(scene, _GROWTH, grid.interval, grid, start=State(x.t, x.q, v)).states
    away = [distance(scene, a, b, size) for a, b in zip(states, near, strict=False)]
    first = max(away[0], 1.0e-3 * _PERTURBATION) if away else 1.0
    return list(np.maximum.accumulate([d / first for d in away])) if away else []


def distance(scene: Scene, a: State, b: State, size: tuple[float, float]) -> float:
    """Difference of two states relative to the size of the motion; inf for NaN."""
    dq = pin.difference(scene.robot.model, a.q, b.q)
    away = max(np.abs(dq).max() / size[0], np.abs(a.v - b.v).max() / size[1])
    return float(away) if away < np.inf else np.inf


def _second(
    scene: Scene,
    grid: Grid,
    states: list[State],
    size: tuple[float, float],
    rate: float,
) -> tuple[list[float], str]:
    """How far another method is from these states at every time, and its name.

    Args:
        grid: The times, as long as a perturbation does not grow.
        states: The first motion there.
        size: Size of the motion.
        rate: Fastest rate [1/s].
    """
    step = _fitting(grid.interval, _PER_RATE / rate)
    closest, name = [np.inf], ""
    methods = [(_SECOND, step)] if step * _STEPS > grid.span else []
    is_smooth = all(part.law.is_rigid for part in scene.constraints)
    for method, dt in (*methods, (_THIRD, grid.interval), (_LONG, grid.interval)):
        if method is _LONG and not (is_smooth and max(closest) <= _NEAR * AGREED):
            break
        found = motion(scene, method, dt, grid).states
        pairs = zip(states, found, strict=False)
        away = [distance(scene, a, b, size) for a, b in pairs]
        if max(away, default=np.inf) <= AGREED and len(away) == len(states):
            return away, str(method["type"])
        if sum(d <= AGREED for d in away) > sum(d <= AGREED for d in closest):
            closest, name = away, str(method["type"])
    return closest, name


def _fitting(interval: float, dt: float) -> float:
    """A whole fraction of the interval, at most dt."""
    return interval / max(1, int(np.ceil(interval / dt - 1.0e-9)))


def first(scene: Scene, grid: Grid) -> Motion:
    """Motion with the smallest tolerance that goes furthest."""
    longest = Motion([], "")
    for tolerance in _TOLERANCES:
        further = motion(scene, {**_FIRST, "tolerance": tolerance}, grid.interval, grid)
        if not longest.states or len(further.states) > len(longest.states):
            longest = further
        if not further.reason:
            break
    return longest


def starting_rate(scene: Scene) -> float:
    """Fastest rate at the start, which the recommended step follows from [1/s]."""
    return max(starting_motion(scene).rate, LEAST_RATE)


def starting_motion(scene: Scene) -> LinearMotion:
    """The motion around the start."""
    system = scene.system()
    return linear_motion(system, assemble(system, system.reduce(scene.initial)))


def elsewhere(load: Callable[[], LoadedScene], solver: str) -> Known:
    """Motion of a scene with the same joints at another place, under another tier."""

    def known(grid: Grid) -> Motion:
        method = {"type": "dop853", "tolerance": _PRECISE}
        return motion(load().scene, method, grid.interval, grid, solver)

    return known


def rotor(moments: Sequence[float], rates: Sequence[float]) -> Known:
    """A free rotor on hinges z, y, x from angles 0, by Euler's equations in body axes.

    I w' = (I w) x w, and w = (c' - a' sin b, b' cos c + a' cos b sin c, a' cos b cos c - b' sin c)
    of the angles a, b, c.

    Args:
        moments: Principal moments of inertia [kg·m^2], shape (3,).
        rates: First rates of the angles [rad/s], shape (3,).
    """
    inertia = np.array(moments)

    def angular_rates(y: Array) -> Array:
        (_, b, c), (x, across, along) = y[:3], y[3:]
        a_rate = (across * np.sin(c) + along * np.cos(c)) / np.cos(b)
        b_rate = across * np.cos(c) - along * np.sin(c)
        return np.array([a_rate, b_rate, x + a_rate * np.sin(b)])

    def slope(_: float, y: Array) -> Array:
        w = y[3:]
        return np.concatenate([angular_rates(y), np.cross(inertia * w, w) / inertia])

    def known(grid: Grid) -> Motion:
        times = np.linspace(0.0, grid.span, grid.count + 1)
        start, span = np.array([0.0, 0.0, 0.0, *rates[::-1]]), (0.0, grid.span)
        found = solve_ivp(slope, span, start, "DOP853", times, rtol=_PRECISE, atol=_PRECISE)
        rows = zip(found.t.tolist(), found.y.T, strict=True)
        return Motion([State(t, y[:3].copy(), angular_rates(y)) for t, y in rows], "")

    return known


def motion(
    scene: Scene, method: Entry, dt: float, grid: Grid, solver: str = "plain", **others: Any
) -> Motion:
    """Run a scene and keep the states on a grid.

    Args:
        dt: A whole fraction of the interval [s], or a longer step than half of it, whose states
            are all kept.
        grid: When to keep states.
        **others: `start`: state to begin with; `stabilization`: entry.
    """
    states: list[State] = []
    every = max(1, round(grid.interval / dt))
    try:
        start = others.pop("start", scene.initial)
        simulation = build_simulation(
            scene, integrator=method, dt=dt, solver={"type": solver}, **others
        )
        for x in simulation.run(start, grid.span):
            states.append(x)
    except MbdError as error:
        return Motion(states[::every], f"{type(error).__name__}: {error}", states)
    return Motion(states[::every], "", states)
