"""What the simulator does about bad commands, lost ones, bad parameters and divergence."""

import math
import re
import signal
import time
from collections import Counter

import numpy as np
import pytest
from nodes.simulation_client import (
    ARM,
    DEEP,
    JOINTS,
    NAME,
    PENDULUM,
    TARGET,
    simulated,
)
from places import ROOT
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from mbd_ros.nodes.shell.diagnostics import QUIET
from mbd_ros.nodes.shell.robot_description import LATCHED
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.joint_state import write_joint_state

NAN = math.nan
GOOD = [0.4, 0.3, 0.002, 0.001]
SHOWN = [*GOOD[:2], 0.0, *GOOD[2:]]  # as efforts: the elbow has no actuator
# Commands of the pendulum fade within 10 ms, 20 ms after the last one.
QUICK = {"command_timeout": 0.02, "safe_ramp": 0.01}


def efforts(names, values):
    """A JointState with these names and efforts, of whatever length."""
    message = JointState(name=list(names))
    message.effort = [float(value) for value in values]
    return message


# ---------------------------------------------------------------------- bad commands


BAD = (
    Float64MultiArray(data=[1.0]),
    Float64MultiArray(data=[1.0] * 5),
    Float64MultiArray(),
    Float64MultiArray(data=[1.0, NAN, 1.0, 1.0]),
    Float64MultiArray(data=[1.0, math.inf, 1.0, 1.0]),
    efforts([], []),
    efforts(JOINTS, []),
    efforts(JOINTS, [1, 2, 3]),
    efforts(JOINTS, [1, 2, 3, NAN]),
    efforts([*JOINTS[:3], JOINTS[0]], [1] * 4),
    efforts([*JOINTS[:3], "thumb"], [1] * 4),
    efforts([*JOINTS, "elbow"], [1] * 5),
    efforts(JOINTS[1:], [1] * 3),
)


def test_a_bad_command_is_dropped_counted_and_the_last_good_one_held(domain, tmp_path):
    """Wrong lengths, NaN, infinities, names unknown, repeated or missing: every reason once."""
    with simulated(domain, tmp_path, ARM, paused="true", command_timeout=1e6) as client:
        begin = time.monotonic()
        for k, message in enumerate(BAD):
            good = (1.0 + 0.1 * k) * np.array(GOOD)
            client.command(good)
            np.testing.assert_array_equal(client.step().effort, np.insert(good, 2, 0.0))
            client.publish(message)
            np.testing.assert_array_equal(client.step().effort, np.insert(good, 2, 0.0))
        count = str(len(BAD))
        health = client.probe.wait_health(lambda h: h.values.get("dropped.command") == count)
        assert (health.level, health.values["commands received"]) == (OK, count)
        text = "~/commands: data has 1 values, expected 4; the last good command is held"
        client.node.wait_for(f"{text} (dropped for 'command': 1)")
        reasons = re.findall(r"\]: (.*; the last good command is held) \(", client.node.log)
        most = max(Counter(reasons).values())
        assert len(set(reasons)) > 5 and most <= 1 + (time.monotonic() - begin) / QUIET


def test_an_effort_of_a_joint_is_no_command_of_a_geared_motor(domain, tmp_path):
    """By the name of the joint `effort` is its torque, by that of the input what it takes."""
    geared = "actuators:\n- {type: geared_motor, joint: hinge, ratio: 50.0}\n"
    text = PENDULUM.partition("actuators:")[0] + geared
    with simulated(domain, tmp_path, text, paused="true", command_timeout=1e6) as client:
        client.command([0.01])
        assert client.step().effort == pytest.approx([0.5])
        client.publish(efforts(["hinge"], [0.25]))
        assert client.step().effort == pytest.approx([0.5])
        client.probe.wait_health(lambda h: h.values.get("dropped.command") == "1")
        reason = "an effort is no command of hinge, which takes the torque of the motor [N·m]"
        client.node.wait_for(reason)
        client.publish(efforts(["hinge_geared_motor"], [0.002]))
        assert client.step().effort == pytest.approx([0.1])


def test_two_drives_of_a_joint_go_by_the_names_of_their_inputs(domain, tmp_path):
    two = PENDULUM.replace("}]\n", "}, {type: ideal, joints: [hinge], name: brake}]\n", 1)
    with simulated(domain, tmp_path, two, paused="true", command_timeout=1e6) as client:
        client.publish(efforts(["brake", "hinge_ideal"], [-0.1, 0.4]))
        assert client.step().effort == pytest.approx([0.3])
        client.command([0.5, 0.1])
        assert client.step().effort == pytest.approx([0.6])
        client.publish(efforts(["hinge"], [0.4]))
        client.node.wait_for("unknown names hinge; accepted: hinge_ideal, brake")


