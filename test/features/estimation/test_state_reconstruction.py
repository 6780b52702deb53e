"""Streams of samples that lack joints, jump, or go back in time; ROS-free."""

import numpy as np
import pytest
from state_projection import FOUR_BAR, LEG, projector

from mbd_ros.errors import SolveError
from mbd_ros.features.estimation.state_reconstruction import StateReconstructor
from mbd_ros.methods.inverse_dynamics.torque_estimator import Tuning
from mbd_ros.methods.projection.state_projection import ProjectedState
from mbd_ros.methods.signals.differentiation import SampleStatus

MS = 1_000_000  # ns
BEGIN = 5_000_000_000  # ns


class Stream:
    """Samples of a scene every 10 ms, and what becomes of them."""

    def __init__(self, name, **tuning):
        self.scene, ours = projector(name)
        self.reconstructor = StateReconstructor(
            ours, self.scene.couplings, self.scene.initial, Tuning(**tuning)
        )
        self.names, self.robot = self.reconstructor.names, self.scene.robot

    def row(self, name):
        return self.names.index(name)

    def observe(self, k, q, v=None, missing=(), stamp=None):
        """SampleStatus k without the joints named in `missing`; v None: no velocities at all."""
        present = np.array([name not in missing for name in self.names])
        q = np.where(present, q, np.nan)
        v = np.full(len(q), np.nan) if v is None else np.where(present, v, np.nan)
        stamp = BEGIN + k * 10 * MS if stamp is None else stamp
        return self.reconstructor.observe(stamp, q, v, present)


def swing(scene, k):
    """A consistent state of the leg at sample k."""
    t, couplings = 0.01 * k, scene.couplings
    q, v = np.zeros(5), np.zeros(5)
    q[couplings.q_index] = 0.3 + 0.1 * np.sin(t), -0.8 + 0.3 * np.sin(2 * t), 0.1 * np.cos(t)
    v[couplings.v_index] = 0.1 * np.cos(t), 0.6 * np.cos(2 * t), -0.1 * np.sin(t)
    couplings.expand(q, v, np.zeros(5))
    return q, v


@pytest.fixture
def leg():
    return Stream(LEG)


def assert_state(found, q, v, atol=1e-12):
    assert isinstance(found, ProjectedState)
    np.testing.assert_allclose(found.x.q, q, rtol=0, atol=atol)
    np.testing.assert_allclose(found.x.v, v, rtol=0, atol=atol)


# ---------------------------------------------------------------------- missing joints


@pytest.mark.parametrize("missing", [("knee_slide_x",), ("knee_slide_x", "knee_slide_y")])
def test_dependent_joints_follow_their_coupling_from_the_first_sample_on(leg, missing):
    for k in range(5):
        q, v = swing(leg.scene, k)
        assert_state(leg.observe(k, q, v, missing), q, v)
        assert (leg.reconstructor.missing, leg.reconstructor.held_joints) == (missing, ())


def test_a_dependent_position_that_is_not_finite_is_missing(leg):
    q, v = swing(leg.scene, 0)
    given = q.copy()
    given[leg.row("knee_slide_y")] = np.nan
    assert_state(leg.observe(0, given, v), q, v)
    assert leg.reconstructor.missing == ("knee_slide_y",)
    given[leg.row("knee")] = np.inf
    assert leg.observe(1, given, v) is SampleStatus.NOT_FINITE


@pytest.mark.parametrize("missing", ["knee_anterior", "knee_tibial", "knee_posterior"])
def test_a_joint_of_a_loop_stays_on_its_branch(missing):
    """Along a simulated swing that starts far from the initial state of the scene."""
    stream = Stream(FOUR_BAR)
    states = list(stream.scene.simulation(dt=0.01).run(stream.scene.initial, 0.5))[20:]
    assert np.abs(states[0].q - stream.scene.initial.q).max() > 0.3
    for k, x in enumerate(states):
        found = stream.observe(k, x.q, x.v, [missing])
        assert_state(found, x.q, x.v, atol=1e-8)
        assert (stream.reconstructor.missing, stream.reconstructor.held_joints) == ((missing,), ())


