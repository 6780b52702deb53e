"""What the controllers do where the simulator, or they themselves, die, freeze or diverge."""

import re
import signal
from contextlib import contextmanager

import numpy as np
import pytest
from nodes.control_client import KINDS, POSE, controlled, gone_safe, said
from nodes.simulation_client import ARM, DAMPED, JOINTS, NAME, simulated
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from msg_adapters.diagnostics import ERROR
from msg_adapters.joint_state import write_joint_state

each = pytest.mark.parametrize("kind", KINDS)
LOOSE = {"timeout": 0.1, "safe_ramp": 0.1}
CALM = ARM + DAMPED  # without it the wrist is off by radians when a busy machine is 10 ms late


def move(simulation, controller):
    """Until the arm is well on its way to POSE, however late commands come."""
    controller.refer(POSE)

    def has_moved():
        return simulation.states and np.abs(np.delete(simulation.newest.position, 2)).max() > 0.15

    simulation.probe.spin_until(has_moved)
    controller.probe.spin_until(lambda: controller.commands[-1].any())


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


@pytest.fixture
def closed_loop(domain, tmp_path):
    """The same, in the hands of the fixture."""
    with running_arm(domain, tmp_path) as both:
        yield both


@each
def test_a_killed_controller_leaves_the_arm_to_the_timeout_of_the_simulator(
    domain, closed_loop, kind
):
    simulation, folder = closed_loop
    with controlled(domain, folder, CALM, kind=kind, plant=NAME, **LOOSE, stop=None) as client:
        client.probe.spin_until(lambda: client.states)
        move(simulation, client)
        client.node.process.kill()
        client.node.wait()
        health = simulation.probe.wait_health(
            lambda h: h.name == NAME and h.values["share of the safe command"] == "1"
        )
        assert "no command for" in health.message


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
    share = np.minimum((np.array(stamps) - stamps[0]) * 1e-9 / LOOSE["safe_ramp"], 1.0) + 1e-9
    damping = client.scene.safe.gain * np.array([speeds[t] for t in stamps])
    sizes = np.abs(commands)
    assert (sizes <= np.outer(share, limits) + damping).all()
    assert sizes.max() > 0.0


@each
def test_a_frozen_and_a_killed_simulator_are_silence(domain, tmp_path, kind):
    """The command goes safe while it is frozen, and takes over again without a bump."""
    with (
        running_arm(domain, tmp_path, stop=None) as (simulation, folder),
        controlled(domain, folder, CALM, kind=kind, plant=NAME, **LOOSE) as client,
    ):
        client.probe.spin_until(lambda: client.states)
        move(simulation, client)
        simulation.node.process.send_signal(signal.SIGSTOP)
        gone_safe(client)
        count = len(client.commands)
        simulation.node.process.send_signal(signal.SIGCONT)
        client.wait_health(lambda h: h.values["share of the safe command"] == "0")
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
    tuned = {**LOOSE, "use_sim_time": simulated_time}
    factor = 0.25 if simulated_time == "true" else 1.0
    timed = {"publish_clock": simulated_time, "real_time_factor": factor}
    with (
        running_arm(domain, tmp_path, **timed) as (simulation, folder),
        controlled(domain, folder, CALM, kind=kind, plant=NAME, **tuned) as client,
    ):
        client.probe.spin_until(lambda: client.states)
        move(simulation, client)
        probe = simulation.probe
        publish = lambda: simulation.publish(absurd)  # noqa: E731
        simulation.repeat(publish, lambda: said(probe, NAME, ERROR, "diverged at t = "))
        (health, *_) = said(probe, NAME, ERROR, "diverged at t = ")
        assert any(joint in health.message for joint in (*JOINTS, "elbow"))
        at = float(re.search(r"diverged at t = ([\d.]+) s", health.message)[1])
        assert 0.0 <= at - float(health.values["simulated time"]) < 0.01
        assert health.values["state"] == "inactive"
        gone_safe(client)
        count, last = simulation.settle(), simulation.newest
        assert not probe.change_state(NAME, "activate")
        assert probe.call(Trigger, f"{NAME}/reset", Trigger.Request()).success
        assert probe.change_state(NAME, "activate")
        probe.spin_until(lambda: len(simulation.states) > count)
        assert np.abs(simulation.sample(count).position - last.position).max() > 0.1
        client.wait_health(lambda h: h.values["share of the safe command"] == "0")
