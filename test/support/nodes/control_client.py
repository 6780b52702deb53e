"""A live controller node and the test's side of its topics: the robot, and whoever leads it."""

import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from deadline import DEADLINE, PATIENT
from nodes.joint_stream import ACTIVE, parameter_file
from nodes.node_process import NodeProcess
from nodes.probe import Probe
from nodes.simulation_client import ARM, DEEP, JOINTS, QuickProbe
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import permitting
from msg_adapters.diagnostics import STALE
from msg_adapters.joint_state import JointSample, read_joint_state, write_joint_state
from msg_adapters.multi_array import read_answered

KINDS = {"sliding": "sliding_mode_controller", "qp": "qp_controller"}
POSE = np.array([0.5, 0.3, 0.2, 0.1])  # of JOINTS
STEP = 10_000_000  # ns between two joint states
MOMENT = 0.1  # s of silence


class ControlClient:
    """Sends joint states and references, and keeps what comes back.

    Attributes:
        commands: Vectors of ~/commands, as they came.
        arrivals: When they came, on the clock of `perf_counter` [s].
        answered: Stamps of the joint states that they answer [ns]; None without one.
        states: Messages of ~/state.
    """

    def __init__(
        self,
        node: NodeProcess,
        probe: QuickProbe,
        scene: Path,
        name: str,
        plant: str,
    ) -> None:
        self.node, self.probe, self.name, self._plant = node, probe, f"/{name}", plant
        self.scene = load_scene(scene)
        self.commands: list[Any] = []
        self.arrivals: list[float] = []
        self.answered: list[int | None] = []
        self.states: list[JointSample] = []
        create, publish = probe.node.create_subscription, probe.node.create_publisher
        self.hear()
        self._states = create(JointState, f"{self.name}/state", self._keep_state, DEEP)
        topic = f"/{name}_test/joint_states" if plant else "/joint_states"
        self._joints = publish(JointState, topic, DEEP)
        self._references = publish(JointState, f"{self.name}/reference", DEEP)
        self._trajectories = publish(JointTrajectory, f"{self.name}/joint_trajectory", DEEP)
        self.stamp = time.time_ns()

    def connect(self) -> None:
        """Until both sides know each other."""
        spin = self.probe.spin_until
        spin(lambda: self.hearing.get_publisher_count() and self._states.get_publisher_count())
        own = () if self._plant else (self._joints,)
        for publisher in (*own, self._references, self._trajectories):
            spin(publisher.get_subscription_count)
        self.probe.meet(self.name)

    def hear(self) -> None:
        """Subscribe to the commands."""
        topic = f"{self._plant or self.name}/commands"
        create = self.probe.node.create_subscription
        self.hearing = create(Float64MultiArray, topic, self._keep, DEEP)

    def unhear(self) -> None:
        """Let nobody hear the commands."""
        self.probe.node.destroy_subscription(self.hearing)

    def message(self, pose: Any = POSE, **changes: Any) -> Any:
        """Joint state of the next stamp, at rest; `changes` replace its fields."""
        self.stamp = changes.pop("stamp", max(self.stamp + STEP, time.time_ns()))
        names = changes.pop("name", JOINTS)
        fields = {"position": pose, "velocity": np.zeros(len(names)), **changes}
        message = JointState(name=list(names))
        write_joint_state(message, self.stamp, names)
        for field, values in fields.items():
            setattr(message, field, np.asarray(values, dtype=float).tolist())
        return message

    def publish(self, message: Any) -> None:
        """Send a joint state."""
        self._joints.publish(message)

    def ask(self, pose: Any = POSE, **changes: Any) -> Any:
        """The command that answers a joint state."""
        seen, answered = len(self.commands), len(self.states)
        message = self.message(pose, **changes)
        self.publish(message)
        self.probe.spin_until(lambda: len(self.states) > answered and len(self.commands) > seen)
        assert self.states[-1].stamp == self.stamp
        return self.commands[-1]

    def stand(self, pose: Any = POSE) -> Any:
        """Joint states at rest until the law alone holds them; its command."""
        full = self.holding(pose)

        def is_full() -> bool:
            command = self.ask(pose, stamp=self.stamp + STEP)
            return np.allclose(command, full, rtol=1e-9, atol=0.0)

        self.probe.spin_until(is_full)
        return self.commands[-1]

    def be_patient(self, is_patient: bool = True) -> None:
        """Let the node wait for joint states for as long as a test may take, or for a moment."""
        timeout = PATIENT["timeout"] if is_patient else MOMENT
        assert self.probe.set_parameter(self.name, "timeout", timeout).successful

    def handled(self) -> None:
        """Until the node has handled what was sent, and what it said of that is here."""
        self.probe.state(self.name)

    def no_answer(self, message: Any) -> None:
        """Send a joint state that must not be answered."""
        answered = len(self.states)
        self.publish(message)
        self.handled()
        assert len(self.states) == answered

    def refer(self, position: Sequence[float], names: Sequence[str] = JOINTS, **more: Any) -> None:
        """Send a reference; it was handled when this returns."""
        message = JointState(name=list(names), position=[float(x) for x in position])
        for field, values in more.items():
            setattr(message, field, [float(x) for x in values])
        self._send(self._references, message)

    def lead(self, trajectory: Any) -> None:
        """Send a trajectory; it was handled when this returns."""
        self._send(self._trajectories, trajectory)

    def holding(self, pose: Any = POSE) -> Any:
        """Torques that hold a pose, by inverse dynamics."""
        q, zero = np.insert(pose, 2, 0.0)[[0, 1, 3, 4]], np.zeros(4)
        return self.scene.inverse_dynamics().solve(q, zero, zero).tau

    def wait_health(self, done: Any) -> Any:
        """First status of the controller after all that was sent that satisfies `done`."""
        self.handled()
        return self.probe.wait_health(lambda h: h.name == self.name and done(h))

    def assert_finite(self) -> None:
        """No NaN was ever published."""
        assert all(np.isfinite(values).all() for values in self.commands)
        for state in self.states:
            assert all(np.isfinite(values).all() for values in state[1:])

    def _send(self, publisher: Any, message: Any) -> None:
        publisher.publish(message)
        assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))
        self.handled()

    def _keep(self, message: Any) -> None:
        self.arrivals.append(time.perf_counter())
        self.commands.append(np.array(message.data))
        self.answered.append(read_answered(message))

    def _keep_state(self, message: Any) -> None:
        self.states.append(read_joint_state(message))


