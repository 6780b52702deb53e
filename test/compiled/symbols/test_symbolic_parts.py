"""Parts of the symbolic subset: asked with symbols they give what they give with numbers."""

import casadi as ca
import numpy as np
import pytest
from places import ROOT
from symbolic_numbers import Symbols

from mbd_ros.compiled.symbols.scalar import column, number
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import NONE, State
from mbd_ros.parts.constraints.distance import Distance
from mbd_ros.parts.constraints.path_length import PathLength
from mbd_ros.parts.forces.cable import Cable
from mbd_ros.parts.forces.gear_friction import GearFriction
from mbd_ros.parts.forces.joint_friction import JointFriction
from mbd_ros.parts.forces.joint_spring import JointSpring
from mbd_ros.parts.forces.joint_torque import JointTorque
from mbd_ros.parts.forces.point_spring import PointSpring
from mbd_ros.scene.reading.path_entries import path_of

ROBOTS = ROOT / "config/robots"
LEG, ARM = (
    read_robot((ROBOTS / f"{name}.urdf").read_text(encoding="utf-8"))
    for name in ("prosthetic_leg", "arm7")
)
EXACT = 1e-14  # of the largest entry, or of 1 where that is a difference of larger ones
SPRING = {"stiffness": 300.0, "damping": 4.0, "length": 0.2}
FAR = {"point_a": (0.2, -0.1, 0.3), "point_b": (0.02, 0.05, -0.04)}
CABLE = {"stiffness": 300.0, "damping": 40.0, "slack_length": 0.3}
VIA = [
    {"frame": "link1", "xyz": [0.1, 0.0, 0.05]},
    {"frame": "link3", "xyz": [0.05, 0.1, 0.0]},
    {"frame": "flange", "xyz": [0.02, 0.03, 0.0]},
]
CURVE = {"polynomial": [0.05, 0.03, -0.02]}
SLIDING = [VIA[0], {**VIA[1], "moves": {"joint": ARM.joints[4].name, "x": CURVE}}, VIA[2]]
SWITCHED = [VIA[0], {**VIA[1], "within": {"joint": ARM.joints[4].name, "upper": 0.1}}, VIA[2]]


def through(robot, points):
    pulleys = {robot.joints[1].name: 0.03, robot.joints[2].name: [0.1, 0.02, 0.01]}
    return path_of(robot, {"points": points, "joints": pulleys}, "here")


FORCES = {
    "joint_spring": (LEG, JointSpring, {"joint": "knee", "stiffness": 30.0, "damping": 0.7}),
    "joint_friction": (LEG, JointFriction, {"joint": "ankle", "coulomb": 0.4, "viscous": 0.05}),
    "gear_friction": (
        LEG,
        GearFriction,
        {"joint": "ankle", "coulomb": 0.4, "load": 0.1, "stribeck": 0.2, "viscous": 0.05},
    ),
    "gear_friction of two joints": (
        LEG,
        GearFriction,
        {"joint": "ankle", "coulomb": 0.4, "viscous": 0.05, "also": {"knee": -0.5}},
    ),
    "joint_torque": (LEG, JointTorque, {"joint": "knee", "torque": 3.0}),
    "point_spring": (ARM, PointSpring, {"frame_a": "link2", "frame_b": "flange", **SPRING, **FAR}),
    "cable over points of links": (ARM, Cable, {**CABLE, "path": through(ARM, VIA)}),
    "cable over points that a joint moves": (ARM, Cable, {**CABLE, "path": through(ARM, SLIDING)}),
    "cable over points that come and go": (ARM, Cable, {**CABLE, "path": through(ARM, SWITCHED)}),
    "point_spring to the world": (
        LEG,
        PointSpring,
        {"frame_a": "foot", "frame_b": "world", **SPRING, **FAR},
    ),
}
BARS = {
    "between links": (ARM, {"frame_a": "link2", "frame_b": "flange"}),
    "from the world": (LEG, {"frame_a": "world", "frame_b": "foot"}),
    "to the world": (LEG, {"frame_a": "foot", "frame_b": "world"}),
}


def states(robot):
    rng, nv = np.random.default_rng(5), robot.model.nv
    return [State(0.3, rng.uniform(-1.5, 1.5, nv), rng.normal(size=nv)) for _ in range(5)]


