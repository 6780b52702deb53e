"""The recursive estimate of a payload, sample by sample at several rates."""

import numpy as np
import pinocchio as pin
import pytest
from identification_data import fourier

from mbd_ros.api import load_scene
from mbd_ros.core.model.inertial_parameters import is_consistent
from mbd_ros.errors import SolveError
from mbd_ros.features.identification.payload.recursive import RecursivePayload

HELD = pin.Inertia(1.7, np.array([0.01, -0.02, 0.09]), np.diag([0.004, 0.005, 0.003]))


def estimator(scene, **changes):
    options = {"cutoff": 5.0, "memory": 10.0, "mass": 10.0, "size": 0.2, **changes}
    return RecursivePayload(scene.robot, scene.inverse_dynamics(), "flange", **options)


def fed(found, scene, t, motion, noise=0.0, begin=0):
    """The estimator after samples of a robot that holds something."""
    random = np.random.default_rng(4)
    given = scene.robot.inertias()
    true = scene.with_inertias({"flange": given["flange"] + HELD})
    tau = true.inverse_dynamics().batch(*motion, []).tau
    tau = tau + noise * random.normal(size=tau.shape)
    for stamp, position, effort in zip(t, motion[0], tau, strict=True):
        found.update(begin + round(stamp * 1e9), position, effort)
    return found


@pytest.mark.parametrize(
    ("rate", "noise", "off"),
    [(1000.0, 0.5, 0.05), (500.0, 0.3, 0.05), (100.0, 0.1, 0.05), (30.0, 0.1, 0.1)],
)
def test_a_payload_is_found_at_any_rate(rate, noise, off):
    """At 30 Hz a filter of 5 Hz sees straight lines between samples where there are curves."""
    scene, t = load_scene("arm7"), np.arange(0.0, 12.0, 1.0 / rate)
    motion = fourier(7, t, 1, frequency=0.15, amplitude=0.4)
    found = fed(estimator(scene), scene, t, motion, noise)
    assert found.numbers[0] == pytest.approx(1.7, abs=off)
    assert found.body[1:4] / found.body[0] == pytest.approx(HELD.lever, abs=0.2 * off)
    sigma = np.sqrt(found.covariance[0, 0])
    assert 1e-4 < sigma < 0.05
    assert found.is_determined[:4].all()


def test_a_robot_at_rest_shows_no_inertia_and_says_so():
    scene, t = load_scene("arm7"), np.arange(0.0, 6.0, 0.01)
    posture = np.tile([0.1, 0.7, 0.2, 1.0, 0.3, 0.5, 0.1], (len(t), 1))
    still = posture, 0.0 * posture, 0.0 * posture
    found = fed(estimator(scene), scene, t, still, 0.05)
    assert not found.is_determined[4:].any()
    assert is_consistent(found.body)
    assert np.isfinite(found.covariance).all()


def test_what_was_held_before_is_forgotten():
    scene, t = load_scene("arm7"), np.arange(0.0, 10.0, 0.01)
    motion = fourier(7, t, 1, frequency=0.15, amplitude=0.4)
    found = fed(estimator(scene, memory=1.0), scene, t, motion, 0.05)
    assert found.numbers[0] == pytest.approx(1.7, abs=0.05)
    empty = scene.inverse_dynamics().batch(*motion, []).tau
    for stamp, position, effort in zip(t, motion[0], empty, strict=True):
        found.update(10_000_000_000 + round(stamp * 1e9), position, effort)
    assert found.numbers[0] == pytest.approx(0.0, abs=0.05)
    assert is_consistent(found.body)


def test_what_is_too_large_for_an_estimate_is_refused_and_changes_nothing():
    scene, t = load_scene("arm7"), np.arange(0.0, 3.0, 0.01)
    found = fed(estimator(scene), scene, t, fourier(7, t, 1, frequency=0.15, amplitude=0.4))
    numbers, updates = found.numbers.copy(), found.updates
    with np.errstate(over="ignore"), pytest.raises(SolveError, match="too large for an estimate"):
        found.update(round(4e9), np.full(7, 0.1), np.full(7, 1e200))
    assert found.updates == updates
    assert np.array_equal(found.numbers, numbers)
