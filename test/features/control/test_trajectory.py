"""Trajectories and guides: smooth, within limits, and exactly where they were told to be."""

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import double_pendulum
from systems import free_system

from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.features.control.reference import ReferenceGenerator
from mbd_ros.features.control.trajectory import ReferenceTrajectory, TargetError
from mbd_ros.methods.control.contract import ControlledJoints, Reference

TIMES = np.array([0.0, 0.4, 1.0, 1.1])
Q = np.array([[0.0, 1.0], [0.5, -1.0], [0.2, 0.0], [0.1, 0.3]])
V = np.array([[0.0, 0.1], [0.5, -0.4], [-0.2, 0.0], [0.1, 0.3]])
A = np.array([[1.0, 0.1], [0.0, -0.4], [-0.2, 2.0], [0.0, 0.3]])
H = 1e-5


def derivatives(trajectory, t):
    """Central differences of position [per s, per s^2]."""
    before, now, after = (trajectory.at(t + k * H).q for k in (-1, 0, 1))
    return (after - before) / (2 * H), (after - 2 * now + before) / H**2


@pytest.mark.parametrize(("v", "a"), [(None, None), (V, None), (V, A)])
def test_a_course_passes_its_points_with_true_derivatives(v, a):
    trajectory = ReferenceTrajectory(TIMES, Q, v, a)
    for k, t in enumerate(TIMES[:-1]):
        ref = trajectory.at(t)
        np.testing.assert_allclose(ref.q, Q[k], atol=1e-14)
        if v is not None:
            np.testing.assert_allclose(ref.v, v[k], atol=1e-13)
        if a is not None:
            np.testing.assert_allclose(ref.a, a[k], atol=1e-11)
    for t in (0.1, 0.39, 0.7, 1.05):
        rate, curvature = derivatives(trajectory, t)
        np.testing.assert_allclose(trajectory.at(t).v, rate, atol=1e-8)
        np.testing.assert_allclose(trajectory.at(t).a, curvature, atol=2e-4)
    np.testing.assert_array_equal(trajectory.at(-1.0).q, Q[0])
    np.testing.assert_array_equal(trajectory.at(9.0).q, Q[-1])
    assert not trajectory.at(9.0).v.any()


@pytest.mark.parametrize(("v", "a"), [(None, None), (V, None), (V, A)])
@pytest.mark.parametrize("count", [1, len(TIMES)])
def test_the_samples_of_a_course_are_on_it(v, a, count):
    parts = [part if part is None else part[:count] for part in (Q, v, a)]
    trajectory = ReferenceTrajectory(TIMES[:count], *parts)
    times, q, v = trajectory.samples()
    found = [trajectory.at(float(t)) for t in times]
    np.testing.assert_allclose(q, [ref.q for ref in found], atol=1e-12)
    np.testing.assert_allclose(v, [ref.v for ref in found], atol=1e-11)


def test_a_course_between_points_has_no_jumps():
    """Velocity everywhere; acceleration too where the points give it."""
    for v, a, fields in ((V, A, 3), (V, None, 2), (None, None, 2)):
        trajectory = ReferenceTrajectory(TIMES, Q, v, a)
        for t in TIMES[1:-1]:
            for field in range(fields):
                before, after = trajectory.at(t - 1e-12)[field], trajectory.at(t + 1e-12)[field]
                np.testing.assert_allclose(before, after, atol=1e-6)


# ---------------------------------------------------------------------- generator


@pytest.fixture
def joints():
    """Two joints from -99 to 99, at most 10/s."""
    robot = read_robot(double_pendulum())
    return ControlledJoints(free_system(robot), ["joint_1", "joint_2"])


def smooth(generator, begin, end, step=1e-3):
    """Asserts that position and velocity never jump, and that velocity is the slope."""
    times = np.arange(begin, end, step)
    refs = [generator.at(t) for t in times]
    q, v = np.array([ref.q for ref in refs]), np.array([ref.v for ref in refs])
    a = np.abs([ref.a for ref in refs]).max()
    np.testing.assert_allclose(np.diff(q, axis=0), 0.5 * step * (v[1:] + v[:-1]), atol=a * step**2)
    return q, v


def test_a_moving_joint_comes_to_rest_where_it_was_measured(joints):
    generator = ReferenceGenerator(joints)
    q, v = np.array([0.3, -0.2]), np.array([1.0, 0.0])
    generator.hold(2.0, q, v)
    np.testing.assert_allclose(generator.at(2.0).v, v, atol=1e-12)
    positions, _ = smooth(generator, 2.0, 3.0)
    np.testing.assert_allclose(positions[-1], q, atol=1e-12)
    assert np.abs(positions - q).max() < 0.2


