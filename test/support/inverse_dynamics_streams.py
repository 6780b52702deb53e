"""Cases that several tests share: inverse dynamics streams."""

import numpy as np
from nodes.joint_stream import MS

from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, TorqueEstimator, Tuning
from msg_adapters.time import read_time


def motion(count, size, seed=7):
    """A smooth motion with jittering stamps: offsets [ns], position, velocity."""
    random = np.random.default_rng(seed)
    offsets = np.cumsum(random.integers(2 * MS, 9 * MS, count))
    t = offsets[:, None] * 1e-9
    w = 2 * np.pi * random.uniform(0.3, 1.0, size)
    reach = random.uniform(0.05, 0.2, size)
    return offsets, 0.3 + reach * np.sin(w * t), reach * w * np.cos(w * t)


def play(stream, offsets, message):
    """Answers to `message(i, stamp)` for every offset, one at a time from empty filters."""
    stream.reset()
    begin = stream.begin
    for i, offset in enumerate(offsets.tolist()):
        stream.publish(message(i, begin + offset))
        stream.answers(i + 1)
    stamps = [read_time(answer.header.stamp) - begin for answer in stream.torques]
    assert stamps == offsets.tolist()
    if stream.scene.couplings.dependent:
        stream.probe.spin_until(lambda: len(stream.forces) == len(stream.torques))
    return efforts(stream.torques), efforts(stream.forces)


def efforts(messages):
    """Efforts of messages as one array."""
    return np.array([message.effort for message in messages])


def offline(scene, offsets, position, velocity, tuning=None):
    """What the estimator gives for the same samples in one process."""
    estimator = TorqueEstimator(scene.robot, scene.inverse_dynamics(), tuning or Tuning())
    n, everywhere = len(scene.couplings.dependent), np.ones(len(estimator.names), dtype=bool)
    everywhere[len(everywhere) - n :] = False
    tau, multipliers = [], []
    for offset, q, v in zip(offsets.tolist(), position, velocity, strict=True):
        absent = np.full(n, np.nan)
        x = estimator.observe(offset, np.r_[q, absent], np.r_[v, absent], everywhere)
        assert isinstance(x, Observation)
        torques = estimator.solve(x)
        tau.append(torques.tau.copy())
        multipliers.append(torques.multipliers.copy())
    return np.array(tau), np.array(multipliers)
