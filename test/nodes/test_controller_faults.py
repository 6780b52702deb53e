"""What the controllers do about bad joint states, silence, crashes and signals, over DDS."""

import signal
import time

import numpy as np
import pytest
from nodes.control_client import POSE, STEP, controlled
from nodes.simulation_client import ARM, JOINTS, NAME, simulated
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from msg_adapters.clock import write_clock
from msg_adapters.diagnostics import ERROR, STALE, WARN

AT_ONCE = {"safe_ramp": 0.0, "timeout": 10.0}
NAN = float("nan")


# ---------------------------------------------------------------------- joint states


def test_bad_joint_states_are_dropped_and_counted(domain, tmp_path):
    """Faults 1, 2, 8, 9, 10, 13 and 14."""
    with controlled(domain, tmp_path, **AT_ONCE) as client:
        expected = client.ask()
        good = client.stamp
        short, empty = client.message(), client.message()
        short.position = short.position[:2]
        empty.name, empty.position, empty.velocity = [], [], []
        twice = client.message(name=[JOINTS[0]] * 4)
        lost = client.message([NAN, *POSE[1:]])
        glitch = client.message(POSE + 5.0)
        for message in (short, empty, twice, lost, glitch, client.message(stamp=good - STEP)):
            client.no_answer(message)
        client.wait_health(lambda h: h.values.get("dropped.malformed") == "3")
        client.wait_health(lambda h: h.values.get("dropped.not_finite") == "1")
        client.wait_health(lambda h: h.values.get("dropped.jump") == "1")
        client.wait_health(lambda h: h.values.get("dropped.old") == "1")
        client.stamp = good
        np.testing.assert_allclose(client.ask(velocity=[NAN] * 4), expected, atol=1e-9)
        np.testing.assert_allclose(client.ask(stamp=client.stamp), expected, atol=1e-9)


def test_a_missing_joint_is_held_for_a_while_then_the_command_goes_safe(domain, tmp_path):
    """Fault 5."""
    with controlled(domain, tmp_path, safe_ramp=0.05, timeout=0.1, max_age=0.1) as client:
        client.stand(0.2)
        held = client.ask(POSE[1:], name=JOINTS[1:])
        np.testing.assert_allclose(held, client.holding(), rtol=1e-6, atol=1e-6)
        client.stamp += 200_000_000
        client.no_answer(client.message(POSE[1:], name=JOINTS[1:]))
        client.probe.spin_until(lambda: not client.commands[-1].any())
        health = client.wait_health(lambda h: h.level == STALE)
        assert JOINTS[0] in health.message
        assert health.values["share of the safe command"] == "1"


def test_joint_states_of_another_clock_are_stale(domain, tmp_path):
    """Fault 15."""
    with controlled(domain, tmp_path, **AT_ONCE) as client:
        client.ask()
        client.no_answer(client.message(stamp=5_000_000_000))
        health = client.wait_health(lambda h: h.level == STALE)
        assert "does use_sim_time fit" in health.message


def test_two_publishers_are_named(domain, tmp_path):
    """Fault 19."""
    with controlled(domain, tmp_path, **AT_ONCE) as client:
        client.ask()
        second = client.probe.node.create_publisher(JointState, "/joint_states", 10)
        health = client.wait_health(lambda h: "2 publishers" in h.message)
        assert health.level == WARN
        client.probe.node.destroy_publisher(second)


# ---------------------------------------------------------------------- silence


def test_silence_ramps_to_safe_and_the_stream_comes_back_without_a_bump(domain, tmp_path):
    """Fault 18."""
    ramp = {"safe_ramp": 0.2, "timeout": 0.1}
    with controlled(domain, tmp_path, **ramp) as client:
        full = client.stand(0.5)
        np.testing.assert_allclose(full, client.holding(), rtol=1e-9)
        first = len(client.commands)
        client.probe.spin_until(lambda: not client.commands[-1].any())
        falling = np.array(client.commands[first - 1 :])[:, 0]
        arrivals = np.array(client.arrivals[first - 1 :])
        assert (np.diff(falling) <= 0.0).all()
        assert len(falling) >= 10
        assert 0.05 < arrivals[1] - arrivals[0] < 0.5  # the timeout, and looks at 0.01 s
        client.probe.spin_for(0.1)
        assert len(client.commands) == first - 1 + len(falling)  # outputs stop
        client.wait_health(lambda h: h.level == STALE)
        first = len(client.commands)
        np.testing.assert_allclose(client.stand(0.5), full, rtol=1e-9)
        back = np.array([np.zeros(4), *client.commands[first:]])[:, 0]
        stamps = np.array([0, *(s.stamp for s in client.states[-len(back) + 1 :])])
        steps = np.diff(stamps * 1e-9)[1:]
        assert np.all(np.diff(back)[1:] <= full[0] * steps / 0.2 * 1.01 + 1e-9)