def test_a_stream_of_targets_is_reached_one_interval_later(joints):
    """A sine at 50 Hz; what is followed is the sine of 20 ms ago."""
    generator = ReferenceGenerator(joints, ramp=0.05)
    generator.hold(0.0, np.zeros(2), np.zeros(2))
    wave = lambda t: Reference(  # noqa: E731
        np.sin([3 * t, 2 * t]), np.array([3, 2]) * np.cos([3 * t, 2 * t]), np.zeros(2)
    )
    worst = 0.0
    for k in range(1, 100):
        t = 0.02 * k
        generator.aim(t, wave(t))
        smooth(generator, t, t + 0.02)
        for part in (0.0, 0.25, 0.5, 0.99):
            if k > 10:
                off = generator.at(t + 0.02 * part).q - wave(t - 0.02 + 0.02 * part).q
                worst = max(worst, np.abs(off).max())
    assert worst < 1e-3
    assert generator.state(t) == "target"
    ends = generator.at(t + 5.0)
    assert not ends.v.any()
    assert "held" in generator.state(t + 5.0)
    np.testing.assert_allclose(ends.q, wave(t).q + 0.25 * wave(t).v, atol=1e-12)


def test_a_step_is_a_ramp_within_its_share_of_the_speed_limit(joints):
    generator = ReferenceGenerator(joints, ramp=0.1, ramp_speed=0.5)
    generator.hold(0.0, np.zeros(2), np.zeros(2))
    generator.aim(0.0, Reference(np.array([3.0, -0.1]), np.zeros(2), np.zeros(2)))
    q, v = smooth(generator, 0.0, 3.0)
    assert np.abs(v).max() == pytest.approx(5.0, rel=1e-3)  # half of 10/s
    np.testing.assert_allclose(q[-1], [3.0, -0.1], atol=1e-12)


def test_a_trajectory_that_begins_elsewhere_is_joined_without_a_jump(joints):
    generator = ReferenceGenerator(joints, ramp=0.2)
    generator.hold(0.0, np.array([1.0, 1.0]), np.zeros(2))
    generator.follow(0.0, TIMES, Q, V, A)  # begins now, at (0, 1)
    np.testing.assert_allclose(generator.at(0.0).q, [1.0, 1.0], atol=1e-13)
    smooth(generator, 0.0, 1.5)
    trajectory = ReferenceTrajectory(TIMES, Q, V, A)
    for t in (0.5, 0.9, 1.05):
        np.testing.assert_allclose(generator.at(t).q, trajectory.at(t).q, atol=1e-12)
    generator.follow(0.7, TIMES + 1.0, Q)  # begins later: goes there from where the reference is
    smooth(generator, 0.7, 3.0)
    np.testing.assert_allclose(generator.at(1.4).q, Q[1], atol=1e-12)
    assert generator.state(1.4) == "trajectory"
    assert "held" in generator.state(9.0)


def test_after_a_break_the_reference_begins_where_the_joints_are(joints):
    generator = ReferenceGenerator(joints)
    generator.follow(0.0, TIMES, Q, V)
    measured = np.array([0.4, 0.4]), np.array([0.1, -0.1])
    generator.resume(0.5, *measured)
    for given, expected in zip(generator.at(0.5)[:2], measured, strict=True):
        np.testing.assert_allclose(given, expected, atol=1e-12)
    smooth(generator, 0.5, 2.0)
    np.testing.assert_allclose(
        generator.at(1.05).q, ReferenceTrajectory(TIMES, Q, V).at(1.05).q, atol=1e-12
    )


@pytest.mark.parametrize(
    ("q", "v", "message"),
    [
        ([100.0, 0.0], [0.0, 0.0], r"joint_1 at 100 .*accepted: -99 to 99"),
        ([0.0, 0.0], [0.0, -11.0], r"joint_2 at -11/s .*accepted: up to 10/s"),
        ([0.0, np.nan], [0.0, 0.0], "not finite"),
    ],
)
def test_a_target_beyond_limits_is_refused_and_changes_nothing(joints, q, v, message):
    generator = ReferenceGenerator(joints)
    generator.hold(0.0, np.ones(2), np.zeros(2))
    with pytest.raises(TargetError, match=message):
        generator.aim(1.0, Reference(np.array(q), np.array(v), np.zeros(2)))
    np.testing.assert_array_equal(generator.at(2.0).q, [1.0, 1.0])


def test_a_trajectory_that_leaves_the_limits_between_its_points_is_refused(joints):
    generator, times = ReferenceGenerator(joints), np.array([0.0, 10.0])
    q, v = np.array([[98.0, 0.0], [98.0, 0.0]]), np.array([[9.0, 0.0], [-9.0, 0.0]])
    with pytest.raises(TargetError, match=r"joint_1 at .* at t = .*accepted: -99 to 99"):
        generator.follow(0.0, times, q, v)
    with pytest.raises(TargetError, match="must increase"):
        generator.follow(0.0, times[::-1], q)
    with pytest.raises(TargetError, match=r"ended 1\.000 s ago"):
        generator.follow(11.0, times, q)
    assert generator.state(0.0) == "held"


