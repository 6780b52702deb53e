"""A live `simulator` node and the test's side of its topics and services."""

import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from deadline import DEADLINE
from nodes.joint_stream import ACTIVE, parameter_file
from nodes.node_process import NodeProcess
from nodes.probe import Probe
from places import ROOT
from rclpy.duration import Duration
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from msg_adapters.joint_state import JointSample, read_joint_state
from msg_adapters.joint_trajectory import JointMotion, read_joint_motion

TARGET = ("-m", "mbd_ros.nodes", "simulator")
NAME = "/simulator"
DEEP = QoSProfile(depth=100_000)
JOINTS = ("shoulder_flexion", "shoulder_abduction", "wrist_rotation", "wrist_flexion")
ARM = f"""robot: {{urdf: {ROOT / "config/robots/prosthetic_arm.urdf"}}}
couplings:
  elbow: {{parent: shoulder_flexion, factor: 1.75, offset: 0.175}}
actuators:
- {{type: ideal, joints: [{", ".join(JOINTS)}]}}
"""
DAMPED = """forces:
- {type: joint_spring, joint: shoulder_flexion, stiffness: 0.0, damping: 2.0}
- {type: joint_spring, joint: shoulder_abduction, stiffness: 0.0, damping: 2.0}
- {type: joint_spring, joint: wrist_rotation, stiffness: 0.05, damping: 0.02}
- {type: joint_spring, joint: wrist_flexion, stiffness: 0.0, damping: 0.05}
"""
STOP = """constraints:
- {type: joint_stop, joint: shoulder_flexion, upper: 0.02, time_constant: 0.01}
"""
PENDULUM = f"""robot: {{urdf: {ROOT / "config/robots/pendulum.urdf"}}}
actuators: [{{type: ideal, joints: [hinge]}}]
initial: {{position: {{hinge: 0.3}}}}
"""


def swinging(t: float) -> Any:
    """Smooth commands of the arm [N·m]."""
    return np.array([2.0, 1.0, 0.002, 0.005]) * np.sin(np.array([6.0, 5.0, 7.0, 9.0]) * t + 0.3)


