"""The simulator and inverse dynamics, live: the commands come back as torques."""

import sys
from contextlib import contextmanager

import numpy as np
import pytest
from deadline import PATIENT
from nodes.joint_stream import ACTIVE, MS, parameter_file
from nodes.node_process import NodeProcess
from nodes.simulation_client import ARM, DAMPED, DEEP, simulated, streamed, swinging
from sensor_msgs.msg import JointState

from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, TorqueEstimator, Tuning
from mbd_ros.scene.reader import load_scene
from msg_adapters.joint_state import read_joint_state

TARGET = ("-m", "mbd_ros.nodes", "inverse_dynamics")
CUTOFF = 20.0  # Hz
TICK, TICKS = 1e-3, 800


class Estimate:
    """Torques that a node `inverse_dynamics` makes of a simulator's joint states.

    Attributes:
        scene: The scene of both.
        torques: Messages as they came.
        delay: That the node states for its derivatives [s], after `end`.
    """

    def __init__(self, client, scene):
        self._client, self.scene, self.torques = client, scene, []
        topic = "/inverse_dynamics/joint_torques"
        keep = client.probe.node.create_subscription(JointState, topic, self.torques.append, DEEP)
        client.probe.spin_until(keep.get_publisher_count)
        client.follow()
        client.repeat(client.reset, lambda: self.torques)  # until all nodes know each other

    def end(self):
        stated = "derivatives"
        health = self._client.probe.wait_health(lambda h: stated in h.values)
        self.delay = float(health.values[stated].split("delay ")[1].split(" s")[0])


@contextmanager
def estimated(domain, folder, **options):
    """A simulator in simulated time and inverse dynamics behind it."""
    with simulated(domain, folder, ARM + DAMPED, publish_clock="true", **options) as client:
        (path := folder / "local.yaml").write_text(ARM + DAMPED, encoding="utf-8")
        (own := folder / "inverse").mkdir()
        tuned = {"use_sim_time": "true", "cutoff": CUTOFF, **PATIENT}
        file = parameter_file(own, {"scene": path, **tuned})
        words = [*TARGET, "--ros-args", "--params-file", str(file)]
        node = NodeProcess([sys.executable, *words], domain)
        try:
            node.wait_for(ACTIVE)
            estimate = Estimate(client, load_scene(path))
            yield client, estimate
            estimate.end()
            assert node.stop() == 0
        finally:
            if node.process.poll() is None:
                node.process.kill()
                node.wait()


def test_inverse_dynamics_of_the_simulated_motion_gives_the_commands_back(domain, tmp_path):
    """Exact with the accelerations of the simulator, late by the filter with causal ones."""
    with estimated(domain, tmp_path, lock_step="true") as (client, estimate):
        client.settle()
        torques, motions = estimate.torques, client.motions
        torques.clear()
        motions.clear()
        for k in range(TICKS):  # an answer each, so that best effort loses nothing
            client.command(swinging(k * TICK))
            client.probe.spin_until(lambda k=k: len(motions) > k and answers(torques, motions[-1]))
    z = estimate.scene.couplings.v_index
    commanded = [motion.effort[z] for motion in motions]
    np.testing.assert_array_equal(commanded, [swinging(k * TICK) for k in range(TICKS)])
    samples = distinct([read_joint_state(m) for m in torques])
    assert len(samples) == len(motions) == TICKS
    compare(estimate, motions, samples)


def answers(torques, motion):
    """Whether the newest torques are those of this motion."""
    return bool(torques) and read_joint_state(torques[-1]).stamp == motion.stamp


def distinct(samples):
    """One answer a stamp: a state that waits for its command is shown and answered again."""
    by_stamp = {sample.stamp: sample for sample in samples}
    for sample in samples:
        np.testing.assert_array_equal(sample.effort, by_stamp[sample.stamp].effort)
    return list(by_stamp.values())


