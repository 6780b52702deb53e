"""All joints as coordinates: y is x."""

import numpy as np

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.state import Array, State


class AllJoints:
    """Coordinates of tiers that integrate every joint.

    Args:
        mechanism: The mechanism.

    Attributes:
        chart: Of the configuration.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism, self.chart = mechanism, Chart(mechanism.model)
        self.mass = mechanism.mass

    def expand(self, y: State) -> State:
        """The same state."""
        return y

    def reduce(self, x: State) -> State:
        """The same state."""
        return x

    def lift(self, y: State, a: Array) -> Array:
        """The same accelerations, fresh."""
        return np.array(a)

    def integrated(self, a: Array) -> Array:
        """The same values."""
        return a

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Generalized force tau - h, shape (nv,)."""
        mechanism = self._mechanism
        mechanism.evaluations += 1
        return mechanism.tau(t, q, v, u) - mechanism.bias(q, v)
