"""Streams of joint samples with everything that happens to them (faults 3, 5-11, 13, 14)."""

import numpy as np
import pytest
from places import ROOT

from mbd_ros.core.model.coupling_functions import Polynomial
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, TorqueEstimator, Tuning
from mbd_ros.methods.signals.differentiation import SampleStatus

MS = 1_000_000
ARM = (ROOT / "config/robots/prosthetic_arm.urdf").read_text(encoding="utf-8")
ELBOW = {"elbow": Coupling("shoulder_flexion", Polynomial([0.2, 1.75]))}
RATE = np.array([0.3, -0.2, 0.5, 0.1])
ALL = np.ones(5, dtype=bool)


def estimator(**tuning):
    """Four independent joints, then the elbow."""
    robot = read_robot(ARM)
    inverse = InverseDynamics(robot, Couplings(robot, ELBOW))
    return TorqueEstimator(robot, inverse, Tuning(**tuning))


def sample(t, lacking=(), offset=0.0):
    """A motion at constant speed; joints of `lacking` are absent."""
    z = RATE * t / 1000 + 0.1
    position = np.r_[z, 0.2 + 1.75 * z[0] + offset]
    present = ALL.copy()
    present[list(lacking)] = False
    return t * MS, np.where(present, position, np.nan), np.full(5, np.nan), present


def test_names_are_the_independent_joints_then_the_dependent_ones():
    names = estimator().names
    assert names[-1] == "elbow"
    assert len(names) == 5


def test_torques_are_those_of_the_solver_at_the_filtered_motion():
    e = estimator()
    for t in range(0, 100, 5):
        x = e.observe(*sample(t))
    assert isinstance(x, Observation)
    assert x.velocity == pytest.approx(RATE, abs=1e-9)
    robot = read_robot(ARM)
    solver = InverseDynamics(robot, Couplings(robot, ELBOW))
    expected = solver.solve(x.position, x.velocity, x.acceleration)
    torques = e.solve(x)
    assert np.array_equal(torques.tau, expected.tau)
    assert np.array_equal(torques.multipliers, expected.multipliers)


@pytest.mark.parametrize(("offset", "expected"), [(0.0, 0.0), (0.07, 0.07), (np.nan, 0.0)])
def test_distance_of_a_dependent_joint_from_its_coupling(offset, expected):
    """Absent is reconstructed, present is compared; the torques never differ."""
    e, reference = estimator(), estimator()
    x = e.observe(*sample(0, offset=offset))
    tau = e.solve(x).tau
    assert e.violation(x) == pytest.approx([expected], abs=1e-12)
    assert np.array_equal(tau, reference.solve(reference.observe(*sample(0))).tau)


def test_position_that_is_not_finite_drops_the_sample():
    e = estimator()
    e.observe(*sample(0))
    for bad in (np.nan, np.inf, -np.inf):
        stamp, position, velocity, present = sample(5)
        position[2] = bad
        assert e.observe(stamp, position, velocity, present) is SampleStatus.NOT_FINITE
    assert e.observe(*sample(5)).velocity == pytest.approx(RATE, abs=1e-6)


def test_missing_joint_is_held_for_max_age_and_then_the_sample_is_incomplete():
    e = estimator(max_age=0.02)
    assert e.observe(*sample(0, lacking=[1])) is SampleStatus.INCOMPLETE
    assert isinstance(e.observe(*sample(10)), Observation)
    for t in (20, 30):
        x = e.observe(*sample(t, lacking=[1]))
        assert x.position[1] == sample(10)[1][1]
        assert x.position[0] == sample(t)[1][0]
    assert e.observe(*sample(40, lacking=[1])) is SampleStatus.INCOMPLETE
    assert isinstance(e.observe(*sample(50)), Observation)
    assert isinstance(e.observe(*sample(60, lacking=[0, 1, 2, 3])), Observation)


def test_two_publishers_with_half_of_the_joints_each_make_a_whole():
    e = estimator(max_age=0.02)
    assert e.observe(*sample(0, lacking=[0, 1])) is SampleStatus.INCOMPLETE
    for t in range(5, 200, 5):
        x = e.observe(*sample(t, lacking=[2, 3] if t % 10 else [0, 1]))
        assert isinstance(x, Observation)
        assert x.position == pytest.approx(sample(t)[1][:4], abs=0.5 * 0.005 + 1e-12)


