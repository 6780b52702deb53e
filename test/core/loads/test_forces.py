"""Force parts against their closed forms and by what they do to energy."""

import math

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.coupling_functions import Polynomial
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import NONE, State
from mbd_ros.errors import SceneError
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.parts.forces.applied_wrench import AppliedWrench
from mbd_ros.parts.forces.gear_friction import GearFriction
from mbd_ros.parts.forces.gravity_compensation import GravityCompensation
from mbd_ros.parts.forces.joint_friction import JointFriction
from mbd_ros.parts.forces.joint_spring import JointSpring
from mbd_ros.parts.forces.joint_torque import JointTorque
from mbd_ros.parts.forces.point_spring import PointSpring
from mbd_ros.parts.forces.prescribed_wrench import PrescribedWrench
from mbd_ros.scene.schema import schema

ROBOTS = ROOT / "config/robots"
LEG = (ROBOTS / "prosthetic_leg.urdf").read_text(encoding="utf-8")
ROBOT, FREE_LEG = read_robot(LEG), read_robot(LEG, base="floating")
ARM = read_robot((ROBOTS / "arm7.urdf").read_text(encoding="utf-8"))
FREE_ARM = read_robot((ROBOTS / "arm7.urdf").read_text(encoding="utf-8"), base="floating")
PENDULUM = read_robot((ROBOTS / "pendulum.urdf").read_text(encoding="utf-8"))
every_base = pytest.mark.parametrize("robot", [ARM, FREE_ARM], ids=["fixed", "floating"])


def force(part, q=0.0, v=0.0, joint="ankle"):
    """Force of a part with one joint away from rest; all other joints must stay free of it."""
    x, index = State(0.0, np.zeros(5), np.zeros(5)), ROBOT.joint(joint).v
    x.q[index], x.v[index] = q, v
    tau = part.force(Kinematics(ROBOT), x, NONE)
    assert not np.delete(tau, index).any()
    return tau[index]


@pytest.mark.parametrize(
    ("q", "v", "expected"), [(0.1, 0.0, 0.0), (0.3, 0.0, -6.0), (0.0, 0.0, 3.0), (0.1, 2.0, -1.0)]
)
def test_spring_pulls_back_to_rest_and_damps(q, v, expected):
    spring = JointSpring(ROBOT, joint="ankle", stiffness=30.0, rest=0.1, damping=0.5)
    assert force(spring, q, v) == pytest.approx(expected, abs=1e-12)


def test_spring_is_the_slope_of_its_energy():
    spring, h = JointSpring(ROBOT, joint="knee", stiffness=12.0, rest=-0.2), 1e-4

    def energy(q):
        return 0.5 * 12.0 * (q + 0.2) ** 2

    for q in (-1.0, -0.2, 0.7):
        slope = (energy(q + h) - energy(q - h)) / (2 * h)
        assert force(spring, q, joint="knee") == pytest.approx(-slope, abs=1e-8)


def test_friction_opposes_motion_saturates_and_vanishes_at_rest():
    friction = JointFriction(ROBOT, joint="ankle", coulomb=0.4, viscous=0.05, smoothing=0.01)
    assert force(friction) == 0.0
    assert force(friction, v=0.01) == pytest.approx(-0.4 * math.tanh(1) - 0.0005)
    assert 0.4 * math.tanh(1) == pytest.approx(0.76 * 0.4, abs=1e-3)
    for v in (-3.0, 3.0):
        assert force(friction, v=v) == pytest.approx(-math.copysign(0.4, v) - 0.05 * v)
    assert all(force(friction, v=v) * v < 0 for v in (-1.0, -1e-6, 1e-6, 50.0))


