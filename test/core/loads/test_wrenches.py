"""External loads: where they act, in which axes, at what time."""

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.core.loads.external_loads import ExternalWrench, WrenchBuffer, at_stamps
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import WrenchSamples
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.scene.schema import schema

ARM = (ROOT / "config/robots/arm7.urdf").read_text(encoding="utf-8")
ROBOT = read_robot(ARM)
MS = 1_000_000
NOW = 1_760_000_000_123_456_789  # ns: beyond what a float holds exactly


def generalized(q, frame, expressed_in, point, wrench):
    """J' w with the wrench turned and moved to the world origin by hand."""
    model, data = ROBOT.model, ROBOT.model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    placement = data.oMf[model.getFrameId(expressed_in, pin.BODY)]
    force = placement.rotation @ wrench[:3]
    lever = placement.rotation @ point + placement.translation
    torque = placement.rotation @ wrench[3:] + np.cross(lever, force)
    J = pin.getFrameJacobian(model, data, model.getFrameId(frame, pin.BODY), pin.WORLD)
    return J.T @ np.r_[force, torque]


def load_torques(loads, q, values):
    """What loads change in the torques of a robot at rest."""
    inverse, zero = InverseDynamics(ROBOT, Couplings(ROBOT), loads), np.zeros(7)
    return inverse.solve(q, zero, zero, values).tau - inverse.solve(q, zero, zero).tau


@pytest.mark.parametrize("expressed_in", ["base", "link3", "link5", "flange"])
@pytest.mark.parametrize("frame", ["link2", "link5", "flange"])
@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.3)])
def test_load_equals_frame_jacobian_transposed_times_wrench(frame, expressed_in, point):
    rng = np.random.default_rng(6)
    load = ExternalWrench(ROBOT, frame=frame, expressed_in=expressed_in, point=point)
    for _ in range(5):
        q, w = rng.uniform(-2, 2, 7), rng.normal(size=6)
        expected = -generalized(q, frame, expressed_in, np.array(point), w)
        assert load_torques([load], q, [w]) == pytest.approx(expected, abs=1e-12)


def test_load_is_given_in_its_own_frame_by_default():
    q, w = np.random.default_rng(7).normal(size=7), np.arange(1.0, 7.0)
    own = load_torques([ExternalWrench(ROBOT, frame="link4")], q, [w])
    assert own == pytest.approx(-generalized(q, "link4", "link4", np.zeros(3), w), abs=1e-12)


def test_loads_on_one_body_add_up_and_one_on_the_base_does_nothing():
    q, w = np.random.default_rng(8).normal(size=7), np.random.default_rng(9).normal(size=(3, 6))
    loads = [
        ExternalWrench(ROBOT, frame="link7", expressed_in="base"),
        ExternalWrench(ROBOT, frame="base", expressed_in="link7"),
        ExternalWrench(ROBOT, frame="flange", point=(0, 0, 1)),
    ]
    expected = -generalized(q, "link7", "base", np.zeros(3), w[0])
    expected -= generalized(q, "flange", "flange", np.array([0, 0, 1]), w[2])
    assert load_torques(loads, q, list(w)) == pytest.approx(expected, abs=1e-12)
    assert np.array_equal(load_torques(loads[1:2], q, [w[1]]), np.zeros(7))


def test_load_does_not_outlive_its_call():
    load = ExternalWrench(ROBOT, frame="link7")
    inverse = InverseDynamics(ROBOT, Couplings(ROBOT), [load])
    q, zero, w = np.ones(7), np.zeros(7), np.ones(6)
    before = inverse.solve(q, zero, zero).tau
    loaded = inverse.solve(q, zero, zero, [w]).tau
    assert np.array_equal(inverse.solve(q, zero, zero).tau, before)
    assert np.array_equal(inverse.solve(q, zero, zero, [np.zeros(6)]).tau, before)
    assert np.array_equal(inverse.solve(q, zero, zero, [w]).tau, loaded)


