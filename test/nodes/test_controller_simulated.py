"""What the controllers do where the simulator, or they themselves, die, freeze or diverge."""

import re
import signal
from contextlib import contextmanager

import numpy as np
import pytest
from nodes.control_client import KINDS, controlled, gone_safe, said
from nodes.simulation_client import ARM, DAMPED, JOINTS, NAME, simulated
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from msg_adapters.diagnostics import ERROR
from msg_adapters.joint_state import write_joint_state

each = pytest.mark.parametrize("kind", KINDS)
RAMP = 0.1  # s
# At 100 Hz these gains leave room for commands that are late, and no error is too large.
TUNED = {
    "sliding": {"gains__bandwidth": [2.0], "gains__gain": [5.0]},
    "qp": {"gains__kp": [10.0], "gains__kd": [5.0]},
}
EASY = {"safe_ramp": RAMP, "error_limit": 0.0}
CALM = ARM + DAMPED  # without it the wrist is off by radians when a busy machine is 10 ms late
SLOW = {"publish_clock": "true", "real_time_factor": 0.2}
START = (0.0, 0.0, 0.175, 0.0, 0.0)  # the elbow is coupled
SAFE = "share of the safe command"


def commanded(client):
    """Until the controller has said something that moves the arm."""
    client.probe.spin_until(lambda: any(command.any() for command in client.commands))


@contextmanager
def running_arm(domain, tmp_path, **more):
    """A simulator at 100 Hz, and a folder for what connects a controller to it."""
    (folder := tmp_path / "simulator").mkdir()
    (other := tmp_path / "controller").mkdir()
    with simulated(domain, folder, CALM, rate=100.0, marker_rate=0.0, **more) as simulation:
        simulation.follow()
        simulation.probe.node.destroy_publisher(simulation._vectors)
        yield simulation, other
        simulation.assert_finite()
        for motion in simulation.motions:
            for values in (motion.position, motion.velocity, motion.acceleration, motion.effort):
                assert np.isfinite(values).all()


def controller_of(domain, folder, kind, **more):
    """Its controller."""
    given = {**TUNED[kind], **EASY, **more}
    return controlled(domain, folder, CALM, kind=kind, plant=NAME, **given)


@each
def test_a_killed_controller_leaves_the_arm_to_the_timeout_of_the_simulator(
    domain, tmp_path, kind
):
    with (
        running_arm(domain, tmp_path) as (simulation, folder),
        controller_of(domain, folder, kind, stop=None) as client,
    ):

        def plant(done):
            return simulation.probe.wait_health(lambda h: h.name == NAME and done(h))

        plant(lambda h: h.values["commands received"] != "0")
        client.node.process.kill()
        client.node.wait()
        plant(lambda h: h.values[SAFE] == "1" and "no command for" in h.message)


def assert_ramped(simulation, client, count):
    """Commands since number `count` grow with the ramp, but for what damps.

    By stamps, since a busy machine lets the arm fall before it is caught.
    """
    answers = zip(client.answered[count:], client.commands[count:], strict=True)
    stamps, commands = zip(*((t, u) for t, u in answers if t is not None), strict=True)
    simulation.probe.spin_until(lambda: simulation.newest.stamp >= stamps[-1])
    samples = map(simulation.sample, range(len(simulation.states)))
    speeds = {sample.stamp: np.abs(np.delete(sample.velocity, 2)) for sample in samples}
    limits = np.array([client.scene.robot.joint(name).max_effort for name in JOINTS])
    share = np.minimum((np.array(stamps) - stamps[0]) * 1e-9 / RAMP, 1.0) + 1e-9
    damping = client.scene.safe.gain * np.array([speeds[t] for t in stamps])
    sizes = np.abs(commands)
    assert (sizes <= np.outer(share, limits) + damping).all()
    assert sizes.max() > 0.0


@each
def test_a_frozen_and_a_killed_simulator_are_silence(domain, tmp_path, kind):
    """The command goes safe while it is frozen, and takes over again without a bump."""
    with (
        running_arm(domain, tmp_path, stop=None, **SLOW) as (simulation, folder),
        controller_of(domain, folder, kind, use_sim_time="true") as client,
    ):
        client.wait_health(lambda h: h.values[SAFE] == "0")
        simulation.node.process.send_signal(signal.SIGSTOP)
        gone_safe(client)
        count = len(client.commands)
        simulation.node.process.send_signal(signal.SIGCONT)
        client.wait_health(lambda h: h.values[SAFE] == "0")
        assert_ramped(simulation, client, count)
        simulation.node.process.kill()
        gone_safe(client)


@each
@pytest.mark.parametrize("simulated_time", ["false", "true"])
def test_a_simulation_that_diverges_is_silence_until_it_is_reset(
    domain, tmp_path, kind, simulated_time
):
    """Fault 32, by an absurd command: joint and time are named, and its state is kept.

    In simulated time it must not look like a pause.
    """
    absurd = write_joint_state(JointState(), 0, JOINTS, effort=np.full(4, 1e308))
    timed = SLOW if simulated_time == "true" else {}
    with (
        running_arm(domain, tmp_path, **timed) as (simulation, folder),
        controller_of(domain, folder, kind, use_sim_time=simulated_time) as client,
    ):
        commanded(client)
        probe = simulation.probe
        publish = lambda: simulation.publish(absurd)  # noqa: E731
        simulation.repeat(publish, lambda: said(probe, NAME, ERROR, "diverged at t = "))
        (health, *_) = said(probe, NAME, ERROR, "diverged at t = ")
        assert any(joint in health.message for joint in (*JOINTS, "elbow"))
        at = float(re.search(r"diverged at t = ([\d.]+) s", health.message)[1])
        assert 0.0 <= at - float(health.values["simulated time"]) < 0.01
        assert health.values["state"] == "inactive"
        gone_safe(client)
        answered, count, last = len(client.states), simulation.settle(), simulation.newest
        assert not probe.change_state(NAME, "activate")
        assert probe.call(Trigger, f"{NAME}/reset", Trigger.Request()).success
        assert probe.change_state(NAME, "activate")
        probe.spin_until(lambda: len(simulation.states) > count)
        assert (last.position != START).any()
        np.testing.assert_array_equal(simulation.sample(count).position, START)
        client.probe.spin_until(lambda: len(client.states) > answered)