def test_gear_friction_grows_with_the_load_and_shrinks_with_speed():
    """Far beyond the smoothing the dry part is coulomb + load |g| + stribeck / (1 + (v/v_s)^2)."""
    keys = {"coulomb": 0.4, "load": 0.1, "stribeck": 0.3, "stribeck_velocity": 2.0}
    more = {"viscous": 0.05, "offset": 0.2, "rotor_inertia": 0.01, "smoothing": 0.01}
    part, v = GearFriction(ROBOT, joint="ankle", **keys, **more), 2.0
    weight = Kinematics(ROBOT).gravity(np.zeros(5))[ROBOT.joint("ankle").v]
    dry = 0.4 + 0.1 * abs(weight) + 0.15
    assert abs(weight) > 0.1
    assert force(part, 0.0, v) == pytest.approx(0.2 - 0.1 - dry, abs=1e-12)
    assert force(part, 0.0, -v) == pytest.approx(0.2 + 0.1 + dry, abs=1e-12)
    assert force(part, 0.0, 0.0) == pytest.approx(0.2)
    assert part.armature()[ROBOT.joint("ankle").v] == 0.01


def test_a_motor_that_two_joints_turn_rubs_on_both():
    """tau = -U' f(U v): power is that of the motor, and nothing where it stands still."""
    part = GearFriction(ROBOT, joint="ankle", also={"knee": -0.5}, coulomb=0.4, viscous=0.1)
    at, other = ROBOT.joint("ankle").v, ROBOT.joint("knee").v
    v = np.zeros(5)
    v[at], v[other] = 1.0, -2.0
    k = Kinematics(ROBOT)
    k.refresh(np.zeros(5), v, Reads.VELOCITY)
    tau = part.force(k, State(0.0, np.zeros(5), v), np.zeros(0))
    assert tau @ v == pytest.approx(-(0.4 + 0.1 * 2.0) * 2.0)
    v[at] = -1.0
    assert np.abs(part.force(k, State(0.0, np.zeros(5), v), np.zeros(0))).max() < 1e-12
    bad = {"joint": "ankle", "also": {"knee": 1.0}, "rotor_inertia": 0.1}
    with pytest.raises(SceneError, match="are not accepted together with also"):
        schema.call(GearFriction, bad, "forces[0]", ROBOT)


def test_force_on_a_dependent_joint_reaches_its_parent_through_the_slope():
    """knee_slide_x = 0.01 knee: 100 N on the slide is 1 N·m about the knee."""
    couplings = Couplings(ROBOT, {"knee_slide_x": Coupling("knee", Polynomial([0.0, 0.01]))})
    spring = JointSpring(ROBOT, joint="knee_slide_x", stiffness=1e4, rest=0.01)
    zero = np.zeros(4)
    free, sprung = (
        InverseDynamics(ROBOT, couplings, forces=forces).solve(zero, zero, zero)
        for forces in ((), (spring,))
    )
    knee = couplings.independent.index("knee")
    assert sprung.tau - free.tau == pytest.approx(-1.0 * np.eye(4)[knee], abs=1e-12)
    assert sprung.multipliers - free.multipliers == pytest.approx([-100.0], abs=1e-10)


def random_state(robot, seed=0, t=0.0):
    rng, model = np.random.default_rng(seed), robot.model
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    return State(t, q, rng.normal(size=model.nv))


def frames(robot, x):
    """Data of Pinocchio's own algorithms for frames."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, x.q, x.v, np.zeros(robot.model.nv))
    pin.computeJointJacobians(robot.model, data)
    pin.updateFramePlacements(robot.model, data)
    return data


def refreshed(robot, x):
    """Data as a system hands it to parts that read frames."""
    k = Kinematics(robot)
    k.refresh(x.q, x.v)
    return k


def at(part, robot, x):
    return part.force(refreshed(robot, x), x, NONE)


def energy_slope(part, robot, x, h=1e-6):
    """dU/dq on the tangent space by central differences."""
    slope = []
    for step in h * np.eye(robot.model.nv):
        ends = [x._replace(q=pin.integrate(robot.model, x.q, sign * step)) for sign in (1, -1)]
        up, down = (part.potential(refreshed(robot, end), end) for end in ends)
        slope.append((up - down) / (2 * h))
    return np.array(slope)


def point_motion(robot, x, frame, point):
    """Place and velocity of a point of a link by Pinocchio's frame algorithms."""
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, x.q, x.v)
    pin.updateFramePlacements(model, data)
    index = robot.frame(frame)
    motion = pin.getFrameVelocity(model, data, index, pin.LOCAL_WORLD_ALIGNED)
    arm = data.oMf[index].rotation @ point
    return data.oMf[index].translation + arm, motion.linear + np.cross(motion.angular, arm)


