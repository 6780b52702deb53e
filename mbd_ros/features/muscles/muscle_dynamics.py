"""Which dynamics muscles have where they share a whole motion."""

from collections.abc import Sequence
from typing import NamedTuple

from mbd_ros.core.muscles.activation import FirstOrder, SmoothFirstOrder
from mbd_ros.core.muscles.degroote_fregly_curves import DeGrooteFreglyCurves
from mbd_ros.core.muscles.muscle import Muscle

ACTIVATION, TENDON = "activation", "tendon"
DEFAULTS = (0.02, 4, 1.0e-3)  # of all but `kind`
_CURVES = DeGrooteFreglyCurves(4.0, 0.6, 0.049, 1.0, 0.01)
_STEEPNESS = 0.1


class MuscleDynamics(NamedTuple):
    """What takes part, and how finely it is followed.

    Attributes:
        kind: `activation`: activations follow excitations, tendons are rigid; `tendon`: tendons
            are elastic, too, where the muscle says so.
        interval: Longest interval of the mesh [s].
        degree: Points on an interval.
        tolerance: Largest error of activations between points; finer intervals are tried where it
            is larger.
    """

    kind: str
    interval: float
    degree: int
    tolerance: float


def muscles_with(dynamics: MuscleDynamics, muscles: Sequence[Muscle]) -> list[Muscle]:
    """The muscles with these dynamics, on the same paths.

    Curves of other types have kinks, at which no optimum is found: these muscles get the curves
    and the activation of De Groote and Fregly, with their own sizes and times.
    """
    found = []
    for muscle in muscles:
        law, rate, tendon = muscle.contraction, muscle.dynamics, muscle.tendon
        if isinstance(rate, FirstOrder):
            law = law._replace(curves=_CURVES)
            rate = SmoothFirstOrder(rate.rising, rate.falling, rate.least, _STEEPNESS)
        one = Muscle(muscle.path, law, rate, tendon if dynamics.kind == TENDON else "rigid")
        one.name = muscle.name
        found.append(one)
    return found
