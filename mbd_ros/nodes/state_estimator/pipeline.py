"""From serialized measurements to messages with estimated states.

The messages carry states, unknown efforts, forces, deviations and innovations.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import without_multiplier
from mbd_ros.core.loads.external_loads import WrenchBuffer
from mbd_ros.core.state import NANOSECOND, NONE, Array, Evaluation, State
from mbd_ros.features.estimation.estimation import EFFORTS, Estimation, build_estimation
from mbd_ros.features.estimation.faults import Consistency
from mbd_ros.features.estimation.tracker import LagWindow, SampleOutcome, Tracker
from mbd_ros.features.estimation.unknowns import scene_sensor
from mbd_ros.methods.estimation.process import Belief
from mbd_ros.nodes.shell.parameters import ParameterError
from mbd_ros.nodes.shell.sensor_messages import sensor_messages
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.nodes.state_estimator.parameters import TRACKER, task_of
from mbd_ros.parts.estimators.moving_horizon import MovingHorizon
from mbd_ros.parts.sensors.effort import Effort
from mbd_ros.parts.sensors.encoder import Encoder
from mbd_ros.parts.sensors.tachometer import Tachometer
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader, JointStateCdrWriter
from msg_adapters.multi_array import MatrixCdrWriter, MultiArrayCdrWriter


class EstimateMessages(NamedTuple):
    """Messages that answer a sample, serialized.

    Attributes:
        stamp: Of the estimate [ns].
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


Answer = (
    list[EstimateMessages] | SampleOutcome
)  # estimates that are due, or what became of the sample
_MOST_LAG = 1.0  # s of work by which answers may lag behind before late samples are left out
_REWIND = 1.0  # s, by which wrenches are older where time begins anew


