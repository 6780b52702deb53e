"""Curves of the muscle of De Groote and Fregly, normalised by peak force and lengths.

They have derivatives of any order and no pieces, for optimal control.

Source: F. De Groote, A. L. Kinney, A. V. Rao, B. J. Fregly, Evaluation of direct collocation
optimal control problem formulations for solving the muscle redundancy problem, Ann. Biomed. Eng.
44, 2016, 2922-2936, doi:10.1007/s10439-016-1591-9, and its supplement, which has the digits.
"""

import math
from typing import Any, NamedTuple

from mbd_ros.core.ranges import is_value

Number = Any  # float, symbol or array
_ACTIVE = (  # height, centre, width at length 0, width per length
    (0.8150671134243542, 1.055033428970575, 0.162384573599574, 0.063303448465465),
    (0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188),
    (0.1, 1.0, 0.353553390593274, 0.0),
)
_RATE, _SHIFT = -8.149, -0.374  # d2, d3 of the force-velocity curve
_AT_REST, _FASTEST = math.asinh(_SHIFT), math.asinh(_SHIFT - _RATE)
_HEIGHT = 1.0 / (_AT_REST - _FASTEST)  # d1 and d4: force 1 at rest and 0 at speed -1
_LEVEL = -_HEIGHT * _FASTEST
_SHORTEST = 0.2  # length at which the passive force is 0
_TENDON, _OFFSET = 0.2, 0.2  # c1, c3 of the tendon; c2 is 1
_THINNEST = 1.0e-12  # square of a width, which is 0 at some length
_WEAKEST = 1.0e-9  # isometric force of fibres that are stretched beyond anything
_HIGHEST = 50.0  # of an exponent: beyond anything that tissue bears
_NEWTON = 8  # corrections of `speed`, which converges from one side
_STEEPEST = 30.0  # of asinh(..): a speed of 1e12


class DeGrooteFreglyCurves(NamedTuple):
    """Forces of fibres and tendon.

    Attributes:
        passive_shape: Exponent of the passive force-length curve, k_PE.
        passive_strain: Fibre strain at which the passive force is the peak force.
        tendon_strain: Tendon strain at which its force is the peak force.
        active_width: Widens the active force-length curve.
        damping: Of the fibres, force per speed.
    """

    passive_shape: Number
    passive_strain: Number
    tendon_strain: Number
    active_width: Number
    damping: Number

    @property
    def key(self) -> Any:
        """Equal where curves are."""
        return self

    @property
    def knots(self) -> tuple[tuple[Number, ...], ...]:
        """None: all curves are smooth."""
        return (), (), ()

    def active(self, k: Any, length: Number) -> Number:
        """Sum of three bells."""
        at = (length - 1.0) / self.active_width + 1.0
        total: Number = 0.0
        for height, centre, width, widening in _ACTIVE:
            off, wide = at - centre, width + widening * at
            total = total + height * k.exp(-0.5 * off * off / k.maximum(wide * wide, _THINNEST))
        return total

    def passive(self, k: Any, length: Number) -> Number:
        """(exp(k (l - 1) / e0) - c) / (exp(k) - c), c such that it is 0 at the shortest length."""
        least = self._grown(k, _SHORTEST)
        return (self._grown(k, length) - least) / (k.exp(self.passive_shape) - least)

    def passive_area(self, k: Any, length: Number) -> Number:
        """Integral of the passive force over the length, from the optimal one."""
        least = self._grown(k, _SHORTEST)
        rate = self.passive_shape / self.passive_strain
        area = (self._grown(k, length) - 1.0) / rate - least * (length - 1.0)
        return area / (k.exp(self.passive_shape) - least)

    def tendon(self, k: Any, length: Number) -> Number:
        """c1 exp(k_T (l - 1)) - c3."""
        return _TENDON * self._pulled(k, length) - _OFFSET

    def tendon_area(self, k: Any, length: Number) -> Number:
        """Integral of the tendon force over the length, from the slack length."""
        area = (self._pulled(k, length) - 1.0) / self._stiffness(k)
        return _TENDON * area - _OFFSET * (length - 1.0)

    def fiber(self, k: Any, a: Number, length: Number, speed: Number) -> Number:
        """Active force of fibres; arguments as in `ThelenCurves.fiber`."""
        w = _RATE * speed + _SHIFT
        return a * self.active(k, length) * (_HEIGHT * _asinh(k, w) + _LEVEL)

    def speed(self, k: Any, a: Number, length: Number, force: Number) -> Number:
        """Speed at which fibres carry a force; arguments as in `ThelenCurves.speed`.

        With w = asinh(d2 speed + d3) this is p w + q sinh(w) = c, which Newton's method solves
        from the far side of a root of a function that bends one way.
        """
        strength = a * self.active(k, length)
        p, q = k.maximum(strength, _WEAKEST) * -_HEIGHT, self.damping / -_RATE
        c = strength * _LEVEL + self.passive(k, length) - force
        c = c - self.damping * _SHIFT / _RATE
        size = k.maximum(c, -c)
        w = k.minimum(size / p, _STEEPEST)
        if not is_value(self.damping, 0.0):
            w = k.minimum(w, _asinh(k, size / q))
        for _ in range(_NEWTON):
            grown = k.exp(w)
            sinh, cosh = 0.5 * (grown - 1.0 / grown), 0.5 * (grown + 1.0 / grown)
            w = k.minimum(w - (p * w + q * sinh - size) / (p + q * cosh), _STEEPEST)
        grown = k.exp(k.where(c < 0.0, -w, w))
        return (0.5 * (grown - 1.0 / grown) - _SHIFT) / _RATE

    def damping_force(self, speed: Number) -> Number:
        """Force of the damper beside the fibres."""
        return self.damping * speed

    def _grown(self, k: Any, length: Number) -> Number:
        exponent = self.passive_shape * (length - 1.0) / self.passive_strain
        return k.exp(k.minimum(exponent, _HIGHEST))

    def _stiffness(self, k: Any) -> Number:
        """k_T."""
        return k.log((1.0 + _OFFSET) / _TENDON) / self.tendon_strain

    def _pulled(self, k: Any, length: Number) -> Number:
        return k.exp(k.minimum(self._stiffness(k) * (length - 1.0), _HIGHEST))


def _asinh(k: Any, x: Number) -> Number:
    """asinh(x), from the side on which nothing cancels."""
    size = k.maximum(x, -x)
    found = k.log(size + k.sqrt(size * size + 1.0))
    return k.where(x < 0.0, -found, found)
