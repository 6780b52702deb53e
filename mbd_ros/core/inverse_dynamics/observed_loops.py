"""Independent joints of a mechanism with loops -> torques, as `InverseDynamics` gives them."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.core.inverse_dynamics.standing import Mask
from mbd_ros.core.inverse_dynamics.torques import Torques
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.couplings import Slopes
from mbd_ros.core.multiplier_laws import Kind
from mbd_ros.core.names import without_multiplier
from mbd_ros.core.state import Array, State


class ObservedLoops:
    """Makes a measured motion consistent, then solves it, sample by sample as `InverseDynamics`.

    Args:
        inverse: The solver, owned from now on.

    Attributes:
        inverse: The solver.
        couplings: The dependent joints.
        configuration: Consistent configuration of the last sample, shape (nq,).
        needed: Joints that must be measured: none, as long as the loops tie them to others.
        rows: Names of the multipliers: the dependent joints, then the rows of the constraints.
        moved: How far a joint of the last sample was moved onto the constraints [rad or m].
        told: Which features of contacts stand, where somebody says so; None for geometry.
        motion: State and acceleration of the last sample as it was solved; None before.
        gap: Residual of every row at the last sample as measured, shape (m,); 0 for couplings,
            whose violation stands elsewhere, and where the motion need not keep a row.
    """

    def __init__(self, inverse: ClosedLoopInverseDynamics) -> None:
        self.inverse, self.couplings = inverse, inverse.couplings
        self.configuration, self.moved = inverse.robot.neutral(), 0.0
        self._model = inverse.robot.model
        self.told: Mask | None = None
        self.motion: tuple[State, Array] | None = None
        self._slopes: Slopes = [0.0] * len(inverse.couplings.pairs)
        constraints = inverse.constraints
        self.rows = tuple(without_multiplier(row.name) for row in constraints.rows)
        self.gap = np.zeros(len(self.rows))
        self._k = Kinematics(inverse.robot)
        self._is_kept = np.zeros(len(self.rows), dtype=np.bool_)
        for part, mine in zip(constraints.parts, constraints.slices, strict=True):
            self._is_kept[mine] = part.law.kind is Kind.BILATERAL
        self.needed: tuple[str, ...] = ()

    def measured(
        self, t: float, position: Array, velocity: Array, acceleration: Array
    ) -> tuple[State, Array]:
        """State and acceleration of all joints as measured, couplings alone kept.

        Args:
            t: Time [s].
            position: Independent joints [rad or m], shape (ny,).
            velocity: [rad/s or m/s], shape (nv_y,).
            acceleration: [rad/s^2 or m/s^2], shape (nv_y,).
        """
        couplings, nv = self.couplings, int(self._model.nv)
        q, v, a = np.empty(int(self._model.nq)), np.zeros(nv), np.zeros(nv)
        q[couplings.q_index] = position
        v[couplings.v_index], a[couplings.v_index] = velocity, acceleration
        couplings.expand(q, v, a, self._slopes)
        return State(t, q, v), a

    def solve(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> Torques:
        """Torques of the independent coordinates of one sample, 0 where nothing acts.

        Args:
            position: y [rad or m], shape (ny,), near the constraints.
            velocity: y' [rad/s or m/s], shape (nv_y,).
            acceleration: y'' [rad/s^2 or m/s^2], shape (nv_y,).
            wrenches: One (6,) array [N, N·m] for every load of the scene; none means unloaded.

        Returns:
            Fresh arrays; multipliers of `rows`.

        Raises:
            SolveError: The mechanism cannot be assembled near this position, or the actuators
                cannot produce the motion.
        """
        measured, given = self.measured(0.0, position, velocity, acceleration)
        self.gap = self._residual(measured)
        x, a = self.inverse.consistent(measured, given)
        self.configuration, self.motion = x.q, (x, a)
        self.moved = float(np.abs(pin.difference(self._model, measured.q, x.q)).max(initial=0.0))
        found = self.inverse.solve(x, a, wrenches, self.told)
        B, n = self.inverse.columns(x), len(found.tau)
        tau = B.dot(found.tau)
        tau += self.inverse.carried(found)
        reduced, _ = self.couplings.reduce(tau, self._slopes)
        nothing, _ = self.couplings.reduce(B.dot(found.null_basis[:n]), self._slopes)
        basis = np.concatenate((nothing, found.null_basis[n:]))
        return found._replace(tau=reduced, null_basis=basis)

    def doubts(self) -> list[str]:
        """What is to be said about force terms at the last sample of `solve`."""
        if self.motion is None:
            return []
        x = self.motion[0]
        return [said for term in self.inverse.forces if (said := term.doubt(x))]

    def _residual(self, x: State) -> Array:
        self._k.refresh(x.q, x.v, Reads.POSITION)
        gap = self.inverse.constraints.residual(self._k, x)
        return np.where(self._is_kept, gap, 0.0)