def test_a_paused_simulation_leaves_the_watchdog_quiet_and_a_dead_one_does_not(domain, tmp_path):
    """Fault 17; then a clock without a publisher is silence."""
    values = {"use_sim_time": "true", "timeout": 0.1, "safe_ramp": 0.05}
    with controlled(domain, tmp_path, **values) as client:
        clock = client.probe.node.create_publisher(Clock, "/clock", 10)
        client.probe.spin_until(clock.get_subscription_count)
        for k in range(1, 60):
            clock.publish(write_clock(Clock(), k * STEP))
            client.probe.spin_for(0.002)
            command = client.ask(stamp=k * STEP)
        np.testing.assert_allclose(command, client.holding(), rtol=1e-9)
        first, busy = len(client.commands), client.node.cpu_seconds()
        client.probe.spin_for(0.5)
        assert len(client.commands) == first
        assert client.node.cpu_seconds() - busy < 0.1
        clock.publish(write_clock(Clock(), 60 * STEP + 1_000_000_000))  # it goes on, alone
        client.probe.spin_until(lambda: not client.commands[-1].any())
        for k in range(200, 240):
            clock.publish(write_clock(Clock(), k * STEP))
            client.probe.spin_for(0.002)
            command = client.ask(stamp=k * STEP)
        assert command.any()
        client.probe.node.destroy_publisher(clock)
        client.probe.spin_until(lambda: not client.commands[-1].any())


def test_a_clock_that_jumps_back_is_a_new_beginning(domain, tmp_path):
    """Fault 16."""
    with controlled(domain, tmp_path, **AT_ONCE, use_sim_time="true") as client:
        clock = client.probe.node.create_publisher(Clock, "/clock", 10)
        client.probe.spin_until(clock.get_subscription_count)
        for begin in (500 * STEP, 0):
            clock.publish(write_clock(Clock(), begin + STEP))
            client.probe.spin_for(0.1)
            for k in range(1, 4):
                other = POSE + (0.1 if begin else 0.0)
                np.testing.assert_allclose(
                    client.ask(other, stamp=begin + k * STEP), client.holding(other), rtol=1e-9
                )
        assert "time jumped back" in client.node.log
        assert client.dropped("old") == client.dropped("jump") == 0


# ---------------------------------------------------------------------- what leaves


def test_a_huge_gain_without_a_boundary_layer_stays_within_size_and_rate(domain, tmp_path):
    """Fault 33: velocities that jitter, at periods that jitter; chatter is measured."""
    gains = {"gains__gain": [1e9], "gains__boundary_layer": [0.0], "gains__bandwidth": [1e3]}
    limits = {"effort_limit": [5.0, 5.0, 1.0, 1.0], "effort_rate": 200.0}
    rng = np.random.default_rng(3)
    with controlled(domain, tmp_path, **AT_ONCE, **gains, **limits) as client:
        client.ask()
        for _ in range(100):
            client.stamp += int(rng.integers(1, 30_000_000))
            client.ask(velocity=rng.normal(0.0, 0.01, 4))
        commands = np.array(client.commands)
        stamps = np.array([state.stamp for state in client.states])
        assert (np.abs(commands) <= [5.0, 5.0, 1.0, 1.0]).all()
        steps = np.minimum(np.diff(stamps) * 1e-9, 10.0)[:, None]
        assert (np.abs(np.diff(commands, axis=0)) <= 200.0 * steps * (1 + 1e-9)).all()
        assert (np.array(client.states[-1].effort) > 0.1).all()
        client.wait_health(lambda h: float(h.values["chatter"].split(",")[0]) > 0.1)


def test_a_joint_without_authority_and_commands_that_nobody_hears_are_named(domain, tmp_path):
    """Faults 25 and 34; the integral of super-twisting stands still meanwhile."""
    law = {"controller": "super_twisting", "effort_limit": [60.0, 60.0, 0.0, 4.0]}
    with controlled(domain, tmp_path, **AT_ONCE, **law) as client:
        client.ask()
        client.wait_health(lambda h: "no authority over wrist_rotation" in h.message)
        client.probe.node.destroy_subscription(client.hearing)
        health = client.wait_health(lambda h: "nobody hears the commands" in h.message)
        assert health.level == WARN


# ---------------------------------------------------------------------- ends


def damped(client, v):
    """What `safe: damping` with gain 1 gives at POSE, held for the timeout of 10 s at most."""
    joints, robot = client.scene.controlled_joints(), client.scene.robot
    q = robot.neutral()
    for name, value in zip((*JOINTS, "elbow"), (*POSE, 1.75 * POSE[0] + 0.175), strict=True):
        q[robot.joint(name).q] = value
    x = client.scene.initial._replace(q=q)
    return -np.linalg.solve(np.eye(4) + 10.0 * joints.response(x).mobility, v)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_last_message_before_a_signal_ends_it_is_the_safe_command(domain, tmp_path, number):
    """Fault 38."""
    with controlled(domain, tmp_path, **AT_ONCE, stop=None) as client:
        client.ask()
        v = np.array([0.3, -0.2, 0.1, 0.0])
        client.ask(velocity=v)
        seen = len(client.commands)
        assert client.node.stop(number) == 0
        client.probe.spin_until(lambda: len(client.commands) > seen)
        client.probe.spin_for(0.1)
        assert len(client.commands) == seen + 1
        np.testing.assert_allclose(client.commands[-1], damped(client, v), rtol=1e-9, atol=1e-12)
        assert "Traceback" not in client.node.log


