"""Names of slip directions in a mode: two odd numbers along the slip of a contact.

A slip is straight where it begins, and its direction is that of its name, a fine one. Where it
turns, it is named by one of a few directions. They say on which side of v_t = 0 it goes on, and
forces follow the direction of the velocity itself; once it is faster, the same directions are
named by larger numbers. Where it gets slow, its direction is that of a fine name again: so forces
are smooth through the end of the slip and beyond, where v_t / |v_t| is not, and rounding across a
straight slip does not grow.
"""

import math

import numpy as np

from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import ON_SURFACE

NO_SLIP = 100.0 * ON_SURFACE  # of 1 + the largest velocity: how slow a slip may end
SLOW = 1.0e4  # times that: from where the direction of a slip that ends is that of its name
FAST = 8.0  # times that: where a slip that did not end follows its velocity again
TURNED = 0.8  # cosine of the angle from which a direction is named anew
COARSE = 3  # the largest number of a name that is not fine
GROWN = 5  # factor of the names of slips that are not slow
_ENDING, STRAIGHT = 2**30, 2**51  # how long names are of slips that end, and of straight ones
_NO_TURN = 0.01  # of the slack of a rate: one across a slip that leaves it straight
STRAY = 1.0e-9  # of a straight slip: how fast it may be across the direction of its name


def slowest(x: State) -> float:
    """Return the slip velocity that counts as none."""
    return NO_SLIP * (1.0 + float(np.abs(x.v).max()))


def initial_name(along: Array) -> Mode:
    """Name of a slip that begins along an acceleration, shape (2,): it is straight at first."""
    return _finely(along, STRAIGHT) if along.any() else (1, 1)


def slip_name(slip: Array, rate: Array, slack: float, slow: float) -> Mode:
    """Return the name of a slip.

    Args:
        slip: Velocity, shape (2,).
        rate: Its acceleration, shape (2,).
        slack: What counts as none of that.
        slow: Slip that counts as none, by `slowest`.
    """
    size = math.hypot(*slip)
    if abs(float(slip[0] * rate[1] - slip[1] * rate[0])) <= _NO_TURN * slack * size:
        return _finely(slip, STRAIGHT)
    if size > 2.0 * SLOW * slow:
        return tuple(GROWN * each for each in _coarsely(slip))
    return _finely(slip, _ENDING) if slip.dot(rate) < 0.0 else _coarsely(slip)


def is_fine(name: Mode) -> bool:
    """Whether the direction of a slip is that of its name."""
    return max(abs(name[0]), abs(name[1])) > COARSE * GROWN


def direction(slip: Array, name: Mode) -> Array:
    """Return the direction that friction is against, shape (2,).

    Args:
        slip: Velocity, shape (2,).
        name: Of the slip; empty where it is looked for.
    """
    if name and is_fine(name):
        return np.array(name) / math.hypot(*name)
    size = math.hypot(*slip) or 1.0
    return slip / (-size if name and slip.dot(name) < 0.0 else size)


def slip_margins(slip: Array, name: Mode, x: State) -> tuple[float, ...]:
    """Return how far a slip is from where it ends, or is named anew."""
    size, none = math.hypot(*name), slowest(x)
    along = float(slip.dot(name)) / size
    if not is_fine(name):
        return (along - SLOW * none if _is_grown(name) else along,)
    if size < STRAIGHT:
        return along, FAST * SLOW * none - along
    across = float(slip[0] * name[1] - slip[1] * name[0]) / size
    return along, none + STRAY * abs(along) - abs(across)


def has_turned(slip: Array, name: Mode, slow: float) -> bool:
    """Whether a slip should have another name, at the start of a step."""
    size = math.hypot(*slip)
    if is_fine(name) or size <= slow:
        return False
    is_grown = _is_grown(name)
    if size > 2.0 * SLOW * slow and not is_grown:
        return True
    return bool(slip.dot(name) < TURNED * size * math.hypot(*name))


def _coarsely(slip: Array) -> Mode:
    size = math.hypot(*slip)
    return tuple(min(2 * math.floor(2.0 * float(each) / size) + 1, COARSE) for each in slip)


def _finely(slip: Array, length: int) -> Mode:
    size = math.hypot(*slip)
    return tuple(2 * round(length * float(each) / size) + 1 for each in slip)


def _is_grown(name: Mode) -> bool:
    return name[0] % GROWN == 0 and name[1] % GROWN == 0