def test_threshold_cuts_force_and_torque_at_the_norm_of_the_force():
    load = ExternalWrench(ROBOT, frame="link7", threshold=5.0)
    q, zero = np.ones(7), np.zeros(7)
    inverse = InverseDynamics(ROBOT, Couplings(ROBOT), [load])
    free = inverse.solve(q, zero, zero).tau
    for wrench, counts in (([3, 4, 0, 9, 9, 9], False), ([3, 4, 0.01, 9, 9, 9], True)):
        tau = inverse.solve(q, zero, zero, [np.array(wrench, dtype=float)]).tau
        assert np.array_equal(tau, free) != counts
    couple = np.array([0, 0, 0, 1.0, 2.0, 3.0])
    assert load_torques([ExternalWrench(ROBOT, frame="link7")], q, [couple]).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frame": "nose"}, "no frame 'nose'; the links are base, link1"),
        ({"frame": "link1", "expressed_in": "nose"}, "no frame 'nose'"),
        ({"frame": "link1", "threshold": -1.0}, ".threshold: -1 is out of range"),
        ({"frame": "link1", "point": [0.0, 1.0]}, ".point: expected 3 numbers, got [0.0, 1.0]"),
    ],
)
def test_load_that_cannot_be_is_refused(options, message):
    with pytest.raises(SceneError) as caught:
        schema.call(ExternalWrench, options, "here", ROBOT)
    assert message in str(caught.value)


@pytest.mark.parametrize("built", [0, 1, 2])
def test_number_of_wrenches_must_be_that_of_the_scene(built):
    """A load that nobody declared is never silently ignored."""
    loads = [ExternalWrench(ROBOT, frame="link7")] * built
    inverse, zero = InverseDynamics(ROBOT, Couplings(ROBOT), loads), np.zeros(7)
    for given in {0, 1, 2, 3} - {0, built}:
        message = f"got {given} wrenches, but the scene has {built}"
        with pytest.raises(ModelError, match=message):
            inverse.solve(zero, zero, zero, [np.ones(6)] * given)
        with pytest.raises(ModelError, match=message):
            inverse.batch(*[np.zeros((2, 7))] * 3, [np.ones((2, 6))] * given)


def filled(stamps, **options):
    buffer = WrenchBuffer(10 * MS, 1000 * MS, **options)
    for i, stamp in enumerate(stamps):
        buffer.add(stamp, np.full(6, float(i)))
    return buffer


@pytest.mark.parametrize("begin", [0, 10**12, NOW])
def test_wrench_between_samples_is_interpolated_and_then_held(begin):
    """Node and table read the same recording alike, also with stamps of this century."""
    steps = np.cumsum(np.random.default_rng(10).integers(1, 9 * MS, 40))
    stamps = begin + steps
    values = np.random.default_rng(11).normal(scale=300.0, size=(40, 6))
    buffer = WrenchBuffer(10 * MS, 1000 * MS)
    for stamp, value in zip(stamps.tolist(), values, strict=True):
        assert buffer.add(stamp, value)
    asked = np.sort(begin + np.random.default_rng(12).integers(-5 * MS, steps[-1] + 30 * MS, 300))
    asked = np.r_[asked, stamps, stamps[-1] + 10 * MS, stamps[-1] + 10 * MS + 1]
    table = at_stamps(WrenchSamples(stamps, values), asked, 10 * MS)
    for stamp, row in zip(asked.tolist(), table, strict=True):
        held = buffer.at(stamp)
        assert np.isnan(row).all() if held is None else row == pytest.approx(held, abs=1e-9)
        assert buffer.covers(stamp) == (stamp <= stamps[-1])
    assert np.array_equal(table[300:340], values)
    assert np.isnan(table[-1]).all()
    assert np.array_equal(table[-2], values[-1])


def test_old_and_repeated_samples_are_refused_and_a_rewind_begins_anew():
    buffer = filled([5000 * MS, 5010 * MS])
    for stamp in (5010, 5005, 4010):
        assert not buffer.add(stamp * MS, np.ones(6))
    assert buffer.add(4009 * MS, np.ones(6))
    assert buffer.at(5000 * MS) is None
    assert buffer.at(4009 * MS)[0] == 1.0
    buffer.clear()
    assert buffer.at(4009 * MS) is None
    assert not buffer.covers(0)


def test_buffer_keeps_a_bounded_number_of_samples():
    buffer = filled(range(0, 1000 * MS, MS), length=16)
    assert buffer.at(983 * MS) is None
    assert buffer.at(984 * MS)[0] == 984.0
