"""Faults 1-17, 19-22, 36-39, 42 of faults.md at the real node; numbers in test names are theirs.

After each fault the node must answer the next good message with the exact torques.
"""

import math
import os
import re
import signal
import time

import numpy as np
import pytest
from deadline import PATIENT
from nodes.joint_stream import ACTIVE, DEEP, SCENES, TARGET, JointStream, WrenchStream, live
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from mbd_ros.jobs.domain_claim import claimed_domain
from msg_adapters.diagnostics import ERROR, OK, STALE, WARN
from msg_adapters.time import read_time

NAN = math.nan
MOMENT = 0.01  # s of silence
GLITCH = np.array([0.0, 0.0, 0.5, 0.0])  # rad in 10 ms; 3 rad/s are allowed
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope="module")
def running_arm(tmp_path_factory):
    """On a domain of its own, where the nodes of single tests are not heard."""
    folder, scene = tmp_path_factory.mktemp("arm"), SCENES / "prosthetic_arm.yaml"
    with claimed_domain() as own, live(own, folder, scene) as stream:
        yield stream


@pytest.fixture
def arm(running_arm):
    """The shared arm with empty filters, proven to work before and after the test."""
    running_arm.reset()
    running_arm.ask(0)
    yield running_arm
    running_arm.assert_finite()
    running_arm.reset()
    running_arm.ask(0)


def assert_dropped(stream, reason, count):
    """Diagnostics count `count` more drops than before for a reason."""
    before = stream.dropped(reason)

    def check():
        key = f"dropped.{reason}"
        stream.probe.wait_health(lambda h: int(h.values.get(key, 0)) == before + count)

    return check


# ---------------------------------------------------------------------- one message


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"position": [0.3, 0.3, 0.3]}, "position has 3 values for 4 names"),
        ({"velocity": [0.3] * 5}, "velocity has 5 values for 4 names"),
        ({"effort": [0.3] * 3}, "effort has 3 values for 4 names"),
        ({"name": [], "position": [], "velocity": []}, "name is empty"),
        ({"name": ["wrist_flexion"] * 4}, "name repeats wrist_flexion"),
    ],
)
def test_1_2_malformed_messages_are_dropped(arm, changes, text):
    check = assert_dropped(arm, "malformed", 3)
    for k in (1, 2, 3):
        arm.send(k, **changes)
    arm.ask(4)
    assert len(arm.torques) == 2
    check()
    if text == "position has 3 values for 4 names":  # the first of this reason; then every 5 s
        arm.node.wait_for(f"joint_states: {text} (dropped for 'malformed': 1)")


def test_1_malformed_is_the_only_thing_that_comes(domain, tmp_path):
    """Who sends nothing but bad messages must read why in diagnostics, not that nothing came."""
    with live(domain, tmp_path, SCENES / "arm7.yaml", stop=signal.SIGTERM) as stream:
        for reason, text, changes in (
            ("malformed", "name is empty", {"name": [], "position": [], "velocity": []}),
            ("incomplete", "joints missing for too long (arm7_joint7)", None),
        ):
            names = stream.joints[:-1]
            fields = {"name": names, "position": [0.1] * 6, "velocity": [0.0] * 6}
            stream.reset()  # sample 0 is of now
            stream.send(0, **(changes or fields))
            health = stream.probe.wait_health(lambda h, key=reason: f"dropped.{key}" in h.values)
            assert health.level == STALE
            expected = "no joint state answered yet on /joint_states; last one dropped: "
            assert health.message.startswith(expected)
            assert text.replace("arm7_joint7", stream.joints[-1]) in health.message
        stream.reset()
        stream.ask(1)


def test_3_4_reordered_and_more_joints(arm):
    """Ignored joints are listed once, however they come."""
    names = [*arm.joints, "camera_pan", "camera_tilt"]
    order = np.random.default_rng(3)
    for k in range(1, 20):
        position, velocity = np.r_[arm.position(k), NAN, 5.0], np.r_[arm.speed, 0.0, math.inf]
        chosen = order.permutation(6 if k % 3 else 5)
        arm.ask(
            k,
            name=[names[i] for i in chosen],
            position=position[chosen],
            velocity=velocity[chosen],
        )
    health = arm.probe.wait_health(lambda h: True)
    assert health.values["joints ignored"] == "camera_pan, camera_tilt"
    assert arm.node.count_logged("joints ignored: camera_pan") <= 2
    assert arm.node.log.count("joints ignored") <= 2


