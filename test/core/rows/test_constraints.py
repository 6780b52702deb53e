"""Constraint parts: derivatives by differences, wrenches by Jacobians, also off g = 0."""

import math

import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.coupling_functions import Linear, Polynomial
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.rows.constraint import Level, Row, box, drive, unilateral
from mbd_ros.core.rows.constraint_rows import CouplingRows
from mbd_ros.core.rows.frame_rows import AxisRotation, FullRotation
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.parts.constraints.distance import Distance
from mbd_ros.parts.constraints.dry_friction import DryFriction
from mbd_ros.parts.constraints.frame_anchor import FrameAnchor
from mbd_ros.parts.constraints.joint_stop import JointStop
from mbd_ros.parts.constraints.knife_edge import KnifeEdge
from mbd_ros.parts.constraints.loop_closure import LoopClosure
from mbd_ros.parts.constraints.point_on_plane import PointOnPlane
from mbd_ros.parts.constraints.prescribed_motion import PrescribedMotion
from mbd_ros.parts.constraints.screw import Screw
from mbd_ros.scene.schema import schema

ROBOTS = ROOT / "config/robots"
LEG_URDF = (ROBOTS / "prosthetic_leg.urdf").read_text(encoding="utf-8")
LEG, FREE_LEG = read_robot(LEG_URDF), read_robot(LEG_URDF, base="floating")
ARM = read_robot((ROBOTS / "arm7.urdf").read_text(encoding="utf-8"))
BODY = read_robot(mechanisms.floating_body(), base="floating")
FOUR_BAR, CHAIN = read_robot(mechanisms.four_bar()), read_robot(mechanisms.chain(3))
A, B, RPY_A, RPY_B = (0.1, -0.2, 0.3), (-0.3, 0.1, 0.2), (0.4, -0.3, 0.7), (-0.2, 0.5, 0.1)
PAIR = {"point_a": A, "rpy_a": RPY_A, "point_b": B, "rpy_b": RPY_B}
ON_ARM = {"frame_a": "link2", "frame_b": "flange", **PAIR}
ON_BODY = {"frame_a": "left", "frame_b": "right", **PAIR}
PLANE = {"normal": (0.3, -2.0, 0.5), "point": A, "plane_point": B}
COUPLINGS = Couplings(
    LEG,
    {
        "knee_slide_x": Coupling("knee", Polynomial([0.01, 0.2, -0.3, 0.4])),
        "knee_slide_y": Coupling("knee_slide_x", Polynomial([0.0, 1.5, 2.0])),
        "ankle": Coupling("knee", Linear(-0.7, 0.1)),
    },
)
IN_SPACE = {  # rows of frames
    "distance": (ARM, lambda r: Distance(r, **_ends(ON_ARM), distance=0.4)),
    "distance to the world": (
        FREE_LEG,
        lambda r: Distance(r, frame_a="foot", frame_b="universe", point_a=A, distance=0.4),
    ),
    "distance on a free body": (BODY, lambda r: Distance(r, **_ends(ON_BODY), distance=0.4)),
    "point": (ARM, lambda r: LoopClosure(r, **ON_ARM)),
    "point xz": (BODY, lambda r: LoopClosure(r, **ON_BODY, directions="xz")),
    "revolute x": (ARM, lambda r: LoopClosure(r, **ON_ARM, kind="revolute", axis="x")),
    "revolute y": (BODY, lambda r: LoopClosure(r, **ON_BODY, kind="revolute", axis="y")),
    "revolute z": (FREE_LEG, lambda r: _to_world(r, kind="revolute")),
    "cylindrical": (ARM, lambda r: LoopClosure(r, **ON_ARM, kind="revolute", directions="xy")),
    "full": (ARM, lambda r: LoopClosure(r, **ON_ARM, kind="full")),
    "full from the world": (LEG, lambda r: _to_world(r, kind="full", frame_a="world")),
    "full to the world": (LEG, lambda r: _from_world(r, kind="full")),
    "full on a free body": (BODY, lambda r: LoopClosure(r, **ON_BODY, kind="full")),
    "four-bar": (FOUR_BAR, lambda r: LoopClosure(r, **mechanisms.four_bar_closure())),
    "anchor": (
        BODY,
        lambda r: FrameAnchor(r, frame="left", position=A, point=B, rpy=RPY_A, orientation=RPY_B),
    ),
    "anchored point": (
        LEG,
        lambda r: FrameAnchor(r, frame="foot", position=A, point=B, kind="point"),
    ),
    "plane": (ARM, lambda r: PointOnPlane(r, frame="flange", plane_frame="link3", **PLANE)),
    "plane at rest": (
        BODY,
        lambda r: PointOnPlane(r, frame="left", plane_frame="universe", **PLANE),
    ),
    "plane over a point at rest": (
        LEG,
        lambda r: PointOnPlane(r, frame="world", plane_frame="foot", **PLANE),
    ),
}
EDGE = {"direction": (0.3, -2.0, 0.5), "point": A}
ON_THE_GROUND = {  # rows of velocities on frames, which have no g
    "knife edge": (ARM, lambda r: KnifeEdge(r, frame="flange", ground_frame="link3", **EDGE)),
    "knife edge at rest": (BODY, lambda r: KnifeEdge(r, frame="left", **EDGE)),
    "knife edge under a point at rest": (
        LEG,
        lambda r: KnifeEdge(r, frame="world", ground_frame="foot", **EDGE),
    ),
}
IN_JOINTS = {
    "screw": (
        LEG,
        lambda r: Screw(r, joint="knee_slide_y", parent="knee", pitch=-0.3, offset=0.1),
    ),
    "couplings": (LEG, lambda r: CouplingRows(r, COUPLINGS)),
    "polynomial": (BODY, lambda r: _moved(r, polynomial=[0.1, -2.0, 0.5, 3.0])),
    "harmonic": (
        LEG,
        lambda r: PrescribedMotion(
            r,
            joint="ankle",
            harmonic={"offset": 0.2, "amplitude": 0.3, "angular_frequency": 5.0, "phase": 0.4},
        ),
    ),
    "spline": (
        BODY,
        lambda r: _moved(r, spline={"x": [0.0, 1.0, 2.0, 4.0], "y": [1.0, 0.0, 0.5, 2.0]}),
    ),
    "stops": (LEG, lambda r: JointStop(r, joints=["all"])),
    "stop of a free body": (BODY, lambda r: JointStop(r, joint="right_slide", upper=0.4)),
    "friction": (BODY, lambda r: DryFriction(r, joint="left_swing", limit=2.0)),
}
WITHOUT_G = {"friction", *ON_THE_GROUND}
EVERY = IN_SPACE | ON_THE_GROUND | IN_JOINTS


