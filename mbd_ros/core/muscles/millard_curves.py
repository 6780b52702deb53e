"""Curves of the muscle of Millard, normalised by peak force, optimal length and slack length.

Each is a `BezierCurve` through a few knots. What is not published of knots and slopes was found
from values and slopes of OpenSim's curves.

Source: M. Millard, T. Uchida, A. Seth, S. L. Delp, J. Biomech. Eng. 135, 2013, 021005,
doi:10.1115/1.4023390, sec. 2 and appendix.
"""

from typing import Any

from mbd_ros.core.muscles.curves import BezierCurve, Knot

Number = Any  # float, symbol or array
_SHOULDER = 0.05  # half of the plateau of the active curve
_STEEP = 1.25  # slope of the steep part per its mean slope
_FOOT = 0.1  # length of the toe of passive fibres per strain, and that of the tendon per toe
_STIFF = 1.375  # slope of the tendon per its mean slope
_NEAR = 0.9  # speed at which the force-velocity curve bends to its ends


class MillardCurves:
    """Forces of fibres and tendon.

    Args:
        active: Force-length curve of active fibres.
        passive: Force-length curve of passive fibres.
        tendon: Force-length curve of the tendon.
        damping: Of the fibres, force per speed.
    """

    def __init__(
        self,
        active: BezierCurve,
        passive: BezierCurve,
        tendon: BezierCurve,
        velocity: BezierCurve,
        damping: Number,
    ) -> None:
        self._active = active
        self._passive = passive
        self._tendon = tendon
        self._velocity = velocity
        self._damping = damping

    @property
    def key(self) -> Any:
        """Equal where curves are."""
        return self._active.key, self._passive.key, self._tendon.key, self._velocity.key

    @property
    def knots(self) -> tuple[tuple[Number, ...], ...]:
        """Knots of the active, the force-velocity and the passive curve."""
        curves = (self._active, self._velocity, self._passive)
        return tuple(tuple(knot.x for knot in curve.knots) for curve in curves)

    def active(self, k: Any, length: Number) -> Number:
        """Active force-length curve."""
        return self._active(k, length)

    def passive(self, k: Any, length: Number) -> Number:
        """Passive force-length curve."""
        return self._passive(k, length)

    def passive_area(self, k: Any, length: Number) -> Number:
        """Integral of the passive force over the length."""
        return self._passive.area(k, length)

    def tendon(self, k: Any, length: Number) -> Number:
        """Force of the tendon."""
        return self._tendon(k, length)

    def tendon_area(self, k: Any, length: Number) -> Number:
        """Integral of the tendon force over the length."""
        return self._tendon.area(k, length)

    def fiber(self, k: Any, a: Number, length: Number, speed: Number) -> Number:
        """Active force of fibres; arguments as in `ThelenCurves.fiber`."""
        return a * self._active(k, length) * self._velocity(k, speed)

    def speed(self, k: Any, a: Number, length: Number, force: Number) -> Number:
        """Speed at which fibres carry a force; arguments as in `ThelenCurves.speed`."""
        scale = a * self._active(k, length)
        rest = force - self._passive(k, length)
        return self._velocity.balanced(k, scale, self._damping, rest)

    def damping_force(self, speed: Number) -> Number:
        """Force of the damper beside the fibres."""
        return self._damping * speed


def active_curve(first: Number, bend: Number, last: Number, slope: Number) -> BezierCurve:
    """Active force-length curve: steep and shallow ascent, plateau at 1, descent.

    Args:
        first: Length at which force begins.
        bend: Length at which the steep ascent turns into the shallow one.
        last: Length at which force ends.
        slope: Of the shallow ascent.
    """
    left, right = 1.0 - _SHOULDER, 1.0 + _SHOULDER
    height = 1.0 - slope * (left - bend)
    knots = (
        Knot(first, 0.0, 0.0),
        Knot(0.5 * (first + bend), 0.5 * height, _STEEP * height / (bend - first)),
        Knot(0.5 * (bend + left), 0.5 * (height + 1.0), slope),
        Knot(1.0, 1.0, 0.0),
        Knot(0.5 * (right + last), 0.5, -1.0 / (last - _SHOULDER - right)),
        Knot(last, 0.0, 0.0),
    )
    return BezierCurve(knots, (1.0,) * 5)


def passive_curve(
    zero: float, unit_strain: float, low: Number, stiffness: float | None, curviness: Number
) -> BezierCurve:
    """Passive force-length curve.

    Args:
        zero: Strain at which force begins.
        unit_strain: Strain at which it is the peak force.
        low: Slope at the end of its toe.
        stiffness: Slope at the peak force; None for twice the mean one.
        curviness: 0 .. 1.
    """
    stiffness = 2.0 / (unit_strain - zero) if stiffness is None else stiffness
    toe = _FOOT * min(1.0 / stiffness, unit_strain - zero)
    knots = (
        Knot(1.0 + zero, 0.0, 0.0),
        Knot(1.0 + zero + toe, 0.5 * low * toe, low),
        Knot(1.0 + unit_strain, 1.0, stiffness),
    )
    return BezierCurve(knots, (curviness,) * 2)


def tendon_curve(
    strain: Number, stiffness: float | None, toe: Number, curviness: Number
) -> BezierCurve:
    """Force-length curve of the tendon.

    Args:
        strain: At the peak force.
        stiffness: Slope from the end of the toe on; None for 1.375 times the mean one.
        toe: Force at the end of the toe.
        curviness: 0 .. 1.
    """
    stiffness = _STIFF / strain if stiffness is None else stiffness
    end = 1.0 + strain - (1.0 - toe) / stiffness
    foot, middle = 1.0 + _FOOT * (end - 1.0), end - 0.5 * toe / stiffness
    slope, bend = 0.5 * toe / (middle - foot), 0.5 * (foot + middle)
    knots = (
        Knot(1.0, 0.0, 0.0),
        Knot(bend, slope * (bend - foot), slope),
        Knot(end, toe, stiffness),
    )
    return BezierCurve(knots, (curviness,) * 2)


def velocity_curve(
    shortening: tuple[Number, Number],
    isometric: Number,
    lengthening: tuple[Number, Number, Number],
) -> BezierCurve:
    """Force-velocity curve, flat at both ends.

    Args:
        shortening: Slope near its end, and curviness.
        isometric: Slope at rest.
        lengthening: Largest force, slope near its end, and curviness.
    """
    near, curviness = shortening
    largest, beyond, bent = lengthening
    rest = 1.0 - _NEAR
    knots = (
        Knot(-1.0, 0.0, 0.0),
        Knot(-_NEAR, 0.5 * near * rest, near),
        Knot(0.0, 1.0, isometric),
        Knot(_NEAR, largest - 0.5 * beyond * rest, beyond),
        Knot(1.0, largest, 0.0),
    )
    return BezierCurve(knots, (curviness, curviness, bent, bent))
