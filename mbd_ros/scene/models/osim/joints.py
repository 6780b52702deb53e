"""Joints of a model: frames on two bodies, and what turns and slides between them.

Joints on an ellipsoid are chains of turns and slides that follow three coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.urdf import MAX_LINKS
from mbd_ros.core.state import Array
from mbd_ros.scene.models.osim.functions import (
    UnknownFunction,
    function_in,
    function_of,
    is_function,
    scaled,
)
from mbd_ros.scene.models.osim.item import Attached, Frames, Item, old_placement, socket
from mbd_ros.scene.models.urdf_text import (
    IDENTITY,
    Function,
    Motion,
    Names,
    Step,
    X,
    Y,
    Z,
    constant,
    linear,
    sine,
)

_RIGHT = math.pi / 2.0
_TURN_NAMES, _SLIDE_NAMES = ("r1", "r2", "r3"), ("tx", "ty", "tz")
_COUNTS = {  # coordinates that a joint has where the file names fewer
    **{"PinJoint": 1, "SliderJoint": 1, "UniversalJoint": 2, "PlanarJoint": 3, "GimbalJoint": 3},
    **{"BallJoint": 3, "FreeJoint": 6, "EllipsoidJoint": 3, "ScapulothoracicJoint": 4},
}


def read_joints(model: Item, frames: Frames) -> list[Joint]:
    """The joints of a model of any format.

    Raises:
        SceneError: Names file, joint and what is wrong.
    """
    joints = [_joint(item, frames, "") for item in model.components("JointSet", ending="Joint")]
    for body in model.objects("BodySet"):
        for item in body.objects("Joint", "joint"):  # before 4.0 a body holds its joint
            joints.append(_joint(item, frames, body.name))
    if len(joints) > MAX_LINKS:
        raise model.error(f"{len(joints)} joints, accepted are {MAX_LINKS}")
    taken = Names()
    return [_unique(joint, taken) for joint in joints]


class Joint(NamedTuple):
    """A joint from a parent to a child.

    Attributes:
        parent: Its frame on the parent.
        child: Its frame on the child.
        steps: What is between both frames, from the parent to the child.
        missing: What of it is not expressed, empty for most.
    """

    item: Item
    name: str
    parent: Attached
    child: Attached
    coordinates: tuple[Coordinate, ...]
    steps: tuple[Step, ...]
    missing: str = ""

    @property
    def all_steps(self) -> list[Step]:
        """From the parent to the child."""
        return [self.parent.at, *self.steps, self.child.at.inverse()]


class Coordinate(NamedTuple):
    """A coordinate of a joint.

    Attributes:
        default: Position at the start [rad or m].
        speed: Velocity at the start [rad/s or m/s].
        limits: Smallest and largest position [rad or m] where it is clamped, else None.
        locked: Whether it never leaves `default`.
    """

    item: Item
    name: str
    default: float
    speed: float
    limits: tuple[float, float] | None
    locked: bool


def _joint(item: Item, frames: Frames, child: str) -> Joint:
    parent = frames.attached(item, "parent_frame", "parent_body")
    parent = Attached(
        parent.body,
        parent.at * old_placement(item, ("location_in_parent",), ("orientation_in_parent",)),
    )
    if child and not socket(item, "child_frame", "child_body"):
        child_frame = Attached(child, pin.SE3.Identity())
    else:
        child_frame = frames.attached(item, "child_frame", "child_body")
    inner = old_placement(
        item, ("location_in_child", "location"), ("orientation_in_child", "orientation")
    )
    child_frame = Attached(child_frame.body, child_frame.at * inner)
    if parent.body == child_frame.body:
        raise item.error(f"its parent and its child are both '{child_frame.body}'")
    if item.flag("reverse"):
        parent, child_frame = child_frame, parent
    coordinates = _coordinates(item)
    joint = Joint(item, item.name, parent, child_frame, coordinates, ())
    if item.type not in _STEPS:
        return joint._replace(missing=f"{item.type}: held at its frames")
    try:
        steps = _STEPS[item.type](joint)
    except UnknownFunction as error:
        return joint._replace(missing=f"{error}: held at its frames")
    return joint._replace(steps=tuple(steps))


def _coordinates(item: Item) -> tuple[Coordinate, ...]:
    """Those of the file; those that it leaves out have the names that OpenSim gives them."""
    listed = [
        _coordinate(coordinate) for coordinate in item.objects("coordinates", "CoordinateSet")
    ]
    for i in range(len(listed), _COUNTS.get(item.type, 0)):
        listed.append(Coordinate(item, f"{item.name}_coord_{i}", 0.0, 0.0, None, False))
    return tuple(listed)


def _coordinate(item: Item) -> Coordinate:
    lower, upper = _range(item)
    return Coordinate(
        item,
        item.name,
        item.number("default_value", default=0.0),
        item.number("default_speed_value", default=0.0),
        (lower, upper) if item.flag("clamped") and lower < upper else None,
        item.flag("locked"),
    )


def _range(item: Item) -> list[float]:
    """Ends of the range, equal where it has none."""
    words = item.words("range")
    is_open = len(words) != 2 or any("inf" in word.lower() for word in words)
    return [0.0, 0.0] if is_open else item.numbers("range")


def _unique(joint: Joint, taken: Names) -> Joint:
    """The joint with coordinates of names that no joint before it has."""
    names = {}
    for coordinate in joint.coordinates:
        is_new = coordinate.name not in taken
        names[coordinate.name] = taken.take(
            coordinate.name if is_new else f"{joint.name}_{coordinate.name}"
        )
    if all(name == other for name, other in names.items()):
        return joint
    steps = [
        step._replace(coordinate=names.get(step.coordinate, ""))
        if isinstance(step, Motion)
        else step
        for step in joint.steps
    ]
    coordinates = tuple(
        coordinate._replace(name=names[coordinate.name]) for coordinate in joint.coordinates
    )
    return joint._replace(coordinates=coordinates, steps=tuple(steps))


def _hinges(*motions: tuple[Array, bool, int]) -> Callable[[Joint], list[Step]]:
    """Reader of a joint whose coordinates turn about axes and slide along them.

    Args:
        motions: Axis, whether it turns, and the place of its coordinate.
    """

    def steps(joint: Joint) -> list[Step]:
        names = [coordinate.name for coordinate in joint.coordinates]
        return [
            Motion(f"{joint.name}_{names[at]}", axis, turns, IDENTITY, names[at])
            for axis, turns, at in motions
        ]

    return steps


def _custom(joint: Joint) -> list[Step]:
    """Translations in the axes of the parent, then turns in the order of the file."""
    transform = joint.item.find("SpatialTransform")
    axes = list(joint.item.objects("TransformAxisSet") if transform is None else ())
    if transform is not None:
        axes = [axis for axis in transform.children() if axis.type == "TransformAxis"]
    turns, slides = list[Step](), list[Step]()
    for axis in axes:
        is_turn = _is_turn(axis, transform is None)
        kind, endings = (turns, _TURN_NAMES) if is_turn else (slides, _SLIDE_NAMES)
        if len(kind) == len(endings):
            raise joint.item.error(f"{axis.title}: more than three axes of a kind")
        kind.append(_motion(joint, axis, f"{joint.name}_{endings[len(kind)]}", is_turn))
    return [*slides, *turns]


def _is_turn(axis: Item, is_old: bool) -> bool:
    return axis.flag("is_rotation", default=True) if is_old else axis.name.startswith("rot")


def _motion(joint: Joint, axis: Item, name: str, turns: bool) -> Motion:
    direction = np.array(axis.vector("axis", default=None))
    length = float(np.linalg.norm(direction))
    coordinates = axis.words("coordinates", "coordinate")
    known = {coordinate.name for coordinate in joint.coordinates}
    unknown = [coordinate_name for coordinate_name in coordinates if coordinate_name not in known]
    if unknown:
        raise joint.item.error(f"{axis.title}: no coordinate '{unknown[0]}' in this joint")
    function = _function(axis, bool(coordinates))
    if function.constant is None and len(coordinates) != 1:
        raise UnknownFunction(f"function of {len(coordinates)} coordinates in {axis.title}")
    if length == 0.0:
        if function.constant != 0.0:
            raise joint.item.error(f"{axis.title}: <axis> is zero")
        return Motion(name, X, turns, constant(0.0), "")
    if not turns and length != 1.0:
        function = scaled(function, length)
    moves = function.constant is None
    return Motion(name, direction / length, turns, function, coordinates[0] if moves else "")


def _function(axis: Item, moves: bool) -> Function:
    functions = [
        child for child in axis.children() if child.name == "function" and is_function(child)
    ]
    if functions:
        return function_of(functions[0])
    holder = axis.find("function")
    has_one = holder is not None and len(holder.element) > 0
    if not moves and not has_one:
        return constant(0.0)
    others = [child for child in axis.children() if child.name == "function"]
    if others:
        raise UnknownFunction(f"function {others[0].type}")
    return function_in(holder)


def on_ellipsoid(joint: Joint) -> list[Step]:
    """The steps of an EllipsoidJoint."""
    return _steps(joint, joint.item.vector("radii_x_y_z", default=None))


def on_thorax(joint: Joint) -> list[Step]:
    """The steps of a ScapulothoracicJoint: an ellipsoid, then a turn about the axis of winging.

    The axes of the ellipsoid are turned by 90 degrees about z, and turned back behind it.

    Source: A. Seth, R. Matias, A. P. Veloso, S. L. Delp, PLoS ONE 11, 2016, e0141028; signs and
        order as OpenSim 4.6 has them.
    """
    item = joint.item
    x, y, z = item.vector("thoracic_ellipsoid_radii_x_y_z", default=None)
    across, up = item.vector("scapula_winging_axis_origin", default=(0.0, 0.0), length=2)
    angle = item.number("scapula_winging_axis_direction", default=0.0)
    turned = pin.SE3(pin.AngleAxis(_RIGHT, Z).toRotationMatrix(), np.zeros(3))
    origin = pin.SE3(np.eye(3), np.array((across, up, 0.0)))
    axis = np.array((-math.sin(angle), math.cos(angle), 0.0))
    winging = Motion(f"{joint.name}_r6", axis, True, IDENTITY, joint.coordinates[3].name)
    steps = _steps(joint, (y, x, z))
    return [turned, *steps, turned.inverse(), origin, winging, origin.inverse()]


def _steps(joint: Joint, radii: Sequence[float]) -> list[Step]:
    """Turns x, y, z at the point of an ellipsoid whose normal is the z axis that they give.

    That point is (a sin q1, -b sin q0 cos q1, c cos q0 cos q1) with the radii a, b and c. A slide
    along z between turns about x by q0, and one between turns by -q0, add up to any b and c.
    """
    a, b, c = radii
    q0, q1, q2 = (coordinate.name for coordinate in joint.coordinates[:3])
    mean, half = (b + c) / 2.0, (c - b) / 2.0

    def step(ending: str, axis: Array, turns: bool, function: Function, name: str) -> Motion:
        moves = function.constant is None
        return Motion(f"{joint.name}_{ending}", axis, turns, function, name if moves else "")

    middle = [
        step("r2", X, True, linear(-2.0), q0),
        step("tz2", Z, False, sine(half, phase=_RIGHT), q1),
        step("r3", X, True, linear(2.0), q0),
    ]
    return [
        step("tx", X, False, sine(a), q1),
        step("r1", X, True, IDENTITY, q0),
        step("tz", Z, False, sine(mean, phase=_RIGHT), q1),
        *(middle if half else ()),
        step("r4", Y, True, IDENTITY, q1),
        step("r5", Z, True, IDENTITY, q2),
    ]


_TURNS = [(axis, True, i) for i, axis in enumerate((X, Y, Z))]
_SLIDES = [(axis, False, 3 + i) for i, axis in enumerate((X, Y, Z))]
_STEPS: Mapping[str, Callable[[Joint], Sequence[Step]]] = {
    "WeldJoint": _hinges(),
    "PinJoint": _hinges((Z, True, 0)),
    "SliderJoint": _hinges((X, False, 0)),
    "UniversalJoint": _hinges(*_TURNS[:2]),
    "GimbalJoint": _hinges(*_TURNS),
    "BallJoint": _hinges(*_TURNS),
    "PlanarJoint": _hinges((X, False, 1), (Y, False, 2), (Z, True, 0)),
    "FreeJoint": _hinges(*_SLIDES, *_TURNS),
    "CustomJoint": _custom,
    "EllipsoidJoint": on_ellipsoid,
    "ScapulothoracicJoint": on_thorax,
}