def _ends(pair):
    return {key: pair[key] for key in ("frame_a", "frame_b", "point_a", "point_b")}


def _to_world(robot, frame_a="universe", **values):
    return LoopClosure(robot, frame_a=frame_a, frame_b="foot", **PAIR, **values)


def _from_world(robot, **values):
    return LoopClosure(robot, frame_a="foot", frame_b="world", **PAIR, **values)


def _moved(robot, **values):
    return PrescribedMotion(robot, joint="right_slide", **values)


def random_state(robot, seed=0, t=0.7):
    rng, model = np.random.default_rng(seed), robot.model
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
    return State(t, q, rng.normal(size=model.nv))


def frames(robot, x):
    """Data of Pinocchio's own algorithms for frames."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, x.q, x.v, np.zeros(robot.model.nv))
    pin.computeJointJacobians(robot.model, data)
    pin.updateFramePlacements(robot.model, data)
    return data


def refreshed(robot, x):
    k = Kinematics(robot)
    k.refresh(x.q, x.v)
    return k


def residual(part, robot, x):
    return part.residual(refreshed(robot, x), x)


def jacobian(part, robot, x):
    return part.jacobian(refreshed(robot, x), x)


def rate(part, robot, x):
    """g' of a state."""
    return jacobian(part, robot, x) @ x.v + part.rate(Kinematics, x)


