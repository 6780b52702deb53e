"""Extreme contact problems whose motion is known, and verdicts on them.

Rows are judged by closed forms, and by laws that need no other solution: no state has a number
that is not finite, lies in the ground, or has gained energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.contact import problems as closed_forms
from mbd_ros.applications.report.contact.ours import sample, scene_of, trace_of
from mbd_ros.applications.report.contact.problems import (
    CORNERS,
    GRAVITY,
    GROUND,
    Problem,
    Solid,
    Trace,
)
from mbd_ros.applications.report.stability.scene_text import Entry
from mbd_ros.applications.report.stability.scenes import item_name
from mbd_ros.applications.report.stability.verdicts import (
    ASKED,
    BOUNDED,
    CONVERGED,
    TIME_STEPPING,
    WRONG,
    Verdict,
    raised,
)
from mbd_ros.core.state import Array, State
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation

_PLATE = (1.0, 1.0, 0.02)  # m
_FLAT = 0.2  # m: largest thickness of a plate times mu; from its length on, friction tips it
_USUAL, _LONG = 1.0e-2, 1.0e-1  # s, steps
_DOWN = (0.0, 0.0, -GRAVITY)
_COUNT = 10  # samples
_Error = Callable[[Sequence[float], Trace], float]
CONTACT_METHODS: dict[str, Entry] = {
    "rk4": {"type": "rk4"},
    "dop853": {"type": "dop853", "tolerance": 1.0e-8},
    TIME_STEPPING: {"type": TIME_STEPPING},
}
_DEPTH = 1.0e-9  # of the largest length of a solid, in the ground
_GAIN = 1.0e-9  # of the energy of the motion, in one step
_QUARTERS, _BETTER = 3, 0.6  # shorter steps, and what one of them must leave of the error


def contact_rows(quick: bool) -> list[ContactRow]:
    """All rows, or one of each family."""
    families = (_masses, _frictions, _legs, _edges, _drops, _long_steps)
    found = [list(family()) for family in families]
    return [row for rows in found for row in (rows[:1] if quick else rows)]


def _masses() -> Iterator[ContactRow]:
    for ratio in (1.0e2, 1.0e4, 1.0e6):
        label = f"1 to {ratio:.0e}".replace("e+0", "e")
        for place, masses in (("on top", (1.0, 1.0, ratio)), ("below", (ratio, 1.0, 1.0))):
            stack = _stack(masses)
            yield ContactRow("contact, mass ratio", f"{label}, heavy {place}", stack)


def _stack(masses: Sequence[float], span: float = 0.2) -> Problem:
    """Boxes at rest, one above the other; they neither move nor share their weight wrongly."""
    size = (0.2, 0.2, 0.1)
    names = [f"box{i}" for i in range(len(masses))]
    solids = [
        Solid(name, mass, "box", size, (0.0, 0.0, (i + 0.5) * size[2]))
        for i, (name, mass) in enumerate(zip(names, masses, strict=True))
    ]
    places = np.array([solid.at for solid in solids])
    weights: Array = GRAVITY * np.cumsum(masses[::-1])[::-1]

    def error(times: Sequence[float], run: Trace) -> float:
        moved = float(np.abs(run.x - places).max()) / size[2]
        return max(moved, float(np.abs(run.forces / weights - 1.0).max()))

    pairs = tuple(zip(names, (GROUND, *names[:-1]), strict=True))
    problem = _problem(solids, 0.5, span, error)
    return problem._replace(pairs=pairs, is_smooth=False, has_forces=True)


def _problem(solids: Sequence[Solid], mu: float, span: float, error: _Error) -> Problem:
    """A problem of a lowest solid on the ground.

    Args:
        solids: From the lowest up.
        mu: Coefficient of friction.
        span: [s].
        error: Relative error of a run with samples at some times.
    """
    times = tuple(round(span * (k + 1) / _COUNT, 9) for k in range(_COUNT))
    name, pairs, own = solids[0].name, ((solids[0].name, GROUND),), partial(error, times)
    return Problem(name, _DOWN, tuple(solids), pairs, mu, 0.0, times, own, "relative", 0.0)


def _frictions() -> Iterator[ContactRow]:
    family = "contact, friction"
    cases = (("mu = 0", 30.0, 0.0, 3.0), ("mu = 1.5 sticks", 50.0, 1.5, 0.0))
    for label, degrees, mu, speed in (*cases, ("mu = 1.5 stops", 50.0, 1.5, 3.0)):
        yield ContactRow(family, label, _incline(degrees, mu, speed))
    for mu in (10.0, 100.0):
        yield ContactRow(family, f"steep cone, mu = {mu:g}", _incline(0.0, mu, 3.0))


def _incline(degrees: float, mu: float, speed: float, solid: Solid | None = None) -> Problem:
    """A plate on an incline whose x points uphill."""
    angle, way = math.radians(degrees), max(1.0, speed**2 / (2.0 * GRAVITY * max(mu, 0.5)))
    solid = solid or _plate(mu, speed)

    def error(times: Sequence[float], run: Trace) -> float:
        truth = [closed_forms.incline(t, degrees, mu, speed)[0] for t in times]
        off = run.x[:, 0] - np.array(solid.at)
        off[:, 0] -= truth
        return float(np.abs(off).max()) / way

    problem = _problem((solid,), mu, 2.0, error)
    return problem._replace(gravity=(-GRAVITY * math.sin(angle), 0.0, -GRAVITY * math.cos(angle)))


def _plate(mu: float, speed: float) -> Solid:
    """A plate that slides, so flat that friction at its lower side does not tip it."""
    length, width, usual = _PLATE
    thickness = min(usual, _FLAT / max(mu, _FLAT))
    size, at = (length, width, thickness), (0.0, 0.0, 0.5 * thickness)
    return Solid("plate", 2.0, "box", size, at, (speed, 0.0, 0.0))


def _legs() -> Iterator[ContactRow]:
    for legs in (4, 8, 16):
        table = Solid("table", 4.0, "feet", (1.0, 1.0, 0.2), (0.0, 0.0, 0.1), (2.0, 0.0, 0.0))
        problem = _incline(0.0, 0.4, 2.0, table._replace(legs=legs))
        yield ContactRow("contact, redundant", f"{legs} legs slide and stop", problem)


def _edges() -> Iterator[ContactRow]:
    """A box falls with an edge on that of another one, across it, and stays there."""
    side, fall, quarter = 0.2, 0.05, 0.25 * math.pi
    edge = side / math.sqrt(2.0)  # height of an edge over the middle
    lower = Solid("lower", 1.0, "box", (1.0, side, side), (0.0, 0.0, 0.0), rpy=(quarter, 0.0, 0.0))
    at, rpy = (0.0, 0.0, 2.0 * edge + fall), (0.0, quarter, 0.0)
    upper = Solid("upper", 1.0, "box", (side, 1.0, side), at, rpy=rpy)
    rest = at[2] - fall

    def height(t: float) -> float:
        return max(rest, at[2] - 0.5 * GRAVITY * t**2)

    solids, pairs = (lower._replace(is_free=False), upper), (("upper", "lower"),)
    problem = _problem(solids, 0.5, 0.5, _height_error(height, fall))
    problem = problem._replace(pairs=pairs, is_smooth=False)
    yield ContactRow("contact, edge on edge", "falls 5 cm", problem)


def _height_error(known: Callable[[float], float], size: float) -> _Error:
    def error(times: Sequence[float], run: Trace) -> float:
        truth = np.array([known(t) for t in times])
        return float(np.abs(run.x[:, 0, 2] - truth).max()) / size

    return error


def _drops() -> Iterator[ContactRow]:
    plate = Solid("plate", 2.0, "box", _PLATE, (0.0, 0.0, 0.5 * _PLATE[2]))
    ball = Solid("ball", 2.0, "sphere", (0.1,), (0.0, 0.0, 0.1))
    for e, solid in ((0.0, plate), (0.5, ball)):
        label = f"{solid.name} from 100 m, e = {e:g}"
        yield ContactRow("contact, drop", label, _bounce(solid, 100.0, e, 6.0))


def _bounce(solid: Solid, height: float, e: float, span: float) -> Problem:
    """A solid that stands on the ground is let go above it."""
    x, y, rest = solid.at

    def known(t: float) -> float:
        return rest + closed_forms.bounce(t, height, e)

    lifted = solid._replace(at=(x, y, rest + height))
    problem = _problem((lifted,), 0.5, span, _height_error(known, height))
    return problem._replace(restitution=e)


def _long_steps() -> Iterator[ContactRow]:
    family = f"contact, steps of {_LONG:g} s"
    for label, degrees, mu, speed in (
        *(("up and stick", 20.0, 0.5, 3.0), ("up and back", 30.0, 0.3, 3.0)),
        ("mu = 1.5 stops", 50.0, 1.5, 3.0),
    ):
        yield ContactRow(family, label, _incline(degrees, mu, speed), _LONG)
    yield ContactRow(family, "stack 1 to 1e6", _stack((1.0, 1.0, 1.0e6), 1.0), _LONG)
    ball = Solid("ball", 1.0, "sphere", (0.1,), (0.0, 0.0, 0.1))
    yield ContactRow(family, "bounces of e = 0.8", _bounce(ball, 1.0, 0.8, 5.0), _LONG)


class ContactRow(NamedTuple):
    """One row of the map.

    Attributes:
        family: The extreme property.
        problem: The problem; its error is relative.
        dt: Step of all methods [s].
        seconds: About how long it takes.
    """

    family: str
    label: str
    problem: Problem
    dt: float = _USUAL
    seconds: float = 2.5

    @property
    def name(self) -> str:
        """Unique name of letters, digits, points and dashes."""
        return item_name(f"{self.family}-{self.label}")


def judge_contact(problem: Problem, method: str, dt: float) -> Verdict:
    """The verdict on one run.

    Args:
        problem: The problem; its error is relative.
        method: Key of `CONTACT_METHODS`.
        dt: Step, or with a tolerance longest first step [s].
    """
    try:
        scene = scene_of(problem)
        error, fault = _attempt(problem, scene, method, dt)
        if fault:
            return Verdict(WRONG, error, fault)
        if error <= ASKED:
            return Verdict(CONVERGED, error)
        shorter, fault = _shorter(problem, scene, method, dt, error)
    except Exception as error:  # noqa: BLE001 - every exception is a verdict
        verdict = raised(error)
        return verdict if _is_named(problem, str(error)) else verdict._replace(kind=WRONG)
    if fault:
        return Verdict(WRONG, error, fault)
    if shorter <= max(ASKED, _BETTER * error):
        return Verdict(BOUNDED, error)
    return Verdict(WRONG, error, f"off by {error:.3g}, and by {shorter:.3g} at shorter steps")


def _attempt(problem: Problem, scene: Scene, method: str, dt: float) -> tuple[float, str]:
    """The error of a run, and its first fault."""
    simulation = build_simulation(scene, integrator=CONTACT_METHODS[method], dt=dt)
    states = list(simulation.run(scene.initial, problem.times[-1]))
    if fault := faults(problem, scene, states):
        return math.inf, fault
    every = [states[round(t / dt)] for t in problem.times]
    return problem.error(trace_of(problem, simulation, every)), ""


def _shorter(
    problem: Problem, scene: Scene, method: str, dt: float, error: float
) -> tuple[float, str]:
    """The error at the first shorter step that is better, else at the last; its first fault."""
    smaller, fault = error, ""
    for k in range(1, _QUARTERS + 1):
        smaller, fault = _attempt(problem, scene, method, dt / 4**k)
        if fault or smaller <= max(ASKED, _BETTER * error):
            break
    return smaller, fault


def _is_named(problem: Problem, text: str) -> bool:
    """Whether a message names a time, a solid or a contact."""
    names = [*(solid.name for solid in problem.solids), "pair"]
    return "t = " in text or any(name in text for name in names)


def faults(problem: Problem, scene: Scene, states: Sequence[State]) -> str:
    """Return the first fault of a motion that shows without a solution; empty without any."""
    model = scene.robot.model
    data, before = model.createData(), math.inf
    size = max(length for solid in problem.solids for length in solid.size)
    energies = [_energy(model, data, x) for x in states]
    lift = sum(solid.mass for solid in problem.solids) * float(np.linalg.norm(problem.gravity))
    swing = max(float(np.ptp(energies)), max(_kinetic(model, data, x) for x in states))
    swing += lift * size
    for x, energy in zip(states, energies, strict=True):
        if not (np.isfinite(x.q).all() and np.isfinite(x.v).all()):
            return f"a state at t = {x.t:.6g} s is not finite"
        if energy > before + _GAIN * swing:
            return f"a step gains {energy - before:.3g} J of {swing:.3g} J at t = {x.t:.6g} s"
        if (depth := _depth(problem, x)) > _DEPTH * size:
            return f"something is {depth:.3g} m in the ground at t = {x.t:.6g} s"
        before = energy
    return ""


def _energy(model: pin.Model, data: pin.Data, x: State) -> float:
    return _kinetic(model, data, x) + float(pin.computePotentialEnergy(model, data, x.q))


def _kinetic(model: pin.Model, data: pin.Data, x: State) -> float:
    return float(pin.computeKineticEnergy(model, data, x.q, x.v))


def _depth(problem: Problem, x: State) -> float:
    """Depth of the lowest point of all solids that are free [m]; the ground is z <= 0."""
    free = [solid for solid in problem.solids if solid.is_free]
    if len(free) < len(problem.solids):  # on something else than the ground
        return -math.inf
    attitudes = [pin.XYZQUATToSE3(q).rotation for q in x.q.reshape(-1, 7)]
    middles = sample(problem, x)[0]
    heights = [
        float(middle[2] + _lowest(solid, R))
        for solid, middle, R in zip(free, middles, attitudes, strict=True)
    ]
    return -min(heights)


def _lowest(solid: Solid, R: Array) -> float:
    """Height of the lowest point of a solid over its middle [m]."""
    if solid.shape == "sphere":
        return -solid.size[0]
    if solid.shape == "feet":
        return float((solid.feet @ R.T)[:, 2].min())
    half = 0.5 * np.array(solid.size)
    corners = [(x, y, z) * half for x, y in CORNERS for z in (-1.0, 1.0)]
    return float((np.array(corners) @ R.T)[:, 2].min())


def contact_methods(problem: Problem) -> list[str]:
    """Methods that take a problem: events need gaps that are smooth."""
    return list(CONTACT_METHODS) if problem.is_smooth else [TIME_STEPPING]
