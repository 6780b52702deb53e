"""Contact problems with known solutions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import lambertw

from mbd_ros.core.state import Array

GROUND = "ground"
CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
_ZERO = (0.0, 0.0, 0.0)
GRAVITY = 9.81  # m/s^2
_RESTS = 1.0e-12  # m/s
_DOWN = (0.0, 0.0, -GRAVITY)
_INCLINES: Mapping[str, tuple[float, float, float]] = {  # degrees, mu, first speed uphill
    "incline_stick": (15.0, 0.3, 0.0),
    "incline_slip": (30.0, 0.3, 0.0),
    "incline_up_stick": (20.0, 0.5, 3.0),
    "incline_up_back": (30.0, 0.3, 3.0),
    "incline_down_stick": (15.0, 0.3, -0.5),
}
_QUICK = ("incline_up_stick", "stuck_box")
_BOX = (0.2, 0.2, 0.1)  # m
_HALVINGS = 60


class Problem(NamedTuple):
    """A contact problem with its true solution.

    Attributes:
        name: Letters, digits and underscores.
        gravity: [m/s^2], shape (3,).
        solids: From the lowest up.
        pairs: Upper and lower solid, or `GROUND`: the half space z <= 0.
        mu: Coefficient of friction of every pair.
        restitution: Of every pair.
        times: Samples [s].
        error: Largest error of a run, in `unit`.
        unit: Of the error.
        demanded: Error that this package must reach, in `unit`.
        is_smooth: Whether nothing but smooth gaps occurs, so that events can be exact.
        has_forces: Whether the error is one of forces.
    """

    name: str
    gravity: tuple[float, float, float]
    solids: tuple[Solid, ...]
    pairs: tuple[tuple[str, str], ...]
    mu: float
    restitution: float
    times: tuple[float, ...]
    error: Callable[[Trace], float]
    unit: str
    demanded: float
    is_smooth: bool = True
    has_forces: bool = False


class Solid(NamedTuple):
    """A free rigid body.

    Attributes:
        mass: [kg].
        shape: `sphere`, `box`, or `feet`: points below a box.
        size: Radius, or three lengths [m].
        at: Middle of the shape [m], shape (3,).
        v: Velocity of the middle [m/s], shape (3,).
        spin: Angular velocity in the world [rad/s], shape (3,).
        centre: Mass centre, from the middle [m], shape (3,).
        rpy: First attitude [rad], shape (3,).
        legs: Number of feet: below the corners, or around the largest ellipse if not four.
        is_free: Whether it moves.
    """

    name: str
    mass: float
    shape: str
    size: tuple[float, ...]
    at: tuple[float, float, float]
    v: tuple[float, float, float] = _ZERO
    spin: tuple[float, float, float] = _ZERO
    centre: tuple[float, float, float] = _ZERO
    rpy: tuple[float, float, float] = _ZERO
    legs: int = 4
    is_free: bool = True

    @property
    def moments(self) -> Array:
        """Principal moments about the mass centre, those of a homogeneous shape [kg·m^2]."""
        if self.shape == "sphere":
            return np.full(3, 0.4 * self.mass * self.size[0] ** 2)
        square = np.square(self.size)
        return self.mass / 12.0 * (square.sum() - square)

    @property
    def feet(self) -> Array:
        """Lower corners, or points of an ellipse between them, from the middle [m]."""
        angles = 2.0 * np.pi * np.arange(self.legs) / self.legs
        around = CORNERS if self.legs == 4 else np.column_stack((np.cos(angles), np.sin(angles)))
        half = 0.5 * np.array(self.size)
        return np.array([(x * half[0], y * half[1], -half[2]) for x, y in around])


class Trace(NamedTuple):
    """A run at the samples.

    Attributes:
        x: Middles of the solids that are free [m], shape (times, solids, 3).
        v: Their velocities [m/s], the same shape.
        spin: Their angular velocities in the world [rad/s], the same shape.
        forces: Normal forces at the end [N], where the problem asks for them: one a pair, or one
            a foot in their order.
    """

    x: Array
    v: Array
    spin: Array
    forces: Array


def problems(quick: bool) -> list[Problem]:
    """All, or two of them."""
    every = [
        *(_incline(name, *case) for name, case in _INCLINES.items()),
        *(_curve(), _rolling("sphere", 0.0), _rolling("sphere_backspin", -60.0)),
        *(_bounce(), stuck(), dropped(), _stack(), _table()),
    ]
    return [p for p in every if p.name in _QUICK] if quick else every


def _incline(name: str, degrees: float, mu: float, speed: float) -> Problem:
    times = _samples(3.0, 15)
    known = np.array([incline(t, degrees, mu, speed)[0] for t in times])

    def error(run: Trace) -> float:
        return float(np.abs(run.x[:, 0, 0] - known).max())

    block = _block((speed, 0.0, 0.0))
    return _problem(name, block, mu, times, gravity=_tilted(degrees), error=error)


def _samples(span: float, count: int) -> tuple[float, ...]:
    return tuple(round(span * (k + 1) / count, 9) for k in range(count))


def incline(t: float, degrees: float, mu: float, speed: float) -> tuple[float, float]:
    """A block on an incline: way and speed uphill.

    Args:
        t: Time [s].
        degrees: Angle of the incline.
        mu: Coefficient of friction.
        speed: First speed uphill [m/s].

    Returns:
        Way [m] and speed [m/s].
    """
    angle = math.radians(degrees)
    pull, rub = GRAVITY * math.sin(angle), mu * GRAVITY * math.cos(angle)
    sign = math.copysign(1.0, speed) if speed else 0.0
    slowing = pull * sign + rub  # along the slip
    if speed == 0.0 or slowing <= 0.0:
        end, way = (0.0, 0.0) if speed == 0.0 else (math.inf, 0.0)
    else:
        end, way = abs(speed) / slowing, sign * speed**2 / (2.0 * slowing)
    if t < end:
        return speed * t - 0.5 * sign * slowing * t**2, speed - sign * slowing * t
    downhill = min(0.0, rub - pull)
    return way + 0.5 * downhill * (t - end) ** 2, downhill * (t - end)


def _block(v: Sequence[float] = (0.0, 0.0, 0.0), height: float = 0.0) -> Solid:
    x, y, z = v
    return Solid("box", 2.0, "box", _BOX, (0.0, 0.0, 0.5 * _BOX[2] + height), (x, y, z))


def _problem(name: str, solid: Solid, mu: float, times: Sequence[float], **others: Any) -> Problem:
    """One solid on the ground."""
    given = {"gravity": _DOWN, "restitution": 0.0, "unit": "m", "demanded": 1e-10, **others}
    pairs = ((solid.name, GROUND),)
    return Problem(name=name, solids=(solid,), pairs=pairs, mu=mu, times=tuple(times), **given)


def _tilted(degrees: float) -> tuple[float, float, float]:
    """Gravity seen from an incline whose x points uphill."""
    angle = np.deg2rad(degrees)
    return (-GRAVITY * float(np.sin(angle)), 0.0, -GRAVITY * float(np.cos(angle)))


def _curve() -> Problem:
    """Friction is isotropic: a block that slides around a bend."""
    times, degrees, speed = _samples(2.0, 10), 30.0, 2.0
    known = np.array([bend(t, degrees, speed) for t in times])

    def error(run: Trace) -> float:
        return float(np.abs(run.x[:, 0, :2] - known).max())

    _, _, down = _tilted(degrees)
    gravity = (0.0, -_tilted(degrees)[0], down)
    mu = float(np.tan(np.deg2rad(degrees)))
    block, more = _block((speed, 0.0, 0.0)), {"gravity": gravity, "demanded": 1e-8}
    return _problem("bend", block, mu, times, error=error, **more)


def bend(t: float, degrees: float, speed: float) -> tuple[float, float]:
    """A block that starts sideways on an incline whose mu is the tangent of its angle.

    With the half angle's tangent u of the velocity against the line of steepest slope and
    a = g sin(angle), the equation of motion is v0 u' = -2 a u / (1 + u^2), from u = 1.

    Args:
        t: Time [s].
        degrees: Angle of the incline.
        speed: First speed v0 sideways [m/s].

    Returns:
        Way sideways and downhill [m].
    """
    a = GRAVITY * math.sin(math.radians(degrees))
    u = math.sqrt(float(np.real(lambertw(math.exp(1.0 - 4.0 * a * t / speed)))))
    way = speed**2 / (2.0 * a)
    return way * (4.0 / 3.0 - u - u**3 / 3.0), 0.5 * way * (-math.log(u) - (1.0 - u**4) / 4.0)


def _rolling(name: str, spin: float) -> Problem:
    times, radius, mu, speed = _samples(3.0, 15), 0.1, 0.2, 5.0
    known = np.array([rolling(t, speed, spin, mu, radius) for t in times])

    def error(run: Trace) -> float:
        return float(np.abs(run.x[:, 0, 0] - known).max())

    ball = Solid("ball", 1.0, "sphere", (radius,), (0.0, 0.0, radius), (speed, 0.0, 0.0))
    return _problem(name, ball._replace(spin=(0.0, spin, 0.0)), mu, times, error=error)


def rolling(t: float, speed: float, spin: float, mu: float, radius: float) -> float:
    """Way of a homogeneous sphere that slides until it rolls [m].

    Args:
        t: Time [s].
        speed: First speed of the centre [m/s].
        spin: First spin, with the sign of rolling forward [rad/s].
        mu: Coefficient of friction.
        radius: [m].
    """
    slip = speed - spin * radius
    braking = math.copysign(mu * GRAVITY, slip)
    slides = min(t, abs(2.0 * slip / (7.0 * mu * GRAVITY)))
    way = speed * slides - 0.5 * braking * slides**2
    return way + (speed - braking * slides) * (t - slides)


def _bounce() -> Problem:
    times, radius, e = _samples(5.0, 25), 0.1, 0.8
    known = np.array([bounce(t, 1.0, e) for t in times])

    def error(run: Trace) -> float:
        return float(np.abs(run.x[:, 0, 2] - radius - known).max())

    ball = Solid("ball", 1.0, "sphere", (radius,), (0.0, 0.0, radius + 1.0))
    return _problem("bounce", ball, 0.0, times, restitution=e, error=error, demanded=1e-9)


def bounce(t: float, height: float, e: float) -> float:
    """Height of a ball that falls from rest and bounces [m].

    Args:
        t: Time [s].
        height: Of its start [m].
        e: Restitution, below 1.
    """
    fall = math.sqrt(2.0 * height / GRAVITY)
    if t <= fall:
        return height - 0.5 * GRAVITY * t**2
    speed, begin = e * GRAVITY * fall, fall
    while speed > _RESTS and begin + 2.0 * speed / GRAVITY < t:
        begin, speed = begin + 2.0 * speed / GRAVITY, e * speed
    if speed < _RESTS:
        return 0.0
    return speed * (t - begin) - 0.5 * GRAVITY * (t - begin) ** 2


def stuck() -> Problem:
    """A box of four contact points that should not creep; the error is its speed."""
    times = _samples(4.0, 2)

    def error(run: Trace) -> float:
        early, late = run.x[:, 0, :2]
        return float(np.linalg.norm(late - early)) / (times[1] - times[0])

    more = {"gravity": _tilted(15.0), "unit": "m/s", "demanded": 1e-11}
    return _problem("stuck_box", _block(), 0.3, times, error=error, **more)


def dropped() -> Problem:
    """A box that falls flat from 0.5 m; the error is its penetration at rest."""
    times = _samples(2.0, 2)

    def error(run: Trace) -> float:
        return float(abs(run.x[-1, 0, 2] - 0.5 * _BOX[2]))

    return _problem("dropped_box", _block(height=0.5), 0.3, times, error=error, demanded=1e-9)


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
    more = {"unit": "relative", "demanded": 1e-9, "is_smooth": False, "has_forces": True}
    return Problem("stack", _DOWN, solids, pairs, 0.5, 0.0, times, error, **more)


def _table() -> Problem:
    """Four legs carry a load beside the middle: forces are split as those of equal springs."""
    table, load, place, length = 4.0, 1.0, (0.5, -0.25), 1.0
    known = legs(table, load, place)
    mass = table + load
    x, y = (0.5 * length * load / mass * s for s in place)

    def error(run: Trace) -> float:
        return float(np.abs(run.forces / known - 1.0).max())

    feet = Solid("table", mass, "feet", (length, length, 0.7), (0.0, 0.0, 0.35))
    feet, times = feet._replace(centre=(x, y, 0.0)), _samples(1.0, 1)
    more = {"unit": "relative", "demanded": 1e-9, "has_forces": True}
    return _problem("table", feet, 0.5, times, error=error, **more)


def legs(table: float, load: float, place: Sequence[float]) -> Array:
    """Forces of four legs at the corners (1, 1), (-1, 1), (-1, -1), (1, -1), those of least norm.

    Args:
        table: Mass of the table, centred [kg].
        load: Mass on it [kg].
        place: Of the load, in half lengths of the table, shape (2,).

    Returns:
        [N], shape (4,).
    """
    x, y = place
    signs = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    shares: Array = 0.25 * GRAVITY * (table + load * (1.0 + signs.dot((x, y))))
    return shares


def penetration(problem: Problem, run: Trace) -> float:
    """Depth of the lowest solid in the ground at the end [m]."""
    lowest = problem.solids[0]
    rest = lowest.size[0] if lowest.shape == "sphere" else 0.5 * lowest.size[2]
    return max(0.0, rest - float(run.x[-1, 0, 2]))


def damping_ratio(restitution: float) -> float:
    """Damping ratio of the contact that gives back a share of the speed of an impact.

    The contact ends when its force vanishes, not when its gap does.

    Args:
        restitution: From 0 to 1; 0 gives critical damping.

    Source: T. Schwager, T. Pöschel, Granular Matter 9, 2007, 465-469, eq. 21.
    """
    if restitution == 0.0:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        ratio = 0.5 * (low + high)
        low, high = (ratio, high) if _restitution(ratio) > restitution else (low, ratio)
    return 0.5 * (low + high)


def _restitution(ratio: float) -> float:
    """With damping beta and frequency omega, both in units of the undamped frequency."""
    beta, omega = ratio, math.sqrt(1.0 - ratio**2)
    phase = math.pi - math.atan2(2.0 * beta * omega, omega**2 - beta**2)
    return math.exp(-beta / omega * phase)
