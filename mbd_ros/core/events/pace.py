"""Events that accumulate."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from mbd_ros.errors import SolveError

_MOST = 16  # events that may follow one another within a short time, besides two a switch


class Pace(NamedTuple):
    """How fast events follow one another.

    Attributes:
        t: Time of the last one [s].
        quick: How many have followed one another within a short time.
    """

    t: float = -math.inf
    quick: int = 0

    def after(self, t: float, short: float, switches: int, names: Sequence[str]) -> "Pace":
        """The pace after one more event.

        Args:
            t: Its time [s].
            short: Time that is short [s].
            switches: How many switches there are.
            names: What happens.

        Raises:
            SolveError: Events accumulate.
        """
        quick = self.quick + 1 if t - self.t < short else 0
        if quick > _MOST + 2 * switches:
            raise SolveError(
                f"t = {t:.9g} s: {quick} switching events, each within {short:.2g} s of the last "
                f"one, accumulate (Zeno) at {', '.join(names)}"
            )
        return Pace(t, quick)
