"""Hostile messages at real nodes over DDS: none ends a node, none leaves more than is stated."""

import pytest
from fuzz.nodes import under_fire
from nodes.simulation_client import NAME, PENDULUM, simulated
from rosgraph_msgs.msg import Clock
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
