"""Events that accumulate."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from mbd_ros.errors import SolveError

_MOST = 16  # events that may follow one another within a short time, besides two a switch
_MOST_BOUNCES = 10_000  # impacts that may: e = 0.999 needs thousands before it is at rest


class Pace(NamedTuple):
    """How fast events follow one another.

    Attributes:
        t: Time of the last one [s].
        quick: How many have followed one another within a short time, since the last impact.
        bounces: How many impacts have.
    """

    t: float = -math.inf
    quick: int = 0
    bounces: int = 0

    def after(
        self, t: float, short: float, switches: int, names: Sequence[str], *, hits: bool
    ) -> "Pace":
        """The pace after one more event.

        Args:
            t: Its time [s].
            short: Time that is short [s].
            switches: How many switches there are.
            names: What happens.
            hits: Whether it is an impact.

        Raises:
            SolveError: Events accumulate.
        """
        if t - self.t >= short:
            return Pace(t)
        pace = Pace(t, 0, self.bounces + 1) if hits else Pace(t, self.quick + 1, self.bounces)
        if pace.quick > _MOST + 2 * switches or pace.bounces > _MOST_BOUNCES:
            kind, count = ("impacts", pace.bounces) if hits else ("switching events", pace.quick)
            raise SolveError(
                f"t = {t:.9g} s: {count} {kind}, each within {short:.2g} s of the last "
                f"one, accumulate (Zeno) at {', '.join(names)}"
                + ("; a smaller dt lets more of them pass" if hits else "")
            )
        return pace
