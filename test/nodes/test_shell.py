"""The node shell: parameters, life cycle, signals, faults, time and QoS, in real processes."""

import os
import signal
import time

import pytest
from places import ROOT
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from mbd_ros.nodes.marker_kinematics.node import MarkerKinematicsNode
from mbd_ros.nodes.shell.process import run
from msg_adapters.diagnostics import ERROR, OK, WARN

ACTIVE = "]: active"
TOLD = """
from pathlib import Path
import numpy as np
from mbd_ros.core.contracts import Load
Path({ran!r}).touch()
class Rest(Load):
    def __init__(self, robot):
        self._zero = np.zeros(robot.model.nv)
    def force(self, k, x, u):
        return self._zero
"""


def yaml(**values):
    """A parameter file for every node."""
    lines = "".join(f"    {name}: {value}\n" for name, value in values.items())
    return f"/**:\n  ros__parameters:\n{lines}"


RELIABLE = yaml(reliable_input="true")


def is_active(health):
    """Whether a status comes from an active node."""
    return health.values.get("state") == "active"


def send(probe, *names, times=1):
    """Publish joint states on `in`, once the node listens; reliable if it asks for that."""
    publisher = probe.node.create_publisher(JointState, "in", 100)
    probe.spin_until(publisher.get_subscription_count)
    for _ in range(times):
        publisher.publish(JointState(name=list(names)))


def collect(probe, kind, topic):
    """Messages of a topic, once publisher and subscription know each other."""
    got = []
    subscription = probe.node.create_subscription(kind, topic, got.append, 10)
    probe.spin_until(subscription.get_publisher_count)
    probe.meet("/minimal")
    return got


# ---------------------------------------------------------------------- parameters


def test_yaml_int_serves_as_double_and_an_empty_list_keeps_its_type(start_node, probe):
    start_node(yaml(gain=3, weights="[4, 5]", joints="[]"))
    values = probe.wait_health(is_active).values
    assert (values["gain"], values["weights"], values["joints"]) == ("3.0", "(4.0, 5.0)", "()")


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (
            {"gain": ".nan"},
            "parameter 'gain' is nan (float); accepted: finite float in [0, 100]",
        ),
        (
            {"weights": "[1.0, .inf]"},
            "parameter 'weights' is inf (float); accepted: list of 2 finite float in [0, inf]",
        ),
        (
            {"weights": "[1.0]"},
            "parameter 'weights' is [1.0] (list); accepted: list of 2 finite float in [0, inf]",
        ),
        (
            {"refuse": "on"},
            "parameter 'refuse' is True (bool); accepted: str: YAML reads y, yes, on as bool",
        ),
        (
            {"executor": "fast"},
            "parameter 'executor' is 'fast' (str); accepted: one of events, single_threaded",
        ),
    ],
)
def test_a_bad_value_at_the_start_leaves_the_node_unconfigured(start_node, probe, given, reason):
    node = start_node(yaml(**given))
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert reason in health.message
    assert health.values["state"] == "unconfigured"
    assert node.stop() == 0


@pytest.mark.parametrize("is_fifo", [True, False])
def test_a_parameter_file_that_is_no_regular_file_ends_the_node(tmp_path, capsys, is_fifo):
    """The reader of rcl would wait for the writer of a FIFO."""
    file = tmp_path / "parameters.yaml"
    os.mkfifo(file) if is_fifo else file.symlink_to("/dev/zero")
    with pytest.raises(SystemExit) as ended:
        run(MarkerKinematicsNode, ["node", "--ros-args", "--params-file", str(file)])
    assert ended.value.code == 2
    kind = "a FIFO" if is_fifo else "a device"
    said = f"--params-file {file}: cannot be read (it is {kind}, not a regular file)"
    assert said in capsys.readouterr().err


def test_overrides_without_effect_are_warned_about(start_node):
    """An unknown key, a duplicate key, a file whose node key lacks the namespace."""
    node = start_node(yaml(gian=2.0) + "    gain: 4.0\n    gain: 5.0\n")
    node.wait_for(ACTIVE)
    node.wait_for("parameter 'gian' is unknown (did you mean 'gain'?); accepted: autostart")
    node.wait_for("key 'gain' is given twice, the last wins")
    node = start_node(
        "minimal:\n  ros__parameters:\n    gain: 2.0\n", ["-r", "__ns:=/left", "-r", "in:=/x"]
    )
    node.wait_for(ACTIVE)
    node.wait_for("the keys /minimal do not match; accepted: /left/minimal or /**")


def test_a_word_that_rcl_does_not_know_is_named(start_node):
    node = start_node(arguments=("--bogus",))
    assert node.wait() == 1
    node.wait_for("unknown after --ros-args")
    node.wait_for("--bogus")
    assert "Traceback" not in node.log