def slope(function, h=1e-4):
    """Derivative at 0, central differences of fourth order: errors of 1e-12 at this step."""
    return (8 * (function(h) - function(-h)) - (function(2 * h) - function(-2 * h))) / (12 * h)


def cases(table):
    return pytest.mark.parametrize(
        ("robot", "make"), [pytest.param(*case, id=name) for name, case in table.items()]
    )


@cases({name: case for name, case in EVERY.items() if name not in WITHOUT_G})
@pytest.mark.parametrize("seed", range(4))
def test_jacobian_is_the_derivative_of_the_residual(robot, make, seed):
    """At random places, far from g = 0, in the tangent space of a floating base."""
    part, x = make(robot), random_state(robot, seed)
    x = State(x.t, x.q, np.zeros(robot.model.nv))
    steps = np.eye(robot.model.nv)
    columns = [slope(lambda h, d=d: residual(part, robot, moved(robot, x, h * d))) for d in steps]
    assert jacobian(part, robot, x) == pytest.approx(np.array(columns).T, abs=1e-9)


def moved(robot, x, dq):
    return State(x.t, pin.integrate(robot.model, x.q, dq), x.v)


@cases(EVERY)
@pytest.mark.parametrize("seed", range(4))
def test_rate_and_drift_are_derivatives_along_a_motion(robot, make, seed):
    """g' = J v + rate and g'' = J a + drift, while time, position and velocity change."""
    part, x = make(robot), random_state(robot, seed)
    a = np.random.default_rng(seed + 100).normal(size=robot.model.nv)

    def later(h):  # right to first order, which is all that a derivative sees
        return State(x.t + h, pin.integrate(robot.model, x.q, h * x.v), x.v + h * a)

    k = refreshed(robot, x)
    if hasattr(part, "accelerations"):
        J, drift = part.accelerations(k, x)
        assert np.array_equal(J, part.jacobian(k, x))
        assert np.array_equal(drift, part.drift(k, x))
    if part.level is Level.POSITION and not isinstance(
        part, JointStop
    ):  # a stop looks ahead by the velocity
        first = slope(lambda h: residual(part, robot, later(h)))
        assert rate(part, robot, x) == pytest.approx(first, abs=1e-9)
    second = slope(lambda h: rate(part, robot, later(h)))
    assert part.jacobian(k, x) @ a + part.drift(k, x) == pytest.approx(second, abs=1e-9)


@cases(IN_SPACE | ON_THE_GROUND)
@pytest.mark.parametrize("seed", range(3))
def test_wrenches_balance_and_are_what_the_multipliers_exert(robot, make, seed):
    """Forces on a and b cancel with their moments; their generalized force is J' lam."""
    part, x = make(robot), random_state(robot, seed)
    k, model = refreshed(robot, x), robot.model
    data = frames(robot, x)
    lam = np.random.default_rng(seed).normal(size=len(part.rows))
    tau, total = np.zeros(model.nv), np.zeros(6)
    wrenches = part.wrenches(k, x, lam)
    assert len(wrenches) == 2
    for name, point, force, torque in wrenches:
        index = robot.frame(name)
        at_point = data.oMf[index].actInv(pin.SE3(np.eye(3), point))
        joint, frame = model.frames[index].parentJoint, model.frames[index].placement
        jacobian = pin.getFrameJacobian(
            model, data, joint, frame * at_point, pin.LOCAL_WORLD_ALIGNED
        )
        tau += np.concatenate([force, torque]) @ jacobian
        total += np.concatenate([force, torque + np.cross(point, force)])
    assert total == pytest.approx(np.zeros(6), abs=1e-13)
    assert tau == pytest.approx(part.jacobian(k, x).T @ lam, abs=1e-13)


