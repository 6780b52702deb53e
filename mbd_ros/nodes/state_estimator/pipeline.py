"""A built scene between messages: from what is measured to estimated states."""

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np

from mbd_ros.core.estimation.tracker import Taken, Tracker
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.jobs.estimate.estimation import EFFORTS, estimation_of
from mbd_ros.nodes.shell.parameters import ParameterError
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.nodes.state_estimator.messages import EstimateMessages, EstimateWriter
from mbd_ros.nodes.state_estimator.parameters import TRACKER, task_of
from mbd_ros.scene.reader import load_scene
from mbd_ros.sensors.encoder import Encoder
from mbd_ros.sensors.imu import Imu
from mbd_ros.sensors.tachometer import Tachometer
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader


def refuse_unknown(given: Sequence[str], names: Sequence[str]) -> None:
    """Refuse joints that there are not.

    Raises:
        ParameterError: Names them and what there is.
    """
    unknown = [name for name in given if name not in names]
    if unknown:
        raise ParameterError(f"unknown joints {', '.join(unknown)}; accepted: {', '.join(names)}")


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
        measured = list(values.measured) or names
        refuse_unknown(measured, names)
        self.estimation = found = estimation_of(
            scene, task_of(values), measured, measured if values.velocities else ()
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
        self._v = [joint.v for joint in scene.robot.joints]
        self._writer = EstimateWriter(found)
        self.forget()

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
        return self._writer.write(self.tracker, stamp, u) if taken is Taken.USED else taken

    def _begin(self, stamp: int, values: Array, velocity: Array) -> None:
        found, kept = self.estimation, self._values
        self._origin = stamp
        start = found.scene.initial
        first = start._replace(t=0.0, v=start.v.copy())
        told = np.flatnonzero(np.isfinite(velocity))
        first.v[[self._v[i] for i in told]] = velocity[told]
        y = found.process.near(found.process.consistent(first), values, found.prior)
        found.estimator.begin(y, found.prior, 0.0)
        options = {name: getattr(kept, name) for name in TRACKER}
        self.tracker = Tracker(found.estimator, found.process.sensors, **options)

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
        else:
            consistency = self.tracker.watch.consistency()
            if consistency.nis > consistency.nis_band[1] and consistency.fault:
                reasons.append(consistency.fault)
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
