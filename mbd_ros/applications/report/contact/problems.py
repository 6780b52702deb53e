"""Contact problems with known solutions."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.applications.report.contact import closed_forms
from mbd_ros.applications.report.contact.closed_forms import GRAVITY
from mbd_ros.applications.report.contact.problem import GROUND, Problem, Solid, Trace

_DOWN = (0.0, 0.0, -GRAVITY)


def problems(quick: bool) -> list[Problem]:
    """All, or two of them."""
    every = [
        *(_incline(name, *case) for name, case in _INCLINES.items()),
        *(_curve(), _rolling("sphere", 0.0), _rolling("sphere_backspin", -60.0)),
        *(_bounce(), stuck(), dropped(), _stack(), _table()),
    ]
    return [p for p in every if p.name in _QUICK] if quick else every


_INCLINES: Mapping[str, tuple[float, float, float]] = {  # degrees, mu, first speed uphill
    "incline_stick": (15.0, 0.3, 0.0),
    "incline_slip": (30.0, 0.3, 0.0),
    "incline_up_stick": (20.0, 0.5, 3.0),
    "incline_up_back": (30.0, 0.3, 3.0),
    "incline_down_stick": (15.0, 0.3, -0.5),
}
_QUICK = ("incline_up_stick", "stuck_box")
_BOX = (0.2, 0.2, 0.1)  # m


def _block(v: Sequence[float] = (0.0, 0.0, 0.0), height: float = 0.0) -> Solid:
    x, y, z = v
    return Solid("box", 2.0, "box", _BOX, (0.0, 0.0, 0.5 * _BOX[2] + height), (x, y, z))


def _samples(span: float, count: int) -> tuple[float, ...]:
    return tuple(round(span * (k + 1) / count, 9) for k in range(count))


def _tilted(degrees: float) -> tuple[float, float, float]:
    """Gravity seen from an incline whose x points uphill."""
    angle = np.deg2rad(degrees)
    return (-GRAVITY * float(np.sin(angle)), 0.0, -GRAVITY * float(np.cos(angle)))


def _problem(name: str, solid: Solid, mu: float, times: Sequence[float], **others: Any) -> Problem:
    """One solid on the ground."""
    given = {"gravity": _DOWN, "restitution": 0.0, "unit": "m", "asked": 1e-10, **others}
    pairs = ((solid.name, GROUND),)
    return Problem(name=name, solids=(solid,), pairs=pairs, mu=mu, times=tuple(times), **given)


def _incline(name: str, degrees: float, mu: float, speed: float) -> Problem:
    times = _samples(3.0, 15)
    known = np.array([closed_forms.incline(t, degrees, mu, speed)[0] for t in times])

    def error(run: Trace) -> float:
        return float(np.abs(run.x[:, 0, 0] - known).max())

    block = _block((speed, 0.0, 0.0))
    return _problem(name, block, mu, times, gravity=_tilted(degrees), error=error)


def _curve() -> Problem:
    """Friction is isotropic: a block that slides around a bend."""
    times, degrees, speed = _samples(2.0, 10), 30.0, 2.0
    known = np.array([closed_forms.bend(t, degrees, speed) for t in times])

    def error(run: Trace) -> float:
        return float(np.abs(run.x[:, 0, :2] - known).max())

    _, _, down = _tilted(degrees)
    gravity = (0.0, -_tilted(degrees)[0], down)
    mu = float(np.tan(np.deg2rad(degrees)))
    block, more = _block((speed, 0.0, 0.0)), {"gravity": gravity, "asked": 1e-8}
    return _problem("bend", block, mu, times, error=error, **more)


def _rolling(name: str, spin: float) -> Problem:
    times, radius, mu, speed = _samples(3.0, 15), 0.1, 0.2, 5.0
    known = np.array([closed_forms.rolling(t, speed, spin, mu, radius) for t in times])

    def error(run: Trace) -> float:
        return float(np.abs(run.x[:, 0, 0] - known).max())

    ball = Solid("ball", 1.0, "sphere", (radius,), (0.0, 0.0, radius), (speed, 0.0, 0.0))
    return _problem(name, ball._replace(spin=(0.0, spin, 0.0)), mu, times, error=error)


def _bounce() -> Problem:
    times, radius, e = _samples(5.0, 25), 0.1, 0.8
    known = np.array([closed_forms.bounce(t, 1.0, e) for t in times])

    def error(run: Trace) -> float:
        return float(np.abs(run.x[:, 0, 2] - radius - known).max())

    ball = Solid("ball", 1.0, "sphere", (radius,), (0.0, 0.0, radius + 1.0))
    return _problem("bounce", ball, 0.0, times, restitution=e, error=error, asked=1e-9)


def stuck() -> Problem:
    """A box of four contact points that should not creep; the error is its speed."""
    times = _samples(4.0, 2)

    def error(run: Trace) -> float:
        early, late = run.x[:, 0, :2]
        return float(np.linalg.norm(late - early)) / (times[1] - times[0])

    more = {"gravity": _tilted(15.0), "unit": "m/s", "asked": 1e-11}
    return _problem("stuck_box", _block(), 0.3, times, error=error, **more)


def dropped() -> Problem:
    """A box that falls flat from 0.5 m; the error is its penetration at rest."""
    times = _samples(2.0, 2)

    def error(run: Trace) -> float:
        return float(abs(run.x[-1, 0, 2] - 0.5 * _BOX[2]))

    return _problem("dropped_box", _block(height=0.5), 0.3, times, error=error, asked=1e-9)


def _stack() -> Problem:
    """Three boxes, the heaviest on top: a mass ratio of 1e6; the error is one of forces."""
    masses, height = (1.0, 1.0, 1.0e6), _BOX[2]
    known = GRAVITY * np.cumsum(masses[::-1])[::-1]
    solids = tuple(
        Solid(f"box{i}", mass, "box", _BOX, (0.0, 0.0, (i + 0.5) * height))
        for i, mass in enumerate(masses)
    )
    pairs = tuple((s.name, b) for s, b in zip(solids, (GROUND, "box0", "box1"), strict=True))

    def error(run: Trace) -> float:
        return float(np.abs(run.forces / known - 1.0).max())

    times = _samples(1.0, 1)
    more = {"unit": "relative", "asked": 1e-9, "is_smooth": False, "has_forces": True}
    return Problem("stack", _DOWN, solids, pairs, 0.5, 0.0, times, error, **more)


def _table() -> Problem:
    """Four legs carry a load beside the middle: forces are split as those of equal springs."""
    table, load, place, length = 4.0, 1.0, (0.5, -0.25), 1.0
    known = closed_forms.legs(table, load, place)
    mass = table + load
    x, y = (0.5 * length * load / mass * s for s in place)

    def error(run: Trace) -> float:
        return float(np.abs(run.forces / known - 1.0).max())

    feet = Solid("table", mass, "feet", (length, length, 0.7), (0.0, 0.0, 0.35))
    feet, times = feet._replace(centre=(x, y, 0.0)), _samples(1.0, 1)
    more = {"unit": "relative", "asked": 1e-9, "has_forces": True}
    return _problem("table", feet, 0.5, times, error=error, **more)
