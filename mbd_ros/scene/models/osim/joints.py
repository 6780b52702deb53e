"""Joints and bodies of a model -> joints and links of a description."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.imported import LeftOut
from mbd_ros.scene.models.osim.functions import (
    UnknownFunction,
    function_in,
    function_of,
    is_function,
    scaled,
)
from mbd_ros.scene.models.osim.item import GROUND, Attached, Frames, Item, old_placement, socket
from mbd_ros.scene.models.urdf_text import (
    IDENTITY,
    Function,
    Motion,
    Names,
    Step,
    UrdfJoint,
    X,
    Y,
    Z,
    constant,
    linear,
    sine,
)

# ---- motions ----------------------------------------------------------------------------------
# What a joint of a model is: frames on two bodies, and what turns and slides between them.


class Coordinate(NamedTuple):
    """A coordinate of a joint.

    Attributes:
        item: The element.
        name: Its name.
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


class Joint(NamedTuple):
    """A joint from a parent to a child.

    Attributes:
        item: The element.
        name: Its name.
        parent: Its frame on the parent.
        child: Its frame on the child.
        coordinates: Its coordinates.
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
    def whole(self) -> list[Step]:
        """From the parent to the child."""
        return [self.parent.at, *self.steps, self.child.at.inverse()]


# ---- ellipsoid --------------------------------------------------------------------------------
# Joints on an ellipsoid as chains of turns and slides that follow three coordinates.


_RIGHT = math.pi / 2.0


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
    q0, q1, q2 = (one.name for one in joint.coordinates[:3])
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


# ---- joints -----------------------------------------------------------------------------------
# Joints of a model: from parent to child, what is fixed and what moves by which coordinate.


def read_joints(model: Item, frames: Frames) -> list[Joint]:
    """The joints of a model of any format.

    Raises:
        SceneError: Names file, joint and what is wrong.
    """
    found = [_joint(item, frames, "") for item in model.components("JointSet", ending="Joint")]
    for body in model.objects("BodySet"):
        for item in body.objects("Joint", "joint"):  # before 4.0 a body holds its joint
            found.append(_joint(item, frames, body.name))
    taken = Names()
    return [_unique(joint, taken) for joint in found]


def _unique(joint: Joint, taken: Names) -> Joint:
    """The joint with coordinates of names that no joint before it has."""
    names = {}
    for one in joint.coordinates:
        is_new = one.name not in taken
        names[one.name] = taken.take(one.name if is_new else f"{joint.name}_{one.name}")
    if all(name == other for name, other in names.items()):
        return joint
    steps = [
        step._replace(coordinate=names.get(step.coordinate, ""))
        if isinstance(step, Motion)
        else step
        for step in joint.steps
    ]
    coordinates = tuple(one._replace(name=names[one.name]) for one in joint.coordinates)
    return joint._replace(coordinates=coordinates, steps=tuple(steps))


def _joint(item: Item, frames: Frames, child: str) -> Joint:
    parent = frames.attached(item, "parent_frame", "parent_body")
    parent = Attached(
        parent.body,
        parent.at * old_placement(item, ("location_in_parent",), ("orientation_in_parent",)),
    )
    if child and not socket(item, "child_frame", "child_body"):
        own = Attached(child, pin.SE3.Identity())
    else:
        own = frames.attached(item, "child_frame", "child_body")
    inner = old_placement(
        item, ("location_in_child", "location"), ("orientation_in_child", "orientation")
    )
    own = Attached(own.body, own.at * inner)
    if parent.body == own.body:
        raise item.error(f"its parent and its child are both '{own.body}'")
    if item.flag("reverse"):
        parent, own = own, parent
    coordinates = _coordinates(item)
    joint = Joint(item, item.name, parent, own, coordinates, ())
    if item.type not in _STEPS:
        return joint._replace(missing=f"{item.type}: held at its frames")
    try:
        steps = _STEPS[item.type](joint)
    except UnknownFunction as error:
        return joint._replace(missing=f"{error}: held at its frames")
    return joint._replace(steps=tuple(steps))


def _coordinates(item: Item) -> tuple[Coordinate, ...]:
    """Those of the file; those that it leaves out have the names that OpenSim gives them."""
    found = [_coordinate(one) for one in item.objects("coordinates", "CoordinateSet")]
    for i in range(len(found), _COUNTS.get(item.type, 0)):
        found.append(Coordinate(item, f"{item.name}_coord_{i}", 0.0, 0.0, None, False))
    return tuple(found)


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
    own = {coordinate.name for coordinate in joint.coordinates}
    unknown = [one for one in coordinates if one not in own]
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
    own = [one for one in axis.children() if one.name == "function" and is_function(one)]
    if own:
        return function_of(own[0])
    holder = axis.find("function")
    has_one = holder is not None and len(holder.element) > 0
    if not moves and not has_one:
        return constant(0.0)
    others = [one for one in axis.children() if one.name == "function"]
    if others:
        raise UnknownFunction(f"function {others[0].type}")
    return function_in(holder)


_TURN_NAMES, _SLIDE_NAMES = ("r1", "r2", "r3"), ("tx", "ty", "tz")
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
_COUNTS = {
    **{"PinJoint": 1, "SliderJoint": 1, "UniversalJoint": 2, "PlanarJoint": 3},
    **{
        "GimbalJoint": 3,
        "BallJoint": 3,
        "FreeJoint": 6,
        "EllipsoidJoint": 3,
        "ScapulothoracicJoint": 4,
    },
}


# ---- mechanism --------------------------------------------------------------------------------
# Joints and bodies of a model -> joints and links of a description, couplings and starts.


_SAME = 1.0e-14  # of a placement that is none


class Follows(NamedTuple):
    """A joint that follows a coordinate by a function."""

    coordinate: str
    function: Function


class Mechanism:
    """The joints and links of a model.

    Args:
        joints: In the order of the tree, each after what carries its parent.
        links: Names of the bodies, ground first.

    Attributes:
        joints: Of the description.
        links: Names of its links, ground first.
        follows: Joint -> what it follows, of those that are no coordinates.
        coordinates: By name.
        unused: Coordinates that move nothing.
    """

    def __init__(self, joints: Sequence[Joint], links: Sequence[str]) -> None:
        self.coordinates = {c.name: c for joint in joints for c in joint.coordinates}
        self.joints: list[UrdfJoint] = []
        self.links = list(links)
        self.follows: dict[str, Follows] = {}
        self.unused: list[Coordinate] = []
        self._links = Names(self.links)
        self._names = Names(self.coordinates)
        for joint in joints:
            self._add(joint)

    def carriers(self, fixed: Mapping[str, float]) -> dict[str, str]:
        """Link -> the joint that carries it where some do not move, empty for ground."""
        found = {GROUND: ""}
        for joint in self.joints:
            moves = joint.motion is not None and joint.name not in fixed
            found[joint.child] = joint.name if moves else found[joint.parent]
        return found

    def _add(self, joint: Joint) -> None:
        steps, carriers = joint.whole, _carriers(joint)
        if joint.parent.body not in self.links:
            raise joint.item.error(f"its parent '{joint.parent.body}' is not in the tree")
        parent, origin = joint.parent.body, pin.SE3.Identity()
        for i, step in enumerate(steps):
            if not _moves(step):
                origin = origin * _placed(step)
                continue
            assert isinstance(step, Motion)
            is_last = _is_none(steps[i + 1 :])
            child = joint.child.body if is_last else self._link(step.name)
            parent = self._moved(step, carriers, parent, child, origin)
            origin = pin.SE3.Identity()
        if parent != joint.child.body:
            wish = joint.name or joint.child.body
            name = self._names.take(f"{wish}_weld" if wish in self.links else wish, "weld")
            self.joints.append(UrdfJoint(name, parent, joint.child.body, origin))
        self._add_unseen(joint, carriers)

    def _moved(
        self, step: Motion, carriers: Mapping[str, Motion], parent: str, child: str, origin: Any
    ) -> str:
        """Add a joint that moves; the link that it carries."""
        if carriers.get(step.coordinate) is step:
            slope, offset = step.function.slope, step.function.offset
            own = step._replace(axis=step.axis * slope, function=IDENTITY)
            limits = self.coordinates[step.coordinate].limits
            placed = origin * step.at(offset)
            self.joints.append(UrdfJoint(step.coordinate, parent, child, placed, own, limits))
        else:
            name = self._names.take(step.name)
            self.joints.append(UrdfJoint(name, parent, child, origin, step))
            self.follows[name] = Follows(step.coordinate, step.function)
        return child

    def _add_unseen(self, joint: Joint, carriers: Mapping[str, Motion]) -> None:
        """A link without mass for a coordinate that nothing follows one to one."""
        for coordinate in joint.coordinates:
            users = [s for s in joint.steps if _moves(s) and s.coordinate == coordinate.name]
            if not users:
                self.unused.append(coordinate)
            elif coordinate.name not in carriers:
                turns = any(one.turns for one in users)
                motion = Motion("", users[0].axis, turns, IDENTITY, coordinate.name)
                child = self._link(coordinate.name)
                at = UrdfJoint(
                    coordinate.name,
                    joint.parent.body,
                    child,
                    joint.parent.at,
                    motion,
                    coordinate.limits,
                )
                self.joints.append(at)

    def _link(self, wish: str) -> str:
        name = self._links.take(f"{wish}_link")
        self.links.append(name)
        return name


def in_tree_order(
    joints: Sequence[Joint], frames: Frames, model: Item
) -> tuple[list[Joint], list[Joint]]:
    """Joints from ground outwards, turned round where that is needed, and those that close loops.

    Bodies without any joint move freely.

    Raises:
        SceneError: Two joints of one name.
    """
    left, placed, ordered = list(joints), {GROUND}, list[Joint]()
    while left or len(placed) < len(frames.bodies):
        found = _next(left, placed)
        if found is not None:
            left.remove(found)
            found = found if found.parent.body in placed else turned_round(found)
        else:
            body = _base(left, placed, frames)
            if body is None:
                break
            found = free_joint(body, model)
        ordered.append(found)
        placed.add(found.child.body)
    return ordered, left


def _next(left: Sequence[Joint], placed: set[str]) -> Joint | None:
    """The next joint from a body that is placed to one that is not, else one the other way."""
    ends = [(joint.parent.body in placed, joint.child.body in placed) for joint in left]
    for wish in ((True, False), (False, True)):
        if wish in ends:
            return left[ends.index(wish)]
    return None


def _base(left: Sequence[Joint], placed: set[str], frames: Frames) -> str | None:
    """A body that no joint carries, or one of those that only hang together among themselves."""
    loose = [body for body in frames.bodies if body not in placed]
    carried = {joint.child.body for joint in left}
    return next((body for body in loose if body not in carried), loose[0] if loose else None)


def turned_round(joint: Joint) -> Joint:
    """The same joint from its child to its parent."""
    steps = tuple(step.inverse() for step in reversed(joint.steps))
    return joint._replace(parent=joint.child, child=joint.parent, steps=steps)


def free_joint(body: str, model: Item) -> Joint:
    """Six joints of a body that nothing holds, as OpenSim calls their coordinates."""
    item = Item(model.element.makeelement("FreeJoint", {"name": f"free_{body}"}), model.source)
    names = [f"free_{body}_coord_{i}" for i in range(6)]
    coordinates = tuple(Coordinate(item, name, 0.0, 0.0, None, False) for name in names)
    six = [(axis, False, names[3 + i]) for i, axis in enumerate((X, Y, Z))]
    six += [(axis, True, names[i]) for i, axis in enumerate((X, Y, Z))]
    steps = tuple(Motion(name, axis, turns, IDENTITY, name) for axis, turns, name in six)
    ends = Attached(GROUND, pin.SE3.Identity()), Attached(body, pin.SE3.Identity())
    return Joint(item, item.name, *ends, coordinates, steps)


def _carriers(joint: Joint) -> dict[str, Motion]:
    """Coordinate -> the motion that is the coordinate itself, perhaps backwards, turns first."""
    found: dict[str, Motion] = {}
    motions = [step for step in joint.steps if _moves(step)]
    for step in sorted(motions, key=lambda one: not one.turns):
        if step.function.slope in (1.0, -1.0):
            found.setdefault(step.coordinate, step)
    return found


def _moves(step: Step) -> bool:
    return isinstance(step, Motion) and step.function.constant is None


def _placed(step: Step) -> Any:
    return step.at(step.function.constant) if isinstance(step, Motion) else step


def _is_none(rest: Iterable[Step]) -> bool:
    """Whether nothing follows but placements that are none."""
    whole = pin.SE3.Identity()
    for step in rest:
        if _moves(step):
            return False
        whole = whole * _placed(step)
    return bool(np.abs(whole.homogeneous - np.eye(4)).max() <= _SAME)


# ---- couplers ---------------------------------------------------------------------------------
# Coordinates that follow others, are locked or prescribed.


COUPLER = "CoordinateCouplerConstraint"


class Coupled(NamedTuple):
    """What the coordinates of a model do besides moving.

    Attributes:
        follows: Coordinate -> what it follows.
        fixed: Coordinate or coupled joint -> position [rad or m] that it never leaves.
        left_out: Couplers that are not expressed.
    """

    follows: dict[str, Follows]
    fixed: dict[str, float]
    left_out: list[LeftOut]


def read_couplers(
    model: Item,
    coordinates: Mapping[str, Coordinate],
    joints: Mapping[str, Follows],
    locked: Mapping[str, float | None],
) -> Coupled:
    """Couplers of coordinates, and what stands still because coordinates do.

    Args:
        model: The `<Model>`.
        coordinates: By name.
        joints: Joints that follow a coordinate by a function of their joint.
        locked: Coordinate -> position where the scene locks it, None where it frees it.

    Raises:
        SceneError: Names coupler and what is wrong.
    """
    found = Coupled({}, {}, [])
    for name, coordinate in coordinates.items():
        if coordinate.locked or _prescribed_constant(coordinate) is not None:
            value = _prescribed_constant(coordinate)
            found.fixed[name] = coordinate.default if value is None else value
    for name, position in locked.items():
        if position is None:
            found.fixed.pop(name, None)
        else:
            found.fixed[name] = position
    for item in model.components("ConstraintSet", ending=COUPLER):
        if item.type == COUPLER and is_enforced(item):
            _add(found, item, coordinates)
    found.follows.update(joints)
    _settle(found, model.source)
    return found


def is_enforced(item: Item) -> bool:
    """Whether a constraint acts."""
    return item.flag("isEnforced", default=not item.flag("isDisabled"))


def _prescribed_constant(coordinate: Coordinate) -> float | None:
    """Position of a coordinate that is prescribed to stand still."""
    if not coordinate.item.flag("prescribed"):
        return None
    try:
        function = function_in(coordinate.item.find("prescribed_function"))
    except UnknownFunction:
        return None
    return function.constant


def _add(found: Coupled, item: Item, coordinates: Mapping[str, Coordinate]) -> None:
    parents = item.words("independent_coordinate_names")
    child = item.text("dependent_coordinate_name")
    for name in (child, *parents):
        if name not in coordinates:
            raise item.error(f"there is no coordinate '{name}'")
    reason = ""
    if len(parents) != 1:
        reason = f"follows {len(parents)} coordinates"
    elif child in found.fixed:
        reason = f"'{child}' is locked"
    elif child in found.follows:
        reason = f"'{child}' follows '{found.follows[child].coordinate}' already"
    try:
        function = function_in(item.find("coupled_coordinates_function"))
    except UnknownFunction as error:
        reason = reason or str(error)
    if reason:
        found.left_out.append(LeftOut(item.type, item.name, reason))
        return
    scale = item.number("scale_factor", default=1.0)
    function = function if scale == 1.0 else scaled(function, scale)
    if function.constant is not None:
        found.fixed[child] = function.constant
    else:
        found.follows[child] = Follows(parents[0], function)


def _settle(found: Coupled, source: str) -> None:
    """What follows something that stands still stands still."""
    settled = True
    while settled:
        settled = False
        for name, (parent, function) in list(found.follows.items()):
            if parent in found.fixed:
                found.fixed[name] = function.value(found.fixed[parent], f"{source}: {name}")
                del found.follows[name]
                settled = True


def entry_of(parent: str, function: Function) -> dict[str, Any]:
    """An entry of `couplings`."""
    return {"parent": parent, **function.entry}
