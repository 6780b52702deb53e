"""Motion and forces of contact problems, in closed form."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import lambertw

from mbd_ros.core.state import Array

GRAVITY = 9.81  # m/s^2
_RESTS = 1.0e-12  # m/s


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