CONSERVATIVE = {
    "joint_spring": (JointSpring, {"joint": ARM.joints[1].name, "stiffness": 12.0, "rest": -0.2}),
    "joint_torque": (JointTorque, {"joint": ARM.joints[2].name, "torque": -4.0}),
    "applied_wrench": (
        AppliedWrench,
        {"frame": "link6", "force": (3.0, -20.0, 8.0), "point": (0.1, 0.2, -0.3)},
    ),
    "point_spring": (
        PointSpring,
        {
            "frame_a": "link2",
            "frame_b": "flange",
            "point_a": (0.1, -0.2, 0.05),
            "point_b": (0.0, 0.1, 0.1),
            "stiffness": 150.0,
            "length": 0.3,
        },
    ),
    "point_spring_to_the_world": (
        PointSpring,
        {"frame_a": "flange", "frame_b": "universe", "point_b": (1, 2, 3), "stiffness": 20.0},
    ),
}


@every_base
@pytest.mark.parametrize("case", CONSERVATIVE)
def test_force_is_the_slope_of_its_potential(case, robot):
    part_class, values = CONSERVATIVE[case]
    part = part_class(robot, **values)
    for seed in range(3):
        x = random_state(robot, seed)
        x = x._replace(v=np.zeros_like(x.v))
        tau = at(part, robot, x)
        assert np.abs(tau).max() > 0.1
        # energies of 1e2 J rounded at 2e-14 and divided by 2e-6 m carry 1e-8; h^2 U''' is 1e-10
        assert tau == pytest.approx(-energy_slope(part, robot, x), abs=1e-7)


def test_constant_torque_is_on_its_joint_alone():
    assert force(JointTorque(ROBOT, joint="knee", torque=-7.0), 0.3, 2.0, "knee") == -7.0


@every_base
def test_spring_and_damper_give_the_power_of_their_line(robot):
    """tau . v = -F d', with d and d' from the motion of the two points."""
    ends = {"frame_a": "link2", "frame_b": "flange"}
    points = {"point_a": (0.1, -0.2, 0.05), "point_b": (0.0, 0.1, 0.1)}
    part = PointSpring(robot, **ends, **points, stiffness=150.0, damping=40.0, length=0.3)
    for seed in range(5):
        x = random_state(robot, seed)
        (a, va), (b, vb) = (
            point_motion(robot, x, ends[f"frame_{e}"], np.array(points[f"point_{e}"]))
            for e in "ab"
        )
        distance = np.linalg.norm(b - a)
        rate = (b - a) @ (vb - va) / distance
        pull = 150.0 * (distance - 0.3) + 40.0 * rate
        assert at(part, robot, x) @ x.v == pytest.approx(-pull * rate, rel=1e-11)


@every_base
def test_swapped_ends_are_the_same_spring(robot):
    x = random_state(robot)
    one = PointSpring(robot, frame_a="link2", frame_b="link7", point_a=(0.1, 0, 0), stiffness=9.0)
    two = PointSpring(robot, frame_b="link2", frame_a="link7", point_b=(0.1, 0, 0), stiffness=9.0)
    assert at(one, robot, x).any()
    assert np.array_equal(at(one, robot, x), at(two, robot, x))