def test_5_a_missing_joint_is_held_and_then_the_output_stops(arm):
    stale = arm.position(0)
    lacking = {"name": arm.joints[:3]}
    for k in (5, 10):  # 50 and 100 ms, max_age is 100 ms
        arm.send(k, position=arm.position(k)[:3], velocity=arm.speed[:3], **lacking)
    held = arm.answers(3)
    assert [answer.position[3] for answer in held] == [stale[3]] * 3
    assert held[2].position[0] == arm.position(10)[0]
    for k in (11, 40, 80):
        arm.send(k, position=arm.position(k)[:3], velocity=arm.speed[:3], **lacking)
    arm.probe.wait_health(lambda h: "dropped.incomplete" in h.values)
    assert len(arm.torques) == 3
    arm.node.wait_for("joints missing for too long (wrist_flexion)")
    assert arm.probe.set_parameter(arm.name, "timeout", MOMENT).successful
    health = arm.probe.wait_health(lambda h: h.level == STALE)
    assert arm.probe.set_parameter(arm.name, "timeout", PATIENT["timeout"]).successful
    assert health.message.startswith("newest answered joint state is ")
    assert "last one dropped: joint_states: joints missing for too long (wrist_flexion)" in (
        health.message
    )
    assert health.values["joints held"] == "wrist_flexion"
    arm.ask(81)


def test_6_7_a_dependent_joint_absent_present_and_off_its_coupling(arm):
    arm.ask(1)
    arm.ask(2)
    health = arm.probe.wait_health(lambda h: "elbow" in h.values["joints reconstructed"])
    assert health.level == OK
    names = ("elbow", *arm.joints)
    elbow = lambda k: 1.75 * arm.position(k)[0] + 0.175  # noqa: E731
    for k, off in ((3, 0.0), (4, 0.2)):
        position = np.r_[elbow(k) + off, arm.position(k)]
        arm.ask(k, name=names, position=position, velocity=np.r_[0.0, arm.speed])
        assert arm.forces[-1].position[0] == pytest.approx(off, abs=1e-12)
    health = arm.probe.wait_health(lambda h: h.level == WARN)
    assert health.message == "off their couplings: elbow by 0.2; the independent joints are used"
    assert health.values["joints reconstructed"] == "none"
    assert float(health.values["largest coupling violation"]) == pytest.approx(0.2)


def test_8_velocity_and_effort_that_are_nan_are_absent(arm):
    nothing = np.full(4, NAN)
    arm.ask(1, effort=nothing)
    for k in range(2, 8):
        velocity = nothing if k % 2 else np.r_[math.inf, arm.speed[1:]]
        arm.ask(k, velocity=velocity, effort=nothing)
    answer = arm.ask(8, velocity=[])
    assert np.isfinite(answer.effort).all()


@pytest.mark.parametrize("bad", [NAN, math.inf, -math.inf])
def test_9_a_position_that_is_not_finite_is_dropped(arm, bad):
    check = assert_dropped(arm, "not_finite", 2)
    for k in (1, 2):
        arm.send(k, position=np.r_[arm.position(k)[:3], bad])
    arm.ask(3)
    assert len(arm.torques) == 2
    check()
    arm.node.wait_for("joint_states: position NaN or infinite")


def test_9_positions_without_any_values_are_dropped(arm):
    check = assert_dropped(arm, "not_finite", 1)
    arm.send(1, position=[])
    arm.ask(2)
    check()


