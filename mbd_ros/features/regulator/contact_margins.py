"""What contacts that are held leave before they open or slip."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.events.crossings import Crossing
from mbd_ros.core.state import Array, State


def held_room(system: Any, crossings: Sequence[Crossing], y: State, u: Array) -> Array:
    """Numbers of forces at a state of what is integrated, positive while contacts are held.

    Args:
        system: The system that holds them.
        crossings: The numbers, shape (n,).
        y: The state.
        u: Inputs.
    """
    x, k = system.expand(y), system.k
    lam, found = system.evaluate(x, u).lam, []
    for crossing in crossings:
        k.refresh(x.q, x.v, crossing.reads)
        found.append(crossing.value(k, x, lam))
    return np.array(found)
