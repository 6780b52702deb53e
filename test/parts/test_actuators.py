"""Actuators against their closed forms and by the power that they pass on."""

import math

import numpy as np
import pinocchio as pin
import pytest
from actuators import FIXED, FREE

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError
from mbd_ros.parts.actuators.geared_motor import GearedMotor
from mbd_ros.parts.actuators.ideal import Ideal
from mbd_ros.parts.actuators.series_elastic import SeriesElastic
from mbd_ros.scene.schema import schema

every_base = pytest.mark.parametrize("robot", [FIXED, FREE], ids=["fixed", "floating"])


def torque(part, u, q=0.0, v=0.0, robot=FIXED):
    """Torque of a one-joint part; all other coordinates must stay free of it."""
    model = robot.model
    x = State(0.0, pin.neutral(model), np.zeros(model.nv))
    x.q[part.joint.q], x.v[part.joint.v] = q, v
    tau = part.force(Kinematics, x, np.array([u]))
    assert tau.shape == (model.nv,)
    assert not np.delete(tau, part.joint.v).any()
    return tau[part.joint.v]


@every_base
def test_ideal_motors_give_what_is_asked_up_to_their_limit(robot):
    x = State(0.0, pin.neutral(robot.model), np.ones(robot.model.nv))
    u = np.array([30.0, -250.0])
    for limit, expected in ((math.inf, u), (100.0, [30.0, -100.0])):
        part = Ideal(robot, joints=["ankle", "hip_flexion"], limit=limit)
        assert part.joints == ("ankle", "hip_flexion")
        tau = part.force(Kinematics, x, u)
        where = [robot.joint(name).v for name in part.joints]
        assert np.array_equal(tau[where], expected)
        assert not np.delete(tau, where).any()
        assert not np.any(part.armature())
    assert u.tolist() == [30.0, -250.0]


@every_base
@pytest.mark.parametrize("ratio", [50.0, -50.0])
def test_lossless_gear_keeps_the_power_of_the_motor(ratio, robot):
    part = GearedMotor(robot, joint="knee", ratio=ratio)
    for u, v in ((0.3, 2.0), (-0.3, 2.0), (0.3, -2.0), (0.3, 0.0)):
        assert torque(part, u, v=v, robot=robot) * v == pytest.approx(u * ratio * v, rel=1e-14)


@pytest.mark.parametrize("ratio", [50.0, -50.0])
@pytest.mark.parametrize(("sign", "share"), [(1.0, 0.8), (-1.0, 1 / 0.8)])
def test_gear_takes_its_share_from_the_side_that_drives(sign, share, ratio):
    """Far above the smoothing velocity (tanh(200) is 1 in double precision)."""
    part = GearedMotor(FIXED, joint="knee", ratio=ratio, efficiency=0.8)
    for u in (0.3, -0.3):
        v = sign * math.copysign(2.0, u * ratio)
        assert torque(part, u, v=v) == pytest.approx(ratio * u * share, rel=1e-14)


@pytest.mark.parametrize("ratio", [50.0, -50.0])
def test_gear_and_its_friction_never_give_power(ratio):
    part = GearedMotor(FIXED, joint="knee", ratio=ratio, efficiency=0.6, viscous=1e-4)
    u, v = np.random.default_rng(0).normal(size=(2, 200)) * np.array([[1.0], [0.05]])
    loss = [a * ratio * b - torque(part, a, v=b) * b for a, b in zip(u, v, strict=True)]
    assert min(loss) > 0.0


def test_gear_is_lossless_at_rest_and_continuous_around_it():
    part = GearedMotor(FIXED, joint="knee", ratio=50.0, efficiency=0.8, smoothing=0.01)
    assert torque(part, 0.3) == pytest.approx(15.0, rel=1e-15)
    at_smoothing = 15.0 * 0.8 ** math.tanh(1.0)
    assert torque(part, 0.3, v=0.01) == pytest.approx(at_smoothing, rel=1e-14)
    rates, step = np.linspace(-0.05, 0.05, 1001, retstep=True)
    values = np.array([torque(part, 0.3, v=v) for v in rates])
    steepest = 15.0 / 0.8 * math.log(1 / 0.8) / 0.01  # tau * |log efficiency| * max d tanh
    assert (np.diff(values) <= 0).all()
    assert np.abs(np.diff(values)).max() <= steepest * step
    for v in (-0.02, 0.02):  # and through u = 0, where driving becomes driven back
        assert abs(torque(part, 1e-12, v=v) - torque(part, -1e-12, v=v)) < 2e-10


def test_friction_of_the_motor_and_its_limit_reach_the_joint_through_the_ratio():
    part = GearedMotor(FIXED, joint="ankle", ratio=20.0, viscous=1e-3, limit=0.5)
    assert torque(part, 0.0, v=3.0) == pytest.approx(-400 * 1e-3 * 3.0)
    assert torque(part, 7.0) == pytest.approx(10.0)
    assert torque(part, -7.0) == pytest.approx(-10.0)