def test_inner_spring_leaves_the_free_base_alone():
    """Action and reaction: no net force or torque on the whole."""
    x = random_state(FREE_ARM)
    part = PointSpring(
        FREE_ARM, frame_a="link2", frame_b="link7", stiffness=150.0, damping=9.0, length=0.1
    )
    tau = at(part, FREE_ARM, x)
    assert np.abs(tau[6:]).max() > 1.0
    assert tau[:6] == pytest.approx(np.zeros(6), abs=1e-12)


def test_spring_and_damper_across_the_tip_of_a_rod():
    """The line runs 0.5 m from the tip along its motion, so the lever is 1 m."""
    angle, rate = 0.4, 3.0
    x = State(0.0, np.array([angle]), np.array([rate]))
    tip = np.array([math.sin(angle), 0.0, -math.cos(angle)])
    anchor = tip + 0.5 * np.array([math.cos(angle), 0.0, math.sin(angle)])
    ends = {"frame_a": "world", "point_a": anchor, "frame_b": "rod", "point_b": (0, 0, -1.0)}
    relaxed = PointSpring(PENDULUM, **ends, stiffness=1e3, length=0.5)
    stretched = PointSpring(PENDULUM, **ends, stiffness=1e3, length=0.2)
    damper = PointSpring(PENDULUM, **ends, damping=8.0)
    assert at(relaxed, PENDULUM, x) == pytest.approx([0.0], abs=1e-12)
    assert at(stretched, PENDULUM, x) == pytest.approx([300.0], rel=1e-12)
    assert at(damper, PENDULUM, x) == pytest.approx([-8.0 * rate], rel=1e-12)


@pytest.mark.parametrize("gap", [0.0, 1e-300, 1e-160, 1e-12])
def test_spring_is_finite_where_its_ends_meet(gap):
    """The hinge of the rod is the origin: its points there do not move."""
    ends = {"frame_a": "world", "frame_b": "rod", "point_b": (gap, 0.0, 0.0)}
    part = PointSpring(PENDULUM, **ends, stiffness=1e5, damping=1e3, length=1.0)
    x = State(0.0, np.zeros(1), np.ones(1))
    k = refreshed(PENDULUM, x)
    assert part.force(k, x, NONE) == pytest.approx([0.0], abs=1e-6)
    assert part.potential(k, x) == pytest.approx(5e4)


def test_a_line_without_direction_carries_no_force():
    ends = {"frame_a": "world", "point_a": (0, 0, -1.0), "frame_b": "rod", "point_b": (0, 0, -1.0)}
    part = PointSpring(PENDULUM, **ends, stiffness=1e5, damping=1e3, length=1.0)
    x = State(0.0, np.zeros(1), np.ones(1))
    assert at(part, PENDULUM, x).tolist() == [0.0]


@every_base
@pytest.mark.parametrize("axes", ["world", "frame"])
def test_applied_wrench_gives_its_virtual_power(axes, robot):
    load, twist = np.array([3.0, -20.0, 8.0]), np.array([1.0, 2.0, -0.5])
    point = np.array([0.1, 0.2, -0.3])
    part = AppliedWrench(
        robot, frame="flange", force=load, torque=twist, point=point, expressed_in=axes
    )
    model, index = robot.model, robot.frame("flange")
    for seed in range(3):
        x = random_state(robot, seed)
        k = refreshed(robot, x)
        data = frames(robot, x)
        turn = data.oMf[index].rotation if axes == "frame" else np.eye(3)
        _, velocity = point_motion(robot, x, "flange", point)
        spin = pin.getFrameVelocity(model, data, index, pin.LOCAL_WORLD_ALIGNED).angular
        power = (turn @ load) @ velocity + (turn @ twist) @ spin
        assert part.force(k, x, NONE) @ x.v == pytest.approx(power, rel=1e-11)