def test_10_a_glitch_is_dropped_and_believed_when_it_stays(arm):
    check = assert_dropped(arm, "jump", 7)
    for k in (1, 2, 3):
        arm.send(k, position=arm.position(k) + GLITCH)
    arm.ask(4)
    for k in range(5, 10):  # patience is 5
        arm.send(k, position=arm.position(k) + GLITCH)
    answer = arm.answers(3)[2]
    assert read_time(answer.header.stamp) == arm.stamp(9)
    q = arm.position(9) + GLITCH
    expected = arm.scene.inverse_dynamics().solve(q, arm.speed, np.zeros(4))
    np.testing.assert_allclose(answer.effort, expected.tau, atol=1e-9)
    check()
    arm.node.wait_for("joint_states: jump beyond the velocity limit")


@pytest.mark.parametrize("cdr", [bytes(4), bytes([0, 1, 0, 0]) + b"\xff" * 40])
def test_bytes_that_are_no_joint_state_are_dropped(arm, cdr):
    check = assert_dropped(arm, "malformed", 1)
    arm.publish(cdr)
    arm.ask(1)
    check()


@pytest.mark.parametrize("size", [1e160, 1e308])
def test_values_that_overflow_never_become_nan_on_a_topic(arm, size):
    check = assert_dropped(arm, "result", 1)
    arm.send(1, velocity=np.r_[size, arm.speed[1:]])
    arm.ask(2)
    assert len(arm.torques) == 2
    check()


# ---------------------------------------------------------------------- stamps


def test_12_without_a_stamp_the_receive_time_counts(arm):
    arm.reset()
    before = time.time_ns()
    for _ in range(3):
        arm.send(0, stamp=0)
    for answer in arm.answers(3):
        assert before < read_time(answer.header.stamp) < time.time_ns()
    assert arm.node.count_logged("stamp 0 in joint states or wrenches: receive time is used") == 1


def test_13_an_old_stamp_is_dropped_and_a_far_older_one_is_a_new_beginning(arm):
    check = assert_dropped(arm, "old", 2)
    arm.ask(20)
    for k in (19, 5):
        arm.send(k)
    arm.ask(21)
    check()
    arm.node.wait_for("joint_states: stamp older than the last")
    arm.ask(-150)  # 1.7 s back, rewind is 1 s
    arm.ask(-149)


def test_14_a_repeated_stamp_is_answered_with_the_same_derivatives(arm):
    arm.ask(1)
    arm.send(1)
    arm.send(1)
    first, *again = arm.answers(4)[1:]
    for answer in again:
        assert answer == first
    arm.ask(2)


@pytest.mark.parametrize("hours", [-1, 1])
def test_15_a_stamp_of_another_clock_is_stale_with_both_times_and_a_hint(arm, hours):
    check = assert_dropped(arm, "two_clocks", 2)
    shifted = arm.begin + hours * 3600 * 10**9
    for _ in range(2):
        arm.send(1, stamp=shifted)
    health = arm.probe.wait_health(lambda h: h.level == STALE)
    assert f"joint state of {shifted * 1e-9:.3f} s, node clock " in health.message
    assert "two clocks; does use_sim_time fit the publisher?" in health.message
    arm.ask(2)
    check()
    arm.ask(100 * (time.time_ns() - arm.begin) // 10**9)
    health = arm.probe.wait_health(lambda h: True)
    assert (health.level, health.message) == (OK, "torques published")


# ---------------------------------------------------------------------- graph


def test_19_two_publishers_are_named_until_one_is_gone(arm):
    second = arm.probe.node.create_publisher(JointState, "/joint_states", DEEP)
    arm.probe.meet(arm.name)
    arm.ask(1)
    health = arm.probe.wait_health(lambda h: True)
    assert health.level == WARN
    assert "/joint_states: 2 publishers (probe, probe), one was expected" in health.message
    arm.ask(2)
    arm.probe.node.destroy_publisher(second)
    arm.probe.wait_health(lambda h: h.level == OK)


@pytest.mark.parametrize(
    ("qos", "reason"),
    [
        (QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL), "Transient local"),
        (QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT), None),
        (QoSProfile(depth=1), None),
    ],
)
def test_20_only_an_incompatible_subscriber_is_named(arm, qos, reason):
    topic = f"{arm.name}/joint_torques"
    other = arm.probe.node.create_subscription(JointState, topic, lambda _: None, qos)
    arm.probe.meet(arm.name)
    arm.send(1, stamp=time.time_ns())
    arm.answers(2)
    health = arm.probe.wait_health(lambda h: True)
    arm.probe.node.destroy_subscription(other)
    if reason is None:
        assert (health.level, health.message) == (OK, "torques published")
    else:
        assert f"{topic}: incompatible QoS with node 'probe': " in health.message
        assert reason.lower() in health.message.lower()
    arm.probe.meet(arm.name)  # it has forgotten the other one