@every_base
def test_rotor_weighs_ratio_squared_on_its_joint(robot):
    part = GearedMotor(robot, joint="ankle", ratio=-50.0, rotor_inertia=1e-5)
    expected = np.zeros(robot.model.nv)
    expected[robot.joint("ankle").v] = 0.025
    assert part.armature() == pytest.approx(expected, rel=1e-15)
    part.armature()[:] = 7.0  # a copy
    assert part.armature() == pytest.approx(expected, rel=1e-15)


@every_base
def test_series_elastic_pulls_to_its_motor_side(robot):
    part = SeriesElastic(robot, joint="ankle", stiffness=300.0, damping=2.0, limit=25.0)
    assert torque(part, 0.05, q=0.1, robot=robot) == pytest.approx(-15.0)
    assert torque(part, 0.1, q=0.1, v=3.0, robot=robot) == pytest.approx(-6.0)
    assert torque(part, 0.3, q=0.1, robot=robot) == 25.0
    assert torque(part, 0.0, q=0.1, robot=robot) == -25.0
    assert not part.armature().any()


def test_series_elastic_with_a_resting_motor_is_a_spring():
    """Slope of 1/2 k (u - q)^2 by central differences, exact for a parabola."""
    part, h = SeriesElastic(FIXED, joint="ankle", stiffness=300.0), 1e-3
    up, down = (150.0 * (0.2 - q) ** 2 for q in (0.05 + h, 0.05 - h))
    assert torque(part, 0.2, q=0.05) == pytest.approx(-(up - down) / (2 * h), rel=1e-10)


@pytest.mark.parametrize("robot", [FIXED])
def test_a_command_that_is_no_number_is_not_hidden_by_the_limit(robot):
    x = State(0.0, np.zeros(5), np.zeros(5))
    for part in (
        Ideal(robot, joints=["ankle"], limit=1.0),
        GearedMotor(robot, joint="ankle", ratio=9.0, efficiency=0.5, limit=1.0),
        SeriesElastic(robot, joint="ankle", stiffness=9.0, limit=1.0),
    ):
        assert np.isnan(part.force(Kinematics, x, np.array([math.nan]))).any()


ANKLE = {"joint": "ankle"}
GEAR, SPRING = {**ANKLE, "ratio": 50.0}, {**ANKLE, "stiffness": 300.0}
NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        (Ideal, {"joints": []}, "joints [] must be one or more different joints"),
        (Ideal, {"joints": ["knee", "knee"]}, "must be one or more different joints"),
        (Ideal, {"joints": ["nose"]}, "no joint 'nose'"),
        (
            Ideal,
            {"joints": ["knee"], "limit": 0.0},
            ".limit: 0 is out of range, accepted: 1e-30 .. 1e+30",
        ),
        (Ideal, {"joints": ["knee"], "limit": NAN}, ".limit: nan is out of range"),
        (GearedMotor, {**GEAR, "joint": "nose"}, "no joint 'nose'"),
        (
            GearedMotor,
            {**GEAR, "ratio": 0.0},
            ".ratio: 0 is out of range, accepted: a size of 1e-09 ..",
        ),
        (GearedMotor, {**GEAR, "ratio": NAN}, ".ratio: nan is out of range"),
        (GearedMotor, {**GEAR, "rotor_inertia": -1.0}, ".rotor_inertia: -1 is out of range"),
        (GearedMotor, {**GEAR, "viscous": INF}, ".viscous: inf is out of range"),
        (
            GearedMotor,
            {**GEAR, "efficiency": 0.0},
            ".efficiency: 0 is out of range, accepted: 1e-06 .. 1",
        ),
        (GearedMotor, {**GEAR, "efficiency": 1.1}, ".efficiency: 1.1 is out of range"),
        (GearedMotor, {**GEAR, "limit": -1.0}, ".limit: -1 is out of range"),
        (GearedMotor, {**GEAR, "smoothing": 0.0}, ".smoothing: 0 is out of range"),
        (SeriesElastic, {**SPRING, "joint": "nose"}, "no joint 'nose'"),
        (SeriesElastic, {**SPRING, "stiffness": 0.0}, ".stiffness: 0 is out of range"),
        (SeriesElastic, {**SPRING, "stiffness": INF}, ".stiffness: inf is out of range"),
        (SeriesElastic, {**SPRING, "damping": -1.0}, ".damping: -1 is out of range"),
        (SeriesElastic, {**SPRING, "limit": 0.0}, ".limit: 0 is out of range"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(part, values, message):
    with pytest.raises(SceneError) as caught:
        schema.call(part, values, "here", FIXED)
    assert message in str(caught.value)
