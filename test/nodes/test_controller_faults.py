"""What the controllers do about bad joint states, silence, crashes and signals, over DDS."""

import signal

import numpy as np
import pytest
from deadline import PATIENT
from nodes.control_client import KINDS, POSE, STEP, controlled, gone_safe, said
from nodes.simulation_client import ARM, JOINTS
from places import ROOT
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from msg_adapters.diagnostics import ERROR, OK, STALE, WARN
from msg_adapters.time import write_clock

AT_ONCE = {"safe_ramp": 0.0}
TRUSTED = {**AT_ONCE, "allow_code": True}
NAN = float("nan")
each = pytest.mark.parametrize("kind", KINDS)


def dropped(health):
    """Counts of dropped messages by reason."""
    values = health.values.items()
    return {key.split(".")[1]: count for key, count in values if key.startswith("dropped.")}


# ---------------------------------------------------------------------- joint states


@each
def test_bad_joint_states_are_dropped_and_counted(domain, tmp_path, kind):
    """Faults 1, 2, 8, 9, 10, 13 and 14."""
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE) as client:
        expected = client.ask()
        good = client.stamp
        short, empty = client.message(), client.message()
        short.position = short.position[:2]
        empty.name, empty.position, empty.velocity = [], [], []
        twice = client.message(name=[JOINTS[0]] * 4)
        lost = [client.message([value, *POSE[1:]]) for value in (NAN, np.inf)]
        glitch = client.message(POSE + 5.0, stamp=good + STEP)
        for message in (short, empty, twice, *lost, glitch, client.message(stamp=good - STEP)):
            client.no_answer(message)
        counts = {"malformed": "3", "not_finite": "2", "jump": "1", "old": "1"}
        client.wait_health(lambda h: counts.items() <= dropped(h).items())
        client.stamp = good
        np.testing.assert_allclose(client.ask(velocity=[NAN] * 4), expected, atol=1e-9)
        np.testing.assert_allclose(client.ask(stamp=client.stamp), expected, atol=1e-9)


@each
def test_a_jump_that_stays_is_believed(domain, tmp_path, kind):
    """Fault 10: after `patience` states; the reference stays where it was."""
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE, patience=4) as client:
        client.ask()
        there = POSE + np.array([0.6, 0.0, 0.0, 0.0])
        for _ in range(3):
            client.no_answer(client.message(there, stamp=client.stamp + STEP))
        client.ask(there, stamp=client.stamp + STEP)
        np.testing.assert_allclose(client.states[-1].position, there - POSE, atol=1e-12)
        client.wait_health(lambda h: dropped(h) == {"jump": "3"})


@each
def test_a_missing_joint_is_held_for_a_while_then_the_command_goes_safe(domain, tmp_path, kind):
    """Fault 5."""
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE, max_age=0.1) as client:
        client.ask()
        begin, rest = client.stamp, {"name": JOINTS[1:]}
        held = client.ask(POSE[1:], **rest, stamp=begin + 100_000_000)
        np.testing.assert_allclose(held, client.holding(), rtol=1e-6, atol=1e-6)
        client.no_answer(client.message(POSE[1:], **rest, stamp=begin + 101_000_000))
        assert f"joints missing for too long ({JOINTS[0]})" in gone_safe(client).message


@each
def test_joint_states_of_another_clock_are_stale(domain, tmp_path, kind):
    """Fault 15: both times, a hint, and the command goes safe."""
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE) as client:
        assert client.ask().any()
        client.no_answer(client.message(stamp=5_000_000_000))
        health = client.wait_health(lambda h: h.level == STALE)
        assert "joint state of 5.000 s, node clock 1" in health.message
        assert "does use_sim_time fit" in health.message
        gone_safe(client)


def test_two_publishers_are_named(domain, tmp_path):
    """Fault 19."""
    with controlled(domain, tmp_path, **AT_ONCE) as client:
        client.ask()
        second = client.probe.node.create_publisher(JointState, "/joint_states", 10)
        health = client.wait_health(lambda h: "2 publishers" in h.message)
        assert health.level == WARN
        client.probe.node.destroy_publisher(second)


# ---------------------------------------------------------------------- silence


