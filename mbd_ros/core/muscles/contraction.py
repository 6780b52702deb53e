"""Contraction dynamics: fibres and tendon in series, with pennation and force equilibrium.

The tendon pulls along the path, and the fibres at the pennation angle to it. Forces are the peak
force times normalised curves, whose arguments are fibre length per optimal fibre length, tendon
length per slack length, and fibre speed per largest speed. Numbers may be floats, symbols, or
arrays over muscles, samples or both.

With activation a, fibre length l, fibre speed v, pennation angle alpha and tendon length l_t, the
equilibrium of fibres and tendon is

    (a f_l(l) f_v(v) + f_p(l) + d v) cos alpha = f_t(l_t)

in units of the peak force: active, passive, damping and tendon force. Source: F. E. Zajac, Crit.
Rev. Biomed. Eng. 17, 1989, 359-411; M. Millard et al., J. Biomech. Eng. 135, 2013, 021005,
doi:10.1115/1.4023390, eq. 1 to 8.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.muscles.curves import ArrayNumbers
from mbd_ros.core.ranges import Within, is_value
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

Angle = Within(0.0, 1.57)
_FLAT = 0.01  # of the optimal length: the shortest fibre without a largest angle
Number = Any  # a float, a symbol or an array
_POINT = 1.0e-9  # of the optimal length, to avoid a division by 0
_GRID, _HALVINGS = 400, 60  # lengths at which signs are compared, and bisections


class Contraction(NamedTuple):
    """Forces of one muscle, or of many side by side.

    Attributes:
        peak: Largest isometric force [N].
        optimal: Fibre length at which active force is largest [m].
        slack: Length of the slack tendon [m].
        fastest: Largest speed at which fibres shorten [m/s].
        pennation: Geometry of the fibres.
        curves: Normalised forces: `ThelenCurves`, `MillardCurves` or `DeGrooteFreglyCurves`.
    """

    peak: Number
    optimal: Number
    slack: Number
    fastest: Number
    pennation: Pennation
    curves: Any

    def cosine(self, k: Any, length: Number) -> Number:
        """Return the cosine of the pennation angle of fibres of a length [m]."""
        if is_value(self.pennation.height, 0.0):
            return 1.0
        sine = self.pennation.height / k.maximum(length, _POINT * self.optimal)
        return k.sqrt(k.maximum(1.0 - sine * sine, 0.0))

    def beside_rigid_tendon(self, k: Any, length: Number, speed: Number) -> Fiber:
        """Return the fibres in series with a rigid tendon of slack length.

        Args:
            k: Mathematical functions for numbers, symbols or arrays.
            length: Length of the path [m].
            speed: Rate of the length [m/s].
        """
        along = length - self.slack
        fiber = self.pennation.fiber(k, along)
        cosine = self.cosine(k, fiber)
        velocity = k.where(along > self.pennation.reach, speed * cosine, 0.0 * speed)
        return Fiber(fiber, cosine, velocity)

    def active(self, k: Any, a: Number, fiber: Fiber) -> Number:
        """Return the active force along the fibres [N]."""
        length, speed = fiber.length / self.optimal, fiber.velocity / self.fastest
        return self.peak * self.curves.fiber(k, a, length, speed)

    def passive(self, k: Any, fiber: Fiber) -> Number:
        """Return the passive force along the fibres [N]."""
        return self.peak * self.curves.passive(k, fiber.length / self.optimal)

    def damping(self, fiber: Fiber) -> Number:
        """Force of the damper beside the fibres, along them [N]."""
        return self.peak * self.curves.damping_force(fiber.velocity / self.fastest)

    def rigid_tension(self, k: Any, a: Number, length: Number, speed: Number) -> Number:
        """Tension of the path where the tendon is rigid [N]; 0 where path or fibres are slack.

        Args:
            k: Functions of numbers, symbols or arrays.
            length: Of the path [m].
            speed: Its rate [m/s].
        """
        fiber = self.beside_rigid_tendon(k, length, speed)
        along = self.active(k, a, fiber) + self.passive(k, fiber) + self.damping(fiber)
        pull = k.maximum(along * fiber.cosine, 0.0)
        return k.where(length - self.slack > self.pennation.reach, pull, 0.0 * pull)

    def stretch(self, k: Any, length: Number, fiber_length: Number) -> Number:
        """Length of an elastic tendon per slack length, between path and fibre length [m]."""
        return (length - self.pennation.along(k, fiber_length)) / self.slack

    def tendon(self, k: Any, length: Number, fiber_length: Number) -> Number:
        """Force of an elastic tendon [N]."""
        return self.peak * self.curves.tendon(k, self.stretch(k, length, fiber_length))

    def beside_elastic_tendon(
        self, k: Any, a: Number, length: Number, fiber_length: Number
    ) -> Fiber:
        """Fibres that are in balance with an elastic tendon.

        Args:
            k: Functions of numbers, symbols or arrays.
            a: Activation, more than 0.
            length: Of the path [m].
            fiber_length: Of the fibres [m].
        """
        cosine = self.cosine(k, fiber_length)
        force = self.curves.tendon(k, self.stretch(k, length, fiber_length)) / cosine
        speed = self.curves.speed(k, a, fiber_length / self.optimal, force)
        return Fiber(fiber_length, cosine, self.fastest * speed)

    def lacking(
        self, k: Any, a: Number, length: Number, fiber_length: Number, velocity: Number
    ) -> Number:
        """Force of the fibres less that of an elastic tendon along them, per peak force.

        Args:
            k: Functions of numbers, symbols or arrays.
            length: Of the path [m].
            fiber_length: Of the fibres [m].
            velocity: Its rate [m/s].
        """
        relative, speed = fiber_length / self.optimal, velocity / self.fastest
        fibers = self.curves.fiber(k, a, relative, speed) + self.curves.passive(k, relative)
        pull = self.curves.tendon(k, self.stretch(k, length, fiber_length))
        return fibers + self.curves.damping_force(speed) - pull / self.cosine(k, fiber_length)

    def tendon_energy(self, k: Any, length: Number, fiber_length: Number) -> Number:
        """Energy of an elastic tendon [J]."""
        area = self.curves.tendon_area(k, self.stretch(k, length, fiber_length))
        return self.peak * self.slack * area

    def fiber_energy(self, k: Any, fiber_length: Number) -> Number:
        """Energy of the elastic force of the fibres [J]."""
        area = self.curves.passive_area(k, fiber_length / self.optimal)
        return self.peak * self.optimal * area


class Fiber(NamedTuple):
    """Fibres at one time.

    Attributes:
        length: Of the fibres [m].
        cosine: Of their angle to the tendon.
        velocity: Rate of their length [m/s].
    """

    length: Number
    cosine: Number
    velocity: Number


class Pennation(NamedTuple):
    """Geometry of the fibres of a muscle of constant thickness, at an angle to its tendon.

    With the thickness h = l_opt sin(a_opt) the angle a of fibres of length l follows from
    sin(a) = h / l, and their length along the tendon is l cos(a) = sqrt(l^2 - h^2).

    Attributes:
        height: The h [m].
        shortest: Least length of the fibres [m].
        reach: Length of the shortest fibres along the tendon [m].
    """

    height: Number
    shortest: Number
    reach: Number

    def along(self, k: Any, length: Number) -> Number:
        """Fibre length [m] along the tendon [m]."""
        if is_value(self.height, 0.0):
            return length  # the root has no derivative at length 0
        return k.sqrt(k.maximum(length * length - self.height * self.height, 0.0))

    def fiber(self, k: Any, along: Number) -> Number:
        """Length of fibres [m] whose length along the tendon [m] is given, at least the least."""
        kept = k.maximum(along, self.reach)
        if is_value(self.height, 0.0):
            return kept
        return k.sqrt(kept * kept + self.height * self.height)


def contraction_of(
    curves: Any,
    *,
    max_isometric_force: float,
    optimal_fiber_length: float,
    tendon_slack_length: float,
    max_contraction_velocity: float,
    pennation_angle: float,
    maximum_pennation_angle: float,
) -> Contraction:
    """Return the contraction dynamics of a muscle with published parameters.

    Args:
        curves: Normalised force curves.
        max_isometric_force: Peak force [N].
        optimal_fiber_length: Fibre length of the peak force [m].
        tendon_slack_length: Length up to which the tendon is slack [m].
        max_contraction_velocity: Largest speed of shortening [optimal fibre lengths per second].
        pennation_angle: Pennation angle at the optimal fibre length [rad].
        maximum_pennation_angle: Pennation angle at which fibres stop shortening [rad]; 0 for none.
    """
    optimal, fastest = optimal_fiber_length, max_contraction_velocity * optimal_fiber_length
    if maximum_pennation_angle == 0.0:
        pennation = Pennation(0.0, _FLAT * optimal, _FLAT * optimal)
    else:
        height, largest = optimal * math.sin(pennation_angle), maximum_pennation_angle
        pennation = Pennation(height, height / math.sin(largest), height / math.tan(largest))
    return Contraction(
        max_isometric_force, optimal, tendon_slack_length, fastest, pennation, curves
    )


def check_sizes(
    tendon: str,
    tendon_slack_length: float,
    pennation_angle: float,
    maximum_pennation_angle: float,
) -> None:
    """Refuse parameters of a muscle that contradict each other.

    Raises:
        ModelError: An elastic tendon has no length, or the pennation angle exceeds its maximum.
    """
    if tendon == "elastic" and tendon_slack_length <= 0.0:
        raise ModelError(
            "tendon_slack_length is 0, but must be positive for an elastic tendon; otherwise use "
            "tendon: rigid"
        )
    if pennation_angle > 0.0 and pennation_angle >= maximum_pennation_angle:
        raise ModelError(
            f"pennation_angle {pennation_angle:g} must be below maximum_pennation_angle "
            f"{maximum_pennation_angle:g}"
        )


def stable_lengths(contraction: Contraction, a: float, length: float) -> list[float]:
    """Return the stable equilibrium lengths of the fibres at rest, in increasing order [m].

    The rate of the fibre length has the sign of g = ft / cos(alpha) - a fal - fpe, the difference
    of tendon force and isometric fibre force, so a length is stable where g decreases through 0.
    On the descending limb of the active force-length curve, a compliant tendon allows two stable
    lengths with an unstable one in between. If the tendon is slack at any length, fibres shorten
    to the shortest length.

    Args:
        contraction: The muscle.
        a: Activation.
        length: Length of the path [m].
    """
    shortest = contraction.pennation.shortest
    longest = contraction.pennation.fiber(Kinematics, length - contraction.slack)
    if longest <= shortest:
        return [shortest]
    lengths = np.linspace(shortest, longest, _GRID)
    pulled = _surplus(ArrayNumbers, contraction, a, length, lengths) > 0.0
    falls = np.flatnonzero(pulled[:-1] & ~pulled[1:])
    stable = [_bisect(contraction, a, length, lengths[i : i + 2]) for i in falls]
    return stable if pulled[0] else [shortest, *stable]


def _surplus(k: Any, contraction: Contraction, a: float, length: float, fiber_length: Any) -> Any:
    """Return tendon force along the fibres minus isometric fibre force, per peak force."""
    relative, curves = fiber_length / contraction.optimal, contraction.curves
    stretch = contraction.stretch(k, length, fiber_length)
    pull = curves.tendon(k, stretch) / contraction.cosine(k, fiber_length)
    return pull - curves.fiber(k, a, relative, 0.0 * relative) - curves.passive(k, relative)


def _bisect(contraction: Contraction, a: float, length: float, ends: Array) -> float:
    """Return the zero of the surplus between two lengths by bisection."""
    low, high = ends.tolist()
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _surplus(Kinematics, contraction, a, length, middle) > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