def at(robot, x):
    k = Kinematics(robot)
    k.refresh(x.q, x.v)
    return k


def assert_same(found, expected):
    expected = np.asarray(expected)
    error = np.abs(found.reshape(expected.shape) - expected)
    assert error.max() <= EXACT * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize(("robot", "make", "entry"), FORCES.values(), ids=FORCES)
def test_a_force_of_symbols_has_the_numbers_of_the_force(robot, make, entry):
    part, symbols = make(robot, **entry), Symbols(robot)
    tau = part.force(symbols.k, symbols.x, NONE)
    energy = part.potential(symbols.k, symbols.x)
    for x in states(robot):
        assert_same(symbols.number(tau, x), part.force(at(robot, x), x, NONE))
        assert_same(symbols.number(energy, x), part.potential(at(robot, x), x))


@pytest.mark.parametrize(("robot", "ends"), BARS.values(), ids=BARS)
def test_rows_of_symbols_have_the_numbers_of_the_rows(robot, ends):
    part, symbols = Distance(robot, **ends, **FAR, distance=0.7), Symbols(robot)
    asked = part.residual, part.jacobian, part.drift
    traced = [method(symbols.k, symbols.x) for method in asked]
    for x in states(robot):
        k = at(robot, x)
        for expression, method in zip(traced, asked, strict=True):
            assert_same(symbols.number(expression, x), method(k, x))
        assert_same(symbols.slopes(traced[0], x), part.jacobian(k, x))


@pytest.mark.parametrize("points", [VIA, SLIDING, SWITCHED], ids=["held", "moved", "switched"])
def test_the_row_of_a_path_of_symbols_has_the_numbers_of_the_row(points):
    part = PathLength(ARM, path=through(ARM, points), length=0.7)
    symbols = Symbols(ARM)
    asked = part.residual, part.jacobian, part.drift
    traced = [method(symbols.k, symbols.x) for method in asked]
    for x in states(ARM):
        k = at(ARM, x)
        for expression, method in zip(traced, asked, strict=True):
            assert_same(symbols.number(expression, x), method(k, x))
        assert_same(symbols.slopes(traced[0], x), part.jacobian(k, x))


def test_points_that_meet_have_the_same_direction_for_both():
    """The axis of a joint, once on either of its links."""
    symbols, joint = Symbols(ARM), ARM.model.getJointId(ARM.joints[3].urdf_name)
    parent, child = (link_of(j) for j in (ARM.model.parents[joint], joint))
    ends = {"frame_a": parent, "frame_b": child}
    ends["point_a"] = ARM.model.jointPlacements[joint].translation.tolist()
    spring = PointSpring(ARM, **ends, stiffness=3.0, damping=1.0, length=0.1)
    bar = Distance(ARM, **ends, distance=0.5)
    force = spring.force(symbols.k, symbols.x, NONE)
    rows = bar.accelerations(symbols.k, symbols.x)
    for x in states(ARM):
        k = at(ARM, x)
        assert not spring.force(k, x, NONE).any()
        assert not symbols.number(force, x).any()
        for expression, expected in zip(rows, bar.accelerations(k, x), strict=True):
            found = symbols.number(expression, x)
            assert found.reshape(expected.shape) == pytest.approx(expected, abs=1e-13)


def link_of(joint):
    """A link in whose axes the joint that carries it stands."""
    for frame in ARM.model.frames:
        if frame.parentJoint == joint and frame.placement.isIdentity(0.0):
            return frame.name
    raise AssertionError(joint)


def test_a_parameter_may_be_a_symbol():
    p, x = ca.SX.sym("p"), states(LEG)[0]
    symbols = Symbols(LEG)
    traced = JointSpring(LEG, joint="knee", stiffness=number(p)).force(symbols.k, symbols.x, NONE)
    f = ca.Function("f", [p, *symbols.given[1:3]], [column(traced)])
    for stiffness in (3.0, 70.0):
        part = JointSpring(LEG, joint="knee", stiffness=stiffness)
        assert_same(np.array(f(stiffness, x.q, x.v)), part.force(at(LEG, x), x, NONE))