def test_commands_of_best_effort_are_named_as_incompatible(domain, tmp_path):
    with simulated(domain, tmp_path, PENDULUM) as client:
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        client.probe.node.create_publisher(Float64MultiArray, f"{NAME}/commands", qos)
        health = client.probe.wait_health(lambda h: "incompatible QoS" in h.message)
        assert f"{NAME}/commands: incompatible QoS with node 'probe'" in health.message
        assert health.level == WARN


# ---------------------------------------------------------------------- lost commands


def test_18_a_stream_that_stops_fades_and_comes_back_without_a_bump(domain, tmp_path):
    """Tick by tick: held for 20 ms, damping within 10 ms, and back within 10 ms."""
    text = PENDULUM + "safe: {type: damping, gain: 0.5}\n"
    with simulated(domain, tmp_path, text, paused="true", **QUICK) as client:
        client.command([0.3])
        shown = [client.step() for _ in range(60)]
        effort = [sample.effort[0] for sample in shown]
        assert effort[:20] == [0.3] * 20
        faded = [-0.5 * sample.velocity[0] for sample in shown[29:-1]]
        np.testing.assert_allclose(effort[30:], faded, rtol=0.05)
        assert np.abs(np.diff(effort)).max() < 0.1 * 0.3 + 0.02 + 0.1 * np.abs(faded).max()
        for _ in range(15):
            client.command([0.3])
            effort.append(client.step().effort[0])
        assert effort[-5:] == [0.3] * 5
        assert np.abs(np.diff(effort)).max() < 0.1 * (0.3 + 2.0 * np.abs(faded).max())


def test_18_a_stream_that_stops_in_real_time_is_reported_until_it_comes_back(domain, tmp_path):
    with simulated(domain, tmp_path, ARM) as client:
        health = client.probe.wait_health(lambda h: h.level == WARN)
        assert "no command yet, instead: damping with gain 1; simulating" in health.message
        assert client.probe.set_parameter(NAME, "command_timeout", 2.0).successful

        def acts():
            client.command(GOOD)
            return (client.newest.effort == SHOWN).all()

        client.probe.spin_until(acts)
        assert client.probe.set_parameter(NAME, "command_timeout", 0.1).successful
        health = client.probe.wait_health(lambda h: "no command for " in h.message)
        assert health.level == WARN
        assert float(health.values["age of the last command"]) > 0.1
        for value in (0.0, NAN):
            assert not client.probe.set_parameter(NAME, "command_timeout", value).successful
        assert client.probe.set_parameter(NAME, "command_timeout", 1000).successful
        client.probe.spin_until(lambda: (client.newest.effort == SHOWN).all())


def test_17_a_pause_is_no_loss_of_commands(domain, tmp_path):
    with simulated(domain, tmp_path, PENDULUM, paused="true", command_timeout=0.1) as client:
        client.command([0.2])
        client.step()
        client.probe.spin_for(0.2)  # twice the timeout
        health = client.probe.wait_health(lambda h: True)
        assert (health.level, health.message) == (OK, "paused, t = 0.001 s")
        assert client.step().effort.tolist() == [0.2]


# ---------------------------------------------------------------------- stops


def test_a_joint_at_a_thousand_radians_a_second_stays_inside_an_exact_stop(domain, tmp_path):
    stop = "constraints: [{type: joint_stop, joint: hinge, upper: 3.0, restitution: 0.5}]\n"
    fast = PENDULUM.replace("hinge: 0.3}", "hinge: 0.3}, velocity: {hinge: 1000.0}")
    with simulated(domain, tmp_path, fast + stop, paused="true") as client:
        for _ in range(20):
            assert client.step().position[0] <= 3.0 + 1e-9
        assert 10.0 < abs(client.newest.velocity[0]) < 510.0
        health = client.probe.wait_health(lambda h: True)
        assert health.values["stops passed"] == "none"


def test_a_stop_that_is_passed_is_named_in_the_diagnostics(domain, tmp_path):
    stop = "constraints: [{type: joint_stop, joint: hinge, upper: 3.0, time_constant: 0.01}]\n"
    fast = PENDULUM.replace("hinge: 0.3}", "hinge: 0.3}, velocity: {hinge: 1000.0}")
    with simulated(domain, tmp_path, fast + stop, paused="true") as client:
        health = client.probe.wait_health(lambda h: True)
        assert health.values["stops passed"] == "none"
        for _ in range(20):
            client.step()
        health = client.probe.wait_health(lambda h: h.values["stops passed"] != "none")
        assert health.values["stops passed"].startswith("hinge passes its stop at 3 rad by 1.")


# ---------------------------------------------------------------------- divergence


