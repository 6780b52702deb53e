"""A built scene between messages: from what is measured to estimated states."""

from collections.abc import Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.estimation.tracker import Taken, Tracker
from mbd_ros.core.names import without_multiplier
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.jobs.estimate.estimation import EFFORTS, estimation_of
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.nodes.state_estimator.parameters import task_of
from mbd_ros.scene.reader import load_scene
from mbd_ros.sensors.encoder import Encoder
from mbd_ros.sensors.imu import Imu
from mbd_ros.sensors.tachometer import Tachometer
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader, JointStateCdrWriter
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


class EstimatorPipeline:
    """Scene and estimator of a configured node `state_estimator`.

    Args:
        values: Parameters of the node.
        description: URDF, where the scene takes it from a topic.

    Attributes:
        scene: The scene, as it was given.
        estimation: Scene, process and estimator.
        joints: Which joints the newest joint state carried.
        reader: Serialized joint states to samples.
        imus: Sensors whose messages come on topics of their own.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        self.scene = scene = load_scene(values.scene, description)
        self._values = values
        names = [joint.name for joint in scene.robot.joints]
        self.estimation = found = estimation_of(
            scene, task_of(values), names, names if values.velocities else ()
        )
        self.joints = JointStateReader(names)
        self.reader = JointStateCdrReader(self.joints, joint_state)
        sensors = found.process.sensors
        pairs = list(zip(sensors.sensors, sensors.slices, strict=True))
        at = {name: i for i, name in enumerate(names)}
        self._of_position, self._of_velocity = (
            [(at[s.frame], mine.start) for s, mine in pairs if isinstance(s, kind)]
            for kind in (Encoder, Tachometer)
        )
        self.imus = {s.name: (s, mine) for s, mine in pairs if isinstance(s, Imu)}
        self._inputs = found.scene.inputs.safe
        self._efforts = found.scene.inputs.slots.get(EFFORTS)
        self._system = found.process.simulation.system
        self._write(names)
        self.forget()

    def _write(self, names: Sequence[str]) -> None:
        found, system = self.estimation, self._system
        self._q, self._v = ([getattr(j, k) for j in self.scene.robot.joints] for k in "qv")
        self._states = JointStateCdrWriter(names)
        self._disturbance = JointStateCdrWriter(found.disturbed, ("effort",))
        rows = [without_multiplier(row.name) for row in system.multiplier_rows]
        self._forces = JointStateCdrWriter(rows, ("effort",)) if rows else None
        labels = [f"{name}.position" for name in names] + [f"{name}.velocity" for name in names]
        labels += system.internals.names
        self._deviations = MultiArrayCdrWriter(len(labels), labels)
        numbers = [*found.process.sensors.names, "nis", "mean_nis", "correlation"]
        self._innovations = MultiArrayCdrWriter(len(numbers), numbers)

    def forget(self) -> None:
        """Forget the past: the next joint state is the first one."""
        self.tracker: Tracker | None = None
        self._origin, self._debt, self._late = 0, 0.0, 0
        self._command = self._inputs.copy()

    def take_command(self, values: Array) -> None:
        """Take the commands of all actuators, in the order of the scene."""
        self._command = np.concatenate((values, self._command[len(values) :]))

    def answer(self, stamp: int, sample: JointSample) -> EstimateMessages | Taken:
        """Messages for a joint state, or what became of it.

        Args:
            stamp: Time [ns].
            sample: What `reader` read last.

        Raises:
            SolveError: There is no consistent state near the sample.
            DivergedError: The prediction is no longer finite.
        """
        values = np.full(self.estimation.process.sensors.m, np.nan)
        for row, at in self._of_position:
            values[at] = sample.position[row]
        for row, at in self._of_velocity:
            values[at] = sample.velocity[row]
        values[~np.isfinite(values)] = np.nan
        u = self._command
        if self._efforts is not None:
            u = self._inputs.copy()
            u[self._efforts] = np.where(np.isfinite(sample.effort), sample.effort, 0.0)
        return self._taken(stamp, values, u, sample.velocity)

    def answer_imu(self, name: str, stamp: int, measured: Array) -> EstimateMessages | Taken:
        """Messages for an IMU; before the first joint state it says nothing.

        Raises:
            SolveError: As `answer`.
            DivergedError: As `answer`.
        """
        if self.tracker is None:
            return Taken.OLD
        values = np.full(self.estimation.process.sensors.m, np.nan)
        values[self.imus[name][1]] = measured
        return self._taken(stamp, values, self._newest_u, self.joints.absent)

    def _taken(
        self, stamp: int, values: Array, u: Array, velocity: Array
    ) -> EstimateMessages | Taken:
        if self.tracker is None:
            self._begin(stamp, values, velocity)
        assert self.tracker is not None
        t = (stamp - self._origin) * NANOSECOND
        before, began = self.tracker.belief.t, perf_counter()
        estimator = self.tracker.estimator
        estimator.is_late = self._debt > self._values.deadline
        self._late += estimator.is_late
        self._newest_u = u
        taken = self.tracker.take(t, values, u)
        spent = perf_counter() - began
        self._debt = max(0.0, self._debt + spent - max(t - before, 0.0))
        return self._messages(u) if taken is Taken.USED else taken

    def _begin(self, stamp: int, values: Array, velocity: Array) -> None:
        found, kept = self.estimation, self._values
        self._origin = stamp
        start = found.scene.initial
        first = start._replace(t=0.0, v=start.v.copy())
        told = np.flatnonzero(np.isfinite(velocity))
        first.v[[self._v[i] for i in told]] = velocity[told]
        y = found.process.near(first, values, found.prior)
        found.estimator.begin(y, found.prior, 0.0)
        names = ("memory", "patience", "max_age", "gate", "agility")
        options = {name: getattr(kept, name) for name in names}
        self.tracker = Tracker(found.estimator, found.process.sensors, **options)

    def _messages(self, u: Array) -> EstimateMessages:
        assert self.tracker is not None
        system, belief = self._system, self.tracker.belief
        stamp = self._origin + round(belief.t / NANOSECOND)
        x = system.expand(belief.x)
        now = system.evaluate(x, u)
        effort = system.loads.actuator_torque(system.k, x, u)
        states = self._states.write(
            stamp, position=x.q[self._q], velocity=x.v[self._v], effort=effort[self._v]
        )
        disturbance = forces = None
        spread = self._spread(len(x.z))
        if self.estimation.disturbed:
            disturbance = self._disturbance.write(stamp, effort=self.estimation.unknown_efforts(x))
        if self._forces is not None:
            forces = self._forces.write(stamp, effort=now.lam)
        self._now = now
        return EstimateMessages(
            stamp, states, disturbance, forces, self._deviations.write(spread), self._judged()
        )

    def _spread(self, nz: int) -> Sequence[float]:
        assert self.tracker is not None
        belief, tangent = self.tracker.belief, self.estimation.process.tangent
        lift, nv = tangent.of_all_joints(belief.x), self.scene.robot.model.nv
        rows = lift[[*self._v, *(nv + v for v in self._v)]]
        spread = np.einsum("ij,ij->i", rows.dot(belief.P), rows)
        z = belief.P.diagonal()[len(belief.P) - nz :]
        deviations: list[float] = np.sqrt(np.maximum(np.concatenate((spread, z)), 0.0)).tolist()
        return deviations

    def _judged(self) -> bytes:
        assert self.tracker is not None
        innovation, consistency = self.tracker.belief.innovation, self.tracker.watch.consistency()
        assert innovation is not None
        values = np.where(np.isfinite(innovation.values), innovation.normalized, 0.0)
        nis = innovation.squared / max(innovation.freedom, 1)
        return self._innovations.write(
            [*values.tolist(), nis, consistency.nis, consistency.correlation]
        )

    def held(self) -> Sequence[str]:
        """Joints that nothing gives: none, all are estimated."""
        return ()

    def health(self) -> tuple[int, str]:
        """WARN where sensors are faulty, innovations are wrong, or there is no time."""
        if self.tracker is None:
            return OK, "nothing measured yet"
        belief, faults = self.tracker.belief, self.tracker.faults.found()
        reasons = [f"{name}: {what}" for name, what in faults.items()]
        if not belief.is_trusted:
            reasons.append(belief.remark)
        elif fault := self.tracker.watch.consistency().fault:
            reasons.append(fault)
        return (WARN, "; ".join(reasons)) if reasons else (OK, "estimates published")

    def details(self) -> dict[str, str]:
        """Of the newest estimate, for diagnostics."""
        found = self.estimation
        shown = {
            "estimator": self._values.estimator,
            "measured": ", ".join(found.process.sensors.names),
            "unknown efforts": ", ".join(found.disturbed) or "none",
            "inputs": self._values.inputs,
            "answers without the horizon": str(self._late),
        }
        if self.tracker is None:
            return shown
        consistency = self.tracker.watch.consistency()
        low, high = consistency.nis_band
        return {
            **shown,
            "mean square of innovations": f"{consistency.nis:.4g}, {low:.4g} .. {high:.4g} for a "
            "right model",
            "correlation of innovations": f"{consistency.correlation:.4g}",
            "sensor faults": ", ".join(self.tracker.faults.found()) or "none",
            "began anew": str(self.tracker.restarts),
        }