@cases(EVERY)
def test_multipliers_do_the_work_of_their_rows(robot, make):
    """Power of J' lam is lam . (g' - rate), which vanishes for scleronomic rows that are kept."""
    part, x = make(robot), random_state(robot, 5)
    k = refreshed(robot, x)
    J, lam = part.jacobian(k, x), np.random.default_rng(5).normal(size=len(part.rows))
    v = x.v - np.linalg.pinv(J) @ (J @ x.v + part.rate(Kinematics, x))
    assert (J.T @ lam) @ v == pytest.approx(-lam @ part.rate(k, x), abs=1e-13)


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("distance", [Row("force", "N")]),
        ("four-bar", [Row(f"force_{i}", "N", "coupler_link") for i in "xy"]),
        (
            "revolute y",
            [
                *(Row(f"force_{i}", "N", "left") for i in "xyz"),
                *(Row(f"torque_{i}", "N·m", "left") for i in "xz"),
            ],
        ),
        ("anchored point", [Row(f"force_{i}", "N", "universe") for i in "xyz"]),
        ("plane", [Row("force", "N", "link3")]),
        ("knife edge", [Row("force", "N", "flange")]),
        ("screw", [Row("force", "N")]),
        ("harmonic", [Row("torque", "N·m")]),
        ("spline", [Row("force", "N")]),
        ("friction", [Row("torque", "N·m")]),
        ("stop of a free body", [Row("force", "N")]),
        (
            "couplings",
            [
                Row("knee_slide_x.multiplier", "N"),
                Row("knee_slide_y.multiplier", "N"),
                Row("ankle.multiplier", "N·m"),
            ],
        ),
    ],
)
def test_rows_say_what_they_are(name, rows):
    robot, make = EVERY[name]
    assert list(make(robot).rows) == rows


def test_distance_pushes_apart_and_stays_finite_where_its_ends_meet():
    """A rod of 1 m whose tip is tied to the point where it hangs or, turned by pi, far away."""
    robot = read_robot(mechanisms.chain(1))
    ends = {"frame_a": "world", "frame_b": "rod_1", "point_b": (1.0, 0.0, 0.0)}
    part = Distance(robot, **ends, point_a=(1.0, 0.0, 0.0), distance=0.5)
    quarter, meeting = (State(0.0, np.array([q]), np.ones(1)) for q in (math.pi / 2, 0.0))
    assert residual(part, robot, quarter) == pytest.approx([math.sqrt(2.0) - 0.5])
    a, b = part.wrenches(refreshed(robot, quarter), quarter, np.array([3.0]))
    assert b.force == pytest.approx(3.0 * np.array([-1.0, 1.0, 0.0]) / math.sqrt(2.0))
    assert (a.frame, b.frame) == ("world", "rod_1")
    k = refreshed(robot, meeting)
    assert part.residual(k, meeting).tolist() == [-0.5]
    values = part.jacobian(k, meeting), part.drift(k, meeting)
    assert all(np.isfinite(value).all() for value in values)


def turned(axis, angle):
    return pin.AngleAxis(angle, np.array(axis) / np.linalg.norm(axis)).toRotationMatrix()


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -2, 0.5)])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.5, 2.0, 3.1, math.pi - 1e-7, math.pi])
def test_rotation_residual_has_the_length_of_the_chord(axis, angle):
    """2 sin(theta / 2), which grows up to 180 degrees: nothing upside down counts as closed."""
    left = FullRotation().residual(turned(axis, angle))
    assert np.linalg.norm(left) == pytest.approx(2.0 * math.sin(angle / 2.0), abs=1e-14)
    for along in range(3):
        R, rows = turned(axis, angle), AxisRotation("xyz"[along])
        across = np.linalg.norm(np.delete(R[:, along], along))
        expected = 2.0 * math.sin(0.5 * math.atan2(across, R[along, along]))
        # 1 + cos of the angle between the axes suffers cancellation near 180 degrees
        assert np.linalg.norm(rows.residual(R)) == pytest.approx(expected, rel=1e-8, abs=1e-14)
        values = rows.slope(R), rows.drift(R, np.ones(3), np.ones(3))
        assert all(np.isfinite(value).all() for value in values)