def test_load_of_a_frame_turns_with_it_and_one_of_the_world_does_not():
    """1 N along x at the tip of the 1 m rod: always 1 N·m as a thruster, else its lever."""
    values = {"frame": "rod", "force": (1.0, 0.0, 0.0), "point": (0.0, 0.0, -1.0)}
    dead, thruster = (
        AppliedWrench(PENDULUM, **values, expressed_in=axes) for axes in ("world", "frame")
    )
    for angle in (0.0, 0.7, 2.0):
        x = State(0.0, np.array([angle]), np.zeros(1))
        assert at(dead, PENDULUM, x) == pytest.approx([math.cos(angle)], abs=1e-14)
        assert at(thruster, PENDULUM, x) == pytest.approx([1.0], rel=1e-14)
        assert thruster.potential(refreshed(PENDULUM, x), x) == 0.0
        rows = [[1.0, 0, 0, 0, 0, 0]] * 2
        table = PrescribedWrench(
            PENDULUM, frame="rod", times=[0, 1], wrenches=rows, point=(0, 0, -1.0)
        )
        assert at(table, PENDULUM, x) == pytest.approx([1.0], rel=1e-14)


TIMES, RAMP = [0.0, 0.5, 2.0], np.outer([1.0, 3.0, 0.0], [10.0, -4.0, 6.0, 2.0, 1.0, -3.0])


@pytest.mark.parametrize(
    ("t", "share"),
    [(-1e-9, 0), (0.0, 1), (0.25, 2), (0.5, 3), (1.0, 2), (1.5, 1), (2.0, 0), (2.1, 0)],
)
def test_table_is_interpolated_and_zero_outside(t, share):
    part = PrescribedWrench(ARM, frame="link7", times=TIMES, wrenches=RAMP)
    assert part.wrench(t) == pytest.approx(share * RAMP[0], abs=1e-13)
    x = random_state(ARM, t=t)
    whole = at(part, ARM, x._replace(t=0.0))
    assert np.abs(whole).max() > 1.0
    assert at(part, ARM, x) == pytest.approx(share * whole, abs=1e-12)


def test_table_that_ends_loaded_holds_to_its_last_sample():
    part = PrescribedWrench(ARM, frame="link7", times=[0.0, 1.0], wrenches=RAMP[:2])
    assert np.array_equal(part.wrench(1.0), RAMP[1])
    assert not part.wrench(np.nextafter(1.0, 2.0)).any()


@every_base
@pytest.mark.parametrize("expressed_in", [None, "link3", "universe"])
def test_prescribed_wrench_is_carried_by_the_jacobian_of_the_world(expressed_in, robot):
    """Force on the flange about a point given in another link, which moves by itself."""
    x, point = random_state(robot, 4), (0.1, -0.3, 0.2)
    table = {"times": TIMES, "wrenches": RAMP}
    part = PrescribedWrench(robot, frame="flange", **table, expressed_in=expressed_in, point=point)
    model, k = robot.model, refreshed(robot, x)
    data = frames(robot, x)
    about = pin.SE3(np.eye(3), np.array(point))
    load = (data.oMf[robot.frame(expressed_in or "flange")] * about).act(pin.Force(RAMP[0]))
    other, flange = model.createData(), robot.frame("flange")
    jacobian = pin.computeFrameJacobian(model, other, x.q, flange, pin.WORLD)
    assert part.force(k, x, NONE) == pytest.approx(jacobian.T @ load.vector, abs=1e-11)


def test_small_force_and_a_body_at_rest_give_nothing():
    x = random_state(ARM)
    table = {"times": TIMES, "wrenches": RAMP}
    norm = float(np.linalg.norm(RAMP[0, :3]))
    for threshold, acts in ((0.99 * norm, True), (1.01 * norm, False)):
        part = PrescribedWrench(ARM, frame="link7", threshold=threshold, **table)
        assert at(part, ARM, x).any() == acts
    assert not at(PrescribedWrench(ARM, frame="base", **table), ARM, x).any()