def test_deactivation_ramps_down_and_activation_begins_anew(domain, tmp_path):
    with controlled(domain, tmp_path, safe_ramp=0.1, timeout=10.0) as client:
        full = client.stand(0.3)
        first = len(client.commands)
        assert client.probe.change_state(client.name, "deactivate")
        client.probe.spin_for(0.1)
        falling = np.array([full, *client.commands[first:]])
        assert len(falling) >= 10
        assert (np.abs(np.diff(falling, axis=0)) <= np.abs(full) * 0.11 + 1e-12).all()
        assert not falling[-1].any()
        client.no_answer(client.message())
        assert client.probe.change_state(client.name, "activate")
        assert np.abs(client.ask(POSE + 0.1)[0]) <= 1e-9  # the share of the safe one is 1 again
        assert client.probe.change_state(client.name, "deactivate")
        assert client.probe.change_state(client.name, "cleanup")
        assert client.probe.change_state(client.name, "configure")
        assert client.probe.change_state(client.name, "activate")
        client.probe.spin_until(client.hearing.get_publisher_count)


CRASHING = """
from mbd_ros.core.parts import ForceTerm
import numpy as np
class Fragile(ForceTerm):
    example = {}
    def __init__(self, robot):
        self._zero = np.zeros(robot.model.nv)
    def force(self, data, x):
        if x.q[0] > 0.54:
            raise ZeroDivisionError("it broke")
        return self._zero
"""


def test_an_exception_in_a_callback_sends_the_safe_command_and_ends_the_node(
    domain, tmp_path, monkeypatch
):
    """Fault 39."""
    (tmp_path / "fragile_part.py").write_text(CRASHING)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    scene = ARM + "forces: [{type: 'fragile_part:Fragile'}]\n"
    with controlled(domain, tmp_path, scene, **AT_ONCE, stop=None) as client:
        assert client.ask().any()
        client.publish(client.message(POSE + 0.05))
        client.probe.spin_until(
            lambda: [
                h
                for h in client.probe.health
                if h.name == client.name and h.level == ERROR and "it broke" in h.message
            ]
        )
        assert client.node.wait() == 1
        assert not client.commands[-1].any()
        assert "ZeroDivisionError" in client.node.log


# ---------------------------------------------------------------------- with a simulator

LOOSE = {"timeout": 0.1, "safe_ramp": 0.1}


def reached(simulation, controller):
    """Until the joints stand at POSE."""
    controller.refer(POSE)

    def near():
        if not simulation.states:
            return False
        position = dict(zip(JOINTS, np.delete(simulation.newest.position, 2), strict=True))
        return np.abs(np.array([position[n] for n in JOINTS]) - POSE).max() < 1e-3

    simulation.probe.spin_until(near)


@pytest.fixture
def closed_loop(domain, tmp_path):
    """A simulator at 500 Hz, and what connects a controller to it."""
    (folder := tmp_path / "simulator").mkdir()
    (other := tmp_path / "controller").mkdir()
    with simulated(domain, folder, ARM, rate=500.0, marker_rate=0.0) as simulation:
        simulation.probe.node.destroy_publisher(simulation._vectors)
        yield simulation, other


def test_a_killed_controller_leaves_the_arm_to_the_timeout_of_the_simulator(domain, closed_loop):
    simulation, folder = closed_loop
    with controlled(domain, folder, plant=NAME, **LOOSE, stop=None) as client:
        client.probe.spin_until(lambda: client.states)
        reached(simulation, client)
        client.node.process.kill()
        client.node.wait()
        health = simulation.probe.wait_health(
            lambda h: h.values.get("share of the safe command") == "1"
        )
        assert "no command for" in health.message
        simulation.assert_finite()


def test_a_frozen_and_a_killed_simulator_are_silence(domain, closed_loop):
    """The command goes safe while it is frozen, and takes over again without a bump."""
    simulation, folder = closed_loop
    with controlled(domain, folder, plant=NAME, **LOOSE) as client:
        client.probe.spin_until(lambda: client.states)
        reached(simulation, client)
        simulation.node.process.send_signal(signal.SIGSTOP)
        health = client.wait_health(lambda h: h.level == STALE)
        assert health.values["share of the safe command"] == "1"
        time.sleep(0.2)
        simulation.node.process.send_signal(signal.SIGCONT)
        client.wait_health(lambda h: h.values["share of the safe command"] == "0")
        moved = np.abs(np.diff([s.position for s in client.states], axis=0)).max()
        assert moved < 0.3
        client.assert_finite()