# ---------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("cutoff", "fast", "Wrong parameter type"),
        ("cutoff", NAN, "out of range"),
        ("cutoff", 0.0, "out of range"),
        ("patience", 0, "parameter 'patience' is 0 (int); accepted: int in [1, 10000]"),
        ("max_age", -1.0, "out of range"),
        ("cutof", 5.0, "'cutof' is unknown (did you mean 'cutoff'?)"),
        ("scene", "other.yaml", "read-only"),
    ],
)
def test_36_a_bad_parameter_is_refused_and_the_node_lives(arm, name, value, reason):
    result = arm.probe.set_parameter(arm.name, name, value)
    assert not result.successful
    assert reason in result.reason
    arm.ask(1)


def test_37_parameters_that_change_within_a_stream_never_spoil_a_message(arm):
    for k in range(1, 40):
        if k % 8 == 0:
            assert arm.probe.set_parameter(arm.name, "cutoff", 4.0 + k % 16).successful
        arm.ask(k)
    assert arm.probe.set_parameter(arm.name, "cutoff", 5).successful


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ("    cutoff: .inf\n", "parameter 'cutoff' is inf (float); accepted: finite float in"),
        ("    scene: /nowhere/scene.yaml\n", "/nowhere/scene.yaml"),
        ("    wrench_wait: 0.1\n", "parameter 'scene' must be given: str"),
    ],
)
def test_36_a_bad_parameter_at_the_start_leaves_the_node_unconfigured(
    start_node, probe, parameters, reason
):
    node = start_node(f"/**:\n  ros__parameters:\n{parameters}", target=TARGET)
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert reason in health.message
    assert health.values["state"] == "unconfigured"
    assert node.stop(signal.SIGTERM) == 0
    assert "Traceback" not in node.log


# ---------------------------------------------------------------------- time of a simulation


def test_16_17_38_clock_that_jumps_back_and_stands(domain, tmp_path):
    """On the other executor, in a namespace; ended by SIGTERM in the middle of a stream."""
    from rosgraph_msgs.msg import Clock

    from msg_adapters.time import write_time

    where = {"name": "/left/inverse_dynamics", "topic": "/left/joint_states"}
    options = {"use_sim_time": "true", "executor": "single_threaded", "timeout": MOMENT}
    scene = SCENES / "prosthetic_arm.yaml"
    arguments = ["-r", "__ns:=/left"]
    with live(
        domain, tmp_path, scene, arguments, stop=signal.SIGTERM, **where, **options
    ) as stream:
        clock = stream.probe.node.create_publisher(Clock, "/clock", 10)
        stream.probe.spin_until(clock.get_subscription_count)
        stream.probe.meet(where["name"])

        def set_clock(second):
            message = Clock()
            write_time(message.clock, int(second * 1e9))
            clock.publish(message)
            stream.probe.state(where["name"])  # handled

        stream.reset(begin=100 * 10**9)
        stream.ask(0)  # before the first /clock
        set_clock(100.0)
        for k in range(1, 10):
            stream.ask(k)
        health = stream.probe.wait_health(lambda h: h.level == OK)
        assert stream.node.is_idle()  # the clock stands longer than the timeout
        assert (health.level, health.message) == (OK, "torques published")
        assert stream.probe.wait_health(lambda h: True).level == OK
        set_clock(98.0)
        stream.node.wait_for("time jumped back by 2.000 s: starting afresh")
        health = stream.probe.wait_health(lambda h: h.level == STALE)
        assert "no joint state answered yet" in health.message
        stream.ask(-199)  # a filter that remembers would say 0.1 s of 2 s: it answers at once
        stream.ask(-198)
        set_clock(98.1)
        assert stream.node.count_logged("jumped back") == 1
        for k in range(-197, -150):
            stream.send(k)