def gone_safe(client: ControlClient) -> Any:
    """The first status that says so, once the last command on the wire is safe.

    The node loses its patience for that, and has it back when this returns.
    """
    client.be_patient(False)
    share = "share of the safe command"
    health = client.wait_health(lambda h: h.level == STALE and h.values[share] == "1")
    client.probe.spin_until(lambda: not client.commands[-1].any())
    client.be_patient()
    return health


def said(probe: Probe, name: str, level: int, text: str) -> list[Any]:
    """Statuses of a node with that level and text."""
    return [h for h in probe.health if h.name == name and h.level == level and text in h.message]


@contextmanager
def controlled(
    domain: int,
    folder: Path,
    scene: str = ARM,
    *,
    kind: str = "sliding",
    plant: str = "",
    stop: int | None = signal.SIGINT,
    **parameters: Any,
) -> Iterator[ControlClient]:
    """A running controller, which must end with exit code 0 and without a traceback.

    Args:
        domain: Domain id.
        folder: For scene and parameters.
        scene: Text of the scene.
        kind: Of `KINDS`.
        plant: Node that takes the commands and sends joint states; empty: the test itself.
        stop: Signal that ends it; None where the test does.
        **parameters: Of the node; `__` in a name stands for a dot. Without others those of
            `PATIENT` hold: where silence is what a test is about, it sets `timeout` by then.
    """
    path = folder / f"control_scene_{len(list(folder.iterdir()))}.yaml"
    path.write_text(scene, encoding="utf-8")
    values = {name.replace("__", "."): value for name, value in parameters.items()}
    values = {**PATIENT, **values}
    if not plant:
        values = {"error_limit": 0.0, **values}  # the test sends joint states that never follow
    file = parameter_file(folder, {"scene": path, **values})
    target = ["-m", "mbd_ros.nodes", KINDS[kind]]
    words = [*target, "--ros-args", "--params-file", str(file)]
    if plant:
        words += ["-r", f"~/commands:={plant}/commands"]
    node = NodeProcess([sys.executable, *words], domain)
    try:
        with QuickProbe(domain) as probe:
            with permitting(bool(parameters.get("allow_code"))):
                client = ControlClient(node, probe, path, KINDS[kind], plant)
            node.wait_for(ACTIVE)
            client.connect()
            yield client
            client.assert_finite()
            if stop is not None:
                assert node.stop(stop) == 0, node.log
                assert "Traceback" not in node.log
    finally:
        if node.process.poll() is None:
            node.process.kill()
            node.wait()
