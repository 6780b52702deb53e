"""How the load passes from one foot to the other while both are on the ground.

Over a double support of length T the trailing foot keeps these shares of the force that it had:

    along the way     k1 exp(-(2 (t - T / 3) / T)^2) - 2 k2 t / T
    across and up     exp(-(2 t / T)^3),        k1 = e^(4/9), k2 = e^(-4/3) / 2

Source: L. Ren, R. K. Jones, D. Howard, J. Biomechanics 41 (2008) 2750,
doi:10.1016/j.jbiomech.2008.06.001, for the forces of walking persons.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

_INSIDE = 0.9  # of the friction that a normal force bears: the corners of a foot differ
_AHEAD = math.exp(4.0 / 9.0), math.exp(-4.0 / 3.0) / 2.0


class DoubleSupport(NamedTuple):
    """Samples with more than one foot on the ground, after one with one.

    Attributes:
        before: Sample of the single support before.
        samples: Those of the double support.
        foot: The trailing foot, which stood alone.
        end: Time of the end [s]: of the first sample after it, or of the last one of all.
    """

    before: int
    samples: range
    foot: int
    end: float


def double_supports(times: Array, feet: NDArray[np.bool_]) -> Iterator[DoubleSupport]:
    """Double supports of a motion whose beginning is in it.

    Args:
        times: Of samples [s], shape (n,).
        feet: Which feet stand, shape (n, feet).
    """
    several = feet.sum(axis=1) > 1
    starts = np.flatnonzero(several[1:] & ~several[:-1]) + 1
    for start in starts.tolist():
        before = start - 1
        if not feet[before].any():
            continue  # a flight before it leaves open which foot was first
        foot, after = int(np.argmax(feet[before])), np.flatnonzero(~several[start:])
        end = start + int(after[0]) if len(after) else len(times)
        last = float(times[min(end, len(times) - 1)])
        yield DoubleSupport(before, range(start, end), foot, last)


def kept_force(force: Array, way: Array, share: float) -> Array:
    """The force of the trailing foot after a share of the double support.

    Args:
        force: What it was at the beginning [N], shape (3,).
        way: Direction of walking, of length 1, shape (3,).
        share: t / T, 0 .. 1.

    Returns:
        Shape (3,), in the axes of `force`.
    """
    k1, k2 = _AHEAD
    along = k1 * math.exp(-((2.0 * (share - 1.0 / 3.0)) ** 2)) - 2.0 * k2 * share
    across = math.exp(-((2.0 * share) ** 3))
    ahead = way.dot(force) * way
    kept: Array = along * ahead + across * (force - ahead)
    return kept


def possible_force(kept: Array, total: Array, normal: Array, mu: float) -> Array:
    """The kept force, so that the rest of the total is one that the ground can exert.

    Args:
        kept: On the trailing foot [N], shape (3,).
        total: On all feet, shape (3,).
        normal: Of the ground below the others, of length 1, shape (3,).
        mu: Coefficient of friction there.
    """
    rest = total - kept
    push = max(float(normal.dot(rest)), 0.0)
    along = rest - normal.dot(rest) * normal
    most, length = _INSIDE * mu * push, float(np.linalg.norm(along))
    if length > most:
        along *= most / length
    possible: Array = total - push * normal - along
    return possible


def direction_of_way(places: Sequence[Array], gravity: Array) -> Array:
    """Level direction from the first to the last place, shape (3,); 0 where nothing moves."""
    up = -gravity / (float(np.linalg.norm(gravity)) or 1.0)
    step = places[-1] - places[0]
    level = step - up.dot(step) * up
    length = float(np.linalg.norm(level))
    return level / length if length > 0.0 else np.zeros(3)