class EstimatorPipeline:
    """Scene and estimator of a configured node `state_estimator`.

    Args:
        description: URDF, where the scene takes it from a topic.
        lag: Time that estimates wait for later measurements [s].

    Attributes:
        scene: The scene, as it was given.
        newest: Stamp of the newest sample that was used [ns].
        estimation: Scene, process and estimator.
        joints: Which joints the newest joint state carried.
        reader: Serialized joint states to samples.
        messages: Of sensors that have topics of their own.
        wrenches: Newest samples of external wrenches, by name.
    """

    def __init__(self, values: Any, description: str | None, lag: float = 0.0) -> None:
        if lag and values.estimator != "extended_kalman":
            raise ParameterError(f"lag: {values.estimator} has none; accepted: extended_kalman")
        self._smoothing_lag = lag
        self.scene = scene = load_scene(values.scene, description)
        self._values = values
        names = [joint.name for joint in scene.robot.joints]
        measured = list(values.measured) or names
        refuse_unknown(measured, names)
        self.estimation = setup = build_estimation(
            scene, task_of(values), measured, measured if values.velocities else ()
        )
        self.joints = JointStateReader(names)
        self.reader = JointStateCdrReader(self.joints, joint_state)
        sensors = setup.process.sensors
        pairs = list(zip(sensors.sensors, sensors.slices, strict=True))
        at = {name: i for i, name in enumerate(names)}
        own = [(scene_sensor(s), mine) for s, mine in pairs]
        self._of_joints = [
            [(at[s.frame], mine.start) for s, mine in own if isinstance(s, kind)]
            for kind in (Encoder, Tachometer, Effort)
        ]
        self._slices = {s.name: mine for s, mine in pairs}
        self.messages = sensor_messages(scene.robot, scene.sensors)
        ages = round(values.wrench_max_age / NANOSECOND), round(_REWIND / NANOSECOND)
        self.wrenches = {name: WrenchBuffer(*ages) for name in scene.wrenches}
        self._inputs = setup.scene.inputs.safe
        slots = setup.scene.inputs.slots
        self._efforts = slots.get(EFFORTS)
        self._loads = [(slots[name], buffer) for name, buffer in self.wrenches.items()]
        self._driven = np.ones(len(names), dtype=np.bool_)
        self._driven[[row for row, _ in self._of_joints[-1]]] = False
        self._v = [joint.v for joint in scene.robot.joints]
        self._writer = EstimateWriter(setup, with_covariance=values.covariance)
        self.forget()

    def forget(self) -> None:
        """Forget the past: the next joint state is the first one."""
        self.tracker: Tracker | None = None
        self.newest = 0
        self._origin = 0
        self._debt = 0.0
        self._lag = 0.0  # of the work behind the samples, which errors do not end [s]
        self._ended = perf_counter()
        self._late = 0
        self._command = self._inputs.copy()
        for buffer in self.wrenches.values():
            buffer.clear()

    def restart(self) -> None:
        """Forget the past after an error, but not how far answers lag behind the samples."""
        lag = self._lag
        self.forget()
        self._lag = lag

    def take_command(self, values: Array) -> None:
        """Take the commands of all actuators, in the order of the scene."""
        self._command = np.concatenate((values, self._command[len(values) :]))

    def answer(self, stamp: int, sample: JointSample) -> Answer:
        """Messages for a joint state, or what became of it.

        Args:
            stamp: Time [ns].
            sample: What `reader` read last.

        Raises:
            SolveError: There is no consistent state near the sample.
            DivergedError: The prediction is no longer finite.
        """
        values = np.full(self.estimation.process.sensors.m, np.nan)
        told = sample.position, sample.velocity, sample.effort
        for field, rows in zip(told, self._of_joints, strict=True):
            for row, at in rows:
                values[at] = field[row]
        values[~np.isfinite(values)] = np.nan
        u = self._command
        if self._efforts is not None:
            u = self._inputs.copy()
            known = self._driven & np.isfinite(sample.effort)
            u[self._efforts] = np.where(known, sample.effort, 0.0)
        return self._taken(stamp, values, self._loaded(stamp, u), sample.velocity)

    def _loaded(self, stamp: int, u: Array) -> Array:
        """The inputs with external wrenches at a time [ns]; nothing where none is near."""
        if self._loads:
            u = u.copy()
        for slot, buffer in self._loads:
            wrench = buffer.at(stamp)
            u[slot] = 0.0 if wrench is None else wrench
        return u

    def answer_sensor(self, name: str, stamp: int, measured: Array) -> Answer:
        """Messages for a sensor with a topic of its own; nothing before the first joint state.

        Raises:
            SolveError: There is no consistent state near the sample.
            DivergedError: The prediction is no longer finite.
        """
        if self.tracker is None:
            return SampleOutcome.OLD
        values = np.full(self.estimation.process.sensors.m, np.nan)
        values[self._slices[name]] = measured
        return self._taken(stamp, values, self._newest_u, self.joints.absent)

    def _taken(self, stamp: int, values: Array, u: Array, velocity: Array) -> Answer:
        began = thread_time()
        self._lag = max(0.0, self._lag - (perf_counter() - self._ended))
        is_hurried = self._lag > _MOST_LAG
        if is_hurried and self.tracker is None:
            return SampleOutcome.OLD
        advance = 0.0
        try:
            if self.tracker is None:
                self._begin(stamp, values, velocity)
            assert self.tracker is not None
            t = (stamp - self._origin) * NANOSECOND
            advance, begin = max(t - self.tracker.belief.t, 0.0), perf_counter()
            estimator = self.tracker.estimator
            estimator.is_late = self._debt > self._values.deadline
            self._late += estimator.is_late
            self._newest_u = u
            self.tracker.is_hurried = is_hurried
            taken = self.tracker.add_sample(t, values, u)
            self._debt = max(0.0, self._debt + perf_counter() - begin - advance)
        finally:
            self._ended, spent = perf_counter(), thread_time() - began
            self._lag = max(0.0, self._lag + spent - min(advance, self._values.max_age))
        if taken is not SampleOutcome.USED:
            return taken
        self.newest, consistency = stamp, self.tracker.watch.consistency()
        if self.tracker.window is None:
            return [self._writer.write(self.tracker.belief, consistency, stamp, u)]
        due = self.tracker.window.due()
        stamps = [self._origin + round(one.belief.t / NANOSECOND) for one in due]
        pairs = zip(due, stamps, strict=True)
        return [self._writer.write(one.belief, consistency, at, one.u) for one, at in pairs]

    def _begin(self, stamp: int, values: Array, velocity: Array) -> None:
        setup, parameters = self.estimation, self._values
        self._origin = stamp
        start = setup.scene.initial
        first = start._replace(t=0.0, v=start.v.copy())
        told = np.flatnonzero(np.isfinite(velocity))
        first.v[[self._v[i] for i in told]] = velocity[told]
        y = setup.process.fit_state(setup.process.consistent(first), values, setup.prior)
        setup.estimator.begin(y, setup.prior, 0.0)
        options = {name: getattr(parameters, name) for name in TRACKER}
        longest = max(parameters.max_age, parameters.patience)
        self.tracker = Tracker(setup.estimator, setup.process.sensors, longest=longest, **options)
        if self._smoothing_lag:
            self.tracker.window = LagWindow(setup.process, self._smoothing_lag)

    def held_joints(self) -> Sequence[str]:
        """Joints that nothing gives: none, all are estimated."""
        return ()

    def health(self) -> tuple[int, str]:
        """WARN where sensors are faulty, innovations are wrong, or there is no time."""
        if self.tracker is None:
            return OK, "nothing measured yet"
        belief, faults = self.tracker.belief, self.tracker.faults.active_faults()
        reasons = [f"{name}: {what}" for name, what in faults.items()]
        if given_up := self._given_up():
            reasons.append(f"beyond limits, which do not count: {given_up}")
        if not belief.is_trusted:
            reasons.append(belief.remark)
        else:
            consistency = self.tracker.watch.consistency()
            if consistency.nis > consistency.nis_band[1] and consistency.fault:
                reasons.append(consistency.fault)
        return (WARN, "; ".join(reasons)) if reasons else (OK, "estimates published")

    def _given_up(self) -> str:
        """Limits that measurements contradict, by name."""
        found, estimator = self.estimation.process, self.estimation.estimator
        if not isinstance(estimator, MovingHorizon):
            return ""
        return ", ".join(found.bounded_names[i] for i in estimator.given_up)

    def details(self) -> dict[str, str]:
        """Return figures of the newest estimate, for diagnostics."""
        setup = self.estimation
        shown = {
            "estimator": self._values.estimator,
            "measured": ", ".join(setup.process.sensors.names),
            "unknown efforts": ", ".join(setup.disturbed) or "none",
            "unknown numbers": ", ".join(setup.deviations) or "none",
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
            "sensor faults": ", ".join(self.tracker.faults.active_faults()) or "none",
            "began anew": str(self.tracker.restarts),
        }