@each
def test_silence_ramps_to_safe_and_the_stream_comes_back_without_a_bump(domain, tmp_path, kind):
    """Fault 18."""
    ramp = 0.5
    with controlled(domain, tmp_path, kind=kind, safe_ramp=ramp) as client:
        full = client.stand()
        silent, first = client.arrivals[-1], len(client.commands)
        client.be_patient(False)
        client.probe.spin_until(lambda: not client.commands[-1].any())
        falling = np.array([full, *client.commands[first:]])[:, 0]
        assert (np.diff(falling) <= 0.0).all()
        assert client.arrivals[-1] - silent > 0.9 * ramp  # whatever is late makes it longer
        client.wait_health(lambda h: h.level == STALE)
        client.handled()
        assert len(client.commands) == first - 1 + len(falling)  # outputs stop
        client.be_patient()
        first, answered = len(client.commands), len(client.states)
        client.stand()
        back = np.array([np.zeros(4), *client.commands[first:]])[:, 0]
        steps = np.diff([state.stamp * 1e-9 for state in client.states[answered:]])
        assert back[1] == 0.0
        assert len(back) > 10
        assert np.all(np.diff(back)[1:] <= full[0] * steps / ramp * 1.01 + 1e-9)


class SimulatedClock:
    """The clock of a simulation, set by the test."""

    def __init__(self, client):
        self._client = client
        self._publisher = client.probe.node.create_publisher(Clock, "/clock", 10)
        client.probe.spin_until(self._publisher.get_subscription_count)
        client.probe.meet(client.name)

    def set(self, time):
        """To a time [ns], for the node too."""
        self._publisher.publish(write_clock(Clock(), time))
        self._client.handled()

    def end(self):
        """No clock any more."""
        self._client.probe.node.destroy_publisher(self._publisher)


@each
def test_a_paused_simulation_leaves_the_watchdog_quiet_and_a_dead_one_does_not(
    domain, tmp_path, kind
):
    """Fault 17; the timeout is one of simulated time; a clock without a publisher is silence."""
    values, timeout = {"use_sim_time": "true", "safe_ramp": 0.05}, round(1e9 * PATIENT["timeout"])
    with controlled(domain, tmp_path, kind=kind, **values) as client:
        clock = SimulatedClock(client)
        for k in range(1, 20):
            clock.set(k * STEP)
            command = client.ask(stamp=k * STEP)
        np.testing.assert_allclose(command, client.holding(), rtol=1e-9)
        first = len(client.commands)
        assert client.node.is_idle()
        clock.set(19 * STEP + timeout - 1_000_000)
        assert client.wait_health(lambda h: True).level != STALE
        assert len(client.commands) == first
        clock.set(19 * STEP + timeout + 1_000_000)  # it goes on, alone
        client.probe.spin_until(lambda: not client.commands[-1].any())
        for k in range(20, 40):
            clock.set(k * STEP + timeout)
            command = client.ask(stamp=k * STEP + timeout)
        assert command.any()
        clock.end()
        client.be_patient(False)
        client.wait_health(lambda h: "nobody publishes /clock any more" in h.message)
        client.probe.spin_until(lambda: not client.commands[-1].any())


@each
@pytest.mark.parametrize("first", ["clock", "joint state"])
def test_a_clock_that_jumps_back_is_a_new_beginning(domain, tmp_path, kind, first):
    """Fault 16: without a bump, whatever comes first; DDS orders no two topics."""
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE, use_sim_time="true") as client:
        clock = SimulatedClock(client)
        for begin, pose in ((400 * STEP, POSE + 0.1), (0, POSE)):
            if first == "clock":
                clock.set(begin + STEP)
            for k in range(1, 4):
                command = client.ask(pose, stamp=begin + k * STEP)
                np.testing.assert_allclose(command, client.holding(pose), rtol=1e-9)
                clock.set(begin + k * STEP)
        client.node.wait_for("time jumped back by 4.020 s")
        assert client.node.count_logged("time jumped back") == 1
        assert dropped(client.wait_health(lambda h: True)) == {}


# ---------------------------------------------------------------------- what leaves


HUGE = {
    "sliding": {"gains__gain": [1e9], "gains__boundary_layer": [0.0], "gains__bandwidth": [1e3]},
    "qp": {"gains__kp": [1e9], "gains__kd": [1e6]},
}
CHATTER = {"sliding": 0.1, "qp": 0.02}  # N·m; the velocity limits make the QP gentler


