"""Reactions of joints and closures against Newton and Euler, body by body."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import floating_body
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.core.contracts import Wrench
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import NONE, State
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.methods.inverse_dynamics.efforts import joint_efforts
from mbd_ros.methods.inverse_dynamics.reactions import JointReactions
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.parts.constraints.distance import Distance
from mbd_ros.parts.constraints.frame_anchor import FrameAnchor
from mbd_ros.parts.forces.applied_wrench import AppliedWrench
from mbd_ros.parts.forces.gravity_compensation import GravityCompensation
from mbd_ros.parts.forces.joint_spring import JointSpring
from mbd_ros.parts.forces.point_spring import PointSpring
from mbd_ros.parts.forces.prescribed_wrench import PrescribedWrench
from mbd_ros.scene.reading.learned_entries import with_files
from mbd_ros.scene.reading.path_entries import with_paths
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.registry import PARTS, resolve

CONFIG = ROOT / "config"


def out_of_balance(robot, x, a, reactions, loads):
    """Largest [N or N·m] that is missing in the momentum of a body, each on its own.

    What the parent exerts on a body, less what the body exerts on its children, closures, other
    loads and its weight, against m a of its mass centre and the rate of I w about it.
    """
    model, data, worst = robot.model, robot.model.createData(), 0.0
    pin.forwardKinematics(model, data, x.q, x.v, a)
    number = {model.joints[i].idx_v: i for i in range(1, model.njoints)}
    joints = {
        number[joint.v]: row for joint, row in zip(robot.joints, reactions.world, strict=True)
    }
    for i in range(1, model.njoints):
        place, inertia = data.oMi[i], model.inertias[i]
        R, com = place.rotation, place.act(inertia.lever)
        force, torque = inertia.mass * model.gravity.linear, np.zeros(3)
        acting = [(place.translation, *np.split(joints.get(i, np.zeros(6)), 2))]
        for j, row in joints.items():
            if model.parents[j] == i:
                acting.append((data.oMi[j].translation, *np.split(-row, 2)))
        for wrench in loads:
            if model.frames[robot.frame(wrench.frame)].parentJoint == i:
                acting.append((wrench.point, wrench.force, wrench.torque))
        for point, push, turn in acting:
            force = force + push
            torque = torque + turn + np.cross(point - com, push)
        w, alpha = R @ data.v[i].angular, R @ data.a[i].angular
        linear = R @ (data.a[i].linear + np.cross(data.v[i].angular, data.v[i].linear))
        arm = com - place.translation
        moved = linear + np.cross(alpha, arm) + np.cross(w, np.cross(w, arm))
        turned = R @ inertia.inertia @ R.T
        force = force - inertia.mass * moved
        torque = torque - turned @ alpha - np.cross(w, turned @ w)
        worst = max(worst, np.abs(force).max(), np.abs(torque).max())
    return worst


def along_axes(robot, reactions):
    """Part of every reaction along the axis of its joint [N or N·m]."""
    axes = {
        joint.idx_v: np.array(joint.createData().S).reshape(6)
        for joint in robot.model.joints
        if joint.nv == 1
    }
    pairs = zip(robot.joints, reactions.local, strict=True)
    return np.array([axes[joint.v] @ wrench for joint, wrench in pairs])


@pytest.mark.parametrize(
    ("name", "joint"), [("four_bar_leg", "knee_anterior"), ("benchmark/a04_bricard", "theta_2")]
)
def test_every_body_of_a_loop_balances(name, joint):
    """And along its axis a joint transmits the actuator and the spring, and nothing else."""
    scene = load_scene(CONFIG / f"scenes/{name}.yaml")
    robot, torque = scene.robot, 2.0
    drive = resolve("forces", "joint_torque", "here")
    push = schema.call(drive, {"joint": joint, "torque": torque}, "here", robot)
    simulation = scene.simulation(forces=[push])
    efforts = joint_efforts(robot, [joint])
    inverse = ClosedLoopInverseDynamics(
        robot, scene.couplings, scene.constraints, efforts, forces=scene.forces
    )
    reactions = JointReactions(robot, inverse.constraints, forces=scene.forces)
    data, moved = robot.model.createData(), 0.0
    for x in list(simulation.run(scene.initial, 0.4))[::20]:
        a = simulation.system.evaluate(x).a
        lam = inverse.solve(x, a).multipliers
        found = reactions.solve(x, a, lam)
        assert out_of_balance(robot, x, a, found, found.closures) <= 1e-9
        expected = sum(
            (force.force(Kinematics(robot, data), x, NONE) for force in scene.forces),
            np.zeros(robot.model.nv),
        )
        expected[robot.joint(joint).v] += torque
        at = [each.v for each in robot.joints]
        assert along_axes(robot, found) == pytest.approx(expected[at], abs=1e-9)
        moved = max(moved, np.abs(x.v).max())
    assert moved > 0.5


def loaded_body():
    """A trunk that turns about a fixed point, a bar between its arms, every kind of load."""
    robot = read_robot(floating_body(), base="floating")
    constraints = [
        FrameAnchor(robot, frame="trunk", position=(0.0,) * 3, kind="point"),
        Distance(robot, frame_a="right", frame_b="left", point_b=(0, 0, -0.5), distance=0.41**0.5),
    ]
    forces = [
        JointSpring(robot, joint="left_swing", stiffness=9.0, damping=0.4),
        GravityCompensation(robot, joints=["right_slide"], factor=0.5),
        AppliedWrench(robot, frame="left", force=(3, 1, -2), torque=(5, 1, 2), point=(0, 0.1, 0)),
        AppliedWrench(robot, frame="right", force=(3, 1, -2), expressed_in="frame"),
        PointSpring(robot, frame_a="right", frame_b="left", stiffness=40.0, damping=2.0),
        PointSpring(robot, frame_a="left", frame_b="universe", stiffness=7.0, length=0.2),
    ]
    return robot, constraints, forces


def test_every_body_balances_under_loads_of_all_kinds():
    """Multipliers of the forward solve; a load that it knows as a force, a recording gave here."""
    robot, constraints, forces = loaded_body()
    rng, data, at = np.random.default_rng(5), robot.model.createData(), (0.1, 0.0, 0.2)
    where = {"frame": "left", "expressed_in": "universe", "point": at}
    load = ExternalWrench(robot, **where)
    for w in rng.normal(size=(5, 6)) * 20.0:
        push = PrescribedWrench(robot, times=[0.0, 2.0], wrenches=[w, w], **where)
        system = build_system(
            robot, Couplings(robot), constraints, Loads(8, [*forces, push]), "kkt"
        )
        x = assemble(system, State(0.7, robot.neutral(), 3.0 * rng.normal(size=8)))
        _, a, _, lam, _ = system.evaluate(x)
        found = JointReactions(robot, system.constraints, [load], forces).solve(x, a, lam, [w])
        again = JointReactions(robot, system.constraints, (), [*forces, push]).solve(x, a, lam)
        assert found.local == pytest.approx(again.local, abs=1e-10)
        pin.forwardKinematics(robot.model, data, x.q, x.v)
        pin.computeJointJacobians(robot.model, data)
        others = [
            one for force in forces for one in force.wrenches(Kinematics(robot, data), x, NONE)
        ]
        assert len(others) == 6
        others += [*found.closures, Wrench("left", np.array(at), w[:3], w[3:])]
        assert out_of_balance(robot, x, a, found, others) <= 1e-9
        assert np.abs(found.local).max() > 10.0
        closed = {wrench.frame for wrench in found.closures}
        assert closed == {"universe", "trunk", "right", "left"}


@pytest.mark.parametrize("name", PARTS["forces"])
def test_wrenches_of_a_force_do_the_work_of_its_generalized_force(name):
    """Sum J' w over the bodies, for every registered force that acts on bodies."""
    urdf = (CONFIG / "robots/prosthetic_leg.urdf").read_text(encoding="utf-8")
    robot, part = read_robot(urdf), resolve("forces", name, "here")
    entry = with_files(part, with_paths(part, part.example, name, robot, {}), name, Path())
    force = schema.call(part, entry, name, robot)
    model, data, rng = robot.model, robot.model.createData(), np.random.default_rng(6)
    x, u = State(0.3, *rng.uniform(-1, 1, (2, model.nv))), rng.normal(size=len(force.inputs))
    x = x._replace(z=rng.uniform(size=len(force.internal)))
    pin.forwardKinematics(model, data, x.q, x.v, np.zeros(model.nv))
    pin.computeJointJacobians(model, data)
    pin.updateFramePlacements(model, data)
    wrenches = force.wrenches(Kinematics(robot, data), x, u)
    assert bool(wrenches) == bool(force.reads)
    total = np.zeros(model.nv)
    for wrench in wrenches:
        J = pin.getFrameJacobian(model, data, robot.frame(wrench.frame), pin.WORLD)
        about_origin = wrench.torque + np.cross(wrench.point, wrench.force)
        total += np.r_[wrench.force, about_origin] @ J
    if wrenches:
        assert total == pytest.approx(force.force(Kinematics(robot, data), x, u), abs=1e-10)


def test_point_pendulum_pulls_with_its_weight_and_the_centrifugal_force():
    """Closed form: m (g cos + l rate^2) along the rod, nothing across it, for a point at l."""
    scene = load_scene(CONFIG / "scenes/benchmark/a01_pendulum.yaml")
    robot, angle, rate = scene.robot, 0.4, 3.0
    inertia = robot.model.inertias[1]
    length = np.linalg.norm(inertia.lever)
    x = State(0.0, np.array([angle]), np.array([rate]))
    a = scene.system().evaluate(x).a
    found = JointReactions(robot, ConstraintRows((), 1)).solve(x, a, np.zeros(0))
    tension = inertia.mass * (9.81 * np.cos(angle) + length * rate**2)
    pull = tension * np.array([-np.sin(angle), np.cos(angle), 0.0])
    assert found.world[0] == pytest.approx([*pull, 0.0, 0.0, 0.0], abs=1e-12)
    assert np.linalg.norm(found.local[0]) == pytest.approx(tension, abs=1e-12)
    assert found.closures == ()