# ---------------------------------------------------------------------- exceptions

PART = '''
import numpy as np
from mbd_ros.core.contracts import Load
from mbd_ros.errors import ModelError


class Fuse(Load):
    """Breaks at the angle that a test sends."""

    def __init__(self, robot):
        self._nv = robot.model.nv

    def force(self, k, x, u):
        if x.q[0] > 2.0:
            raise ModelError("the fuse of joint 1 is gone")
        if x.q[0] < -2.0:
            raise ZeroDivisionError("a bug")
        return np.zeros(self._nv)
'''


def test_39_exceptions_in_a_callback(domain, tmp_path, monkeypatch):
    """Of this package: deactivated with ERROR, and activation helps. A bug: the process ends."""
    (tmp_path / "fuse.py").write_text(PART)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.syspath_prepend(tmp_path)
    scene = tmp_path / "scene.yaml"
    urdf = SCENES.parent / "robots" / "arm7.urdf"
    scene.write_text(f"robot: {{urdf: {urdf}}}\nforces: [{{type: 'fuse:Fuse'}}]\n")
    with live(domain, tmp_path, scene, code=1, allow_code=True) as stream:
        stream.ask(0)
        stream.send(1, position=[2.5] * 7, stamp=stream.stamp(300))
        health = stream.probe.wait_health(lambda h: h.level == ERROR)
        assert health.message == "the fuse of joint 1 is gone"
        assert health.values["state"] == "inactive"
        stream.send(2)
        assert stream.probe.state(stream.name) == "inactive"
        assert len(stream.torques) == 1
        assert stream.probe.change_state(stream.name, "activate")
        stream.ask(3)
        stream.send(4, position=[-2.5] * 7, stamp=stream.stamp(300))
        health = stream.probe.wait_health(lambda h: h.level == ERROR)
        assert "ZeroDivisionError('a bug')" in health.message
        assert stream.node.wait() == 1
        stream.node.wait_for("ZeroDivisionError: a bug")


# ---------------------------------------------------------------------- robot description

URDF = """<robot name="wheel">
  <link name="base"/>
  <link name="arm"><inertial><origin xyz="{com} 0 0"/><mass value="{mass}"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="wheel" type="continuous"><parent link="base"/><child link="arm"/>
    <axis xyz="0 1 0"/><limit velocity="20" effort="10"/></joint>
</robot>"""
GOOD = URDF.format(com=0.2, mass=1.5)


def test_11_21_22_robot_description_on_a_topic(start_node, probe, tmp_path):
    scene = tmp_path / "scene.yaml"
    scene.write_text("robot: {description_topic: robot_description}\n")
    node = start_node(f"/**:\n  ros__parameters:\n    scene: {scene}\n", target=TARGET)
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert "waiting for the robot description on robot_description" in health.message
    assert health.values["state"] == "unconfigured"
    publisher = probe.node.create_publisher(String, "/robot_description", LATCHED)
    probe.spin_until(publisher.get_subscription_count)
    for text, reason in (
        ("", f"configuring: {scene}: robot: topic robot_description: robot description is empty"),
        (GOOD[:-9], "not well-formed XML"),
        ('<!DOCTYPE robot [<!ENTITY a "b">]>' + GOOD, "DOCTYPE and ENTITY declarations"),
        (GOOD + " " * (16 * 1024 * 1024), "characters, accepted are 16777216"),
        (URDF.format(com=0.2, mass=-1.5), "mass is -1.5 kg, but must not be negative"),
    ):
        publisher.publish(String(data=text))
        node.wait_for(reason)
    health = probe.wait_health(lambda h: "link 'arm'" in h.message)
    assert (health.level, health.values["state"]) == (ERROR, "unconfigured")
    assert ACTIVE not in node.log
    publisher.publish(String(data=GOOD))
    node.wait_for(ACTIVE)
    _wrap(stream := JointStream(node, probe, scene, description=GOOD))
    _swap(stream, publisher, scene)
    stream.assert_finite()
    assert node.stop() == 0


