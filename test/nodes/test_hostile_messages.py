"""Hostile messages at real nodes over DDS: none ends a node, none leaves more than is stated."""

import math

import pytest
from fuzz.nodes import SUBJECTS, under_fire
from nodes.simulation_client import NAME, PENDULUM, simulated
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

from msg_adapters.clock import write_clock
from msg_adapters.diagnostics import ERROR, Health

LAST = (2**31 - 1, 2**32 - 1)  # sec, nanosec


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
        clock = target.probe.node.create_publisher(Clock, "/clock", 10)
        target.probe.spin_until(clock.get_subscription_count)
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
    for topic, kind in target.subject.inputs.items():
        message = target.valid(0)
        if kind is not type(message):
            message = kind()
        whole = serialize_message(message)
        yield topic, whole[: len(whole) // 2]
        yield topic, b"\x00\x01\x00\x00" + bytes(range(40))
        at = 12 if kind is Float64MultiArray else 8  # of a length, or of nanosec
        yield topic, whole[:at] + b"\xff" * 4 + whole[at + 4 :]
        yield topic, serialize_message(kind())  # nothing in it
        if kind is JointState:
            for field, values in (
                ("position", [math.nan] * 9),
                ("velocity", [1.0]),
                ("name", ["a"]),
            ):
                bad = target.state(0)
                setattr(bad, field, values[: max(1, len(bad.name))])
                yield topic, serialize_message(bad)


@pytest.mark.parametrize("name", SUBJECTS)
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
