"""Robots against Pinocchio's own models of the same descriptions."""

import math

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.errors import ModelError
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics

ROBOTS = ROOT / "config/robots"
ARM = (ROBOTS / "arm7.urdf").read_text(encoding="utf-8")
LEG = (ROBOTS / "prosthetic_leg.urdf").read_text(encoding="utf-8")


def torques(robot, q, v, a):
    return InverseDynamics(robot, Couplings(robot)).solve(q, v, a).tau


@pytest.mark.parametrize("gravity", [(0, 0, -9.81), (0, -9.81, 0), (1.0, 2.0, 3.0), (0, 0, 0)])
def test_gravity_has_direction_and_size(gravity):
    """Against -sum m J' g, from the Jacobian of the centre of mass."""
    robot = read_robot(ARM, gravity=gravity)
    q = np.random.default_rng(0).uniform(-2, 2, 7)
    data, zero = robot.model.createData(), np.zeros(7)
    J = pin.jacobianCenterOfMass(robot.model, data, q)
    expected = -pin.computeTotalMass(robot.model) * J.T @ np.array(gravity, dtype=float)
    assert torques(robot, q, zero, zero) == pytest.approx(expected, abs=1e-12)


def test_continuous_joints_equal_pinocchios_own_over_many_turns():
    """There a continuous joint is (cos, sin); here an angle that may go on for ever."""
    text = ARM.replace('type="revolute"', 'type="continuous"', 4)
    own, robot = pin.buildModelFromXML(text), read_robot(text, gravity=(1.0, -2.0, -9.0))
    own.gravity.linear = robot.model.gravity.linear
    assert (own.nq, robot.model.nq) == (11, 7)
    kinds = [joint.kind for joint in robot.joints]
    assert kinds == ["continuous"] * 4 + ["revolute"] * 3
    assert robot.joints[0].lower == -math.inf
    assert robot.joints[0].upper == math.inf
    rng, data = np.random.default_rng(1), own.createData()
    for _ in range(20):
        v, a = rng.normal(size=(2, 7))
        q = rng.uniform(-2, 2, 7)
        q[:4] += 2 * np.pi * rng.integers(-5, 6, 4)
        pairs = np.column_stack([np.cos(q[:4]), np.sin(q[:4])]).ravel()
        expected = pin.rnea(own, data, np.r_[pairs, q[4:]], v, a)
        assert torques(robot, q, v, a) == pytest.approx(expected, abs=1e-10)


def test_locked_joint_equals_a_joint_fixed_by_hand():
    """joint4 turns about -y: frozen at 0.7 rad it is a fixed joint with rpy 0 -0.7 0."""
    head, tail = ARM.split('<joint name="joint4" type="revolute">')
    joint, rest = tail.split("</joint>", 1)
    assert "rpy" not in joint
    joint = joint.replace("<origin ", '<origin rpy="0 -0.7 0" ')
    by_hand = read_robot(f'{head}<joint name="joint4" type="fixed">{joint}</joint>{rest}')
    robot = read_robot(ARM, locked={"joint4": 0.7})
    assert [j.name for j in robot.joints] == [f"joint{i}" for i in (1, 2, 3, 5, 6, 7)]
    q, v, a = np.random.default_rng(2).normal(size=(3, 6))
    assert torques(robot, q, v, a) == pytest.approx(torques(by_hand, q, v, a), abs=1e-12)
    with pytest.raises(ModelError, match=r"joint 'joint4' is locked at 0\.7"):
        robot.joint("joint4")
    with pytest.raises(ModelError, match="joint 'joint4' is fixed"):
        by_hand.joint("joint4")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"locked": {"nose": 0.0}}, "locked: joint 'nose' does not exist"),
        ({"locked": {"flange_fix": 0.0}}, "locked: joint 'flange_fix' is fixed already"),
        ({"rename": {"nose": "a"}}, "rename: no joint 'nose'; the robot has joint1, "),
        ({"rename": {"joint1": "joint2"}}, "rename: two joints would have the name joint2"),
        ({"rename": {"joint1": ""}}, "rename: the new name of 'joint1' is empty"),
        ({"base": "flying"}, "base is 'flying', accepted: fixed, floating"),
    ],
)
def test_options_that_do_not_fit_are_named(options, message):
    if "flange_fix" in str(options):
        name = ARM.split('type="fixed"')[0].rsplit('name="', 1)[1].split('"')[0]
        options, message = {"locked": {name: 0.0}}, message.replace("flange_fix", name)
    with pytest.raises(ModelError) as caught:
        read_robot(ARM, **options)
    assert message in str(caught.value)


