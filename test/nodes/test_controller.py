"""The controllers as nodes: what they hold, follow and answer, over DDS."""

import re

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from nodes.control_client import KINDS, POSE, controlled
from nodes.simulation_client import ARM, JOINTS
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from msg_adapters.diagnostics import OK

AT_ONCE = {"safe_ramp": 0.0}
LAWS = {
    "sliding_mode": "sliding",
    "super_twisting": "sliding",
    "computed_torque": "sliding",
    "gravity_compensation": "sliding",
    "qp_tracking": "qp",
}


@pytest.mark.parametrize("law", LAWS)
def test_every_law_holds_the_first_state_by_the_torques_of_inverse_dynamics(domain, tmp_path, law):
    kind = LAWS[law]
    chosen = {"controller": law} if kind == "sliding" else {}
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE, **chosen) as client:
        for _ in range(3):
            np.testing.assert_allclose(client.ask(), client.holding(), rtol=1e-9, atol=1e-9)
        for field in ("position", "velocity"):
            np.testing.assert_allclose(getattr(client.states[-1], field), 0.0, atol=1e-12)
        health = client.wait_health(lambda h: h.level == OK)
        assert health.message == "controlling"
        assert health.values["gravity"].startswith("included")
        assert health.values["reference"] == "held"
        assert health.values["solver tier"] == "reduced"


def test_the_order_of_joints_and_of_messages_is_free(domain, tmp_path):
    """Reordered, extra and dependent joints in; the order of the parameter out."""
    order = list(JOINTS[::-1])
    with controlled(domain, tmp_path, **AT_ONCE, joints=order) as client:
        expected = client.holding()[::-1]
        np.testing.assert_allclose(client.ask(), expected, atol=1e-9)
        names = ["thumb", *order, "elbow"]
        pose = [9.0, *POSE[::-1], 1.75 * POSE[0] + 0.175]
        np.testing.assert_allclose(client.ask(pose, name=names), expected, atol=1e-9)
        health = client.wait_health(lambda h: h.values["joints ignored"] == "thumb")
        assert health.values["joints reconstructed"] == "none"
        client.ask()
        client.wait_health(lambda h: h.values["joints reconstructed"] == "elbow")


# ---------------------------------------------------------------------- references


def followed(client, stamp):
    """Where the reference is at a stamp, from the tracking error of joints at rest at POSE."""
    client.ask(POSE, stamp=stamp)
    return POSE - client.states[-1].position