def refuse_unknown(chosen: Sequence[str], names: Sequence[str]) -> None:
    """Refuse joints that there are not.

    Raises:
        ParameterError: Names them and what there is.
    """
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise ParameterError(f"unknown joints {', '.join(unknown)}; accepted: {', '.join(names)}")


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
        self._complete_rows: Array | None = None

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
            consistency: Of the newest innovations.
            stamp: Of the estimate [ns].

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
        if self._complete_rows is not None:
            return self._complete_rows
        tangent, nz = self._estimation.process.tangent, len(y.z)
        lift, nv = tangent.lift_to_joints(y), self._system.robot.model.nv
        rows = np.zeros((2 * len(self._v) + nz, tangent.n))
        rows[: len(rows) - nz] = lift[[*self._v, *(nv + v for v in self._v)]]
        rows[len(rows) - nz :, tangent.n - nz :] = np.eye(nz)
        if tangent.is_unconstrained:
            self._complete_rows = rows
        return rows

    def _judged(self, belief: Belief, consistency: Consistency) -> bytes:
        innovation = belief.innovation
        assert innovation is not None
        values = np.where(np.isfinite(innovation.values), innovation.normalized, 0.0)
        nis = innovation.squared / max(innovation.freedom, 1)
        more = nis, consistency.nis, consistency.correlation
        return self._innovations.write([*values.tolist(), *more])