@pytest.mark.soak
@pytest.mark.parametrize("seconds", [20.0])
def test_the_same_in_real_time_whatever_is_lost_on_the_way(domain, tmp_path, seconds):
    """A free stream at 1 kHz: what counts is what the simulator says that acted at a stamp."""
    with estimated(domain, tmp_path) as (client, estimate):
        client.probe.spin_for(0.5)  # what was on its way when the simulation began anew is here
        for messages in (client.states, client.motions, estimate.torques):
            messages.clear()
        sent = streamed(client, seconds, 1000.0)
        client.probe.spin_for(0.2)
        states = {(s := client.sample(k)).stamp: s for k in range(len(client.states))}
        samples = [s for m in estimate.torques if (s := read_joint_state(m)).stamp in states]
    motions = client.motions
    assert min(map(len, (states, motions, samples))) > 0.5 * sent
    for motion in motions:  # the efforts of the joint states are those of the motions
        if motion.stamp in states:
            np.testing.assert_array_equal(states[motion.stamp].effort, motion.effort)
    same_as_in_one_process(estimate, states, samples)
    compare(estimate, motions, samples)


def same_as_in_one_process(estimate, states, samples):
    """An answer is that of the estimator, fed with the states that were answered."""
    scene = estimate.scene
    tuning = Tuning(cutoff=CUTOFF)
    estimator = TorqueEstimator(scene.robot, scene.inverse_dynamics(), tuning)
    settled = samples[0].stamp + round(1e9 * estimator.differentiator.settling_time) + 500 * MS
    everywhere, compared = np.ones(len(estimator.names), dtype=bool), 0
    names = [joint.name for joint in scene.robot.joints]
    order = [names.index(name) for name in estimator.names]
    for sample in samples:
        state = states[sample.stamp]
        x = estimator.observe(
            sample.stamp, state.position[order], state.velocity[order], everywhere
        )
        assert isinstance(x, Observation)
        expected = estimator.solve(x).tau
        if sample.stamp > settled:  # the past before the first one is forgotten
            np.testing.assert_allclose(sample.effort, expected, rtol=0, atol=1e-8)
            compared += 1
    assert compared > 0.5 * len(samples)


def compare(estimate, motions, samples):
    scene, delay = estimate.scene, estimate.delay
    inverse, z = scene.inverse_dynamics(), scene.couplings.v_index
    solved = [inverse.solve(m.position[z], m.velocity[z], m.acceleration[z]).tau for m in motions]
    commanded = np.array([motion.effort[z] for motion in motions])
    np.testing.assert_allclose(solved, commanded, rtol=0, atol=1e-6)

    at = {motion.stamp: motion for motion in motions}
    calm = since_calm(np.array([*at]), commanded)
    samples = [s for s in samples if calm.get(s.stamp, 0.0) > max(0.1, 6.0 * delay)]
    assert len(samples) >= 300
    estimated = np.array([s.effort for s in samples])

    def late(lag):
        """Torques with accelerations that are `lag` old [ms]."""
        rows = []
        for sample in samples:
            now, then = at[sample.stamp], at.get(sample.stamp - lag * MS)
            a = np.full(len(z), np.nan) if then is None else then.acceleration[z]
            rows.append(inverse.solve(now.position[z], now.velocity[z], a).tau)
        return np.array(rows)

    lags = range(0, round(2e3 * delay) + 1)
    errors = [np.nanstd((late(lag) - estimated)[:, 0]) for lag in lags]
    sys.stdout.write(
        f"stated {1e3 * delay:.3g} ms, found {np.argmin(errors)} ms, error {min(errors):.3g} N m, "
        f"without a lag {errors[0]:.3g} N m, {len(samples)} samples\n"
    )
    assert 1e-3 * int(np.argmin(errors)) == pytest.approx(delay, abs=max(2e-3, 0.1 * delay))
    assert min(errors) < 0.1 * errors[0], errors


def since_calm(stamps, commanded):
    """For how long every command has held two ticks at most, by stamp [s].

    A filter delays what is slow; a stream that stalls makes a step, which a filter smears.
    """
    fastest = np.array([12.0, 5.0, 0.014, 0.045])  # N·m/s, of `swinging`
    steps = np.abs(np.diff(commanded, axis=0)) > 2.0 * TICK * fastest
    disturbed = steps.any(axis=1) | (np.diff(stamps) != MS)
    last = np.maximum.accumulate(np.where(disturbed, stamps[1:], stamps[0]))
    return dict(zip(stamps[1:].tolist(), 1e-9 * (stamps[1:] - last), strict=True))