def test_a_file_that_rcl_refuses_ends_with_its_reason_and_no_traceback(start_node):
    node = start_node(yaml(weights="[1, 2.0]"))
    assert node.wait() == 1
    node.wait_for("Sequence should be of same type")
    assert "Traceback" not in node.log


def test_changes_at_run_time(start_node, probe):
    """Fault 36: refused with the reason, the node lives; fault 37: a change is one swap."""
    start_node()
    probe.wait_health(is_active)
    for name, value, reason in (
        ("gain", "high", "Wrong parameter type"),
        ("gain", float("nan"), "out of range"),
        ("gain", 1e9, "out of range"),
        ("gain", 13, "gain 13 makes the filter unstable"),
        ("weights", [1.0, float("nan")], "accepted: list of 2 finite float in [0, inf]"),
        ("weights", [1.0, 2.0, 3.0], "accepted: list of 2 finite float in [0, inf]"),
        ("gian", 1.0, "'gian' is unknown (did you mean 'gain'?)"),
        ("joints", ["a"], "read-only"),
    ):
        result = probe.set_parameter("/minimal", name, value)
        assert not result.successful
        assert reason in result.reason
    assert probe.set_parameter("/minimal", "gain", 7).successful
    health = probe.wait_health(lambda h: h.values["gain"] == "7.0")
    assert health.values["tuned"] == "1.0 -> 7.0"
    assert health.level == OK


# ---------------------------------------------------------------------- life cycle


def test_life_cycle_over_its_services(start_node, probe):
    node = start_node(
        yaml(autostart="false", reliable_input="true", refuse="'scene.yaml: no such file'")
    )
    assert probe.state("/minimal") == "unconfigured"
    assert not probe.change_state("/minimal", "activate")
    node.wait_for("transition 'activate' is not possible while unconfigured; accepted: configure")
    assert not probe.change_state("/minimal", "configure")
    assert probe.wait_health(lambda h: h.level == ERROR).message == "scene.yaml: no such file"
    assert probe.set_parameter("/minimal", "refuse", "").successful
    for label, state in (
        ("configure", "inactive"),
        ("activate", "active"),
        ("deactivate", "inactive"),
        ("cleanup", "unconfigured"),
        ("configure", "inactive"),
        ("activate", "active"),
    ):
        assert probe.change_state("/minimal", label)
        assert probe.state("/minimal") == state
    got = collect(probe, JointState, "/minimal/out")
    send(probe)
    probe.spin_until(lambda: got)
    assert node.stop() == 0


def test_an_inactive_node_does_not_answer(start_node, probe):
    start_node(RELIABLE)
    probe.wait_health(is_active)
    got = collect(probe, JointState, "/minimal/out")
    assert probe.change_state("/minimal", "deactivate")
    send(probe)
    health = probe.wait_health(lambda h: h.values["state"] == "inactive")
    assert (health.level, health.message) == (WARN, "inactive")
    assert got == []