def _wrap(stream):
    """Fault 11: over 2 pi, with and without measured velocity, as if the angle went on."""
    stream.connect()
    stream.reset()
    for k, velocity in ((0, stream.speed), (1, stream.speed), (2, []), (3, []), (4, [])):
        turns = 2 * math.pi * (k >= 1) - 4 * math.pi * (k >= 3)
        stream.ask(k, position=stream.position(k) + turns, velocity=velocity)
    assert "jump" not in stream.node.log


def _swap(stream, publisher, scene):
    """Fault 22: a bad description is refused, the same one is no news, a good one is used."""
    bad = GOOD.replace('ixx="0.01"', 'ixx="9"')
    publisher.publish(String(data=bad))
    health = stream.probe.wait_health(lambda h: "dropped.robot_description" in h.values)
    assert health.values["state"] == "active"
    stream.node.wait_for("new robot description refused")
    stream.node.wait_for("link 'arm'")
    stream.node.wait_for("triangle inequality")
    stream.ask(5)
    publisher.publish(String(data=GOOD))
    stream.probe.state(stream.name)  # handled
    assert "new robot description in use" not in stream.node.log
    publisher.publish(String(data=URDF.format(com=0.3, mass=2.0)))
    stream.node.wait_for("new robot description in use")
    heavier = JointStream(
        stream.node, stream.probe, scene, description=URDF.format(com=0.3, mass=2.0)
    )
    heavier.connect()
    heavier.begin = stream.begin
    heavier.ask(6)
    heavier.ask(7)
    point = re.sub(r'(i[xyz]{2})="[^"]*"', r'\1="0"', GOOD)
    publisher.publish(String(data=point))
    doubt = "link 'arm': a point mass, all moments of inertia are 0"
    stream.probe.wait_health(lambda h: h.values.get("inertias in doubt") == doubt)
    light = JointStream(stream.node, stream.probe, scene, description=point)
    light.connect()
    light.begin = stream.begin
    light.ask(8)
    light.ask(9)
    health = stream.probe.wait_health(lambda h: f"; inertias in doubt: {doubt}" in h.message)
    assert health.level in (WARN, STALE)


# ---------------------------------------------------------------------- wrenches


def test_42_force_plate(domain, tmp_path):
    scene = SCENES / "prosthetic_leg_stance.yaml"
    with live(domain, tmp_path, scene) as stream:
        plate = WrenchStream(stream, "/force_plate")
        stream.reset()
        stream.send(0)
        health = stream.probe.wait_health(lambda h: "dropped.no_wrench" in h.values)
        assert health.level == STALE
        assert "no wrench 'ground_reaction' near the joint state" in health.message
        load = [10.0, 5.0, 600.0, 1.0, -40.0, 2.0]
        for bad, frame, reason in (
            (load, "plate_7", "wrench 'ground_reaction': frame 'plate_7', expected 'world'"),
            ([NAN, *load[1:]], "world", "wrench 'ground_reaction': wrench is not finite"),
        ):
            before = stream.dropped("wrench")
            stream.reset()
            stream.send(1)
            plate.send(1, bad, frame)
            stream.probe.wait_health(
                lambda h, n=before: int(h.values.get("dropped.wrench", 0)) > n
            )
            if frame == "plate_7":
                stream.node.wait_for(reason)
            assert stream.torques == []
        plate.send(2, load)
        stream.ask(2, [np.array(load)])
        plate.send(3, load, frame="")
        stream.ask(3, [np.array(load)])
        faint = [3.0, 0.0, 19.0, 1e6, 1e6, 1e6]  # centre of pressure kilometres away
        plate.send(4, faint)
        stream.ask(4, [np.zeros(6)])
        health = stream.probe.wait_health(lambda h: True)
        before = int(health.values["dropped.no_wrench"])
        stream.send(14.5)  # 105 ms after the last wrench, wrench_max_age is 100 ms
        stream.probe.wait_health(lambda h: int(h.values["dropped.no_wrench"]) > before)
        assert len(stream.torques) == 3
