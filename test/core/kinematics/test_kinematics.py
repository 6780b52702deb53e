"""Kinematics k: its numbers against Pinocchio's frames, and who may go past it."""

import ast

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.errors import ModelError

ROBOTS = ROOT / "config/robots"
PARTS = (
    "actuators",
    "constraints",
    "controllers",
    "forces",
    "integrators",
    "stabilization",
)


def trees(folder):
    for path in sorted((ROOT / folder).rglob("*.py")):
        yield path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))


def doors(tree):
    """Lines that read the `Data` of a kinematics called k."""
    return [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr in ("data", "_data")
        and ast.unparse(node.value).split(".")[-1] in ("k", "_k", "kinematics")
    ]


def imports_pinocchio(tree):
    names = [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    names += [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    return any(name.split(".")[0] == "pinocchio" for name in names)


def test_there_is_no_door_past_k():
    found = [f"{path}:{line}" for path, tree in trees("mbd_ros") for line in doors(tree)]
    assert not found, "\n".join(found)
    assert doors(ast.parse("place = self._k.data.oMi[0]")) == [1]


def test_no_part_imports_pinocchio():
    files = [p for f in PARTS for p, tree in trees(f"mbd_ros/{f}") if imports_pinocchio(tree)]
    assert files == []
    assert imports_pinocchio(ast.parse("from pinocchio import SE3"))


@pytest.fixture(params=["arm7", "pendulum", "body"])
def robot(request):
    free = request.param == "body"
    name = "prosthetic_leg" if free else request.param
    text = (ROBOTS / f"{name}.urdf").read_text(encoding="utf-8")
    return read_robot(text, base="floating" if free else "fixed")


@pytest.fixture
def moment(robot):
    rng, model = np.random.default_rng(3), robot.model
    return pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv)), rng.normal(
        size=model.nv
    )


PLACE = {"xyz": (0.1, -0.2, 0.3), "rpy": (0.4, -0.5, 0.6)}


def link_of(robot):
    return next(f.name for f in reversed(robot.model.frames) if f.type == pin.FrameType.BODY)


def with_frame(robot, link):
    """Model with the point as a frame of its own, its data at a state, and the frame."""
    model, at = robot.model.copy(), robot.model.frames[robot.frame(link)]
    place = at.placement * pin.SE3(pin.rpy.rpyToMatrix(*PLACE["rpy"]), np.array(PLACE["xyz"]))
    frame = pin.Frame("spot", at.parentJoint, robot.frame(link), place, pin.FrameType.OP_FRAME)
    index = model.addFrame(frame)
    return model, model.createData(), index


def test_a_point_moves_as_the_frame_that_pinocchio_has_there(robot, moment):
    (q, v), link = moment, link_of(robot)
    k, point = Kinematics(robot), robot.point(link, **PLACE)
    k.refresh(q, v, Reads.DRIFT)
    model, data, frame = with_frame(robot, link)
    pin.computeJointJacobians(model, data, q)
    pin.forwardKinematics(model, data, q, v, 0.0 * v)
    pin.updateFramePlacements(model, data)
    world, own = pin.LOCAL_WORLD_ALIGNED, pin.LOCAL
    J, here = pin.getFrameJacobian(model, data, frame, world), data.oMf[frame]
    bent = pin.getFrameClassicalAcceleration(model, data, frame, world).linear
    pairs = [
        (k.position(point), here.translation),
        (k.rotation(point), here.rotation),
        (k.velocity(point), pin.getFrameVelocity(model, data, frame, world).linear),
        (k.acceleration(point), bent),
        (k.spatial_jacobian(point), J.reshape(6, -1)),
        (k.jacobian(point), J.reshape(6, -1)[:3]),
        (k.local_jacobian(point), pin.getFrameJacobian(model, data, frame, own).reshape(6, -1)),
        (k.jacobian(point) @ v, k.velocity(point)),
    ]
    for found, expected in pairs:
        assert found.shape == expected.shape
        assert found == pytest.approx(expected, rel=1e-13, abs=1e-13)


def test_a_point_at_rest_stands_still(robot, moment):
    k, point = Kinematics(robot), robot.point("universe", **PLACE)
    k.refresh(*moment)
    assert not point.moves
    assert k.position(point) == pytest.approx(PLACE["xyz"], abs=0.0)
    assert k.rotation(point) == pytest.approx(pin.rpy.rpyToMatrix(*PLACE["rpy"]), abs=0.0)
    still = (k.velocity, k.acceleration, k.jacobian, k.spatial_jacobian, k.local_jacobian)
    assert not any(call(point).any() for call in still)
    assert k.spatial_jacobian(point).shape == (6, robot.model.nv)


def test_less_is_refreshed_where_less_is_read_and_the_bits_are_the_same(robot, moment):
    q, v = moment
    point = robot.point(link_of(robot), **PLACE)
    whole = Kinematics(robot)
    whole.refresh(q, v, Reads.DRIFT)
    asked = {
        Reads.POSITION: ("position", "rotation"),
        Reads.VELOCITY: ("position", "rotation", "velocity"),
        Reads.JACOBIAN: ("position", "velocity", "jacobian", "spatial_jacobian"),
    }
    for reads, names in asked.items():
        k = Kinematics(robot)
        k.refresh(q, v, reads)
        for name in names:
            assert np.array_equal(getattr(k, name)(point), getattr(whole, name)(point)), name
    idle = Kinematics(robot)
    idle.refresh(q, v, Reads.NOTHING)
    start = Kinematics(robot).position(point)
    assert np.array_equal(idle.position(point), start)
    assert not np.array_equal(whole.position(point), start)


def test_two_data_do_not_meet_and_late_points_are_bound(robot, moment):
    q, v = moment
    early, k, other = robot.point(link_of(robot), **PLACE), Kinematics(robot), Kinematics(robot)
    k.refresh(q, v)
    other.refresh(robot.neutral(), 0.0 * v)
    before = k.position(early).copy()
    assert not np.array_equal(before, other.position(early))
    assert np.array_equal(before, k.position(early))
    late = robot.point(link_of(robot), (0.1, 0.3, 0.3))
    assert np.linalg.norm(k.position(late) - before) == pytest.approx(0.5, rel=1e-13)
    k.refresh(robot.neutral(), v)
    assert np.array_equal(k.position(early), other.position(early))


def test_a_point_has_one_number_however_often_it_is_asked_for(robot):
    link = link_of(robot)
    count = len(robot.places.points)
    points = [robot.point(link, **PLACE) for _ in range(3)]
    assert len({point.number for point in points}) == 1
    assert len(robot.places.points) == count + 1
    turned = robot.rotated(points[0], pin.rpy.rpyToMatrix(0.0, 0.0, 1.0))
    assert turned.number != points[0].number
    pairs = [robot.pair(robot.point("universe"), points[0]) for _ in range(2)]
    assert pairs[0].number == pairs[1].number


def test_points_that_do_not_exist_are_named(robot):
    link = link_of(robot)
    with pytest.raises(ModelError, match="no frame 'nose'; the links are"):
        robot.point("nose")
    with pytest.raises(ModelError, match="have no relative motion"):
        robot.pair(robot.point(link), robot.point(link, (0.0, 1.0, 0.0)))