def test_applied_and_prescribed_wrench_agree_in_the_axes_of_the_link():
    x, on = random_state(FREE_LEG), {"frame": "foot", "point": (0.02, 0.0, -0.05)}
    constant = AppliedWrench(
        FREE_LEG, **on, force=RAMP[0, :3], torque=RAMP[0, 3:], expressed_in="frame"
    )
    table = PrescribedWrench(FREE_LEG, **on, times=[-1.0, 1.0], wrenches=[RAMP[0]] * 2)
    assert at(constant, FREE_LEG, x) == pytest.approx(at(table, FREE_LEG, x), abs=1e-12)


@pytest.mark.parametrize("robot", [ROBOT, ARM], ids=["leg", "arm"])
def test_compensated_robot_stays_where_it_is(robot):
    part, model, x = GravityCompensation(robot), robot.model, random_state(robot)
    rest, free = np.zeros(model.nv), np.zeros(model.nv)
    data = model.createData()
    fall = np.abs(pin.aba(model, data, x.q, rest, free)).max()
    a = pin.aba(model, data, x.q, rest, part.force(Kinematics(robot), x, NONE))
    assert fall > 5.0
    assert a == pytest.approx(rest, abs=1e-12 * fall)  # the masses of a leg differ by 1e3


def test_compensation_of_some_joints_and_by_a_share():
    x, model = random_state(ROBOT), ROBOT.model
    gravity = pin.computeGeneralizedGravity(model, model.createData(), x.q)
    share = GravityCompensation(ROBOT, joints=["knee", "hip_flexion"], factor=0.5).force(
        Kinematics(ROBOT), x, NONE
    )
    for joint in ROBOT.joints:
        factor = 0.5 if joint.name in ("knee", "hip_flexion") else 0.0
        assert share[joint.v] == pytest.approx(factor * gravity[joint.v], abs=1e-14)
    every = GravityCompensation(ROBOT, joints=["all"])
    assert np.array_equal(every.force(Kinematics(ROBOT), x, NONE), gravity)


def test_compensation_does_not_act_on_a_free_base():
    x, model = random_state(FREE_ARM), FREE_ARM.model
    tau = GravityCompensation(FREE_ARM).force(Kinematics(FREE_ARM), x, NONE)
    gravity = pin.computeGeneralizedGravity(model, model.createData(), x.q)
    assert not tau[:6].any()
    assert tau.any()
    assert np.array_equal(tau[6:], gravity[6:])


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        (JointSpring, {"stiffness": -1.0}, ".stiffness: -1 is out of range, accepted: 0 .. 1e+30"),
        (JointSpring, {"stiffness": 1.0, "damping": -2.0}, ".damping: -2 is out of range, acc"),
        (JointFriction, {"coulomb": -1.0}, ".coulomb: -1 is out of range, acc"),
        (JointFriction, {"viscous": -1.0}, ".viscous: -1 is out of range, acc"),
        (JointFriction, {"smoothing": 0.0}, ".smoothing: 0 is out of range, accepted: 1e-12 .."),
        (JointSpring, {"stiffness": 1.0, "joint": "nose"}, "no joint 'nose'; the robot has hip"),
        (JointSpring, {"stiffness": 1.0, "joint": "socket_fix"}, "joint 'socket_fix' is fixed"),
    ],
)
def test_values_that_make_no_sense_are_refused(part, values, message):
    with pytest.raises(SceneError) as caught:
        schema.call(part, {"joint": "ankle", **values}, "here", ROBOT)
    assert message in str(caught.value)


