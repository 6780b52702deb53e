"""Messages of an estimate: states, unknown efforts, forces, deviations, innovations."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.estimation.tracker import Tracker
from mbd_ros.core.names import without_multiplier
from mbd_ros.core.state import Array, Evaluation
from mbd_ros.jobs.estimate.estimation import Estimation
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.multi_array_cdr import MultiArrayCdrWriter


class EstimateMessages(NamedTuple):
    """Messages that answer a sample, serialized.

    Attributes:
        stamp: Of the estimate [ns].
        states: All joints.
        disturbance: Unknown efforts, None without any.
        forces: Multipliers of all rows, None without any.
        deviations: Float64MultiArray of standard deviations, labelled.
        innovations: Float64MultiArray, labelled: normalised innovations, then NIS, its mean and
            the correlation of the newest samples.
    """

    stamp: int
    states: bytes
    disturbance: bytes | None
    forces: bytes | None
    deviations: bytes
    innovations: bytes


class EstimateWriter:
    """Writes what a tracker believes.

    Args:
        estimation: What is estimated.

    Attributes:
        now: The equations of motion at the newest estimate.
    """

    now: Evaluation

    def __init__(self, estimation: Estimation) -> None:
        self._estimation, self._system = estimation, estimation.process.simulation.system
        joints = estimation.scene.robot.joints
        names = [joint.name for joint in joints]
        self._q, self._v = [joint.q for joint in joints], [joint.v for joint in joints]
        self._states = JointStateCdrWriter(names)
        self._disturbance = JointStateCdrWriter(estimation.disturbed, ("effort",))
        rows = [without_multiplier(row.name) for row in self._system.multiplier_rows]
        self._forces = JointStateCdrWriter(rows, ("effort",)) if rows else None
        labels = [f"{name}.{kind}" for kind in ("position", "velocity") for name in names]
        labels += self._system.internals.names
        self._deviations = MultiArrayCdrWriter(len(labels), labels)
        numbers = [*estimation.process.sensors.names, "nis", "mean_nis", "correlation"]
        self._innovations = MultiArrayCdrWriter(len(numbers), numbers)

    def write(self, tracker: Tracker, stamp: int, u: Array) -> EstimateMessages:
        """The messages of the newest estimate.

        Args:
            tracker: Has it.
            stamp: Of the estimate [ns].
            u: Inputs there.

        Raises:
            MessageError: A number is not finite.
        """
        system, belief = self._system, tracker.belief
        x = system.expand(belief.x)
        self.now = system.evaluate(x, u)
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
        spread = self._deviations.write(self._spread(tracker, len(x.z)))
        judged = self._judged(tracker)
        return EstimateMessages(stamp, states, disturbance, forces, spread, judged)

    def _spread(self, tracker: Tracker, nz: int) -> list[float]:
        belief, nv = tracker.belief, self._system.robot.model.nv
        lift = self._estimation.process.tangent.of_all_joints(belief.x)
        rows = lift[[*self._v, *(nv + v for v in self._v)]]
        spread = np.einsum("ij,ij->i", rows.dot(belief.P), rows)
        every = np.concatenate((spread, belief.P.diagonal()[len(belief.P) - nz :]))
        deviations: list[float] = np.sqrt(np.maximum(every, 0.0)).tolist()
        return deviations

    def _judged(self, tracker: Tracker) -> bytes:
        innovation, consistency = tracker.belief.innovation, tracker.watch.consistency()
        assert innovation is not None
        values = np.where(np.isfinite(innovation.values), innovation.normalized, 0.0)
        nis = innovation.squared / max(innovation.freedom, 1)
        more = nis, consistency.nis, consistency.correlation
        return self._innovations.write([*values.tolist(), *more])
