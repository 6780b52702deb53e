"""Metabolic rate of a muscle: heat of activation, maintenance and shortening, and work.

m is the mass of the muscle, and e its excitation, which recruits the fractions s and f of slow and
fast fibres. Fa and F are active and total force of the fibres. Their velocity v is positive in
lengthening.

    s = r sin(pi e / 2),   f = (1 - r) (1 - cos(pi e / 2))
    rate = m (40 s + 133 f) + m L(l) (74 s + 111 f) - alpha F v - Fa v

where alpha is 0.25 in shortening and 0 in lengthening. The rate is not negative, and the heat is
at least 1 W/kg. All switches are smoothed by tanh, so that the rate is differentiable.

Source: L. J. Bhargava, M. G. Pandy, F. C. Anderson, A phenomenological model for estimating
metabolic energy consumption in muscle contraction, J. Biomech. 37, 2004, 81-88; smooth as in
A. Falisse et al., J. R. Soc. Interface 16, 2019, 20190402; least heat by B. R. Umberger,
K. G. M. Gerritsen, P. E. Martin, Comput. Methods Biomech. Biomed. Eng. 6, 2003, 99-111.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from mbd_ros.core.muscles.contraction import Contraction, Fiber

Number = Any  # float, symbol or array
BASAL = 1.2  # [W/kg], basal rate of the body
_ACTIVATION = 40.0, 133.0  # W/kg, slow and fast fibres
_MAINTENANCE = 74.0, 111.0
_SHORTENING = 0.25
_LEAST_HEAT = 1.0  # W/kg
_BREAKS = (0.5, 1.0, 1.5)  # fibre length per optimal length
_PIECES = ((0.5, 0.0), (0.0, 1.0), (3.0, -2.0), (0.0, 0.0))  # level and slope of maintenance


class Metabolism(NamedTuple):
    """Metabolic parameters of muscle fibres.

    Attributes:
        slow_twitch: Fraction r of slow fibres.
        specific_tension: Peak force per area [N/m^2], from which the mass follows.
        density: Density [kg/m^3].
        smoothing: Steepness of the tanh, per m/s and per W.
    """

    slow_twitch: float = 0.5
    specific_tension: float = 2.5e5
    density: float = 1059.7
    smoothing: float = 10.0

    def mass(self, muscle: Contraction) -> Number:
        """Return the mass of a muscle [kg]."""
        return muscle.peak / self.specific_tension * self.density * muscle.optimal


USUAL_METABOLISM = Metabolism()


def metabolic_rate(
    k: Any,
    muscle: Contraction,
    activation: Number,
    excitation: Number,
    fiber: Fiber,
    numbers: Metabolism,
) -> Number:
    """Return the metabolic rate of a muscle [W].

    Args:
        k: Mathematical functions for numbers or symbols.
        muscle: Contraction dynamics of the muscle.
        activation: Activation.
        excitation: Excitation.
        fiber: State of the fibres.
        numbers: Metabolic parameters.
    """
    steep, mass, v = numbers.smoothing, numbers.mass(muscle), fiber.velocity
    slow, fast = _recruited(k, excitation, numbers.slow_twitch)
    active = muscle.active(k, activation, fiber)
    total = active + muscle.passive(k, fiber) + muscle.damping(fiber)
    level, slope = k.piece(fiber.length / muscle.optimal, _BREAKS, _PIECES)
    share = level + slope * fiber.length / muscle.optimal
    heat = mass * (_ACTIVATION[0] * slow + _ACTIVATION[1] * fast)
    heat = heat + mass * share * (_MAINTENANCE[0] * slow + _MAINTENANCE[1] * fast)
    heat = heat - _switch(k, steep * v, _SHORTENING * total, 0.0) * v
    work = -active * v
    heat = heat - _switch(k, -steep * (heat + work), 0.0, heat + work)
    lowest = _LEAST_HEAT * mass
    return _switch(k, steep * (lowest - heat), heat, lowest) + work


def _recruited(k: Any, excitation: Number, slow_twitch: Number) -> tuple[Number, Number]:
    angle = 0.5 * math.pi * excitation
    return slow_twitch * k.sin(angle), (1.0 - slow_twitch) * (1.0 - k.cos(angle))


def _switch(k: Any, condition: Number, first: Number, second: Number) -> Number:
    """Return the first value if a condition is far below zero, the second if far above."""
    return first + (second - first) * (0.5 + 0.5 * k.tanh(condition))