def test_no_position_of_the_past_survives_a_rewind():
    """A looping bag: what was seen at 50 s is not younger than what comes at 1 s."""
    e = estimator(max_age=0.02)
    e.observe(*sample(49_990))
    assert isinstance(e.observe(*sample(50_000, lacking=[1])), Observation)
    assert e.observe(*sample(1000, lacking=[1])) is SampleStatus.INCOMPLETE
    assert e.observe(*sample(1010, lacking=[1])) is SampleStatus.INCOMPLETE
    assert isinstance(e.observe(*sample(1020)), Observation)
    x = e.observe(*sample(1030, lacking=[1]))
    assert x.position[1] == sample(1020)[1][1]
    assert e.observe(*sample(1050, lacking=[1])) is SampleStatus.INCOMPLETE


def test_rejected_spike_is_not_what_a_missing_joint_is_held_at():
    e = estimator()
    for t in (0, 5):
        e.observe(*sample(t))
    stamp, position, velocity, present = sample(10)
    position[1] += 3.0
    assert e.observe(stamp, position, velocity, present) is SampleStatus.JUMP
    x = e.observe(*sample(15, lacking=[1]))
    assert isinstance(x, Observation)
    assert x.position[1] == sample(5)[1][1]


@pytest.mark.parametrize(
    ("t", "outcome"),
    [(99, SampleStatus.OLD), (100, None), (-899, SampleStatus.OLD), (-901, None)],
)
def test_stamps_that_do_not_increase(t, outcome):
    """An old sample is dropped, a repeated stamp changes no derivative, a rewind starts anew."""
    e = estimator(rewind=1.0)
    for now in range(0, 101, 5):
        before = e.observe(*sample(now))
    x = e.observe(*sample(t))
    if outcome:
        assert x is outcome
        return
    assert np.isfinite(e.solve(x).tau).all()
    expected = before.velocity if t == 100 else np.zeros(4)
    assert np.array_equal(x.velocity, expected)


def test_torques_that_are_not_finite_restart_the_filters():
    e = estimator()
    x = e.observe(*sample(0))
    assert e.solve(x._replace(acceleration=np.full(4, np.nan))) is None
    stamp, position, _, present = sample(5)
    again = e.observe(stamp, position, np.array([1.0, np.nan, 2.0, 3.0, 4.0]), present)
    assert np.array_equal(again.velocity, [1.0, 0.0, 2.0, 3.0])
    assert np.array_equal(again.acceleration, np.zeros(4))


def measured(k):
    """A sample with velocities of all joints."""
    stamp, position, velocity, present = sample(k)
    return stamp, position, np.linspace(0.1, 0.2, len(velocity)) * k, present


@pytest.mark.parametrize("bad", [1e200, -1e308])
def test_a_sample_without_torques_leaves_nothing_behind(bad):
    """The next ones are answered to the bit as by an estimator that never saw it."""
    seen, spared = estimator(), estimator()
    for k in range(6):
        for e in (seen, spared):
            e.solve(e.observe(*measured(k)))
        stamp, position, velocity, present = measured(k)
        with np.errstate(all="ignore"):
            lost = seen.observe(stamp + 1000, position, np.full_like(velocity, bad), present)
            assert seen.solve(lost) is None
    one, other = (e.solve(e.observe(*measured(6))) for e in (seen, spared))
    np.testing.assert_array_equal(one.tau, other.tau)
    np.testing.assert_array_equal(one.multipliers, other.multipliers)


def test_new_tuning_takes_effect_at_once():
    e = estimator(cutoff=5.0)
    slow = e.differentiator.delay
    e.tune(Tuning(cutoff=50.0))
    assert e.differentiator.delay == pytest.approx(slow / 10)
    assert isinstance(e.observe(*sample(0)), Observation)


def test_two_publishers_whose_stamps_differ_by_microseconds_both_count():
    """A joint moves as far as the time since its own last sample allows.

    Between its messages it is held: steps of 10 ms, which the 5 Hz filters smooth to 5 %.
    """
    e, whole = estimator(), estimator()
    for t in range(0, 400, 10):
        stamp, position, velocity, present = sample(t)
        expected = whole.observe(stamp, position, velocity, present)
        first, second = np.zeros_like(present), present.copy()
        first[0], second[0] = True, False
        e.observe(stamp, position, velocity, first)
        late = e.observe(stamp + 20_000, position, velocity, second)
        if t > 100:
            assert isinstance(late, Observation)
            assert late.position == pytest.approx(expected.position, abs=1e-12)
            assert late.velocity == pytest.approx(expected.velocity, rel=0.06)
