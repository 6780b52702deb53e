"""A live `inverse_dynamics` node, a motion to send to it, and what it should answer."""

import math
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from deadline import PATIENT
from geometry_msgs.msg import WrenchStamped
from nodes.node_process import NodeProcess
from nodes.probe import Probe
from places import ROOT
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.code_permission import permitting
from msg_adapters.joint_state import write_joint_state
from msg_adapters.time import read_time
from msg_adapters.wrench import write_wrench

MS = 1_000_000
STEP = 10 * MS  # between two samples of the motion
DEEP = QoSProfile(depth=1000)
TARGET = ("-m", "mbd_ros.nodes", "inverse_dynamics")
SCENES = ROOT / "config" / "scenes"
ACTIVE = "]: active"


def parameter_file(folder: Path, values: dict[str, Any]) -> Path:
    """Parameters of every node as YAML."""
    lines = "".join(f"    {name}: {value}\n" for name, value in values.items())
    path = folder / f"parameters_{len(list(folder.iterdir()))}.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n{lines}")
    return path


class JointStream:
    """Sends a motion of constant speed, whose exact torques are known at every sample.

    Sample k belongs to the stamp `begin + k STEP`; joint i is at 0.3 + 0.02 i + speed_i t.
    """

    def __init__(
        self,
        node: NodeProcess,
        probe: Probe,
        scene: Path | str,
        *,
        name: str = "/inverse_dynamics",
        topic: str = "/joint_states",
        description: str | None = None,
    ) -> None:
        self.node, self.probe, self.name = node, probe, name
        self.scene = load_scene(scene, description)
        self.joints = self.scene.couplings.independent
        self.speed = 0.1 * (-1.0) ** np.arange(len(self.joints))
        self.torques: list[Any] = []
        self.forces: list[Any] = []
        create = probe.node.create_subscription
        self._subscriptions = [
            create(JointState, f"{name}/joint_torques", self.torques.append, DEEP),
            create(JointState, f"{name}/constraint_forces", self.forces.append, DEEP),
        ]
        self._publisher = probe.node.create_publisher(JointState, topic, DEEP)
        self.begin = time.time_ns()

    def connect(self) -> None:
        """Until both sides know each other: the first message is not answered by chance."""
        probe = self.probe
        probe.spin_until(self._publisher.get_subscription_count)
        probe.spin_until(lambda: all(s.get_publisher_count() for s in self._subscriptions))
        probe.wait_health(lambda h: h.name == self.name and h.values["state"] == "active")
        probe.meet(self.name)
        self.begin = time.time_ns()

    def reset(self, begin: int | None = None) -> None:
        """Empty the filters of the node; the motion begins now, or at `begin` [ns]."""
        assert self.probe.call(Trigger, f"{self.name}/reset", Trigger.Request()).success
        self.begin = time.time_ns() if begin is None else begin
        self.torques.clear()
        self.forces.clear()

    def stamp(self, k: float) -> int:
        """Stamp of a sample [ns]."""
        return self.begin + round(k * STEP)

    def position(self, k: float) -> Any:
        """Position of the independent joints at a sample [rad]."""
        return 0.3 + 0.02 * np.arange(len(self.joints)) + self.speed * (k * STEP * 1e-9)

    def message(self, k: float, **changes: Any) -> Any:
        """Sample k as message; `changes` replace its fields."""
        fields = {"position": self.position(k), "velocity": self.speed, **changes}
        names = fields.pop("name", self.joints)
        stamp = fields.pop("stamp", self.stamp(k))
        message = JointState(name=list(names))
        if all(len(values) == len(names) for values in fields.values()) and names:
            return write_joint_state(message, stamp, names, **fields)
        write_joint_state(message, stamp, names)
        for field, values in fields.items():
            setattr(message, field, np.asarray(values, dtype=float).tolist())
        return message

    def publish(self, message: Any) -> None:
        """Send one message."""
        self._publisher.publish(message)

    def send(self, k: float, **changes: Any) -> None:
        """Send sample k."""
        self.publish(self.message(k, **changes))

    def answers(self, count: int) -> list[Any]:
        """The first `count` torques since the last reset."""
        self.probe.spin_until(lambda: len(self.torques) >= count)
        return self.torques

    def ask(self, k: float, wrenches: Sequence[Any] = (), **changes: Any) -> Any:
        """Send sample k, check its answer against the solver, return it."""
        seen = len(self.torques)
        self.send(k, **changes)
        return self.check(self.answers(seen + 1)[seen], k, wrenches)

    def check(self, answer: Any, k: float, wrenches: Sequence[Any] = ()) -> Any:
        """An answer must be that of the solver at sample k."""
        assert read_time(answer.header.stamp) == self.stamp(k)
        assert tuple(answer.name) == self.joints
        q = self.position(k)
        expected = self.scene.inverse_dynamics().solve(q, self.speed, 0.0 * q, wrenches)
        np.testing.assert_allclose(answer.position, q, rtol=0, atol=1e-12)
        np.testing.assert_allclose(answer.velocity, self.speed, rtol=0, atol=1e-9)
        np.testing.assert_allclose(answer.effort, expected.tau, rtol=1e-9, atol=1e-8)
        if self.scene.couplings.dependent:
            self.probe.spin_until(lambda: len(self.forces) >= len(self.torques))
            force = self.forces[self.torques.index(answer)]
            assert force.header == answer.header
            assert tuple(force.name) == self.scene.couplings.dependent
            np.testing.assert_allclose(force.effort, expected.multipliers, rtol=1e-9, atol=1e-8)
        return answer

    def dropped(self, reason: str) -> int:
        """How many messages the newest diagnostics count as dropped for a reason."""
        own = [h for h in self.probe.health if h.name == self.name]
        return int(own[-1].values.get(f"dropped.{reason}", 0)) if own else 0

    def assert_finite(self) -> None:
        """No NaN was ever published."""
        for message in self.torques + self.forces:
            for values in (message.position, message.velocity, message.effort):
                assert all(map(math.isfinite, values)), message


