"""Warnings of `simulate`: step size, residuals of contacts, stiffness of contacts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.complementarity.contact_problem import Residuals
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY, TOGGLE_RISE
from mbd_ros.errors import SolveError
from mbd_ros.files.table import Column, Table
from mbd_ros.methods.events.step_events import Event
from mbd_ros.methods.integration.linear_motion import (
    LinearMotion,
    is_bounded,
    linear_motion,
    longest_step,
)
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.integration.stiffness_window import longest, pressed_motion
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.describe.stiffness_windows import (
    depth_doubts,
    window_doubts,
    window_text,
    windows_at,
)

_RATE_SAMPLES = 8  # states whose fastest rate is computed, besides the last one
_FOLD_SAMPLES = 2_000  # states whose constraint rows are factorised
_AT_REST = 1.0e-9  # of the velocity of a free fall of the same duration
_TURN = 0.5  # change of velocity in a step, of the largest one in the motion
UNITS = {"primal": "m/s", "dual": "N·s", "cone": "N·s", "correction": "m/s"}
_WINDOW_SAMPLES = 8  # states whose stiffness window is computed
_DEPTH_SAMPLES = 2_000  # states whose penetration is checked


def step_warnings(
    system: System,
    method: Integrator,
    dt: float,
    states: Sequence[State],
    events: Sequence[Event] = (),
) -> Iterator[str]:
    """Yield warnings about the step; none for methods that choose their steps.

    Args:
        system: The simulated system.
        method: The integrator.
        dt: Step [s].
        states: States of all joints after each step.
        events: Events of the run, at which velocities may jump.
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
    """Return whether velocities may jump in each step, shape (len(states) - 1,)."""
    times = np.array([x.t for x in states])
    if method.at_velocity_level and system.layout.yielding:
        return np.ones(len(times) - 1, dtype=np.bool_)
    jumps = [event.t for event in events if (event.before.v != event.after.v).any()]
    has_jump = np.zeros(len(times) + 1, dtype=np.bool_)
    for side in ("left", "right"):  # an event at a sample belongs to both of its steps
        has_jump[np.searchsorted(times, jumps, side)] = True  # type: ignore[call-overload]
    return has_jump[1:-1]


def _stiffness(
    system: System, method: Integrator, dt: float, states: Sequence[State]
) -> Iterator[str]:
    samples, worst = (
        (*states[:: max(1, len(states) // _RATE_SAMPLES)], states[-1]),
        (math.inf, 0.0, 0.0),
    )
    for x in samples:
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
    """Return the linearised motion; None if a state nearby has no acceleration."""
    try:
        return linear_motion(system, system.reduce(x))
    except SolveError:
        return None


def _folds(system: System, states: Sequence[State]) -> Iterator[str]:
    """Yield a warning if the mechanism comes near a toggle, where it may change its branch."""
    if not system.bilateral.rows:
        return
    samples, conditions = states[:: 1 + len(states) // _FOLD_SAMPLES], []
    for x in samples:
        y = system.reduce(x)
        factor = system.bilateral.factor_at(y.t, y.q)
        conditions.append(factor.condition)
    known = [c for c in conditions if c < math.inf]
    if known and max(known) > TOGGLE_RISE * min(known):
        t = samples[conditions.index(max(known))].t
        yield (
            f"near a toggle at t = {t:.6g} s: the condition number of the rows rises "
            f"{max(known) / min(known):.0f}-fold; too long a step may change the branch there, so "
            "compare with a smaller dt or tolerance"
        )


def window_lines(
    simulation: Simulation, parts: Sequence[Any], states: Sequence[State]
) -> Iterator[str]:
    """Yield the stiffness window of each contact at the start, and warnings about the run.

    Args:
        simulation: The simulation after its run.
        parts: Compliant contacts.
        states: States of all joints.
    """
    system, method, dt = simulation.system, simulation.integrator, simulation.dt
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        begin = windows_at(system, parts, method, dt, states[0])
        yield from (f"window of {window_text(window, method, dt)}" for window in begin)
        warned = set()
        for window in begin:
            for text in window_doubts(window, method, dt):
                warned.add(window.part)
                yield f"warning: {text}"
        yield from (f"warning: {t}" for t in _outside(simulation, parts, states, warned))
        samples = states[:: 1 + len(states) // _DEPTH_SAMPLES]
        yield from (f"warning: {text}" for text in depth_doubts(system, parts, samples))


def _outside(
    simulation: Simulation, parts: Sequence[Any], states: Sequence[State], known: set[Any]
) -> Iterator[str]:
    """Yield a warning for each contact that became too stiff for the step during the run."""
    method, dt = simulation.integrator, simulation.dt
    for x in (*states[:: max(1, len(states) // _WINDOW_SAMPLES)], states[-1]):
        if known.issuperset(parts) or not method.is_explicit or method.stable == math.inf:
            return
        try:
            motion = pressed_motion(simulation.system, parts, x)
        except SolveError:
            continue
        if motion is None or not np.isfinite(motion.A).all():
            continue
        for group in motion.parted():
            new = {feature.part for feature in group.features} - known
            if new and not is_bounded(method, group.linear(), dt):
                known.update(new)
                names = ", ".join(part.name for part in parts if part in new)
                yield (
                    f"{names}: too stiff at t = {x.t:.6g} s for steps of {method.title} "
                    f"at dt {dt:g} s: they need dt < {longest(group, method, 1.0):.3g} s there"
                )


def with_residuals(table: Table, residuals: Sequence[Residuals]) -> Table:
    """Add columns of the largest contact residuals in the steps up to each sample.

    Args:
        table: One row per sample; the last samples may be missing.
        residuals: One entry per sample.
    """
    values = np.array(residuals[: table.rows]).reshape(-1, len(UNITS))
    columns = zip(UNITS.items(), values.T, strict=True)
    more = [Column(f"contacts.residual.{name}", values, unit) for (name, unit), values in columns]
    return Table([*table.columns, *more])


def residual_line(residuals: Sequence[Residuals]) -> str:
    """Return a line about the largest residuals of a run.

    Args:
        residuals: One entry per sample.
    """
    worst = np.array(residuals).max(axis=0)
    texts = (
        f"{name} {value:.2g} {unit}"
        for (name, unit), value in zip(UNITS.items(), worst, strict=True)
    )
    return f"largest residuals of contacts: {', '.join(texts)}"