def test_renamed_joints_are_found_by_their_new_names_only():
    robot = read_robot(ARM, rename={"joint1": "joint2", "joint2": "joint1"}, locked={"joint1": 0})
    assert [(j.name, j.urdf_name) for j in robot.joints][:2] == [
        ("joint2", "joint1"),
        ("joint3", "joint3"),
    ]
    assert dict(robot.locked) == {"joint1": 0}
    with pytest.raises(ModelError, match="no joint 'nose'; the robot has joint2, joint3, "):
        robot.joint("nose")


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("name", ["root_joint", "universe"])
def test_joint_called_like_pinocchios_own_frames_is_one_joint(base, name):
    robot = read_robot(LEG.replace('joint name="knee"', f'joint name="{name}"'), base=base)
    names = [joint.name for joint in robot.joints]
    assert names == ["hip_flexion", "knee_slide_x", "knee_slide_y", name, "ankle"]
    first = 6 * robot.floating
    assert [joint.v for joint in robot.joints] == list(range(first, first + 5))


def test_frame_is_the_link_even_where_a_joint_has_its_name():
    robot = read_robot(LEG.replace('joint name="knee"', 'joint name="residual_limb"'))
    frame = robot.model.frames[robot.frame("residual_limb")]
    assert frame.type == pin.FrameType.BODY
    assert frame.parentJoint == 1
    with pytest.raises(ModelError, match="no frame 'nose'; the links are world, residual_limb, "):
        robot.frame("nose")


def test_limits_and_units_are_those_of_the_description():
    knee = read_robot(LEG).joint("knee")
    assert (knee.lower, knee.upper, knee.max_velocity, knee.max_effort) == (-2.0944, 0, 8, 120)
    assert knee.effort_unit == "N·m"
    assert read_robot(LEG).joint("knee_slide_x").effort_unit == "N"
    unlimited = LEG.replace('velocity="8"', 'velocity="0"')
    assert read_robot(unlimited).joint("knee").max_velocity == math.inf


def test_what_is_left_out_is_said():
    rubbed = LEG.replace('<child link="foot"/>', '<child link="foot"/><dynamics damping="0.5"/>')
    robot = read_robot(rubbed.replace("</robot>", "<transmission/></robot>"))
    assert robot.ignored == ("URDF <transmission>",)
    assert robot.joint_friction == {"ankle": (0.0, 0.5)}
    assert (read_robot(LEG).ignored, read_robot(LEG).joint_friction) == ((), {})


def test_a_continuous_joint_without_an_effort_limit_has_none():
    hinge = LEG.replace('name="ankle" type="revolute"', 'name="ankle" type="continuous"')
    assert hinge != LEG
    at = hinge.index("<limit", hinge.index('name="ankle"'))
    limit = hinge[at : hinge.index("/>", at) + 2]
    assert read_robot(hinge).joint("ankle").max_effort > 0
    assert read_robot(hinge.replace(limit, "")).joint("ankle").max_effort == math.inf
    bare = hinge.replace(limit, '<limit velocity="2"/>')
    assert read_robot(bare).joint("ankle").max_effort == math.inf
    none = hinge.replace(limit, '<limit velocity="2" effort="0"/>')
    assert read_robot(none).joint("ankle").max_effort == 0.0


def test_floating_base_equals_newtons_law_for_the_whole_body():
    """The first six torques are the rate of momentum of all bodies minus gravity."""
    robot = read_robot(LEG, base="floating")
    model, data = robot.model, robot.model.createData()
    couplings = Couplings(robot)
    rng = np.random.default_rng(4)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    v, a = rng.normal(size=(2, model.nv))
    for configuration in (q, pin.neutral(model)):
        tau = InverseDynamics(robot, couplings).solve(configuration, v, a).tau
        pin.computeCentroidalMomentumTimeVariation(model, data, configuration, v, a)
        weight = pin.Force(-data.mass[0] * model.gravity.linear, np.zeros(3))
        at_com = data.dhg + weight
        expected = data.oMi[1].actInv(pin.SE3(np.eye(3), data.com[0]).act(at_com))
        assert tau[:6] == pytest.approx(expected.vector, abs=1e-9)