# ---------------------------------------------------------------------- limits on the way


@pytest.fixture
def narrow(joints):
    """The same joints from -1 to 1, at most 3/s."""
    limited = [replace(j, lower=-1.0, upper=1.0, max_velocity=3.0) for j in joints.joints]
    joints.joints = tuple(limited)
    return joints


def extent(generator, begin, end):
    """Largest position and velocity of a reference."""
    refs = [generator.at(t) for t in np.arange(begin, end, 1e-3)]
    return np.abs([ref.q for ref in refs]).max(), np.abs([ref.v for ref in refs]).max()


@pytest.mark.parametrize("distance", [0.06, 0.4])
@pytest.mark.parametrize("after", [0.001, 0.01, 0.05, 0.1])
def test_a_trajectory_that_begins_too_soon_is_ramped_to(narrow, distance, after):
    """One point from rest; what is within the limits is there in time, nothing swings."""
    generator = ReferenceGenerator(narrow)
    generator.hold(0.0, np.full(2, 0.5), np.zeros(2))
    generator.follow(0.0, np.array([after]), np.full((1, 2), 0.5 + distance))
    q, v = smooth(generator, 0.0, 3.0)
    assert (q > 0.5 - 1e-12).all()
    assert (q < 0.5 + distance + 1e-12).all()
    assert np.abs(v).max() <= 3.0
    in_time = 1.5 * distance / after <= 3.0  # peak of a cubic from rest to rest
    assert np.allclose(generator.at(after).q, 0.5 + distance) == in_time


def test_noise_of_a_stream_does_not_swing_what_comes_after(narrow):
    noise = np.random.default_rng(2)
    generator = ReferenceGenerator(narrow)
    generator.hold(0.0, np.zeros(2), np.zeros(2))
    t = 0.0
    for _ in range(400):
        t += noise.uniform(4e-3, 8e-3)
        generator.aim(t, Reference(noise.normal(0.0, 1e-3, 2), np.zeros(2), np.zeros(2)))
    generator.aim(t + 5e-3, Reference(np.full(2, 0.4), np.zeros(2), np.zeros(2)))
    positions = np.array([generator.at(time).q for time in np.arange(t, t + 3.0, 1e-3)])
    assert positions.min() > -0.1
    assert positions.max() < 0.5


def test_no_target_takes_the_reference_beyond_a_position_limit(narrow):
    noise, t = np.random.default_rng(3), 0.0
    generator = ReferenceGenerator(narrow)
    generator.hold(0.0, np.array([0.95, 0.0]), np.array([3.0, 0.0]))
    assert extent(generator, 0.0, 2.0)[0] <= 1.0
    for _ in range(100):
        t += noise.choice([0.01, 0.3, 1.0])
        q, v = noise.uniform(-1.0, 1.0, 2), noise.uniform(-3.0, 3.0, 2)
        generator.aim(t, Reference(q, v, np.zeros(2)))
        assert extent(generator, t, t + 2.0)[0] <= 1.0


def test_a_measured_state_beyond_a_limit_is_held_there(narrow):
    generator = ReferenceGenerator(narrow)
    generator.hold(0.0, np.array([1.02, 0.0]), np.zeros(2))
    np.testing.assert_array_equal(generator.at(1.0).q, [1.02, 0.0])


def test_another_guide_goes_on_beyond_a_limit(narrow):
    generator, other = ReferenceGenerator(narrow), ReferenceGenerator(narrow)
    generator.hold(0.0, np.array([1.02, 0.0]), np.zeros(2))
    other.take_over(0.5, generator)
    np.testing.assert_array_equal(other.at(1.0).q, [1.02, 0.0])


def test_two_targets_at_once_are_the_second_one(joints):
    """What comes between two joint states must not break the stream that it belongs to."""
    generator, other = ReferenceGenerator(joints), ReferenceGenerator(joints)
    for one in (generator, other):
        one.hold(0.0, np.zeros(2), np.zeros(2))
    for k in range(1, 50):
        target = Reference(np.full(2, 0.01 * k), np.full(2, 0.5), np.zeros(2))
        generator.aim(0.02 * k, target)
        generator.aim(0.02 * k, target)
        other.aim(0.02 * k, target)
    np.testing.assert_allclose(generator.at(0.995).q, other.at(0.995).q, atol=1e-12)


def test_a_trajectory_of_another_clock_is_refused(joints):
    generator = ReferenceGenerator(joints)
    with pytest.raises(TargetError, match=r"begins in 1\.7e\+09 s, .* 3600 s; .*use_sim_time"):
        generator.follow(0.0, np.array([1.7e9]), np.zeros((1, 2)))
