"""Messages of an estimate: states, unknown efforts, forces, deviations, innovations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbd_ros.core.contracts import without_multiplier
from mbd_ros.core.state import NONE, Array, Evaluation, State
from mbd_ros.features.estimation.estimation import Estimation
from mbd_ros.features.estimation.faults import Consistency
from mbd_ros.methods.estimation.process import Belief
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.multi_array import MatrixCdrWriter, MultiArrayCdrWriter


class EstimateWriter:
    """Writes what is believed.

    Args:
        estimation: What is estimated.
        with_covariance: Whether the covariance is wanted.
    """

    def __init__(self, estimation: Estimation, *, with_covariance: bool = False) -> None:
        self._estimation = estimation
        self._system = estimation.process.simulation.system
        joints = estimation.scene.robot.joints
        names = [joint.name for joint in joints]
        self._q = [joint.q for joint in joints]
        self._v = [joint.v for joint in joints]
        self._states = JointStateCdrWriter(names)
        self._disturbance = JointStateCdrWriter(estimation.disturbed, ("effort",))
        rows = [without_multiplier(row.name) for row in self._system.multiplier_rows]
        self._forces = JointStateCdrWriter(rows, ("effort",)) if rows else None
        labels = [f"{name}.{kind}" for kind in ("position", "velocity") for name in names]
        labels += self._system.internals.names
        self._numbers = list(estimation.parameters.values())
        named = [*estimation.parameters, *(f"{n}.deviation" for n in estimation.parameters)]
        self._parameters = MultiArrayCdrWriter(len(named), named) if named else None
        self._covariance = MatrixCdrWriter(labels, labels) if with_covariance else None
        self._deviations = MultiArrayCdrWriter(len(labels), labels)
        numbers = [*estimation.process.sensors.names, "nis", "mean_nis", "correlation"]
        self._innovations = MultiArrayCdrWriter(len(numbers), numbers)
        self._x: State = estimation.process.start
        self._u: Array | None = NONE
        self._now: Evaluation | None = None
        self._whole: Array | None = None

    @property
    def now(self) -> Evaluation:
        """The equations of motion at the estimate that was written last."""
        if self._now is None:
            self._now = self._estimation.process.evaluate(self._x, self._u)
        return self._now

    def write(
        self, belief: Belief, consistency: Consistency, stamp: int, u: Array | None
    ) -> EstimateMessages:
        """The messages of an estimate.

        Args:
            belief: The estimate.
            consistency: Of the newest innovations.
            stamp: Of the estimate [ns].
            u: Inputs there.

        Raises:
            MessageError: A number is not finite.
        """
        system = self._system
        x = system.expand(belief.x)
        self._x = x
        self._u = u
        self._now = None
        system.k.refresh(x.q, x.v, system.loads.reads)
        effort = system.loads.actuator_torque(system.k, x, u)
        states = self._states.write(
            stamp, position=x.q[self._q], velocity=x.v[self._v], effort=effort[self._v]
        )
        disturbance = forces = None
        if self._estimation.disturbed:
            unknown = self._estimation.unknown_efforts(x)
            disturbance = self._disturbance.write(stamp, effort=unknown)
        if self._forces is not None:
            forces = self._forces.write(stamp, effort=self.now.lam)
        rows = self._rows(belief.x)
        spread = np.sqrt(np.maximum(np.einsum("ij,ij->i", rows.dot(belief.P), rows), 0.0))
        parameters = covariance = None
        if self._parameters is not None:
            known = spread[len(spread) - len(x.z) :][self._numbers]
            parameters = self._parameters.write([*x.z[self._numbers].tolist(), *known.tolist()])
        if self._covariance is not None:
            covariance = self._covariance.write(rows.dot(belief.P).dot(rows.T).ravel().tolist())
        deviations = self._deviations.write(spread.tolist())
        return EstimateMessages(
            *(stamp, states, disturbance, forces, deviations, parameters, covariance),
            self._judged(belief, consistency),
        )

    def _rows(self, y: State) -> Array:
        """From steps of the tangent to positions, velocities and internal states."""
        if self._whole is not None:
            return self._whole
        tangent, nz = self._estimation.process.tangent, len(y.z)
        lift, nv = tangent.of_all_joints(y), self._system.robot.model.nv
        rows = np.zeros((2 * len(self._v) + nz, tangent.n))
        rows[: len(rows) - nz] = lift[[*self._v, *(nv + v for v in self._v)]]
        rows[len(rows) - nz :, tangent.n - nz :] = np.eye(nz)
        if tangent.is_whole:
            self._whole = rows
        return rows

    def _judged(self, belief: Belief, consistency: Consistency) -> bytes:
        innovation = belief.innovation
        assert innovation is not None
        values = np.where(np.isfinite(innovation.values), innovation.normalized, 0.0)
        nis = innovation.squared / max(innovation.freedom, 1)
        more = nis, consistency.nis, consistency.correlation
        return self._innovations.write([*values.tolist(), *more])


class EstimateMessages(NamedTuple):
    """Messages that answer a sample, serialized.

    Attributes:
        stamp: Of the estimate [ns].
        states: All joints.
        disturbance: Unknown efforts, None without any.
        forces: Multipliers of all rows, None without any.
        deviations: Float64MultiArray of standard deviations, labelled.
        parameters: Float64MultiArray of estimated numbers and their deviations, None without any.
        covariance: Float64MultiArray, None where it is not wanted.
        innovations: Float64MultiArray, labelled: normalised innovations, then NIS, its mean and
            the correlation of the newest samples.
    """

    stamp: int
    states: bytes
    disturbance: bytes | None
    forces: bytes | None
    deviations: bytes
    parameters: bytes | None
    covariance: bytes | None
    innovations: bytes