@pytest.mark.parametrize("paused", ["true", "false"])
def test_32_divergence_deactivates_with_joint_and_time_and_resumes_after_a_reset(
    domain, tmp_path, paused
):
    text = PENDULUM + "integrator: {type: rk4}\n"
    with simulated(domain, tmp_path, text, paused=paused, publish_clock="true") as client:
        client.command([0.1])
        if paused == "true":
            client.step()
        client.command([1e308])
        if paused == "true":
            for _ in range(5):
                response = client.probe.call(Trigger, f"{NAME}/step", Trigger.Request())
            assert not response.success
            assert "diverged at t = " in response.message
        health = client.probe.wait_health(lambda h: h.level == ERROR)
        assert "diverged at t = " in health.message
        assert "hinge" in health.message
        assert health.values["state"] == "inactive"
        kept = client.newest.stamp * 1e-9
        assert float(health.values["simulated time"]) == pytest.approx(kept, abs=1e-9)
        count = client.settle()
        assert not client.probe.change_state(NAME, "activate")
        health = client.probe.wait_health(lambda h: h.level == ERROR)
        assert "; call ~/reset first" in health.message
        client.reset(is_active=False)
        assert client.probe.change_state(NAME, "activate")
        client.probe.spin_until(lambda: len(client.states) > count)
        if paused == "true":
            client.command([0.1])
            assert client.step().stamp == 1_000_000
        else:
            client.probe.spin_until(lambda: client.newest.stamp > 0)


# ---------------------------------------------------------------------- robot description


def test_11_21_22_a_simulation_waits_for_its_robot_and_keeps_it(start_node, probe, tmp_path):
    urdf = (ROOT / "config/robots/pendulum.urdf").read_text(encoding="utf-8")
    scene = tmp_path / "scene.yaml"
    scene.write_text("robot: {description_topic: robot_description}\n")
    node = start_node(f"/**:\n  ros__parameters:\n    scene: {scene}\n", target=TARGET)
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert "waiting for the robot description on robot_description" in health.message
    states = []
    probe.node.create_subscription(JointState, "/joint_states", states.append, DEEP)
    publisher = probe.node.create_publisher(String, "/robot_description", LATCHED)
    publisher.publish(String(data=urdf.replace("<mass", "<mess")))
    probe.wait_health(lambda h: h.level == ERROR and "waiting" not in h.message)
    publisher.publish(String(data=re.sub("(?s)<inertial>.*?</inertial>", "", urdf)))
    node.wait_for("joint 'hinge' moves nothing that has mass")
    publisher.publish(String(data=urdf))
    probe.spin_until(lambda: states)
    assert states[-1].name == ["hinge"]
    publisher.publish(String(data=urdf.replace('"hinge"', '"pivot"')))
    node.wait_for("new robot description refused: a simulation keeps its robot")
    probe.wait_health(lambda h: h.values.get("dropped.robot_description") == "1")
    for label in ("deactivate", "cleanup", "configure", "activate"):
        assert probe.change_state(NAME, label)
    probe.spin_until(lambda: states[-1].name == ["pivot"])
    assert node.stop() == 0


# ---------------------------------------------------------------------- parameters, life cycle


@pytest.mark.parametrize(
    ("scene", "parameters", "reason"),
    [
        (PENDULUM, "rate: 1500.0", "a tick of 0.000666667 s is not a multiple of the step dt"),
        (PENDULUM, "joints: [knee]", "parameter 'joints' is knee; accepted: all actuated joints"),
    ],
)
def test_what_does_not_fit_leaves_the_node_unconfigured(
    start_node, probe, tmp_path, scene, parameters, reason
):
    (path := tmp_path / "scene.yaml").write_text(scene, encoding="utf-8")
    text = f"/**:\n  ros__parameters:\n    scene: {path}\n    {parameters}\n"
    node = start_node(text, target=TARGET)
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert reason in health.message
    assert health.values["state"] == "unconfigured"
    for service, request, kind in (
        ("step", Trigger.Request(), Trigger),
        ("reset", Trigger.Request(), Trigger),
        ("pause", SetBool.Request(data=True), SetBool),
    ):
        response = probe.call(kind, f"{NAME}/{service}", request)
        assert not response.success
        assert response.message
    assert node.stop(signal.SIGTERM) == 0
    assert "Traceback" not in node.log


def test_the_whole_life_cycle_twice(domain, tmp_path):
    with simulated(domain, tmp_path, PENDULUM, publish_clock="true") as client:
        for label in ("deactivate", "cleanup", "configure", "activate") * 2:
            assert client.probe.change_state(NAME, label)
        client.probe.spin_until(client._states.get_publisher_count)
        count = len(client.states)
        client.probe.spin_until(lambda: len(client.states) > count + 100)
        publisher = client.probe.node.create_publisher(JointState, f"{NAME}/joint_commands", DEEP)
        client.probe.spin_until(publisher.get_subscription_count)
        message = write_joint_state(JointState(), 0, ["hinge"], effort=np.array([0.1]))

        def is_heard():
            publisher.publish(message)
            return client.newest.effort[0] == 0.1

        client.probe.spin_until(is_heard)
