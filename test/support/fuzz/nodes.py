"""Live nodes under fire over DDS: `python -m fuzz.nodes --seed 1 --messages 20000`.

Each node answers a valid exchange, is sent hostile messages on every input, and must then be
alive, must have published finite numbers only, and must answer the exchange bit for bit as before.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fuzz.messages import Hostile
from nodes.joint_stream import ACTIVE, parameter_file
from nodes.node_process import DEADLINE, NodeProcess
from nodes.simulation_client import DEEP, QuickProbe
from places import ROOT
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.scene.reader import load_scene
from msg_adapters.joint_state import write_joint_state

STEP = 10_000_000  # ns between valid joint states
EXCHANGES = 20
SCENES = ROOT / "config" / "scenes"
STATES = {"/joint_states": JointState}
REFERENCES = {"reference": JointState, "joint_trajectory": JointTrajectory}
LAW = {"timeout": 60.0, "safe_ramp": 0.0, "clock_tolerance": 1e6}


class Subject(NamedTuple):
    """A node under fire.

    Attributes:
        module: Of `mbd_ros.nodes`, and name of the node.
        scene: Of `config/scenes`.
        parameters: Beside the scene.
        inputs: Topics with their types, relative ones below the node.
        outputs: Likewise; the first one answers each valid message.
    """

    module: str
    scene: str
    parameters: dict[str, Any]
    inputs: dict[str, type]
    outputs: dict[str, type]


def controller(module: str, scene: str) -> Subject:
    """Either controller."""
    outputs = {"commands": Float64MultiArray, "state": JointState}
    return Subject(module, scene, LAW, STATES | REFERENCES, outputs)


TORQUES = {"joint_torques": JointState, "constraint_forces": JointState}
PROJECTED = {
    "joint_states": JointState,
    "constraint_forces": JointState,
    "violation": Float64MultiArray,
}
SHOWN = {**STATES, "constraint_forces": JointState, "markers": MarkerArray}
JUDGED = {"timeout": 3600.0, "clock_tolerance": 1e6}
SUBJECTS = {
    "inverse_arm": Subject("inverse_dynamics", "prosthetic_arm", JUDGED, STATES, TORQUES),
    "inverse_four_bar": Subject(
        "inverse_dynamics", "controlled_four_bar", JUDGED, STATES, TORQUES
    ),
    "projector_arm": Subject("joint_state_projector", "prosthetic_arm", JUDGED, STATES, PROJECTED),
    "projector_four_bar": Subject(
        "joint_state_projector", "four_bar_leg", JUDGED, STATES, PROJECTED
    ),
    "sliding_arm": controller("sliding_mode_controller", "controlled_arm"),
    "sliding_four_bar": controller("sliding_mode_controller", "controlled_four_bar"),
    "qp_arm": controller("qp_controller", "controlled_arm"),
    "qp_four_bar": controller("qp_controller", "controlled_four_bar"),
    "simulator_four_bar": Subject(
        "simulator",
        "controlled_four_bar",
        {"lock_step": "true", "publish_clock": "true", "command_timeout": 1e6},
        {"commands": Float64MultiArray, "joint_commands": JointState},
        SHOWN,
    ),
}


class Target:
    """The test's side of a node under fire.

    Attributes:
        heard: Serialized messages of each output since the last `exchange` began.
        lost: Numbers that were not finite, as sentences.
    """

    def __init__(self, subject: Subject, node: NodeProcess, probe: QuickProbe) -> None:
        self.subject, self.node, self.probe = subject, node, probe
        self.name, self.lost = f"/{subject.module}", list[str]()
        self.scene = load_scene(SCENES / f"{subject.scene}.yaml")
        self.is_simulator = subject.module == "simulator"
        driven = [name for part in self.scene.actuators for name in part.joints]
        everything = [joint.name for joint in self.scene.robot.joints]
        self.joints = driven if self.is_simulator else everything
        self.heard: dict[str, list[bytes]] = {topic: [] for topic in subject.outputs}
        create, publish = probe.node.create_subscription, probe.node.create_publisher
        self._subscriptions = [
            create(kind, self._full(topic), self._keeper(topic, kind), DEEP, raw=True)
            for topic, kind in subject.outputs.items()
        ]
        self.publishers = {
            topic: publish(kind, self._full(topic), DEEP) for topic, kind in subject.inputs.items()
        }
        self.begin = time.time_ns() // STEP * STEP

    def connect(self) -> None:
        """Until both sides know each other."""
        spin = self.probe.spin_until
        spin(lambda: all(p.get_subscription_count() for p in self.publishers.values()))
        spin(lambda: all(s.get_publisher_count() for s in self._subscriptions[:2]))
        self.probe.meet(self.name)
        self.exchange()  # what is not known to everybody yet may be lost

    def valid(self, k: int) -> Any:
        """Message k of a valid exchange: the first joint swings, or is driven, a little."""
        swing = 0.05 * np.sin(0.3 * k) * np.eye(len(self.joints))[0]
        if self.is_simulator:
            return Float64MultiArray(data=(10.0 * swing).tolist())
        return self.state(k)

    def state(self, k: int) -> Any:
        """Joint state k of a valid exchange."""
        x, joints = self.scene.initial, self.scene.robot.joints
        q = x.q[[joint.q for joint in joints]]
        q[0] += 0.05 * np.sin(0.3 * k)
        names, stamp = [joint.name for joint in joints], self.begin + k * STEP
        return write_joint_state(JointState(), stamp, names, position=q, velocity=0.0 * q)

    def ask(self, k: int) -> None:
        """Send message k of a valid exchange; it was answered when this returns."""
        answer = next(iter(self.heard.values()))
        seen = len(answer)
        self.publishers[next(iter(self.subject.inputs))].publish(self.valid(k))
        self.probe.spin_until(lambda: len(answer) > seen)

    def reset(self) -> None:
        """The node at its beginning, and active."""
        self.probe.call(Trigger, f"{self.name}/reset", Trigger.Request())
        if self.probe.state(self.name) == "inactive":
            assert self.probe.change_state(self.name, "activate")
            self.probe.call(Trigger, f"{self.name}/reset", Trigger.Request())

    def exchange(self, between: Callable[[int], None] = lambda k: None) -> dict[str, list[bytes]]:
        """What a valid exchange from the beginning is answered with, by topic.

        Args:
            between: Called after each answer.
        """
        self.reset()
        self.probe.spin_for(0.1)  # what the reset itself shows
        for heard in self.heard.values():
            heard.clear()
        for k in range(EXCHANGES):
            self.ask(k)
            between(k)
        self.probe.spin_until(lambda: all(map(self._is_complete, self.heard)), DEADLINE)
        # A simulator that waits for a command shows its state again.
        return {
            topic: [cdr for cdr, _ in groupby(heard)]
            for topic, heard in self.heard.items()
            if topic != "markers"
        }

    def fire(self, seed: int, messages: int) -> None:
        """Send hostile messages on all inputs; seeds say which."""
        rng = np.random.default_rng(seed)
        hostile = Hostile(rng, self.joints, self.begin)
        topics = list(self.subject.inputs)
        for i in range(messages):
            topic = topics[rng.integers(len(topics))]
            self.publishers[topic].publish(hostile.cdr(self.subject.inputs[topic]))
            if i % 50 == 49:
                self.probe.spin_for(0.0)
                self.catch_up()

    def catch_up(self) -> None:
        """Until the node has handled about all that was sent."""
        self.probe.spin_for(0.005)
        assert self.node.process.poll() is None, f"the node ended:\n{self.node.log}"
        for heard in self.heard.values():
            del heard[:-1000]

    def memory(self) -> float:
        """Resident memory of the node [MB]."""
        pages = int(Path(f"/proc/{self.node.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def _is_complete(self, topic: str) -> bool:
        is_rare = topic == "markers" or not self.heard[topic]
        return is_rare or len(self.heard[topic]) >= EXCHANGES

    def _full(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"{self.name}/{topic}"

    def _keeper(self, topic: str, kind: type) -> Callable[[bytes], None]:
        def keep(cdr: bytes) -> None:
            self.heard[topic].append(cdr)
            if not all(
                np.isfinite(part).all() for part in _numbers(deserialize_message(cdr, kind))
            ):
                self.lost.append(f"{topic}: {deserialize_message(cdr, kind)}")

        return keep


def _numbers(msg: Any) -> Iterator[Any]:
    if isinstance(msg, JointState):
        yield from (msg.position, msg.velocity, msg.effort)
    elif isinstance(msg, Float64MultiArray):
        yield msg.data
    else:
        yield from ([p.x, p.y, p.z] for marker in msg.markers for p in marker.points)


@contextmanager
def under_fire(name: str, domain: int, folder: Path, **parameters: Any) -> Iterator[Target]:
    """A running node, which must end with exit code 0 and without a traceback."""
    subject = SUBJECTS[name]
    scene = SCENES / f"{subject.scene}.yaml"
    file = parameter_file(folder, {"scene": scene, **subject.parameters, **parameters})
    words = ["-m", "mbd_ros.nodes", subject.module, "--ros-args", "--params-file", str(file)]
    node = NodeProcess([sys.executable, *words], domain)
    try:
        with QuickProbe(domain) as probe:
            node.wait_for(ACTIVE)
            target = Target(subject, node, probe)
            target.connect()
            yield target
            assert not target.lost, target.lost[:3]
            for health in probe.health:
                texts = {
                    text.strip().lower() for v in health.values.values() for text in v.split(",")
                }
                assert not texts & {"nan", "inf", "-inf"}, health
            assert node.stop() == 0, node.log
            assert "Traceback" not in node.log
    finally:
        if node.process.poll() is None:
            node.process.kill()
            node.wait()


def main() -> int:
    """Fire at the nodes that are named, or at all; exit code 1 where one does not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("subjects", nargs="*", default=list(SUBJECTS), help="of: all by default")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--messages", type=int, default=20_000)
    args = parser.parse_args()
    failed = 0
    for name in args.subjects:
        line = f"{name}: seed {args.seed}, {args.messages} messages"
        with tempfile.TemporaryDirectory() as folder, claimed_domain() as domain:
            try:
                with under_fire(name, domain, Path(folder)) as target:
                    before, used = target.exchange(), target.memory()
                    begin = time.perf_counter()
                    target.fire(args.seed, args.messages)
                    took = time.perf_counter() - begin
                    assert target.exchange() == before, "another answer than before"
                    line += (
                        f", {args.messages / took:.0f}/s, {used:.0f} -> {target.memory():.0f} MB"
                    )
            except AssertionError as error:
                failed += 1
                line += f": FAILED: {error}"
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
