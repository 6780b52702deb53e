"""Limits, bushings, springs along paths and forces on bodies: closed forms, power, other parts."""

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import NONE, State
from mbd_ros.errors import SceneError
from mbd_ros.parts.forces.applied_wrench import AppliedWrench
from mbd_ros.parts.forces.body_force import BodyForce
from mbd_ros.parts.forces.bushing import Bushing
from mbd_ros.parts.forces.soft_limit import SoftLimit
from mbd_ros.scene.from_python import scene_from

SCENE = scene_from(urdf="arm7")
ROBOT = SCENE.robot
THREE = ([100.0, 200.0, 300.0], [1.0, 2.0, 3.0], [5.0, 6.0, 7.0], [0.1, 0.2, 0.3])
NUMBERS = ("stiffness", "damping", "angular_stiffness", "angular_damping")


def moment(seed):
    """Kinematics, State: random posture and speeds."""
    rng, nv = np.random.default_rng(seed), ROBOT.model.nv
    x = State(0.0, rng.uniform(-1.0, 1.0, nv), rng.uniform(-1.0, 1.0, nv))
    k = Kinematics(ROBOT)
    k.refresh(x.q, x.v)
    return k, x


@pytest.mark.parametrize(
    ("q", "v", "expected"),
    [
        (0.0, 2.0, 0.0),
        (0.35, 0.0, -40.0 * 0.5 * 0.05),  # half of the transition: half of the spring
        (0.5, 2.0, -40.0 * 0.2 - 2.0),  # beyond it: all of the spring and of the damper
        (-0.6, 0.0, 50.0 * 0.3),
    ],
)
def test_a_soft_limit_is_a_spring_beyond_its_transition(q, v, expected):
    given = {"lower": -0.3, "upper": 0.3, "lower_stiffness": 50.0, "upper_stiffness": 40.0}
    part = SoftLimit(ROBOT, joint="joint4", transition=0.1, damping=1.0, **given)
    k, x = moment(0)
    joint = ROBOT.joint("joint4")
    x.q[joint.q], x.v[joint.v] = q, v
    tau = part.force(k, x, NONE)
    assert tau[joint.v] == pytest.approx(expected, rel=1e-14)
    assert not np.delete(tau, joint.v).any()


def deflection(q):
    """Offset and body-fixed angles of link5 as link2 sees them, by Pinocchio alone."""
    model, data = ROBOT.model, ROBOT.model.createData()
    pin.framesForwardKinematics(model, data, q)
    a, b = (data.oMf[model.getFrameId(name)] for name in ("link2", "link5"))
    at = a.actInv(b)
    turned = at.rotation
    angles = pin.rpy.matrixToRpy(turned.T)  # (Rx Ry Rz)' = Rz' Ry' Rx' has angles -x, -y, -z
    return np.concatenate((at.translation, -angles))


@pytest.mark.parametrize("seed", range(3))
def test_a_bushing_does_the_work_of_its_springs_and_dampers(seed):
    """Power is -(K d + D d') . d' with the rates of the deflections by differences."""
    part = Bushing(
        ROBOT, frame_a="link2", frame_b="link5", **dict(zip(NUMBERS, THREE, strict=True))
    )
    k, x = moment(seed)
    step = 1e-6
    rates = (deflection(x.q + step * x.v) - deflection(x.q - step * x.v)) / (2.0 * step)
    stiffness, damping = np.concatenate(THREE[::2]), np.concatenate(THREE[1::2])
    load = stiffness * deflection(x.q) + damping * rates
    assert x.v @ part.force(k, x, NONE) == pytest.approx(-load @ rates, rel=1e-8)


def test_a_force_on_a_body_is_that_of_an_applied_wrench():
    k, x = moment(4)
    at = {"frame": "link6", "point": [0.1, 0.0, -0.05]}
    asked = BodyForce(ROBOT, direction=[0.0, 2.0, 0.0], **at)
    held = AppliedWrench(ROBOT, force=[0.0, 7.0, 0.0], expressed_in="frame", **at)
    tau = asked.force(k, x, np.array([7.0]))
    assert tau == pytest.approx(held.force(k, x, NONE), abs=1e-13)
    assert asked.columns(k, x)[:, 0] * 7.0 == pytest.approx(tau, abs=1e-14)


