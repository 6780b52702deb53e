"""Results of inverse dynamics, and the solvers that are asked sample by sample."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import NONE, Array

NO_BASIS: Array = np.zeros((0, 0))
NO_BASIS.setflags(write=False)


class Torques(NamedTuple):
    """Torques and multipliers that explain a motion, with loops or without.

    Attributes:
        tau: Force of every independent coordinate [N·m or N], shape (nv_y,) or (n, nv_y); of
            `ClosedLoopInverseDynamics` the inputs of its `efforts`, shape (na,).
        multipliers: Force of the tendon, cam or gear of every dependent joint on that joint
            [N·m for a revolute joint, N for a prismatic one], shape (n_d,) or (n, n_d). Positive
            pushes the joint in its positive direction. On its parent the coupling exerts -f' times
            as much. With loops one a row of the constraints; that of a drive is its effort.
        rank: How many independent forces efforts and multipliers exert together.
        residual: What a free base would need beside them, since nothing carries it: force [N],
            then moment [N·m] on it, in its axes, shape (6,) or (n, 6); six for each free base, 0
            where something carries it; size 0 without a free base.
        null_space: Dimension of the efforts and multipliers that together exert nothing, bounds
            left aside; 0 without loops.
        undetermined: `<joint>.effort` and names of rows that take part in it.
        condition: Beyond 1e6 the mechanism is near a toggle and the result unreliable; 1
            without loops.
        null_basis: Entries of tau, then of multipliers, that together exert nothing, one
            combination a column, shape (.., null_space); size 0 without loops.
        carried: The same as the residual for joints that stand for a free base [N·m or N].
    """

    tau: Array
    multipliers: Array
    rank: int
    residual: Array = NONE
    null_space: int = 0
    undetermined: tuple[str, ...] = ()
    condition: float = 1.0
    null_basis: Array = NO_BASIS
    carried: Array = NONE


class SampleSolver(Protocol):
    """Inverse dynamics of the independent joints, sample by sample, with loops or without.

    Attributes:
        couplings: The dependent joints.
        configuration: Configuration of the last sample, shape (nq,).
        rows: Names of the multipliers: the dependent joints, then the rows of the constraints.
        needed: Joints that must be measured; loops give the others.
        moved: Largest move of a joint of the last sample onto the constraints [rad or m].
        gap: Residual of every row at the last sample as measured, shape (m,); 0 for drives and
            for couplings.
    """

    couplings: Couplings
    configuration: Array
    rows: tuple[str, ...]
    needed: tuple[str, ...]
    moved: float
    gap: Array

    def solve(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> Torques:
        """Torques of one sample.

        Args:
            position: y [rad or m], shape (ny,).
            velocity: y' [rad/s or m/s], shape (nv_y,).
            acceleration: y'' [rad/s^2 or m/s^2], shape (nv_y,).
            wrenches: One (6,) array [N, N·m] for every load of the scene; none means unloaded.
        """
        ...

    def doubts(self) -> list[str]:
        """What is to be said about force terms at the last sample of `solve`."""
        ...
