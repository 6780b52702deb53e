"""Slips of contacts in a mode that is an argument; see `core.contact_modes.slip_directions`.

The tangents of a contact that slips have two odd numbers along the slip in the mode, its name.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols.link_rotations import ONE
from mbd_ros.core.contact_modes import slip_directions as names
from mbd_ros.core.contact_modes.contact_modes import CHANGE
from mbd_ros.core.thresholds import TINY

LONG = 1.0e9  # a step that no slip makes shorter [s]


class Slip(NamedTuple):
    """A contact in a mode; SX scalars.

    Attributes:
        is_on: 1 where it slips, else 0.
        is_fine: 1 where the direction is that of the name.
        name: Two numbers.
        along: Velocity of its points along the plane.
        size: Of that.
        slowest: Slip that counts as none.
    """

    is_on: Any
    is_fine: Any
    name: tuple[Any, Any]
    along: tuple[Any, Any]
    size: Any
    slowest: Any

    @property
    def direction(self) -> tuple[Any, Any]:
        """What friction is against."""
        length, (x, y), (a, b) = self._length, self.along, self.name
        size = ca.if_else(self.size > 0.0, self.size, 1.0)
        turned = ca.if_else(x * a + y * b < 0.0, -size, size)
        pairs = ((a / length, x / turned), (b / length, y / turned))
        fine, other = (ca.if_else(self.is_fine, one, both) for one, both in pairs)
        return fine, other

    @property
    def ends(self) -> tuple[Any, Any]:
        """How far it is from where it ends, or is named anew; 1 where that does not count."""
        length, slow, (x, y), (a, b) = self._length, self.slowest, self.along, self.name
        along, across = (x * a + y * b) / length, (x * b - y * a) / length
        coarse = along - ca.if_else(self._is_grown, names.SLOW * slow, 0.0)
        straight = slow + names.STRAY * ca.fabs(along) - ca.fabs(across)
        fast = names.FAST * names.SLOW * slow - along
        fine = ca.if_else(length < names.STRAIGHT, fast, straight)
        first, second = (
            ca.if_else(self.is_fine, along, coarse),
            ca.if_else(self.is_fine, fine, 1.0),
        )
        return self._where(first), self._where(second)

    @property
    def keeps_name(self) -> Any:
        """0 where it should have another name, at the start of a step; else 1."""
        slow, (x, y), (a, b) = self.slowest, self.along, self.name
        is_fast = ca.logic_and(self.size > 2.0 * names.SLOW * slow, ca.logic_not(self._is_grown))
        has_turned = x * a + y * b < names.TURNED * self.size * self._length
        turns = ca.logic_and(ca.logic_or(is_fast, has_turned), self.size > slow)
        return ca.logic_not(ca.logic_and(turns, self.turns))

    @property
    def turns(self) -> Any:
        """1 where it slips along its velocity, else 0."""
        return ca.logic_and(self.is_on, ca.logic_not(self.is_fine))

    @property
    def is_directed(self) -> Any:
        """0 where it is too slow to have a direction, else 1."""
        return ca.logic_not(ca.logic_and(self.turns, self.size <= self.slowest))

    def longest(self, rates: Sequence[Any]) -> Any:
        """Length of a step in which it does not change by much [s].

        Args:
            rates: Of its velocity.
        """
        rate = ca.sqrt(rates[0] * rates[0] + rates[1] * rates[1])
        return ca.if_else(self.turns, CHANGE * self.size / ca.fmax(rate, TINY), LONG)

    @property
    def _length(self) -> Any:
        a, b = self.name
        square = a * a + b * b
        return ca.sqrt(ca.if_else(square > 0.0, square, 1.0))

    @property
    def _is_grown(self) -> Any:
        return ca.fabs(self.name[0]) > names.COARSE

    def _where(self, value: Any) -> Any:
        return ca.if_else(self.is_on, value, ONE)


def slip_of(way: Any, name: tuple[Any, Any], along: tuple[Any, Any], speed: Any) -> Slip:
    """A contact in a mode.

    Args:
        way: Of its normal: 0 where it touches.
        name: Of its tangents.
        along: Velocity of its points along the plane.
        speed: The largest velocity of a joint.
    """
    a, b = name
    is_on = ca.logic_and(way == 0.0, ca.logic_or(a != 0.0, b != 0.0))
    is_fine = ca.fmax(ca.fabs(a), ca.fabs(b)) > names.COARSE * names.GROWN
    size = ca.sqrt(along[0] * along[0] + along[1] * along[1])
    return Slip(is_on, is_fine, name, along, size, names.NO_SLIP * (1.0 + speed))