@pytest.mark.parametrize("kind", ["revolute", "full"])
def test_small_rotations_are_angles_and_their_multipliers_torques(kind):
    rows = FullRotation() if kind == "full" else AxisRotation("y")
    small = 1e-6 * np.array([1.0, -2.0, 3.0])
    across = [0, 1, 2] if kind == "full" else [0, 2]
    assert rows.residual(pin.exp3(small)) == pytest.approx(small[across], abs=1e-11)
    assert rows.slope(np.eye(3)) == pytest.approx(np.eye(3)[across], abs=1e-15)


@pytest.mark.parametrize("kind", ["revolute", "full"])
@pytest.mark.parametrize("seed", range(5))
def test_newton_closes_a_loop_that_can_be_closed(kind, seed):
    """From 0.2 rad beside a configuration in which frame b is where frame a is."""
    rng, model = np.random.default_rng(seed), ARM.model
    closed, hand = rng.uniform(-1.0, 1.0, model.nq), ARM.frame("flange")
    x = State(0.0, closed + rng.uniform(-0.2, 0.2, model.nq), np.zeros(model.nv))
    data, b = model.createData(), pin.SE3(pin.rpy.rpyToMatrix(*RPY_B), np.array(B))
    pin.framesForwardKinematics(model, data, closed)
    a = data.oMf[hand] * b
    ends = {"frame_a": "base", "point_a": a.translation, "rpy_a": pin.rpy.matrixToRpy(a.rotation)}
    ends |= {"frame_b": "flange", "point_b": B, "rpy_b": RPY_B}
    part = LoopClosure(ARM, **ends, kind=kind, axis="x")
    for _ in range(30):
        g, J = residual(part, ARM, x), jacobian(part, ARM, x)
        x = moved(ARM, x, np.linalg.pinv(J) @ -g)
    pin.framesForwardKinematics(model, data, x.q)
    held = data.oMf[hand] * b
    assert held.translation == pytest.approx(a.translation, abs=1e-13)
    shared = slice(0, 3) if kind == "full" else slice(0, 1)
    assert held.rotation[:, shared] == pytest.approx(a.rotation[:, shared], abs=1e-13)


def test_anchor_holds_a_frame_where_it_is():
    x = random_state(LEG, 2)
    k = refreshed(LEG, x)
    data = frames(LEG, x)
    place = data.oMf[LEG.frame("toe")]
    at = {"position": place.translation, "orientation": pin.rpy.matrixToRpy(place.rotation)}
    part = FrameAnchor(LEG, frame="toe", **at)
    assert part.residual(k, x) == pytest.approx(np.zeros(6), abs=1e-14)


def test_point_on_plane_measures_along_the_normal_whatever_its_length():
    x = random_state(LEG, 3)
    k = refreshed(LEG, x)
    data = frames(LEG, x)
    height = data.oMf[LEG.frame("heel")].translation[2]
    for size in (1.0, 1e-200, -1e200):
        part = PointOnPlane(
            LEG,
            frame="heel",
            plane_frame="world",
            normal=(0, 0, size),
            plane_point=(9, 9, 0.2),
        )
        expected = math.copysign(1.0, size) * (height - 0.2)
        assert part.residual(k, x) == pytest.approx([expected], abs=1e-14)


def test_screw_moves_its_pitch_in_a_turn():
    part = Screw(LEG, joint="knee_slide_y", parent="knee", pitch=0.01, offset=-0.02)
    x = State(0.0, np.zeros(5), np.zeros(5))
    x.q[LEG.joint("knee").q], x.q[LEG.joint("knee_slide_y").q] = 4.0 * math.pi, 0.0
    assert part.residual(Kinematics, x) == pytest.approx([0.0], abs=1e-16)


