"""The window of the stiffness of contacts that give way: what depth asks, what a step follows."""

import math
from typing import Any, NamedTuple

from mbd_ros.core.integration.contact_motion import ContactMotion
from mbd_ros.core.integration.linear_motion import is_bounded, longest_step
from mbd_ros.core.integration.spring_rebound import bisected, largest_without_gain
from mbd_ros.core.integration.stepping import Integrator

_WIDE = 4.0  # factor by which the end of a window is looked for
_FARTHEST = 1.0e12
_HALVINGS = 16  # of the ratio `_WIDE`
_GENTLE = 0.1  # k dt^2/m up to which other methods of fixed steps gain no more than `GAIN`
_LONGER = 1.0e4  # than the shortest time of a motion: steps that no bound is looked for beyond


class Ends(NamedTuple):
    """How stiff contacts may be, and how long a step, that move one another.

    Attributes:
        share: Largest multiple of their stiffness that steps follow; 0 where friction and
            dampers alone are too much, inf without any end.
        impacts: The same of impacts that gain no speed, NaN where it is not known.
        longest: Longest step for their stiffness [s].
    """

    share: float
    impacts: float
    longest: float


class Window(NamedTuple):
    """The window of the stiffness of one contact, in units of its stiffness.

    Attributes:
        part: The contact.
        features: How many of its features touch.
        load: Largest normal force of one of them that it is made for [N].
        lower: Stiffness that keeps that as deep as it may be, 0 where no depth is known.
        upper: Largest stiffness that steps follow, inf without any end.
        impacts: Largest one at which no impact gains speed, NaN where it is not known.
        longest: Longest step for its stiffness [s], inf where none is too long.
        opening: Longest step for the lower end [s].
    """

    part: Any
    features: int
    load: float
    lower: float
    upper: float
    impacts: float
    longest: float
    opening: float


def windows(motion: ContactMotion, method: Integrator, dt: float) -> list[Window]:
    """The window of each contact, all contacts that move one another made stiffer together.

    Args:
        motion: Of contacts.
        method: What integrates it.
        dt: Its step [s].
    """
    found = []
    for group in motion.parted():
        ends = ends_of(group, method, dt)
        for part in dict.fromkeys(feature.part for feature in group.features):
            loads = [feature.load for feature in group.features if feature.part is part]
            k, depth, load = part.normal.stiffness, part.max_penetration, max(loads)
            lower = part.normal.least(load, depth) if depth else 0.0
            opening = longest(group, method, lower / k) if lower > k * ends.share else math.inf
            found.append(
                Window(
                    *(part, len(loads), load, lower, k * ends.share, k * ends.impacts),
                    *(ends.longest, opening),
                )
            )
    return found


def ends_of(motion: ContactMotion, method: Integrator, dt: float) -> Ends:
    """Largest multiples of the stiffness of contacts, and their longest step.

    Args:
        motion: Of contacts that move one another.
        method: What integrates it.
        dt: Its step [s].
    """
    if method.stable == math.inf:
        return Ends(math.inf, math.nan, math.inf)

    def holds(share: float) -> bool:
        return is_bounded(method, motion.linear(share), dt)

    share = _largest(holds) if method.is_explicit else math.inf
    rate, damping = motion.stiffest()
    a, b = rate * dt * dt, damping * dt
    is_known = type(method).growth is not Integrator.growth and not method.finds_surfaces
    impacts = _GENTLE / a if a > 0.0 and share > 0.0 else math.nan
    if is_known and 0.0 < share < math.inf and a > 0.0:
        impacts = share * largest_without_gain(method, share * a, b)
    return Ends(share, impacts, longest(motion, method, 1.0))


def longest(motion: ContactMotion, method: Integrator, share: float) -> float:
    """Longest step for a multiple of the stiffness of contacts [s], inf without any."""
    linear = motion.linear(share)
    if not method.is_explicit or not linear.rate:
        return math.inf
    return longest_step(method, linear, _LONGER * method.stable / linear.rate)


def _largest(holds: Any) -> float:
    """Largest share for which something holds, 0 for none, inf for all."""
    share = 1.0
    if holds(share):
        while holds(_WIDE * share):
            share *= _WIDE
            if share > _FARTHEST:
                return math.inf
    else:
        while not holds(share / _WIDE):
            share /= _WIDE
            if share < 1.0 / _FARTHEST:
                return 0.0
        share /= _WIDE
    return bisected(holds, share, _WIDE * share, _HALVINGS)
