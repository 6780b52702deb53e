"""Hostile messages at real nodes over DDS: none ends a node, none leaves more than is stated."""

import ast
import inspect
import math
import textwrap
import time
from importlib import import_module

import pytest
from builtin_interfaces.msg import Duration
from fuzz.nodes import SUBJECTS, under_fire
from nodes.simulation_client import NAME, PENDULUM, simulated
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.lifecycle import LifecycleNode
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mbd_ros.nodes.shell.serialized import message_of
from mbd_ros.nodes.table import NODES
from msg_adapters.diagnostics import ERROR, Health
from msg_adapters.errors import MessageError
from msg_adapters.joint_trajectory import MOST_POINTS
from msg_adapters.time import write_clock

# The loops of a four-bar remember most; open arms are left to `make soak`.
FOUR_BARS = [
    name if name.endswith("four_bar") else pytest.param(name, marks=pytest.mark.soak)
    for name in SUBJECTS
    if name.endswith(("four_bar", "_arm")) and name not in ("payload_arm", "player_arm")
]
LAST = (2**31 - 1, 2**32 - 1)  # sec, nanosec


def test_every_node_is_fired_at():
    assert {subject.node for subject in SUBJECTS.values()} == set(NODES)


def assigned(node_class):
    """Names of the attributes that a class gives its objects."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(node_class)))
    attributes = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    return {
        node.attr
        for node in attributes
        if isinstance(node.ctx, ast.Store) and getattr(node.value, "id", "") == "self"
    }


@pytest.mark.parametrize("name", NODES)
def test_a_node_leaves_the_attributes_of_rclpy_alone(name):
    """One that replaced those of its parameters ended at the first `ros2 param list`."""
    module, _, node_class = NODES[name].partition(":")
    classes = getattr(import_module(module), node_class).__mro__
    below = classes.index(LifecycleNode)
    of_rclpy = {attribute for base in classes[below:-1] for attribute in assigned(base)}
    assert "_parameters" in of_rclpy
    for node_class in classes[:below]:
        assert not assigned(node_class) & of_rclpy


def test_a_parameter_of_an_unknown_type_is_refused(domain, tmp_path):
    with under_fire("player_arm", domain, tmp_path) as target:
        good, bad = Parameter(name="duration"), Parameter(name="repeat")
        good.value.type, good.value.double_value, bad.value.type = 3, 5.0, 10
        reason = "parameter 'repeat': type 10 is unknown; accepted: 0 to 9"
        for kind in (SetParameters, SetParametersAtomically):
            service = f"{target.name}/set_parameters"
            if kind is SetParametersAtomically:
                service += "_atomically"
            response = target.request(service, kind.Request(parameters=[good, bad]))
            results = getattr(response, "results", None) or [response.result]
            assert {result.reason for result in results} == {reason}
            assert not any(result.successful for result in results)


def counted(target, reason, least):
    """Until diagnostics count so many dropped messages for a reason."""

    def is_enough(health: Health):
        count = int(health.values.get(f"dropped.{reason}", 0))
        return health.name == target.name and count >= least

    target.probe.wait_health(is_enough)


@pytest.mark.parametrize("name", ["inverse_arm", "projector_arm", "sliding_arm", "qp_arm"])
def test_stamps_that_no_message_can_carry_back_are_malformed(domain, tmp_path, name):
    """In simulated time, where /clock has the same value, and a negative one."""
    with under_fire(name, domain, tmp_path, use_sim_time="true") as target:
        clock = target.publishers["/clock"]
        before = target.exchange()
        bad, message = Clock(), target.valid(3)
        for sec, nanosec in (LAST, (-1, 0), (-(2**31), 5), (3, 10**9)):
            bad.clock.sec, bad.clock.nanosec = sec, nanosec
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
            for _ in range(3):
                clock.publish(bad)
                target.publishers["/joint_states"].publish(message)
                target.catch_up()
        counted(target, "clock", 4)
        counted(target, "malformed", 2)
        clock.publish(write_clock(Clock(), target.begin))
        target.probe.spin_for(0.1)
        assert target.exchange() == before


def test_a_simulator_stops_before_its_time_does_not_fit_into_a_stamp(domain, tmp_path):
    """Under a foreign clock that stands at the last second that a stamp can name."""
    with simulated(domain, tmp_path, PENDULUM, use_sim_time="true") as client:
        clock = client.probe.node.create_publisher(Clock, "/clock", 10)
        client.probe.spin_until(clock.get_subscription_count)
        last = write_clock(Clock(), 2**31 * 10**9 - 1)
        pause = SetBool.Request(data=False)
        text = "does not fit into a message, whose seconds are an int32"

        def is_stopped():
            clock.publish(last)
            client.probe.call(SetBool, f"{NAME}/pause", pause)  # stamps begin anew
            own = [h for h in client.probe.health if h.name == NAME and text in h.message]
            return own and own[-1].values["state"] == "inactive" and own[-1].level == ERROR

        client.probe.spin_until(is_stopped)


def unusable(target):
    """Messages for each input of which none can be used."""
    for topic, kind in target.inputs.items():
        message = target.valid(0)
        if kind is not type(message):
            message = kind()
        whole = serialize_message(message)
        yield topic, whole[: len(whole) // 2]
        yield topic, b"\x00\x01\x00\x00" + bytes(range(40))
        at = 12 if kind is Float64MultiArray else 8  # of a length, or of nanosec
        yield topic, whole[:at] + b"\xff" * 4 + whole[at + 4 :]
        if kind is not JointTrajectory:  # an empty one is a stop
            yield topic, serialize_message(kind())
        if kind is JointState:
            for field, values in (
                ("position", [math.nan] * 9),
                ("velocity", [1.0]),
                ("name", ["a"]),
            ):
                bad = target.state(0)
                setattr(bad, field, values[: max(1, len(bad.name))])
                yield topic, serialize_message(bad)


@pytest.mark.parametrize("name", FOUR_BARS)
def test_dropped_messages_leave_nothing_but_their_count(domain, tmp_path, name):
    """A valid exchange is answered to the bit as without them, and after any burst and ~/reset."""
    with under_fire(name, domain, tmp_path) as target:
        alone = target.exchange()
        bad = list(unusable(target))

        def between(k):
            topic, cdr = bad[k % len(bad)]
            target.publishers[topic].publish(cdr)

        assert target.exchange(between) == alone
        target.fire(seed=12, messages=400)
        assert target.exchange() == alone


@pytest.mark.parametrize("name", [pytest.param("sliding_arm", marks=pytest.mark.soak), "qp_arm"])
def test_a_trajectory_of_too_many_points_is_refused_unread(domain, tmp_path, name):
    with under_fire(name, domain, tmp_path) as target:
        target.reset()
        target.ask(0)
        start = target.state(0)
        names = list(target.scene.controlled_joints().names)
        pose = [start.position[list(start.name).index(joint)] for joint in names]
        for k, (points, answer) in enumerate(
            ((MOST_POINTS, "trajectory"), (100_000, "malformed"))
        ):
            trajectory = JointTrajectory(joint_names=names)
            for i in range(points):
                since = Duration(sec=1 + i // 100, nanosec=i % 100 * 10_000_000)
                trajectory.points.append(
                    JointTrajectoryPoint(positions=pose, time_from_start=since)
                )
            target.publishers[f"{target.name}/joint_trajectory"].publish(trajectory)
            text = f"{points} points, accepted: {MOST_POINTS}"
            if answer == "malformed":
                target.node.wait_for(text)
            else:
                target.probe.wait_health(lambda h: h.values.get("reference") == "trajectory")
            target.ask(k + 1)


def least_cpu(act, times):
    """CPU time of the quickest of some calls [s]."""
    spent = []
    for _ in range(times):
        begin = time.process_time()
        act()
        spent.append(time.process_time() - begin)
    return min(spent)


def test_a_long_trajectory_is_refused_in_a_hundredth_of_the_time_to_read_it():
    points = [JointTrajectoryPoint(positions=[0.1] * 4) for _ in range(20_000)]
    cdr = serialize_message(JointTrajectory(joint_names=list("abcd"), points=points))

    def refuse():
        with pytest.raises(MessageError, match="20000 points, accepted"):
            message_of(cdr, JointTrajectory)

    read = least_cpu(lambda: deserialize_message(cdr, JointTrajectory), 1)
    assert least_cpu(refuse, 5) < 0.01 * read
    for end in (5, 13, 30):
        with pytest.raises(MessageError, match="its bytes are no JointTrajectory"):
            message_of(cdr[:end], JointTrajectory)


def test_bytes_that_claim_many_names_are_refused_at_once():
    """16 MiB of empty names: counting them took 4 s."""
    cdr = bytes([0, 1, 0, 0]) + bytes(12) + b"\xff" * 4 + bytes(2**24 - 64)

    def refuse():
        with pytest.raises(MessageError, match="4294967295 joint names, accepted: 4000"):
            message_of(cdr, JointTrajectory)

    assert least_cpu(refuse, 3) < 0.1


@pytest.mark.parametrize("name", ["inverse_arm", "projector_arm"])
def test_names_of_ignored_joints_do_not_pile_up(domain, tmp_path, name):
    with under_fire(name, domain, tmp_path) as target:
        target.reset()
        for k in range(200):
            message = target.state(k)
            more = [f"\n{k}_{i}" + "x" * 300 for i in range(20)]
            message.name = [*message.name, *more]
            message.position = [*message.position, *([0.0] * 20)]
            message.velocity = [*message.velocity, *([0.0] * 20)]
            message.effort = []
            seen = len(next(iter(target.heard.values())))
            target.publishers["/joint_states"].publish(message)
            answers = next(iter(target.heard.values()))
            target.probe.spin_until(lambda seen=seen, answers=answers: len(answers) > seen)
        ignored = target.probe.wait_health(lambda h: h.name == target.name).values[
            "joints ignored"
        ]
        assert ignored.endswith("more") and len(ignored) < 1000
        assert target.node.log.count("joints ignored") <= 10
        assert len(target.node.log) < 20_000


def test_messages_that_were_taken_leave_no_memory(domain, tmp_path):
    """DDS kept a buffer of the largest message for each place of a queue: 50 MB here."""
    with under_fire("simulator_four_bar", domain, tmp_path) as target:
        large = serialize_message(target.valid(0)) + bytes(1_000_000)
        commands, before = target.publishers[f"{target.name}/commands"], target.memory()
        for _ in range(50):
            commands.publish(large)
        counted(target, "malformed", 50)
        assert target.memory() < before + 20.0