def test_coupling_multipliers_are_those_of_inverse_dynamics():
    """tau of the independent joints and lam together must do what rnea asks for."""
    rng, robot = np.random.default_rng(3), LEG
    z, w, a = (rng.uniform(-1, 1, len(COUPLINGS.v_index)) for _ in range(3))
    solution = InverseDynamics(robot, COUPLINGS).solve(z, w, a)
    q, v, joint_a = (np.zeros(5) for _ in range(3))
    q[COUPLINGS.q_index], v[COUPLINGS.v_index], joint_a[COUPLINGS.v_index] = z, w, a
    COUPLINGS.expand(q, v, joint_a)
    rows, x = CouplingRows(robot, COUPLINGS), State(0.0, q, v)
    assert rows.residual(Kinematics, x) == pytest.approx(np.zeros(3), abs=1e-15)
    J = rows.jacobian(Kinematics, x)
    assert J @ joint_a + rows.drift(Kinematics, x) == pytest.approx(np.zeros(3), abs=1e-14)
    tau = np.zeros(5)
    tau[COUPLINGS.v_index] = solution.tau
    needed = pin.rnea(robot.model, robot.model.createData(), q, v, joint_a)
    assert tau + J.T @ solution.multipliers == pytest.approx(needed, rel=1e-12, abs=1e-12)


def test_drive_with_a_limit_gives_way_and_one_without_is_rigid():
    weak = _moved(BODY, polynomial=[0.0, 1.0], limit=3.0, time_constant=0.1)
    assert weak.law == drive(3.0) and not weak.law.is_rigid
    assert weak.gains == pytest.approx((100.0, 20.0))
    assert _moved(BODY, polynomial=[0.0, 1.0]).law == drive()
    assert drive().is_rigid
    friction = DryFriction(BODY, joint="left_swing", limit=2.0, time_constant=0.01)
    assert friction.law == box(-2.0, 2.0)
    assert friction.gains == (0.0, 100.0)


@pytest.mark.parametrize(("robot", "joints"), [(ARM, "all"), (LEG, "all"), (BODY, "right_slide")])
def test_quick_margin_is_the_smallest_of_all_ends(robot, joints):
    limits = {} if joints == "all" else {"upper": 0.4}  # and the lower one of the description
    part = JointStop(robot, joints=[joints], **limits, time_constant=0.1)
    kp, kd = part.gains
    for seed in range(20):
        x = random_state(robot, seed)
        a = np.random.default_rng(seed).normal(size=robot.model.nv)
        margins = []
        for name in part.joints:
            joint = robot.joint(name)
            q, v, acceleration = x.q[joint.q], x.v[joint.v], a[joint.v]
            upper = limits.get("upper", joint.upper)
            margins.append(acceleration + kd * v + kp * (q - joint.lower))
            margins.append(-acceleration - kd * v + kp * (upper - q))
        assert part.quick_margin(x.q, x.v, a) == pytest.approx(min(margins), rel=1e-12, abs=1e-9)


def test_stop_watches_the_end_that_the_joint_heads_for():
    part = JointStop(LEG, joint="ankle", lower=-0.5, upper=1.5, time_constant=0.1)
    joint = LEG.joint("ankle")
    for q, v, gap, sign in (
        (0.0, 0.0, 0.5, 1.0),
        (1.0, 0.0, 0.5, -1.0),
        (0.4, 2.0, 1.1, -1.0),  # in 2 T it would be at 0.8
        (0.6, -2.0, 1.1, 1.0),
        (2.0, 0.0, -0.5, -1.0),
    ):
        x = State(0.0, np.zeros(5), np.zeros(5))
        x.q[joint.q], x.v[joint.v] = q, v
        assert part.residual(Kinematics, x) == pytest.approx([gap])
        assert part.jacobian(Kinematics, x)[0, joint.v] == sign


def test_stop_with_one_end_and_those_of_the_description():
    part = JointStop(LEG, joints=["ankle", "knee"], upper=9.0)
    x = State(0.0, np.zeros(5), np.zeros(5))
    lower = [LEG.joint(name).lower for name in ("ankle", "knee")]
    assert part.residual(Kinematics, x) == pytest.approx([-end for end in lower])
    assert JointStop(LEG, joints=["all"]).joints == tuple(j.name for j in LEG.joints)
    assert part.law == unilateral()


