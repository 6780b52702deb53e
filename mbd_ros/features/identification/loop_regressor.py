"""Rows of a mechanism with loops: one for each motion that its loops leave.

N = [E; -J_2^-1 J_1] has a column for each of some actuated joints, chosen once: J N = 0 takes the
multipliers out, N' (M a + h - loads) = N' B u. Efforts of other joints act along N, too.

Source: J. Garcia de Jalon, E. Bayo, Kinematic and Dynamic Simulation of Multibody Systems, 1994,
section 5.2 (independent coordinates by the matrix R).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.inverse_dynamics.observed_loops import ObservedLoops
from mbd_ros.core.model.inertial_parameters import parameters_of
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SINGULAR
from mbd_ros.errors import ModelError


class LoopRegressor:
    """Rows of a mechanism, see `Regressor`.

    Args:
        robot: The robot.
        solver: Inverse dynamics of the scene, whose forces and wrenches are the known ones.
        start: State near the constraints.
        driven: Joints whose efforts are measured.

    Attributes:
        labels: Actuated joints by which the mechanism moves, and coordinates of free bases.
        coordinates: Their places among the independent velocities.
        size: Inertial numbers of all bodies.
        base: Rows that no joint drives.

    Raises:
        ModelError: The driven joints do not determine the motion.
    """

    def __init__(
        self, robot: Robot, solver: ObservedLoops, start: State, driven: Sequence[str]
    ) -> None:
        self._solver, self._inverse = solver, solver.inverse
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._carried, self._given = self._model, parameters_of(robot.model).ravel()
        self.size = len(self._given)
        names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
        first = [*robot.base_v.tolist(), *(robot.joint(name).v for name in driven)]
        q = self._inverse.motion.start(start)
        J = self._inverse.motion.jacobian(start.t, q)
        self._first = _leading(J, first)
        self._others = np.setdiff1d(np.arange(self._model.nv), self._first)
        self.labels = tuple(names[int(v)] for v in self._first)
        self.coordinates = np.searchsorted(solver.couplings.v_index, self._first)
        self.base = np.flatnonzero(np.isin(self._first, robot.base_v))

    def motions(self, q: Array) -> Array:
        """N at a configuration on the constraints, shape (nv, len(labels))."""
        J = self._inverse.motion.jacobian(0.0, q)
        N = np.zeros((self._model.nv, len(self._first)))
        N[self._first, np.arange(len(self._first))] = 1.0
        N[self._others] = -np.linalg.lstsq(J[:, self._others], J[:, self._first], rcond=SINGULAR)[
            0
        ]
        return N

    def consistent(self, y: Array, v: Array, a: Array) -> tuple[State, Array]:
        """State and acceleration of all joints that the loops allow, near a sample."""
        return self._inverse.consistent(*self._solver.measured(0.0, y, v, a))

    def rows(self, y: Array, v: Array, a: Array) -> Array:
        """N' W at samples, shape (n, len(labels), `size`)."""
        found = np.empty((len(y), len(self.labels), self.size))
        for row, *sample in zip(found, y, v, a, strict=True):
            x, push = self.consistent(*sample)
            W = pin.computeJointTorqueRegressor(self._model, self._data, x.q, x.v, push)
            row[...] = self.motions(x.q).T @ W
        return found

    def known(self, rows: Array, y: Array, v: Array, a: Array, loads: Sequence[Array]) -> Array:
        """What acts besides the inertias, shape (n, len(labels))."""
        found = np.empty((len(y), len(self.labels)))
        for i, sample in enumerate(zip(y, v, a, strict=True)):
            x, push = self.consistent(*sample)
            terms = self._inverse.demand(x, push, [load[i] for load in loads])
            found[i] = self.motions(x.q).T @ terms
        known: Array = found - rows @ self._given
        return known

    def carry(self, model: Any) -> None:
        """From now on `weight` is that of a model with other inertias."""
        self._carried = model

    def weight(self, y: Array) -> Array:
        """Torques that hold joints still, shape (n, len(labels))."""
        zero, found = np.zeros((len(y), self._model.nv)), np.empty((len(y), len(self.labels)))
        for row, sample in zip(found, y, strict=True):
            still = zero[0][: self._width(sample)]
            x, _ = self._solver.measured(0.0, sample, still, still)
            row[...] = pin.computeGeneralizedGravity(self._carried, self._data, x.q)[self._first]
        return found

    def _width(self, sample: Array) -> int:
        return len(sample) - (int(self._model.nq) - int(self._model.nv))


def _leading(J: Array, wanted: Sequence[int]) -> NDArray[np.intp]:
    """Coordinates that determine all others, of those that are wanted.

    Raises:
        ModelError: They do not, or there are more of them than the mechanism has motions.
    """
    nv, size = J.shape[1], SINGULAR * float(np.linalg.norm(J, 2))

    def rank(columns: Sequence[int]) -> int:
        return int(np.linalg.matrix_rank(J[:, columns], tol=size)) if len(columns) else 0

    freedom, chosen = nv - rank(range(nv)), list[int]()
    for v in wanted:
        held = [i for i in range(nv) if i not in {*chosen, v}]
        if rank(held) == nv - freedom:
            chosen.append(v)
    if len(chosen) < freedom or len(wanted) > freedom:
        raise ModelError(
            f"the mechanism has {freedom} motions and {len(wanted)} joints with measured efforts: "
            "identification needs as many as there are motions, none of them idle"
        )
    return np.array(sorted(chosen), dtype=np.intp)