@each
def test_a_huge_gain_without_a_boundary_layer_stays_within_size_and_rate(domain, tmp_path, kind):
    """Fault 33: velocities that jitter, at periods that jitter; chatter is measured."""
    limits = {"effort_limit": [5.0, 5.0, 1.0, 1.0], "effort_rate": 200.0}
    rng = np.random.default_rng(3)
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE, **HUGE[kind], **limits) as client:
        client.ask()
        for _ in range(100):
            client.stamp += int(rng.integers(1, 30_000_000))
            client.ask(velocity=rng.normal(0.0, 0.01, 4))
        commands = np.array(client.commands)
        stamps = np.array([state.stamp for state in client.states])
        assert (np.abs(commands) <= [5.0, 5.0, 1.0, 1.0]).all()
        steps = np.minimum(np.diff(stamps) * 1e-9, PATIENT["timeout"])[:, None]
        assert (np.abs(np.diff(commands, axis=0)) <= 200.0 * steps * (1 + 1e-9)).all()
        assert (np.array(client.states[-1].effort) > CHATTER[kind]).all()
        client.wait_health(lambda h: float(h.values["chatter"].split(",")[0]) > 0.1)


@each
def test_a_joint_without_authority_and_commands_that_nobody_hears_are_named(
    domain, tmp_path, kind
):
    """Faults 25 and 34."""
    limit = {"effort_limit": [60.0, 60.0, 0.0, 4.0]}
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE, **limit) as client:
        client.ask()
        client.wait_health(lambda h: "no authority over wrist_rotation" in h.message)
        client.unhear()
        health = client.wait_health(lambda h: "nobody hears the commands" in h.message)
        assert health.level == WARN


def test_an_integral_stands_still_while_nobody_hears_the_commands(domain, tmp_path):
    """Fault 34: fifty steps unheard leave it where one step heard would bring it."""
    ahead = POSE + np.array([0.001, 0.0, 0.0, 0.0])
    with controlled(domain, tmp_path, controller="super_twisting", **AT_ONCE) as client:
        client.ask()
        heard = [client.ask(ahead, stamp=client.stamp + STEP) for _ in range(3)]
        client.unhear()
        client.wait_health(lambda h: "nobody hears the commands" in h.message)
        answered = len(client.states)
        for _ in range(50):
            client.publish(client.message(ahead, stamp=client.stamp + STEP))
        client.probe.spin_until(lambda: len(client.states) == answered + 50)
        client.hear()
        client.wait_health(lambda h: "nobody hears the commands" not in h.message)
        after = client.ask(ahead, stamp=client.stamp + STEP)
        step = np.diff(heard, axis=0)[-1]
        assert abs(step[0]) > 1e-3
        np.testing.assert_allclose(after - heard[-1], step, rtol=1e-6, atol=1e-9)


# ---------------------------------------------------------------------- ends


def damped(client, v):
    """What `safe: damping` with gain 1 gives at POSE, held for the timeout at most."""
    joints, robot = client.scene.controlled_joints(), client.scene.robot
    q = robot.neutral()
    for name, value in zip((*JOINTS, "elbow"), (*POSE, 1.75 * POSE[0] + 0.175), strict=True):
        q[robot.joint(name).q] = value
    x = client.scene.initial._replace(q=q)
    return -np.linalg.solve(np.eye(4) + PATIENT["timeout"] * joints.response(x).mobility, v)


@each
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_last_message_before_a_signal_ends_it_is_the_safe_command(
    domain, tmp_path, kind, number
):
    """Fault 38."""
    with controlled(domain, tmp_path, kind=kind, **AT_ONCE, stop=None) as client:
        client.ask()
        v = np.array([0.3, -0.2, 0.1, 0.0])
        client.ask(velocity=v)
        seen = len(client.commands)
        assert client.node.stop(number) == 0
        client.probe.spin_until(lambda: said(client.probe, client.name, OK, "stopped"))
        assert len(client.commands) == seen + 1
        np.testing.assert_allclose(client.commands[-1], damped(client, v), rtol=1e-9, atol=1e-12)
        assert "Traceback" not in client.node.log


def test_a_reset_leaves_the_watchdog_awake(domain, tmp_path):
    with controlled(domain, tmp_path, safe_ramp=0.1) as client:
        assert client.stand().any()
        assert client.probe.call(Trigger, f"{client.name}/reset", Trigger.Request()).success
        client.be_patient(False)
        client.probe.spin_until(lambda: not client.commands[-1].any())


def test_an_inactive_controller_has_nothing_to_say_when_it_ends(domain, tmp_path):
    """Another one may have its topic by then."""
    with controlled(domain, tmp_path, **AT_ONCE, stop=None) as client:
        client.ask()
        assert client.probe.change_state(client.name, "deactivate")
        client.handled()
        count = len(client.commands)
        assert client.node.stop(signal.SIGTERM) == 0
        client.probe.spin_until(lambda: said(client.probe, client.name, OK, "stopped"))
        assert len(client.commands) == count