@pytest.mark.parametrize("executor", ["events", "single_threaded"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals(start_node, probe, executor, number):
    """Fault 38: the safe command, last words, exit code 0, no traceback."""
    node = start_node(yaml(executor=executor))
    probe.wait_health(is_active)
    safe = collect(probe, String, "/minimal/safe")
    node.process.send_signal(number)
    node.process.send_signal(number)  # a terminal and launch both send it
    probe.spin_until(lambda: safe)
    assert node.wait() == 0
    probe.spin_until(lambda: probe.health[-1].message == "stopped")
    assert "Traceback" not in node.log


@pytest.mark.alone
def test_the_safe_command_comes_within_0_2_s(start_node, probe):
    """In the best of some turns: one that others disturb decides nothing."""
    took = []
    for _ in range(3):
        node = start_node()
        node.wait_for(ACTIVE)
        safe = collect(probe, String, "/minimal/safe")
        sent = time.monotonic()
        node.process.send_signal(signal.SIGTERM)
        probe.spin_until(lambda heard=safe: heard)
        took.append(time.monotonic() - sent)
        assert node.wait() == 0
    assert min(took) < 0.2


# ---------------------------------------------------------------------- faults


def test_an_error_of_the_core_deactivates(start_node, probe):
    """Fault 39: safe command, ERROR with the text, no answers; activation starts again."""
    node = start_node(RELIABLE)
    probe.wait_health(is_active)
    safe = collect(probe, String, "/minimal/safe")
    send(probe, "mbd_error")
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert health.message == "column 'knee' is empty"
    assert health.values["state"] == "inactive"
    probe.spin_until(lambda: safe)
    assert probe.change_state("/minimal", "activate")
    assert probe.wait_health(is_active).level == OK
    assert node.stop() == 0


@pytest.mark.parametrize("executor", ["events", "single_threaded"])
def test_a_bug_in_a_callback_ends_the_process(start_node, probe, executor):
    node = start_node(yaml(executor=executor, reliable_input="true"))
    probe.wait_health(is_active)
    safe = collect(probe, String, "/minimal/safe")
    send(probe, "crash")
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert health.message == "ValueError('a bug')"
    probe.spin_until(lambda: safe)
    assert node.wait() == 1
    node.wait_for("Traceback")


def test_a_bug_while_configuring_ends_the_process(start_node):
    node = start_node(yaml(refuse="crash"))
    assert node.wait() == 1
    node.wait_for("ValueError: configure crashed")


def test_drops_are_counted_and_one_warning_is_given(start_node, probe):
    node = start_node(RELIABLE)
    probe.wait_health(is_active)
    send(probe, "drop", times=10)
    probe.wait_health(lambda h: h.values.get("dropped.malformed") == "10")
    assert node.count_logged("joint_states: too short (dropped for 'malformed': 1)") == 1
    assert node.count_logged("joint_states: too short") == 1


# ---------------------------------------------------------------------- time and graph


def test_diagnostics_at_1_hz_under_a_clock_that_never_starts(start_node, probe):
    """Fault 17: no busy loop, and the node still speaks."""
    node = start_node(yaml(use_sim_time="true"))
    probe.wait_health(is_active)
    begin = time.monotonic()
    before = len(probe.health)
    probe.spin_until(lambda: len(probe.health) >= before + 2)
    assert node.is_idle()
    assert len(probe.health) - before <= time.monotonic() - begin + 1.0
    last = probe.health[-1]
    assert (last.name, last.level, last.message) == ("/minimal", OK, "fine")


def test_time_that_jumps_back_resets_once(start_node, probe):
    """Fault 16."""
    node = start_node(yaml(use_sim_time="true"))
    probe.wait_health(is_active)
    clock = probe.node.create_publisher(Clock, "/clock", 10)
    probe.spin_until(clock.get_subscription_count)
    for second in (5, 6, 7, 2, 3):
        msg = Clock()
        msg.clock.sec = second
        clock.publish(msg)
        probe.state("/minimal")  # handled
    health = probe.wait_health(lambda h: h.values["resets"])
    assert health.values["resets"] == "time jumped back by 5.000 s"
    assert node.count_logged("time jumped back by 5.000 s: starting afresh") == 1


def test_incompatible_qos_and_a_second_publisher_are_named_until_they_are_gone(start_node, probe):
    """Faults 19 and 20."""
    node = start_node(yaml(reliable_input="true"))
    probe.wait_health(is_active)
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    first = probe.node.create_publisher(JointState, "in", best_effort)
    health = probe.wait_health(lambda h: h.level == WARN)
    assert health.message.startswith("/in: incompatible QoS with node 'probe': ")
    assert "Best effort publisher and reliable subscription" in health.message
    second = probe.node.create_publisher(JointState, "in", 10)
    health = probe.wait_health(lambda h: "publishers" in h.message)
    assert "/in: 2 publishers (probe, probe), one was expected" in health.message
    probe.node.destroy_publisher(first)
    probe.wait_health(lambda h: h.level == OK)
    assert node.count_logged("one was expected") == 1
    probe.node.destroy_publisher(second)


# ---------------------------------------------------------------------- code of others


@pytest.mark.parametrize("node", ["simulator", "joint_state_projector", "sliding_mode_controller"])
def test_a_node_imports_no_code_of_others_unasked(start_node, probe, tmp_path, monkeypatch, node):
    ran = tmp_path / "ran"
    (tmp_path / "told_part.py").write_text(TOLD.format(ran=str(ran)))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    scene = tmp_path / "scene.yaml"
    text = (
        f"robot: {{urdf: {ROOT}/config/robots/arm7.urdf}}\nforces: [{{type: 'told_part:Rest'}}]\n"
    )
    scene.write_text(text)
    target = ("-m", "mbd_ros.nodes", node)
    start_node(yaml(scene=scene), target=target)
    health = probe.wait_health(lambda h: "names code of others" in h.message)
    assert health.level == ERROR and health.values["state"] == "unconfigured"
    assert "forces[0].type 'told_part:Rest'" in health.message
    assert not ran.exists()
    assert not probe.set_parameter(f"/{node}", "allow_code", True).successful
    start_node(yaml(scene=scene, allow_code="true"), target=target).wait_for(ACTIVE)
    assert ran.exists()