def test_what_nothing_determines_is_held_and_is_incomplete_when_it_is_too_old():
    stream = Stream(LEG, max_age=0.1)
    q0, v0 = swing(stream.scene, 0)
    ankle = stream.row("ankle")
    assert_state(stream.observe(0, q0, v0), q0, v0)
    for k in (5, 10):
        q, v = swing(stream.scene, k)
        found = stream.observe(k, q, v, ["ankle"])
        assert stream.reconstructor.held_joints == stream.reconstructor.missing == ("ankle",)
        assert found.x.q[ankle] == pytest.approx(q0[ankle], abs=1e-12)
        np.testing.assert_allclose(np.delete(found.x.q, ankle), np.delete(q, ankle), atol=1e-12)
    for k in (11, 12, 30):
        assert stream.observe(k, *swing(stream.scene, k), ["ankle"]) is SampleStatus.INCOMPLETE
        assert stream.reconstructor.held_joints == ("ankle",)
    q, v = swing(stream.scene, 31)
    assert_state(stream.observe(31, q, v), q, v)
    assert stream.reconstructor.held_joints == stream.reconstructor.missing == ()


def test_what_was_never_seen_is_incomplete(leg):
    q, v = swing(leg.scene, 0)
    assert leg.observe(0, q, v, ["ankle"]) is SampleStatus.INCOMPLETE
    assert isinstance(leg.observe(1, q, v), ProjectedState)
    assert isinstance(leg.observe(2, q, v, ["ankle"]), ProjectedState)
    leg.reconstructor.reset()
    assert leg.observe(3, q, v, ["ankle"]) is SampleStatus.INCOMPLETE


def test_velocities_that_are_not_measured_are_derived():
    stream = Stream(LEG, cutoff=20.0)
    for k in range(100):
        q, v = swing(stream.scene, 0.2 * k)
        found = stream.observe(k, q, None, stamp=BEGIN + k * 2 * MS)
        np.testing.assert_allclose(found.x.q, q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.x.v, v, rtol=0, atol=0.03)  # 24 ms of delay
    J = stream.reconstructor._projector.system.jacobian(0.0, found.x.q)
    assert np.abs(J @ found.x.v).max() <= 1e-12


# ---------------------------------------------------------------------- jumps and time


def test_a_jump_is_rejected_until_it_is_believed():
    stream = Stream(LEG, patience=3)
    q, v = swing(stream.scene, 0)
    assert_state(stream.observe(0, q, v), q, v)
    far = q.copy()
    far[stream.row("hip_flexion")] += 1.0
    for k in (1, 2):
        assert stream.observe(k, far, v) is SampleStatus.JUMP
    assert_state(stream.observe(3, q, v), q, v)
    for k in (4, 5):
        assert stream.observe(k, far, v) is SampleStatus.JUMP
    assert_state(stream.observe(6, far, v), far, v)


def test_a_jump_of_a_dependent_joint_is_a_violation(leg):
    q, v = swing(leg.scene, 0)
    leg.observe(0, q, v)
    far = q.copy()
    far[leg.row("knee_slide_y")] += 0.05
    found = leg.observe(1, far, v)
    assert found.gap[1] == pytest.approx(0.05)
    z = found.x.q[leg.scene.couplings.q_index]
    np.testing.assert_allclose(found.x.q, leg.scene.couplings.positions(z), rtol=0, atol=1e-12)


def test_the_past_is_old_and_the_far_past_a_new_beginning():
    stream = Stream(LEG, rewind=1.0)
    q, v = swing(stream.scene, 0)
    assert_state(stream.observe(10, q, v), q, v)
    assert stream.observe(5, q, v) is SampleStatus.OLD
    far = q.copy()
    far[stream.row("hip_flexion")] += 1.0  # no jump: time begins anew
    assert_state(stream.observe(-200, far, v), far, v)
    assert_state(stream.observe(-199, far, v), far, v)


def test_a_second_sample_of_one_stamp_is_projected_too(leg):
    q, v = swing(leg.scene, 0)
    leg.observe(0, q, v)
    assert_state(leg.observe(0, q, v), q, v)


def test_an_unsolved_sample_leaves_nothing_behind(leg):
    q, v = swing(leg.scene, 0)
    leg.observe(0, q, v)
    bad = np.array([1e308, -1e308, 1e308, 1e308, -1e308])
    with np.errstate(all="ignore"), pytest.raises(SolveError):
        leg.observe(1, q, bad)
    far = q.copy()
    far[leg.row("hip_flexion")] += 1.0
    assert leg.observe(2, far, v) is SampleStatus.JUMP
    assert_state(leg.observe(3, q, v), q, v)
