"""Fibres at an angle to the tendon, in a muscle of constant thickness.

With the thickness h = l_opt sin(a_opt) the angle a of fibres of length l follows from
sin(a) = h / l, and their length along the tendon is l cos(a) = sqrt(l^2 - h^2).

Source: F. E. Zajac, Crit. Rev. Biomed. Eng. 17, 1989, 359-411; M. Millard et al., J. Biomech. Eng.
135, 2013, 021005, doi:10.1115/1.4023390.
"""

import math
from typing import Any, NamedTuple

from mbd_ros.core.ranges import Within, is_value

Angle = Within(0.0, 1.57)
Number = Any  # float, symbol or array
_FLAT = 0.01  # of the optimal length: the shortest fibre where nothing limits the angle


class Pennation(NamedTuple):
    """Geometry of the fibres of a muscle.

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


def pennation(optimal_length: Number, angle: float, largest: float) -> Pennation:
    """Fibres by what is published of them.

    Args:
        optimal_length: The l_opt [m].
        angle: The a_opt [rad].
        largest: Angle beyond which fibres do not shorten [rad]; 0 for none.
    """
    if largest == 0.0:
        shortest = _FLAT * optimal_length
        return Pennation(0.0, shortest, shortest)
    height = optimal_length * math.sin(angle)
    return Pennation(height, height / math.sin(largest), height / math.tan(largest))
