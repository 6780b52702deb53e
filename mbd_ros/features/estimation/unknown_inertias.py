"""Masses of links and payloads as states of an estimator.

Inertias of bodies are linear in them: pi = pi_0 + sum (z_i - z_i0) d_i, with the ten numbers of a
body. Source: C. G. Atkeson, C. H. An, J. M. Hollerbach, Int. J. Robotics Research 5(3) (1986).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array, State
from mbd_ros.features.estimation.unknown_numbers import UnknownNumber


class UnknownMass(NamedTuple):
    """A mass whose number is an internal state.

    Attributes:
        part: Its internal state.
        joint: Index of the joint that carries it.
        first: Its value in the model [kg].
        unit: Ten numbers of 1 kg of it, in the axes of the joint, shape (10,).
    """

    part: UnknownNumber
    joint: int
    first: float
    unit: Array


class UnknownInertias:
    """Writes masses into a model.

    Args:
        model: Pinocchio model that nobody else uses.
        masses: The masses.
    """

    def __init__(self, model: Any, masses: Sequence[UnknownMass]) -> None:
        self._model, self._data, self.masses = model, pin.Data(model), tuple(masses)
        joints = {mass.joint for mass in masses}
        self._known = {j: np.array(model.inertias[j].toDynamicParameters()) for j in joints}
        self._written = b""

    def write(self, z: Array) -> None:
        """Give the model the inertias of internal states."""
        if not self.masses or self._written == z.tobytes():
            return
        self._written = z.tobytes()
        self._set([float(z[mass.part.z][0]) for mass in self.masses])

    def efforts(self, x: State, a: Array) -> Array:
        """What 1 kg more of each asks of the joints [N·m/kg or N/kg], shape (nv, count).

        Args:
            x: State of all joints, whose internal states are written.
            a: Accelerations of all joints, shape (nv,).
        """
        values = [float(x.z[mass.part.z][0]) for mass in self.masses]
        here = np.array(pin.rnea(self._model, self._data, x.q, x.v, a))
        found = np.empty((len(here), len(values)))
        for i in range(len(values)):
            self._set([value + (i == j) for j, value in enumerate(values)])
            found[:, i] = pin.rnea(self._model, self._data, x.q, x.v, a) - here
        self._set(values)
        return found

    def _set(self, values: Sequence[float]) -> None:
        total = {joint: known.copy() for joint, known in self._known.items()}
        for mass, value in zip(self.masses, values, strict=True):
            total[mass.joint] += (value - mass.first) * mass.unit
        for joint, numbers in total.items():
            self._model.inertias[joint] = pin.Inertia.FromDynamicParameters(numbers)