@pytest.mark.parametrize("axes", ["frame", "world"])
def test_a_torque_against_another_body_moves_joints_between_them_alone(axes):
    """Its power is that of the relative angular velocity along the axis."""
    k, x = moment(5)
    given = {"kind": "torque", "direction": [1.0, 2.0, 3.0], "expressed_in": axes}
    part = BodyForce(ROBOT, frame="link6", against="link3", **given)
    tau = part.force(k, x, np.array([2.0]))
    assert np.abs(tau[:3]).max() < 1e-14
    model, data = ROBOT.model, ROBOT.model.createData()
    pin.forwardKinematics(model, data, x.q, x.v)
    ends = [model.getFrameId(name) for name in ("link6", "link3")]
    turns = [pin.getFrameVelocity(model, data, i, pin.LOCAL_WORLD_ALIGNED).angular for i in ends]
    pin.updateFramePlacements(model, data)
    along = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    if axes == "frame":
        along = data.oMf[ends[0]].rotation @ along
    assert x.v @ tau == pytest.approx(2.0 * along @ (turns[0] - turns[1]), rel=1e-12)


PATH = {"points": [{"frame": "world", "xyz": [0.3, 0.0, 1.0]}, {"frame": "link6"}]}


def test_forces_along_a_path_pull_by_their_laws():
    """tau = -F dl/dq with the F of each part, from lengths by differences."""
    springs = [
        {"type": "path_spring", "name": "taut", "path": "line", "stiffness": 900.0}
        | {"resting_length": 0.01, "dissipation": 0.2},
        {"type": "path_spring", "name": "slack", "path": "line", "stiffness": 900.0}
        | {"resting_length": 9.0},
        {"type": "path_force", "name": "asked", "path": "line", "limit": 50.0},
    ]
    scene = scene_from({"forces": springs, "paths": {"line": PATH}}, urdf="arm7")
    _, x = moment(6)
    k, path = Kinematics(scene.robot), scene.parts["paths"]["line"]

    def length(q):
        k.refresh(q, x.v)
        return path.length(k, x._replace(q=q))

    step, nv = 1e-6, ROBOT.model.nv
    ways = [step * row for row in np.eye(nv)]
    slope = np.array([length(x.q + way) - length(x.q - way) for way in ways]) / (2.0 * step)
    taut = 900.0 * (length(x.q) - 0.01) * (1.0 + 0.2 * slope @ x.v)
    k.refresh(x.q, x.v)
    for part, pull in zip(scene.forces, (taut, 0.0, 50.0), strict=True):
        tau = part.force(k, x, np.array([80.0]))  # more than the limit
        assert tau == pytest.approx(-pull * slope, abs=1e-6)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            {"type": "soft_limit", "joint": "joint4", "transition": 0.1},
            "lower and upper are missing",
        ),
        (
            {"type": "soft_limit", "joint": "joint4", "transition": 0.1, "lower": 1, "upper": 0},
            "lower 1 is above upper 0",
        ),
        (
            {"type": "bushing", "frame_a": "link2", "frame_b": "link5", "damping": [0, -1, 0]},
            "stiffness and damping must be 0 or more",
        ),
        (
            {"type": "body_force", "frame": "link5", "direction": [0, 0, 0]},
            "direction [0.0, 0.0, 0.0] has no length",
        ),
        (
            {"type": "body_force", "frame": "link5", "direction": [0, 0, 1], "against": "link2"},
            "against is accepted with kind: torque",
        ),
        (
            {"type": "body_force", "frame": "base", "direction": [0, 0, 1]},
            "frame 'base' cannot move",
        ),
    ],
)
def test_numbers_that_mean_nothing_are_refused(entry, message):
    with pytest.raises(SceneError) as caught:
        scene_from({"forces": [entry]}, urdf="arm7")
    assert message in str(caught.value)
