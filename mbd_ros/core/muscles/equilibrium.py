"""Fibre lengths at which a muscle with an elastic tendon is at rest."""

from typing import Any

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.muscles.array_numbers import ArrayNumbers
from mbd_ros.core.muscles.contraction import Contraction
from mbd_ros.core.state import Array

_LOOKED_AT, _HALVINGS = 400, 60  # lengths that are looked at, and halvings between two of them


def stable_lengths(contraction: Contraction, a: float, length: float) -> list[float]:
    """Fibre lengths at rest to which fibres return by themselves, the shortest one first [m].

    The rate of the fibre length has the sign of g = ft cos(a)^-1 - A fal - fpe, the surplus of the
    tendon over fibres that neither shorten nor lengthen: a length is stable where g falls through
    0. On the descending limb of the active force-length curve a compliant tendon lets fibres have
    two such lengths, with one between them that is not stable. Where the tendon is slack at any
    length, fibres shorten to the least one.

    Args:
        contraction: Of the muscle.
        a: Activation.
        length: Of the path [m].
    """
    shortest = contraction.pennation.shortest
    longest = contraction.pennation.fiber(Kinematics, length - contraction.slack)
    if longest <= shortest:
        return [shortest]
    lengths = np.linspace(shortest, longest, _LOOKED_AT)
    pulled = _surplus(ArrayNumbers, contraction, a, length, lengths) > 0.0
    falls = np.flatnonzero(pulled[:-1] & ~pulled[1:])
    found = [_between(contraction, a, length, lengths[i : i + 2]) for i in falls]
    return found if pulled[0] else [shortest, *found]


def _between(contraction: Contraction, a: float, length: float, ends: Array) -> float:
    """The zero of the surplus between two lengths, by halving."""
    low, high = ends.tolist()
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _surplus(Kinematics, contraction, a, length, middle) > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _surplus(k: Any, contraction: Contraction, a: float, length: float, fiber_length: Any) -> Any:
    """Force of the tendon along the fibres less that of fibres at rest, per peak force."""
    relative, curves = fiber_length / contraction.optimal, contraction.curves
    stretch = contraction.stretch(k, length, fiber_length)
    pull = curves.tendon(k, stretch) / contraction.cosine(k, fiber_length)
    return pull - curves.fiber(k, a, relative, 0.0 * relative) - curves.passive(k, relative)