class QuickProbe(Probe):
    """A probe that takes several thousand messages per second."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self._executor.remove_node(self.node)
        self._executor.shutdown()
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)


class Client:
    """Commands a simulator and keeps what it publishes.

    Attributes:
        states: Serialized joint states, as they came.
        arrivals: When they came, on the clock of `perf_counter` [s].
        motions: Messages of ~/motion, once `follow` was called.
    """

    def __init__(self, node: NodeProcess, probe: Probe, topic: str = "/joint_states") -> None:
        self.node, self.probe = node, probe
        self.states: list[bytes] = []
        self.arrivals: list[float] = []
        self.motions: list[JointMotion] = []
        create, publish = probe.node.create_subscription, probe.node.create_publisher
        self._states = create(JointState, topic, self._keep, DEEP, raw=True)
        self._vectors = publish(Float64MultiArray, f"{NAME}/commands", DEEP)
        self._efforts = publish(JointState, f"{NAME}/joint_commands", DEEP)
        self._step = probe.node.create_client(Trigger, f"{NAME}/step")
        self._reset = probe.node.create_client(Trigger, f"{NAME}/reset")
        self._pause = probe.node.create_client(SetBool, f"{NAME}/pause")

    def connect(self, has_actuators: bool, is_paused: bool, is_standing: bool) -> None:
        """Until both sides know each other: the node shows the state that a reset leads to.

        Commands need no such proof: what was sent before the node knew its sender comes later,
        and `step` waits for it.
        """
        spin = self.probe.spin_until
        spin(self._states.get_publisher_count)
        for publisher in (self._vectors, self._efforts) if has_actuators else ():
            spin(publisher.get_subscription_count)
        for service in (self._step, self._reset, self._pause):
            spin(service.service_is_ready)
        self.probe.ask_repeatedly(self._step, Trigger.Request())
        self.probe.ask_repeatedly(self._pause, SetBool.Request(data=is_paused))
        self.probe.ask_repeatedly(self._reset, Trigger.Request())
        self.repeat(self._ask_reset, lambda: self.states)
        if is_standing:
            self.settle()  # what is repeated for a new listener is here

    def follow(self) -> None:
        """Subscribe to ~/motion; at the initial state once motions come."""
        create, topic = self.probe.node.create_subscription, f"{NAME}/motion"
        create(JointTrajectory, topic, self._keep_motion, DEEP)
        self.repeat(self._ask_reset, lambda: self.motions)

    def repeat(self, act: Callable[[], None], done: Callable[[], Any]) -> None:
        """Act until `done()`: a writer sends nothing to who it does not know yet."""
        end = time.monotonic() + DEADLINE
        while not done():
            assert time.monotonic() < end
            act()
            self.probe.spin_for(0.02)

    def settle(self) -> int:
        """How many states there are, once none has come for 0.2 s."""
        seen = -1
        while seen < len(self.states):
            seen = len(self.states)
            self.probe.spin_for(0.2)
        return seen

    def command(self, values: Sequence[float]) -> None:
        """Send a vector of commands, by whatever order the node takes."""
        self.publish(Float64MultiArray(data=np.asarray(values, dtype=float).tolist()))

    def publish(self, message: Any) -> None:
        """Send a message to ~/commands or ~/joint_commands."""
        publisher = self._efforts if isinstance(message, JointState) else self._vectors
        publisher.publish(message)

    def step(self) -> JointSample:
        """One tick while paused, under the commands sent before; the state that it leads to."""
        seen = len(self.states)
        response = self._ask(self._step, Trigger.Request())
        assert response.success, response.message
        self.probe.spin_until(lambda: len(self.states) > seen)
        return self.newest

    def refused_step(self) -> str:
        """Why a step was refused."""
        response = self._ask(self._step, Trigger.Request())
        assert not response.success
        return str(response.message)

    def pause(self, is_paused: bool) -> None:
        """Pause, or go on."""
        assert self._ask(self._pause, SetBool.Request(data=is_paused)).success

    def reset(self, is_active: bool = True) -> None:
        """Back to the initial state; waits until that is shown, as an active node does."""
        seen = len(self.states)
        self._ask_reset()
        if is_active:
            self.probe.spin_until(lambda: len(self.states) > seen)

    @property
    def newest(self) -> JointSample:
        """The newest joint state."""
        return self.sample(-1)

    def sample(self, k: int) -> JointSample:
        """Joint state number k."""
        return read_joint_state(deserialize_message(self.states[k], JointState))

    def stamps(self) -> Any:
        """Stamps of all joint states [ns]."""
        return np.array([self.sample(k).stamp for k in range(len(self.states))])

    def assert_finite(self) -> None:
        """No NaN was ever published."""
        for k in range(len(self.states)):
            for values in self.sample(k)[1:]:
                assert np.isfinite(values).all()

    def _ask_reset(self) -> None:
        response = self._ask(self._reset, Trigger.Request())
        assert response.success, response.message

    def _ask(self, client: Any, request: Any) -> Any:
        """Response of a service, after the commands sent before: DDS orders no two topics."""
        for publisher in (self._vectors, self._efforts):
            assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))
        return self.probe.ask(client, request)

    def _keep(self, cdr: bytes) -> None:
        self.arrivals.append(time.perf_counter())
        self.states.append(cdr)

    def _keep_motion(self, message: Any) -> None:
        self.motions.append(read_joint_motion(message))


def streamed(
    client: Client, seconds: float, rate: float, commands: Callable[[float], Any] = swinging
) -> int:
    """Send commands at a rate while taking states; how many were sent."""
    begin, count = time.perf_counter(), round(seconds * rate)
    for k in range(count):
        while (left := begin + k / rate - time.perf_counter()) > 0.0:
            client.probe.spin_for(min(left, 0.01))
        client.command(commands(k / rate))
    return count


@contextmanager
def simulated(
    domain: int, folder: Path, scene: str, *, stop: int | None = signal.SIGINT, **parameters: Any
) -> Iterator[Client]:
    """A running simulator, which must end with exit code 0 and without a traceback.

    With `stop` None the test ends it.
    """
    path = folder / f"scene_{len(list(folder.iterdir()))}.yaml"
    path.write_text(scene, encoding="utf-8")
    file = parameter_file(folder, {"scene": path, **parameters})
    command = [sys.executable, *TARGET, "--ros-args", "--params-file", str(file)]
    node = NodeProcess(command, domain)
    try:
        with QuickProbe(domain) as probe:
            client = Client(node, probe)
            node.wait_for(ACTIVE)
            is_paused = parameters.get("paused") == "true"
            is_standing = is_paused or parameters.get("lock_step") == "true"
            client.connect("actuators" in scene, is_paused, is_standing)
            yield client
            client.assert_finite()
            if stop is not None:
                assert node.stop(stop) == 0, node.log
                assert "Traceback" not in node.log
    finally:
        if node.process.poll() is None:
            node.process.kill()
            node.wait()