def test_stop_of_a_continuous_joint_needs_one_end_only():
    spinner = read_robot(mechanisms.chain(2).replace('"revolute"', '"continuous"'))
    with pytest.raises(SceneError, match="joint 'joint_1' has no limits, give lower or upper"):
        schema.call(JointStop, {"joint": "joint_1"}, "here", spinner)
    with pytest.raises(ModelError, match=r"joints \[all\]: no joint has a limit"):
        JointStop(spinner, joints=["all"])
    part = JointStop(spinner, joint="joint_1", upper=1.0)
    x = State(0.0, np.full(2, -50.0), np.zeros(2))
    assert part.residual(Kinematics, x) == pytest.approx([51.0])
    assert part.quick_margin(x.q, x.v, x.v) == pytest.approx(51.0 * part.gains[0])


def listed(value):
    """As a file holds it."""
    return np.array(value).tolist() if isinstance(value, tuple | np.ndarray) else value


FOOT, ENDS = {"frame": "foot"}, {"frame_a": "world", "frame_b": "foot"}
NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        (Distance, {**ENDS, "distance": 0.0}, ".distance: 0 is out of range, accepted: 1e-30"),
        (Distance, {**ENDS, "distance": NAN}, ".distance: nan is out of range"),
        (Distance, {**ENDS, "distance": 1.0, "point_a": (0, 1)}, ".point_a: expected 3 numbers"),
        (Distance, {**ENDS, "distance": 1.0, "frame_b": "nose"}, "no frame 'nose'; the links"),
        (
            Distance,
            {"frame_a": "foot", "frame_b": "toe", "distance": 1.0},
            "frames 'foot' and 'toe' have no relative motion",
        ),
        (LoopClosure, {**ENDS, "kind": "ball"}, ".kind: expected one of point, revolute, full"),
        (LoopClosure, {**ENDS, "directions": "yx"}, "one of x, y, z, xy, xz, yz, xyz, got 'yx'"),
        (LoopClosure, {**ENDS, "directions": ""}, ".directions: expected one of x, y, z"),
        (LoopClosure, {**ENDS, "axis": "-z"}, ".axis: expected one of x, y, z, got '-z'"),
        (LoopClosure, {**ENDS, "rpy_b": (0, 0, NAN)}, ".rpy_b[2]: nan is out of range"),
        (LoopClosure, {"frame_a": "foot", "frame_b": "heel"}, "have no relative motion"),
        (FrameAnchor, {**FOOT, "position": (0, 0, 0)}, "orientation must be given for kind full"),
        (
            FrameAnchor,
            {**FOOT, "position": A, "orientation": A, "kind": "point"},
            "orientation must be left out for kind point",
        ),
        (
            FrameAnchor,
            {**FOOT, "position": A, "kind": "x"},
            ".kind: expected one of full, point, got 'x'",
        ),
        (FrameAnchor, {**FOOT, "position": (0, 0), "kind": "point"}, ".position: expected 3 numb"),
        (
            FrameAnchor,
            {"frame": "world", "position": A, "kind": "point"},
            "frames 'universe' and 'world' have no relative motion",
        ),
        (
            PointOnPlane,
            {**FOOT, "plane_frame": "world", "normal": (0, 0, 0)},
            "normal [0.0, 0.0, 0.0] must have a direction",
        ),
        (
            PointOnPlane,
            {**FOOT, "plane_frame": "world", "normal": (0, 0, INF)},
            ".normal[2]: inf is out of range",
        ),
        (
            PointOnPlane,
            {**FOOT, "plane_frame": "foot", "normal": (0, 0, 1)},
            "frames 'foot' and 'foot' have no relative motion",
        ),
        (Screw, {"joint": "ankle", "parent": "knee", "pitch": 1.0}, "'ankle' is revolute, accept"),
        (
            Screw,
            {"joint": "knee_slide_x", "parent": "knee_slide_y", "pitch": 1.0},
            "parent 'knee_slide_y' is prismatic, accepted: revolute, continuous",
        ),
        (
            Screw,
            {"joint": "knee_slide_x", "parent": "knee", "pitch": 0.0},
            ".pitch: 0 is out of range, accepted: a size of 1e-30 .. 1e+30",
        ),
        (
            Screw,
            {"joint": "knee_slide_x", "parent": "knee", "pitch": 1.0, "offset": INF},
            ".offset: inf is out of range",
        ),
        (PrescribedMotion, {"joint": "nose", "polynomial": [1.0]}, "no joint 'nose'"),
        (PrescribedMotion, {"joint": "knee"}, "exactly one of polynomial, harmonic, spline; got"),
        (
            PrescribedMotion,
            {"joint": "knee", "polynomial": [1.0], "spline": {}},
            "got polynomial, spline",
        ),
        (PrescribedMotion, {"joint": "knee", "polynomial": []}, "a polynomial needs at least one"),
        (PrescribedMotion, {"joint": "knee", "polynomial": [NAN]}, ".polynomial[0]: nan is out"),
        (
            PrescribedMotion,
            {"joint": "knee", "harmonic": {"amplitude": 1.0}},
            "harmonic: angular_frequency is missing",
        ),
        (
            PrescribedMotion,
            {"joint": "knee", "harmonic": {"frequency": 1.0}},
            "harmonic has 'frequency', accepted: amplitude, angular_frequency, offset, phase",
        ),
        (
            PrescribedMotion,
            {"joint": "knee", "spline": {"x": [0.0, 1.0]}},
            "spline has x, accepted: x and y",
        ),
        (
            PrescribedMotion,
            {"joint": "knee", "spline": {"x": [0.0, 1.0, 1.0], "y": [0.0] * 3}},
            "x must be at least two increasing numbers",
        ),
        (
            PrescribedMotion,
            {"joint": "knee", "spline": {"x": [0.0, 1.0], "y": [0.0, INF]}},
            ".spline.y[1]: inf is out of range",
        ),
        (
            PrescribedMotion,
            {"joint": "knee", "polynomial": [0.0], "limit": 0.0},
            ".limit: 0 is out of range",
        ),
        (
            PrescribedMotion,
            {"joint": "knee", "polynomial": [0.0], "time_constant": 0.0},
            ".time_constant: 0 is out of range, accepted: 1e-09 .. 1e+09",
        ),
        (JointStop, {}, "give either 'joint' or 'joints'"),
        (JointStop, {"joint": "knee", "joints": ["ankle"]}, "give either 'joint' or 'joints'"),
        (JointStop, {"joints": ["knee", "knee"]}, "must be [all] or different joints"),
        (JointStop, {"joints": []}, "joints [] must be [all] or different joints"),
        (JointStop, {"joint": "nose"}, "no joint 'nose'"),
        (
            JointStop,
            {"joint": "knee", "lower": 0.5},
            "joint 'knee': lower 0.5 must be less than upper 0",
        ),
        (JointStop, {"joint": "knee", "upper": NAN}, ".upper: nan is out of range"),
        (JointStop, {"joint": "knee", "time_constant": -1.0}, ".time_constant: -1 is out of"),
        (DryFriction, {"joint": "knee", "limit": 0.0}, ".limit: 0 is out of range"),
        (DryFriction, {"joint": "knee", "limit": INF}, ".limit: inf is out of range"),
        (
            DryFriction,
            {"joint": "knee", "limit": 1.0, "time_constant": 0.0},
            ".time_constant: 0 is out of range",
        ),
    ],
)
def test_values_that_make_no_sense_are_refused(part, values, message):
    with pytest.raises(SceneError) as caught:
        schema.call(part, {key: listed(value) for key, value in values.items()}, "here", LEG)
    assert message in str(caught.value)