@each
def test_a_state_that_does_not_close_a_loop_is_dropped(domain, tmp_path, kind):
    robots = (ROOT / "config/robots").as_posix()
    text = (ROOT / "config/scenes/controlled_four_bar.yaml").read_text(encoding="utf-8")
    text = text.replace("../robots", robots)
    with controlled(domain, tmp_path, text, kind=kind, **AT_ONCE) as client:
        names, pose = [j.name for j in client.scene.robot.joints], client.scene.initial.q
        first = client.ask(pose, name=names)
        off = pose + 1.0 * (np.array(names) == "knee_tibial")
        later = client.stamp + 200_000_000  # no glitch
        client.no_answer(client.message(off, name=names, stamp=later))
        health = client.wait_health(lambda h: dropped(h).get("unsolved") == "1")
        assert health.values["state"] == "active"
        again = client.ask(pose, name=names, stamp=later + 200_000_000)
        np.testing.assert_allclose(again, first, rtol=1e-6)


def test_deactivation_ramps_down_and_activation_begins_anew(domain, tmp_path):
    with controlled(domain, tmp_path, safe_ramp=0.1) as client:
        full = client.stand()
        first = len(client.commands)
        assert client.probe.change_state(client.name, "deactivate")
        falling = np.array([full, *client.commands[first:]])
        assert len(falling) >= 10
        assert (np.abs(np.diff(falling, axis=0)) <= np.abs(full) * 0.11 + 1e-12).all()
        assert not falling[-1].any()
        client.no_answer(client.message())
        assert client.probe.change_state(client.name, "activate")
        assert np.abs(client.ask(POSE + 0.1)[0]) <= 1e-9  # the share of the safe one is 1 again
        assert client.probe.change_state(client.name, "deactivate")
        assert client.probe.change_state(client.name, "cleanup")
        client.probe.spin_until(lambda: not client.hearing.get_publisher_count())
        assert client.probe.change_state(client.name, "configure")
        assert client.probe.change_state(client.name, "activate")
        client.connect()
        client.stand()


CRASHING = """
from mbd_ros.core.contracts import Load
from mbd_ros.errors import SolveError
import numpy as np
class Fragile(Load):
    example = {}
    def __init__(self, robot):
        self._zero = np.zeros(robot.model.nv)
    def force(self, k, x, u):
        if 0.54 < x.q[0] < 0.56:
            raise ZeroDivisionError("it broke")
        if 0.44 < x.q[0] < 0.46:
            raise SolveError("no way")
        return self._zero
"""


@pytest.fixture
def fragile(tmp_path, monkeypatch):
    """A scene with a part that raises away from POSE."""
    (tmp_path / "fragile_part.py").write_text(CRASHING)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return ARM + "forces: [{type: 'fragile_part:Fragile'}]\n"


@each
def test_a_bug_in_a_callback_sends_the_safe_command_and_ends_the_node(
    domain, tmp_path, fragile, kind
):
    """Fault 39."""
    with controlled(domain, tmp_path, fragile, kind=kind, **TRUSTED, stop=None) as client:
        assert client.ask().any()
        client.publish(client.message(POSE + 0.05))
        client.probe.spin_until(lambda: said(client.probe, client.name, ERROR, "it broke"))
        assert client.node.wait() == 1
        client.probe.spin_until(lambda: not client.commands[-1].any())
        client.node.wait_for("ZeroDivisionError")


@each
def test_a_law_without_an_answer_keeps_its_last_one_and_then_deactivates(
    domain, tmp_path, fragile, kind
):
    """Fault 39, an error of this package: safe command, ERROR; activation helps."""
    more = {**TRUSTED, "failures": 3}
    with controlled(domain, tmp_path, fragile, kind=kind, **more) as client:
        last = client.ask()
        for _ in range(2):
            np.testing.assert_array_equal(client.ask(POSE - 0.05), last)
        client.publish(client.message(POSE - 0.05))
        client.probe.spin_until(
            lambda: said(client.probe, client.name, ERROR, "3 states in a row")
        )
        assert client.probe.state(client.name) == "inactive"
        assert not client.commands[-1].any()
        client.no_answer(client.message())
        assert client.probe.change_state(client.name, "activate")
        np.testing.assert_allclose(client.ask(), client.holding(), rtol=1e-9)
