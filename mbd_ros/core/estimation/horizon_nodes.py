"""What the window of a moving horizon is made of, and what its solvers answer."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.estimation.process import Bounded, Observation, Transition
from mbd_ros.core.state import NONE as _NONE
from mbd_ros.core.state import Array


def _unknown() -> Array:
    return _NONE


@dataclass
class Link:
    """What a chain knows of a node, see `horizon_chain`; measurements have unit noise.

    Attributes:
        before: Covariance before the measurement, shape (n, n).
        seen: About which it is linearised.
        H: Shape (m, n).
        r: Measured less expected, shape (m,).
        K: Gain, shape (n, m).
        weight: Inverse of the covariance of the innovation, shape (m, m).
        after: Covariance after the measurement, shape (n, n).
        going: The interval behind it; None while there is none.
        ahead: Covariance at its end, in the tangent there.
        next_x: The state of the next node.
        F: Of `going`.
        turned: F, to the tangent of the next node.
        G: Of `going`, to the tangent of the next node.
        gap: From the next node to the end of the interval, in the tangent of that node.
        ahead_turned: `ahead`, in the tangent of the next node.
    """

    before: Array
    seen: Observation
    H: Array
    r: Array
    K: Array
    weight: Array
    after: Array
    going: Transition | None = None
    ahead: Array = field(default_factory=_unknown)
    next_x: Any = None
    F: Array | None = None
    turned: Array = field(default_factory=_unknown)
    G: Array = field(default_factory=_unknown)
    gap: Array = field(default_factory=_unknown)
    ahead_turned: Array = field(default_factory=_unknown)


class Whitening:
    """W with W R W' = 1 for what was measured; the last one is kept."""

    def __init__(self) -> None:
        self._known: tuple[Array, bytes, Array] | None = None

    def of(self, R: Array, told: NDArray[np.bool_]) -> Array:
        """W, shape as many as told.

        Args:
            R: Covariance of the noise, shape (m, m).
            told: What was measured, shape (m,).
        """
        known, key = self._known, told.tobytes()
        if known is None or known[0] is not R or known[1] != key:
            factor = np.linalg.cholesky(R[np.ix_(told, told)])
            self._known = known = R, key, np.linalg.inv(factor)
        return known[2]


@dataclass
class Node:
    """One time of the window.

    Attributes:
        t: Time [s].
        x: State about which it is linearised.
        values: What was measured, NaN where nothing was or where it does not count, shape (m,).
        u: Inputs after it.
        going: To the next node, linearised at x; None at the end.
        seen: Linearised at x.
        bounded: At x.
        link: What a chain knows of it.
    """

    t: float
    x: Any
    values: Array
    u: Array | None = None
    going: Transition | None = None
    seen: Observation | None = None
    bounded: Bounded | None = None
    link: Link | None = None


class Arrival(NamedTuple):
    """What is known of the first node before its measurements.

    Attributes:
        x: Mean.
        P: Covariance, shape (n, n); None where nothing is known.
    """

    x: Any
    P: Array | None


class Answer(NamedTuple):
    """What a solve of the window found.

    Attributes:
        steps: From the states of the nodes, one row a node, shape (count, n).
        P: Covariance of the last one, where no bound acts, shape (n, n).
        residual: Of the conditions of the optimum.
        active: How many bounds act.
        w: Disturbances, shape (count - 1, nw).
    """

    steps: Array
    P: Array
    residual: float
    active: int
    w: Array