class WrenchStream:
    """Sends wrenches of one load."""

    def __init__(self, stream: JointStream, topic: str) -> None:
        self._stream = stream
        self._publisher = stream.probe.node.create_publisher(WrenchStamped, topic, DEEP)
        stream.probe.spin_until(self._publisher.get_subscription_count)
        stream.probe.meet(stream.name)

    def send(self, k: float, wrench: Sequence[float], frame: str = "world") -> None:
        """Send a wrench with the stamp of sample k."""
        stamp = self._stream.stamp(k)
        self._publisher.publish(write_wrench(WrenchStamped(), stamp, frame, np.array(wrench)))


@contextmanager
def live(
    domain: int,
    folder: Path,
    scene: Path | str,
    arguments: Sequence[str] = (),
    *,
    stop: int = signal.SIGINT,
    code: int = 0,
    name: str = "/inverse_dynamics",
    topic: str = "/joint_states",
    **parameters: Any,
) -> Iterator[JointStream]:
    """A running node, which must end with exit code `code`, and if 0 without a traceback."""
    file = parameter_file(folder, {"scene": scene, **PATIENT, **parameters})
    words = [*TARGET, "--ros-args", "--params-file", str(file), *arguments]
    node = NodeProcess([sys.executable, *words], domain)
    try:
        with Probe(domain) as probe:
            with permitting(bool(parameters.get("allow_code"))):
                stream = JointStream(node, probe, scene, name=name, topic=topic)
            node.wait_for(ACTIVE)
            stream.connect()
            yield stream
            stream.assert_finite()
            assert node.stop(stop) == code, node.log
            assert code or "Traceback" not in node.log
    finally:
        if node.process.poll() is None:
            node.process.kill()
            node.wait()