def test_a_target_is_reached_along_a_ramp_and_held(domain, tmp_path):
    ramp = {"reference_ramp": 0.2, "reference_ramp_speed": 1.0}
    with controlled(domain, tmp_path, **AT_ONCE, **ramp) as client:
        client.ask()
        begin, second = client.stamp, 1_000_000_000
        client.refer([0.6, 0.4, 0.2, 0.0])
        middle = followed(client, begin + second // 10)
        assert 0.5 < middle[0] < 0.6
        end = followed(client, begin + second)
        np.testing.assert_allclose(end, [0.6, 0.4, 0.2, 0.0], atol=1e-12)
        elbow = 1.75 * 0.7 + 0.175
        client.refer([elbow, 0.4, 0.2, 0.0], ["elbow", *JOINTS[1:]])
        end = followed(client, begin + 2 * second)
        np.testing.assert_allclose(end, [0.7, 0.4, 0.2, 0.0], atol=1e-12)
        client.node.wait_for("references: shoulder_flexion from elbow")
        client.wait_health(lambda h: "held" in h.values["reference"])


def trajectory(points, names=JOINTS):
    """Points at 0.5 s, 1 s, ..."""
    message = JointTrajectory(joint_names=list(names))
    for k, positions in enumerate(points, 1):
        half = Duration(sec=k // 2, nanosec=500_000_000 * (k % 2))
        point = JointTrajectoryPoint(positions=[float(x) for x in positions])
        point.time_from_start = half
        message.points.append(point)
    return message


def test_a_trajectory_is_followed_through_its_points(domain, tmp_path):
    with controlled(domain, tmp_path, **AT_ONCE) as client:
        client.ask()
        begin = client.stamp
        points = [POSE + np.array([0.1, 0, 0, 0]), POSE + np.array([0.1, 0.2, 0, 0]), POSE]
        client.lead(trajectory(points))
        for k, point in enumerate(points, 1):
            there = followed(client, begin + k * 500_000_000)
            np.testing.assert_allclose(there, point, atol=1e-9)
        client.wait_health(lambda h: h.values["reference"] == "end of the trajectory: held")


def test_a_bad_reference_is_dropped_and_the_old_one_held(domain, tmp_path):
    """NaN, wrong size, joints missing or unknown, beyond limits, too fast, over (fault 35)."""
    with controlled(domain, tmp_path, **AT_ONCE) as client:
        client.refer(POSE)
        first = f"{client.name}/reference: reference refused: no joint state yet"
        client.node.wait_for(first)
        client.ask()
        bad = [
            ([0.5, np.nan, 0.2, 0.1], JOINTS, {}),
            ([0.5, 0.3], JOINTS[:2], {}),
            ([0.5, 0.3, 0.2], JOINTS, {}),
            ([0.5, 0.3, 0.2, 0.1, 0.0], [*JOINTS, "thumb"], {}),
            ([5.0, 0.3, 0.2, 0.1], JOINTS, {}),
            (POSE, JOINTS, {"velocity": [0.0, 99.0, 0.0, 0.0]}),
        ]
        for position, names, more in bad:
            client.refer(position, names, **more)
        client.lead(trajectory([POSE, POSE + np.array([0, 0, 0, 9.0])]))
        client.lead(JointTrajectory(joint_names=["thumb"]))
        old = trajectory([POSE])
        old.header.stamp.sec = 1
        client.lead(old)
        count = str(len(bad) + 4)
        client.wait_health(lambda h: h.values.get("dropped.reference") == count)
        client.stamp += 2_000_000_000
        np.testing.assert_allclose(client.ask(), client.holding(), rtol=1e-9, atol=1e-9)


# ---------------------------------------------------------------------- gains


NONSENSE = {
    "sliding": (
        ("gains.gain", "much", "type"),
        ("gains.gain", [float("nan")], "finite"),
        ("gains.gain", [-1.0], "accepted"),
        ("gains.gain", [0.0], "gain .* must be finite and > 0"),
        ("gains.gain", [1.0, 2.0], "gains.gain.* has 2 values; accepted: one, or one for each"),
        ("gains.rate", [1.0, 2.0], "gains.rate.* has 2 values"),
        ("gains.power", 1.0, "out of range"),
        ("gains.gains", [1.0], "gains.gain"),
        ("gains.law", "linear", "one of constant, exponential, power_rate"),
        ("controller", "super_twisting", "read-only"),
    ),
    "qp": (
        ("gains.kp", 1.0, "type"),
        ("gains.kp", [100.0, float("nan"), 100.0, 100.0], "finite"),
        ("gains.kp", [0.0], "kp .* must be finite and > 0"),
        ("gains.kp", [1.0] * 5, "gains.kp.* has 5 values; accepted: one, or one for each of"),
        ("gains.kpp", [1.0], "gains.kp"),
        ("gains.horizon", float("inf"), "out of range"),
        ("gains.velocity_limits", [True], "type"),
        ("timeout", 0.0, "out of range"),
    ),
}
GAIN = {"sliding": ("gains.gain", [120.0] * 4), "qp": ("gains.kp", [200.0])}
AHEAD = POSE + np.array([0.01, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("kind", KINDS)
def test_nonsense_is_refused_with_the_reason_and_the_old_gains_stay(domain, tmp_path, kind):
    """Fault 36: wrong type, NaN, length, sign, unknown name."""
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE) as client:
        client.ask()
        before = client.ask(AHEAD)
        for name, value, reason in NONSENSE[kind]:
            result = client.probe.set_parameter(client.name, name, value)
            assert not result.successful
            assert re.search(reason, result.reason), result.reason
        np.testing.assert_allclose(client.ask(AHEAD), before, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_gains_that_change_within_a_stream_take_hold_between_two_states(domain, tmp_path, kind):
    """Fault 37: each of 100 states is answered by the old law or by the new one, in this order."""
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE) as client:
        remote = AsyncParameterClient(client.probe.node, client.name)
        client.probe.spin_until(remote.services_are_ready)
        client.probe.meet(client.name)
        client.ask()
        before, seen, answered = client.ask(AHEAD), len(client.commands), len(client.states)
        for k in range(100):
            client.publish(client.message(AHEAD))
            if k == 50:
                name, value = GAIN[kind]
                change = remote.set_parameters([Parameter(name, value=value)])
        client.probe.spin_until(lambda: len(client.states) == answered + 100 and change.done())
        assert change.result().results[0].successful
        client.handled()
        stream, after = np.array(client.commands[seen:]), client.ask(AHEAD)
        assert len(stream) == 100
        old, new = (np.isclose(stream, law, rtol=1e-9).all(axis=1) for law in (before, after))
        assert 0 < old.sum() < 100
        assert (new == ~old).all()
        assert (np.diff(old.astype(int)) <= 0).all()


def test_the_new_gain_is_that_of_the_formula(domain, tmp_path):
    with controlled(domain, tmp_path, **AT_ONCE, gains__boundary_layer=[10.0]) as client:
        client.ask()
        before = client.ask(AHEAD)
        assert client.probe.set_parameter(client.name, *GAIN["sliding"]).successful
        s = client.states[-1].velocity[0]
        mobility = client.scene.controlled_joints()
        x = mobility.system.expand(mobility.system.reduce(client.scene.initial))
        assert s == pytest.approx(20.0 * 0.01)
        changed = client.ask(AHEAD) - before
        q = x.q.copy()
        for name, value in zip((*JOINTS, "elbow"), (*AHEAD, 1.75 * AHEAD[0] + 0.175), strict=True):
            q[client.scene.robot.joint(name).q] = value
        inverse = np.linalg.inv(mobility.response(x._replace(q=q)).mobility)
        np.testing.assert_allclose(changed, -inverse[:, 0] * 60.0 * s / 10.0, rtol=1e-9)


def test_scenes_and_parameters_that_cannot_be_controlled_are_refused(domain, start_node, tmp_path):
    scene = tmp_path / "arm.yaml"
    scene.write_text(ARM)
    (twice := tmp_path / "twice.yaml").write_text(ARM + "- {type: ideal, joints: [elbow]}\n" * 2)
    for extra, reason in (
        (f"scene: {twice}", "actuators: elbow driven twice"),
        ("joints: [elbow]", "parameter 'joints' is elbow; accepted: all actuated joints"),
        ("effort_limit: [1.0]", "'effort_limit' has 1 values; accepted: none, or one for each"),
        ("gains.bandwidth: [1.0, 2.0]", "'gains.bandwidth' has 2 values; accepted: one, or one"),
        ("controller: magic", "accepted: one of sliding_mode, super_twisting"),
    ):
        own = "" if extra.startswith("scene") else f"    scene: {scene}\n"
        text = f"/**:\n  ros__parameters:\n{own}    {extra}\n"
        node = start_node(text, target=("-m", "mbd_ros.nodes", KINDS["sliding"]))
        node.wait_for(reason)
        assert node.stop() == 0
        assert "Traceback" not in node.log


def test_the_qp_controller_keeps_the_limits_of_joints_and_says_which_act(domain, tmp_path):
    """Beside its upper limit, moving towards it: the elbow is braked for, though it follows."""
    near = np.array([1.2, 0.3, 0.2, 0.1])  # the elbow at 2.275 of 2.36
    with controlled(domain, tmp_path, kind="qp", **AT_ONCE, gains__kp=[1.0]) as client:
        client.ask(near)
        speed = [1.2, 0.0, 0.0, 0.0]
        client.ask(near + np.array([0.012, 0.0, 0.0, 0.0]), velocity=speed)
        braking = client.commands[-1][0]
        free = client.holding(near)[0]
        assert braking < free - 1.0
        health = client.wait_health(lambda h: "position" in h.values["limits that act"])
        assert int(health.values["qp solves"]) > 0
        assert health.values["qp failed"] == "0"


def test_the_qp_controller_keeps_torque_and_torque_rate(domain, tmp_path):
    limits = {"effort_limit": [9.0, 1.0, 1.0, 1.0], "effort_rate": 100.0}
    with controlled(domain, tmp_path, kind="qp", **AT_ONCE, **limits) as client:
        for _ in range(40):
            client.ask()
        commands = np.array(client.commands)
        stamps = np.array([state.stamp for state in client.states])
        assert (np.abs(commands) <= np.array(limits["effort_limit"])).all()
        steps = np.diff(stamps)[:, None] * 1e-9
        assert (np.abs(np.diff(commands, axis=0)) <= 100.0 * steps * (1 + 1e-9)).all()
        assert commands[-1][1] == 1.0  # holding needs more
        client.wait_health(lambda h: "torque shoulder_abduction" in h.values["limits that act"])
