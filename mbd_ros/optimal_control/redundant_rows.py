"""Rows that follow from others wherever these hold, such as those of a foot at several points.

What they say is said already, and no equation tells their multipliers from those of the others.
They are zero then: the sums over rows on which a motion depends are the same for all choices.
"""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array


class Dependence(NamedTuple):
    """Rows that depend on others.

    Attributes:
        rows: Their numbers among those that act.
        null: Multipliers that push nothing, one line each of them, shape (.., m).
        q: A configuration in which the rows hold.
    """

    rows: tuple[int, ...]
    null: Array
    q: Array


NO_DEPENDENCE = Dependence((), np.zeros((0, 0)), np.zeros(0))
