"""Inputs of a motion that are no unknowns: measured loads."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.mesh import Numbers


class GivenInputs(NamedTuple):
    """Inputs that are known over time.

    Attributes:
        places: Where they stand in u, shape (k,).
        at: Shares of the duration of a phase, shape (m,) -> values, shape (m, k).
    """

    places: Numbers
    at: Callable[[Array], Array]


NONE_GIVEN = GivenInputs(np.zeros(0, dtype=np.intp), lambda shares: np.zeros((len(shares), 0)))
