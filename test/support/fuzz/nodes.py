"""Live nodes under fire over DDS: `python -m fuzz.nodes --seed 1 --messages 20000`.

Each node answers a valid exchange, is sent hostile messages on every input and hostile requests of
every service, and must then be alive, must have published finite numbers only, must answer a
request within `PATIENCE`, and must answer the exchange bit for bit as before.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from deadline import DEADLINE
from fuzz.messages import Hostile
from fuzz.subjects import SUBJECTS, Seeds, Subject
from nodes.joint_stream import ACTIVE, SCENES, parameter_file
from nodes.node_process import PROFILES, NodeProcess
from nodes.simulation_client import DEEP, QuickProbe
from places import ROOT
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.scene.reader import load_scene

RCLError = rclpy_implementation.RCLError
STEP = 10_000_000  # ns between valid messages
EXCHANGES = 20
VOLLEY = 50  # messages between two requests, which tell that the node has handled them
PATIENCE = 10.0  # s of work until a request is answered, whatever was sent before
LEAST = 0.1  # share of the hostile messages that must be answered or used
DESCRIPTION = "/robot_description"
_FEW = 0.01  # share of messages for which a node builds its scene anew
_AFRESH = 0.3  # share of requests that reset
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_OF_ROS = ("/parameter_events", "/rosout", "/diagnostics", "/transition_event")
_HIDES = ("ignored", "frame of the markers")  # ends of diagnostics that repeat texts of messages


class Target:
    """The test's side of a node under fire.

    Attributes:
        heard: Serialized messages of each answer since the last `exchange` began.
        lost: Numbers that were not finite, as sentences.
        inputs: Topics that the node hears, with their types.
        sent: Hostile messages.
        used: How many of them were answered, or where answers do not tell, not dropped.
    """

    def __init__(self, subject: Subject, node: NodeProcess, probe: QuickProbe, scene: Any) -> None:
        self.subject, self.node, self.probe = subject, node, probe
        self.name, self.lost = f"/{subject.node}", list[str]()
        self.begin = time.time_ns() // STEP * STEP
        text = subject.description.read_text() if subject.description else None
        self.seeds = Seeds(load_scene(scene, text), self.begin, STEP)
        self.scene, self.sent, self.used = self.seeds.scene, 0, 0.0
        self.heard: dict[str, list[bytes]] = {topic: [] for topic in subject.answers}
        self._description = text
        is_one_each = subject.answers and not subject.silent and len(subject.asked) == 1
        is_paused = subject.node == "simulator"  # now and then: it takes commands without answers
        self._is_told_by_drops = is_paused or not is_one_each
        self._seen: dict[str, list[bytes]] = {}

    def connect(self) -> None:
        """Until both sides know each other, and every input has a valid message."""
        probe, graph = self.probe, self.probe.node
        probe.meet(self.name)
        probe.spin_until(lambda: self.subject.node in graph.get_node_names())
        hears = graph.get_subscriber_names_and_types_by_node(self.subject.node, "/")
        says = graph.get_publisher_names_and_types_by_node(self.subject.node, "/")
        offers = graph.get_service_names_and_types_by_node(self.subject.node, "/")
        self.inputs = {
            topic: _kind(kinds[0]) for topic, kinds in hears if not topic.endswith(_OF_ROS[:2])
        }
        outputs = {
            topic: _kind(kinds[0])
            for topic, kinds in says
            if not topic.endswith(_OF_ROS) and topic not in self.inputs
        }
        missing = [topic for topic in self.heard if self._full(topic) not in outputs]
        assert not missing, f"{self.name} has no outputs {missing}: {sorted(outputs)}"
        self.seed = {
            topic: self.seeds.of(kind, topic)
            for topic, kind in self.inputs.items()
            if topic != DESCRIPTION
        }
        if DESCRIPTION in self.inputs:
            self.seed[DESCRIPTION] = String(data=self._description)
        short = {self._full(topic): topic for topic in self.heard}
        create = graph.create_subscription
        self._subscriptions = [
            create(kind, topic, self._keeper(short.get(topic), topic, kind), DEEP, raw=True)
            for topic, kind in outputs.items()
        ]
        self.publishers = {
            topic: graph.create_publisher(kind, topic, _LATCHED if kind is String else DEEP)
            for topic, kind in self.inputs.items()
        }
        self._clients = {
            service: graph.create_client(_kind(kinds[0]), service) for service, kinds in offers
        }
        probe.spin_until(lambda: all(c.service_is_ready() for c in self._clients.values()))
        probe.spin_until(lambda: all(p.get_subscription_count() for p in self.publishers.values()))
        for client in self._clients.values():
            if client.srv_type in (ListParameters, GetParameters, SetParameters):
                probe.ask_repeatedly(client, client.srv_type.Request())
        probe.meet(self.name)
        self._parameters = self._present()
        if self.subject.answers:
            self.exchange()  # what is not known to everybody yet may be lost

    def valid(self, k: int) -> Any:
        """Message k of a valid exchange: the first joint swings, or is driven, a little."""
        return self._valid(self.subject.asked[-1], k)

    def state(self, k: int) -> Any:
        """Joint state k of a valid exchange."""
        return self.seeds.of(JointState, "/joint_states", k)

    def ask(self, k: int) -> None:
        """Send message k of a valid exchange; it was answered when this returns."""
        answer = next(iter(self.heard.values()))
        seen = len(answer)
        for topic in self.subject.asked:
            self.publishers[self._full(topic)].publish(self._valid(topic, k))
        if k >= self.subject.silent:
            self.probe.spin_until(lambda: len(answer) > seen)

    def reset(self) -> None:
        """The node at its beginning, and active."""
        if "/clock" in self.publishers:
            self.publishers["/clock"].publish(self.seeds.of(Clock, "/clock"))
            self.probe.spin_for(0.2)
        has_reset = f"{self.name}/reset" in self._clients
        if has_reset:
            self.request(f"{self.name}/reset", Trigger.Request())
        if f"{self.name}/pause" in self._clients:
            self.request(f"{self.name}/pause", SetBool.Request(data=False))
        if self.probe.state(self.name) == "active" and not has_reset:
            assert self.probe.change_state(self.name, "deactivate")
        if self.probe.state(self.name) == "inactive":
            assert self.probe.change_state(self.name, "activate")
            if has_reset:
                self.request(f"{self.name}/reset", Trigger.Request())

    def exchange(self, between: Callable[[int], None] = lambda k: None) -> dict[str, list[bytes]]:
        """What a valid exchange from the beginning is answered with, by topic.

        Args:
            between: Called after each answer.
        """
        self.reset()
        self.probe.spin_for(0.1)  # what the reset itself shows
        for heard in self.heard.values():
            heard.clear()
        for k in range(EXCHANGES if self.heard else 0):
            self.ask(k)
            between(k)
        least = EXCHANGES - self.subject.silent
        self.probe.spin_until(lambda: all(len(heard) >= least for heard in self.heard.values()))
        # A simulator that waits for a command shows its state again.
        return {topic: [cdr for cdr, _ in groupby(heard)] for topic, heard in self.heard.items()}

    def fire(self, seed: int, messages: int) -> None:
        """Send hostile messages on all inputs, and requests; seeds say which."""
        rng = np.random.default_rng(seed)
        hostile = Hostile(rng, self.begin)
        topics = list(self.inputs)
        weights = np.array([_FEW if topic == DESCRIPTION else 1.0 for topic in topics])
        weights /= weights.sum()
        before = self._dropped()
        for heard in self.heard.values():
            heard.clear()
        for i in range(messages):
            topic = topics[rng.choice(len(topics), p=weights)]
            with suppress(RCLError):  # DDS sends no more bytes of a type than that has at most
                self.publishers[topic].publish(hostile.cdr(self.seed[topic]))
            if i % VOLLEY == VOLLEY - 1:
                self._request(rng, hostile)
                self._count()
        self.catch_up()
        self._restore()
        self.sent += messages
        if self._is_told_by_drops:
            self.used += messages - (self._dropped() - before)

    def catch_up(self) -> None:
        """Until the node has handled what was sent."""
        for publisher in self.publishers.values():  # DDS keeps no order between topics
            publisher.wait_for_all_acked(Duration(seconds=DEADLINE))
        self.request(f"{self.name}/get_state")
        self._count()

    def request(self, service: str, request: Any = None) -> Any:
        """The answer to a request."""
        client = self._clients[service]
        future = client.call_async(client.srv_type.Request() if request is None else request)
        begin, end = self.node.cpu_seconds(), time.monotonic() + DEADLINE
        while not future.done():
            assert self.node.process.poll() is None, f"the node ended:\n{self.node.log}"
            is_late = self.node.cpu_seconds() - begin > PATIENCE or time.monotonic() > end
            assert not is_late, f"{service}: no answer within {PATIENCE} s"
            self.probe.spin_for(0.002)
        return future.result()

    def memory(self) -> float:
        """Resident memory of the node [MB]."""
        pages = int(Path(f"/proc/{self.node.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def _request(self, rng: Any, hostile: Hostile) -> None:
        services = list(self._clients)
        service = services[rng.integers(len(services))]
        if rng.random() < _AFRESH and f"{self.name}/reset" in services:
            service = f"{self.name}/reset"  # after a stamp of the future all others are old
        kind = self._clients[service].srv_type
        self.request(service, hostile.request(kind, list(self._parameters)))
        if kind.__name__.startswith("SetParameters"):
            self._restore()

    def _present(self) -> dict[str, Any]:
        """All parameters that may be changed: name -> value."""
        names = self.request(f"{self.name}/list_parameters").result.names
        request = GetParameters.Request(names=names)
        values = self.request(f"{self.name}/get_parameters", request).values
        return dict(zip(names, values, strict=True))

    def _restore(self) -> None:
        """Parameters as they were."""
        from rcl_interfaces.msg import Parameter

        changed = [
            Parameter(name=name, value=self._parameters[name])
            for name, value in self._present().items()
            if serialize_message(value) != serialize_message(self._parameters[name])
        ]
        request = SetParameters.Request(parameters=changed)
        for parameter, result in zip(
            changed,
            self.request(f"{self.name}/set_parameters", request).results,
            strict=True,
        ):
            value = parameter_value_to_python(parameter.value)
            assert result.successful, f"{parameter.name} = {value}: {result.reason}"
        if self._description and self.publishers[DESCRIPTION].get_subscription_count():
            self.publishers[DESCRIPTION].publish(self.seed[DESCRIPTION])
            self.publishers[DESCRIPTION].wait_for_all_acked(Duration(seconds=PATIENCE))

    def _dropped(self) -> int:
        """How many messages the node says that it has dropped."""
        health = self.probe.wait_health(lambda h: h.name == self.name)
        return sum(int(n) for key, n in health.values.items() if key.startswith("dropped."))

    def _count(self) -> None:
        """Forget answers, but for how many they are."""
        if not self._is_told_by_drops:
            self.used += len(next(iter(self.heard.values())))
        for heard in self.heard.values():
            heard.clear()

    def _valid(self, topic: str, k: int) -> Any:
        full = self._full(topic)
        return self.seeds.of(self.inputs[full], full, k)

    def _full(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"{self.name}/{topic}"

    def _keeper(self, short: str | None, topic: str, kind: type) -> Callable[[bytes], None]:
        def keep(cdr: bytes) -> None:
            if short is not None:
                self.heard[short].append(cdr)
            message = deserialize_message(cdr, kind)
            if not all(np.isfinite(part).all() for part in _numbers(message)):
                self.lost.append(f"{topic}: {message}")

        return keep


def _kind(name: str) -> Any:
    """The class of a message or service, such as sensor_msgs/msg/JointState."""
    package, folder, kind = name.split("/")
    return getattr(import_module(f"{package}.{folder}"), kind)


def _numbers(msg: Any) -> Iterator[Any]:
    """All floating-point numbers of a message."""
    for field, of_type in msg.get_fields_and_field_types().items():
        value = getattr(msg, field)
        if of_type.startswith(("double", "float", "sequence<double", "sequence<float")):
            yield value
        elif hasattr(value, "get_fields_and_field_types"):
            yield from _numbers(value)
        elif of_type.startswith("sequence<") and "/" in of_type:
            for part in value:
                yield from _numbers(part)


@contextmanager
def under_fire(name: str, domain: int, folder: Path, **parameters: Any) -> Iterator[Target]:
    """A running node, which must end with exit code 0 and without a traceback."""
    subject = SUBJECTS[name]
    scene = SCENES / f"{subject.scene}.yaml"
    if "\n" in subject.scene:
        scene = folder / "scene.yaml"
        scene.write_text(subject.scene)
    file = parameter_file(folder, {"scene": scene, **subject.parameters, **parameters})
    words = ["-m", "mbd_ros.nodes", subject.node, "--ros-args", "--params-file", str(file)]
    node = NodeProcess([sys.executable, *words], domain)
    try:
        with QuickProbe(domain) as probe:
            if subject.description:
                first = probe.node.create_publisher(String, DESCRIPTION, _LATCHED)
                first.publish(String(data=subject.description.read_text()))
            node.wait_for(ACTIVE)
            if subject.description:
                probe.node.destroy_publisher(first)
            target = Target(subject, node, probe, scene)
            target.connect()
            yield target
            assert not target.lost, target.lost[:3]
            lost = {
                f"{key}: {value}"
                for health in probe.health
                for key, value in health.values.items()
                if health.name == target.name and not key.endswith(_HIDES)
                if {text.strip().lower() for text in value.split(",")} & {"nan", "inf", "-inf"}
            }
            assert not lost, lost
            assert node.stop() == 0, node.log
            assert "Traceback" not in node.log, node.log
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
    os.environ[PROFILES] = str(ROOT / "test/support/nodes/quick_acks.xml")  # of the tests
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    failed = 0
    for name in args.subjects:
        line = f"{name}: seed {args.seed}, {args.messages} messages"
        with tempfile.TemporaryDirectory() as folder, claimed_domain() as domain:
            try:
                with under_fire(name, domain, Path(folder)) as target:
                    before, started = target.exchange(), target.memory()
                    begin = time.perf_counter()
                    target.fire(args.seed, args.messages)
                    took = time.perf_counter() - begin
                    share = target.used / target.sent
                    line += (
                        f", {args.messages / took:.0f}/s, {100.0 * share:.0f} % used"
                        f", {started:.0f} -> {target.memory():.0f} MB"
                    )
                    assert target.exchange() == before, "another answer than before"
                    assert share >= LEAST, f"less than {100.0 * LEAST:.0f} % used"
            except AssertionError as error:
                failed += 1
                reason = str(error)
                line += f": FAILED: {reason[:300]} .. {reason[-3000:]}"
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
