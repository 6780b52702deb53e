"""Curves of the muscle of Thelen, normalised by peak force, optimal length and slack length.

Source: D. G. Thelen, Adjustment of muscle mechanics model parameters to simulate dynamic
contractions in older adults, J. Biomech. Eng. 125, 2003, 70-77, doi:10.1115/1.1531112. The toe of
the tendon is where its exponential and its straight part have one slope, as OpenSim has it.
"""

from typing import Any, NamedTuple

Number = Any  # float, symbol or array
_TOE_FORCE, _TOE_SHAPE = 0.33, 3.0
_HIGHEST = 50.0  # exponent of the passive force: beyond anything that tissue bears
_WEAKEST = 1.0e-9  # isometric force of fibres that are stretched beyond anything
_RESTING, _RISING = 0.25, 0.75  # largest speed at no activation, and what full activation adds


class ThelenCurves(NamedTuple):
    """Forces of fibres and tendon.

    Attributes:
        active_shape: Width of the active force-length curve, gamma.
        passive_shape: Exponent of the passive one.
        passive_strain: Fibre strain at which the passive force is the peak force.
        tendon_strain: Tendon strain at which its force is the peak force.
        shape: Curvature of the force-velocity curve, A_f.
        lengthening: Largest force of lengthening fibres, Flen.
        straight: Share of `lengthening` from which on the force-velocity curve is straight.
    """

    active_shape: Number
    passive_shape: Number
    passive_strain: Number
    tendon_strain: Number
    shape: Number
    lengthening: Number
    straight: Number

    @property
    def key(self) -> Any:
        """Equal where curves are."""
        return self

    @property
    def knots(self) -> tuple[tuple[Number, ...], ...]:
        """Where the active, the force-velocity and the passive curve are not smooth.

        The force-velocity curve is that at full activation.
        """
        last = self.straight * self.lengthening
        end = (last - 1.0) / (self._lengthening_slope() * (self.lengthening - last))
        return (), (-1.0, 0.0, end), (1.0,)

    def active(self, k: Any, length: Number) -> Number:
        """exp(-(l - 1)^2 / gamma)."""
        off = length - 1.0
        return k.exp(-off * off / self.active_shape)

    def passive(self, k: Any, length: Number) -> Number:
        """(exp(k (l - 1) / e0) - 1) / (exp(k) - 1) where l > 1, else 0."""
        return (self._grown(k, length) - 1.0) / (k.exp(self.passive_shape) - 1.0)

    def passive_area(self, k: Any, length: Number) -> Number:
        """Integral of the passive force over the length."""
        rate = self.passive_shape / self.passive_strain
        strain = k.maximum(length - 1.0, 0.0)
        area = (self._grown(k, length) - 1.0) / rate - strain
        return area / (k.exp(self.passive_shape) - 1.0)

    def tendon(self, k: Any, length: Number) -> Number:
        """Exponential in the toe, then straight; 0 where it is slack."""
        strain = k.maximum(length - 1.0, 0.0)
        toe, slope = self._toe(k)
        share = k.minimum(strain, toe) / toe
        curved = _TOE_FORCE * (k.exp(_TOE_SHAPE * share) - 1.0) / (k.exp(_TOE_SHAPE) - 1.0)
        return curved + slope * k.maximum(strain - toe, 0.0)

    def tendon_area(self, k: Any, length: Number) -> Number:
        """Integral of the tendon force over the length."""
        strain = k.maximum(length - 1.0, 0.0)
        toe, slope = self._toe(k)
        share, beyond = k.minimum(strain, toe) / toe, k.maximum(strain - toe, 0.0)
        curved = (k.exp(_TOE_SHAPE * share) - 1.0) / _TOE_SHAPE - share
        area = _TOE_FORCE * toe * curved / (k.exp(_TOE_SHAPE) - 1.0)
        return area + beyond * (_TOE_FORCE + 0.5 * slope * beyond)

    def fiber(self, k: Any, a: Number, length: Number, speed: Number) -> Number:
        """Active force of fibres.

        Args:
            k: Functions of numbers, symbols or arrays.
            length: Of the fibres.
            speed: Of the fibres, lengthening positive, 1 the largest at which they shorten.
        """
        w = speed / (_RESTING + _RISING * a)
        return a * self.active(k, length) * self._at_speed(k, w)

    def speed(self, k: Any, a: Number, length: Number, force: Number) -> Number:
        """Speed at which fibres carry a force, passive force included.

        Args:
            k: Functions of numbers, symbols or arrays.
            a: Activation, more than 0.
            length: Of the fibres.
            force: Of the fibres.
        """
        isometric = k.maximum(a * self.active(k, length), _WEAKEST)
        g = (force - self.passive(k, length)) / isometric
        return (_RESTING + _RISING * a) * self._at_force(k, g)

    def damping_force(self, speed: Number) -> Number:
        """None: the fibres are not damped."""
        return 0.0 * speed

    def _grown(self, k: Any, length: Number) -> Number:
        strain = k.maximum(length - 1.0, 0.0)
        return k.exp(k.minimum(self.passive_shape * strain / self.passive_strain, _HIGHEST))

    def _toe(self, k: Any) -> tuple[Number, Number]:
        """Strain at the end of the toe, and the slope beyond it."""
        e = k.exp(_TOE_SHAPE)
        toe = self.tendon_strain * 99.0 * e / (166.0 * e - 67.0)
        return toe, (1.0 - _TOE_FORCE) / (self.tendon_strain - toe)

    def _lengthening_slope(self) -> Number:
        """K of w = (g - 1) / (K (Flen - g)) where fibres lengthen."""
        return (2.0 + 2.0 / self.shape) / (self.lengthening - 1.0)

    def _at_force(self, k: Any, g: Number) -> Number:
        """Speed, per largest speed at this activation, of a force per isometric force."""
        last, rate = self.straight * self.lengthening, self._lengthening_slope()
        inside = k.minimum(k.maximum(g, 0.0), last)
        room = self.lengthening - k.maximum(inside, 1.0)
        shortening = (k.minimum(inside, 1.0) - 1.0) / (1.0 + k.minimum(inside, 1.0) / self.shape)
        lengthening = (k.maximum(inside, 1.0) - 1.0) / (rate * room)
        before = (1.0 + 1.0 / self.shape) * k.minimum(g, 0.0)
        return shortening + lengthening + before + self._last_slope() * k.maximum(g - last, 0.0)

    def _at_speed(self, k: Any, w: Number) -> Number:
        """Inverse of `_at_force`."""
        rate, last_slope = self._lengthening_slope(), self._last_slope()
        last = self.straight * self.lengthening
        end = (last - 1.0) / (rate * (self.lengthening - last))
        down, up = k.maximum(k.minimum(w, 0.0), -1.0), k.minimum(k.maximum(w, 0.0), end)
        shortening = (1.0 + down) / (1.0 - down / self.shape)
        lengthening = (1.0 + rate * self.lengthening * up) / (1.0 + rate * up)
        before = k.minimum(w + 1.0, 0.0) / (1.0 + 1.0 / self.shape)
        return shortening + lengthening - 1.0 + before + k.maximum(w - end, 0.0) / last_slope

    def _last_slope(self) -> Number:
        """Slope of `_at_force` where it becomes straight."""
        room = self.lengthening * (1.0 - self.straight)
        return (self.lengthening - 1.0) / (self._lengthening_slope() * room * room)
