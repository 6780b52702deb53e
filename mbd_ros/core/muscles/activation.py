"""Activation dynamics: how activation a follows excitation e."""

from typing import Any, NamedTuple

Number = Any  # float, symbol or array
_LEAST, _MORE = 0.5, 1.5  # of the factor of both time constants


class FirstOrder(NamedTuple):
    """a' = (e - a) / tau, tau by whether activation rises.

    With z = 0.5 + 1.5 a, tau = rising z where e > a, and falling / z where not. The rate is
    continuous and has a kink at e = a.

    Source: D. G. Thelen, J. Biomech. Eng. 125, 2003, 70-77, doi:10.1115/1.1531112, eq. 1 and 2.

    Attributes:
        rising: Time constant [s].
        falling: Time constant [s].
        least: The a_min.
    """

    rising: Number
    falling: Number
    least: Number

    def rate(self, k: Any, e: Number, a: Number) -> Number:
        """A' [1/s]."""
        factor = _LEAST + _MORE * a
        lack = k.minimum(k.maximum(e, self.least), 1.0) - a
        up, down = k.maximum(lack, 0.0), k.minimum(lack, 0.0)
        return up / (self.rising * factor) + down * factor / self.falling


class SmoothFirstOrder(NamedTuple):
    """a' = ((f + 1/2) / (rising z) + (1/2 - f) z / falling) (e - a), smooth everywhere.

    Here z = 0.5 + 1.5 a and f = tanh(b (e - a)) / 2.

    Source: F. De Groote et al., Ann. Biomed. Eng. 44, 2016, 2922-2936,
    doi:10.1007/s10439-016-1591-9, eq. 1 and 2.

    Attributes:
        rising: Time constant [s].
        falling: Time constant [s].
        least: Least activation.
        steepness: The b.
    """

    rising: Number
    falling: Number
    least: Number
    steepness: Number

    def rate(self, k: Any, e: Number, a: Number) -> Number:
        """A' [1/s]."""
        factor = _LEAST + _MORE * a
        lack = k.minimum(k.maximum(e, self.least), 1.0) - a
        side = 0.5 * k.tanh(self.steepness * lack)
        pace = (side + 0.5) / (self.rising * factor) + (0.5 - side) * factor / self.falling
        return pace * lack