ON_FOOT, TABLE = {"frame": "foot"}, {"times": TIMES, "wrenches": RAMP.tolist()}
ENDS = {"frame_a": "world", "frame_b": "foot"}
NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        (JointTorque, {"joint": "ankle", "torque": NAN}, ".torque: nan is out of range, acc"),
        (JointTorque, {"joint": "nose", "torque": 1.0}, "no joint 'nose'"),
        (PointSpring, {**ENDS, "stiffness": -1.0}, ".stiffness: -1 is out of range"),
        (PointSpring, {**ENDS, "damping": NAN}, ".damping: nan is out of range"),
        (PointSpring, {**ENDS, "length": INF}, ".length: inf is out of range"),
        (PointSpring, {**ENDS, "point_a": [0, 1]}, ".point_a: expected 3 numbers, got [0, 1]"),
        (PointSpring, {**ENDS, "point_b": [0, 1, NAN]}, ".point_b[2]: nan is out of range"),
        (PointSpring, {**ENDS, "frame_b": "nose"}, "no frame 'nose'; the links are world, "),
        (
            PointSpring,
            {"frame_a": "foot", "frame_b": "toe"},
            "frames 'foot' and 'toe' have no relative motion",
        ),
        (AppliedWrench, {**ON_FOOT, "force": [1, 2]}, ".force: expected 3 numbers, got [1, 2]"),
        (AppliedWrench, {**ON_FOOT, "torque": [1, 2, INF]}, ".torque[2]: inf is out of range"),
        (AppliedWrench, {**ON_FOOT, "point": [1]}, ".point: expected 3 numbers"),
        (
            AppliedWrench,
            {**ON_FOOT, "expressed_in": "toe"},
            ".expressed_in: expected one of world, frame, got 'toe'",
        ),
        (AppliedWrench, {"frame": "world"}, "frame 'world' cannot move"),
        (AppliedWrench, {"frame": "nose"}, "no frame 'nose'"),
        (PrescribedWrench, {**ON_FOOT, **TABLE, "frame": "nose"}, "no frame 'nose'"),
        (PrescribedWrench, {**ON_FOOT, **TABLE, "expressed_in": "nose"}, "no frame 'nose'"),
        (
            PrescribedWrench,
            {**ON_FOOT, **TABLE, "threshold": -1.0},
            ".threshold: -1 is out of range",
        ),
        (PrescribedWrench, {**ON_FOOT, **TABLE, "point": [1, 2]}, ".point: expected 3 numbers"),
        (
            PrescribedWrench,
            {**ON_FOOT, **TABLE, "times": [0.0]},
            "times must be at least two increasing",
        ),
        (PrescribedWrench, {**ON_FOOT, **TABLE, "times": [0, 1, 1]}, "at least two increasing"),
        (
            PrescribedWrench,
            {**ON_FOOT, **TABLE, "times": [0, 1, NAN]},
            ".times[2]: nan is out of range",
        ),
        (
            PrescribedWrench,
            {**ON_FOOT, **TABLE, "times": [0, 1]},
            "wrenches has 3 rows, but times has 2",
        ),
        (
            PrescribedWrench,
            {**ON_FOOT, "times": [0, 1], "wrenches": [[0] * 6, [0] * 5]},
            ".wrenches[1]: expected 6 numbers, got [0, 0, 0, 0, 0]",
        ),
        (
            PrescribedWrench,
            {**ON_FOOT, "times": [0, 1], "wrenches": [[0] * 6, [NAN] * 6]},
            ".wrenches[1][0]: nan is out of range",
        ),
        (GravityCompensation, {"joints": []}, "joints [] must be [all] or different joints"),
        (GravityCompensation, {"joints": ["knee"] * 2}, "must be [all] or different joints"),
        (GravityCompensation, {"joints": ["all", "knee"]}, "no joint 'all'"),
        (GravityCompensation, {"joints": ["nose"]}, "no joint 'nose'"),
        (GravityCompensation, {"factor": INF}, ".factor: inf is out of range"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(part, values, message):
    with pytest.raises(SceneError) as caught:
        schema.call(part, values, "here", ROBOT)
    assert message in str(caught.value)
