"""Translation of a scene for other packages."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.rows.constraint import Constraint, Kind
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.coupling_entries import coupling_kinds
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.schema.sections import SECTIONS, keys

# Constraints of a scene as pairs of frames, as other packages take them.
_CLOSED = 1.0e-8  # m: directions that no row holds and that stay closed by themselves
_LEVER = 0.1  # m, between the two points that make an axis
_FORCES = ("joint_friction", "joint_spring", "joint_torque", "point_spring")


def task_of(ground: Ground, states: Sequence[State] = ()) -> Task:
    """The task of a scene for other packages.

    Args:
        states: States of all joints on its motion. They show whether loops that are closed along
            some directions stay closed along the others.

    Raises:
        SceneError: It has parts that they cannot express, named.
    """
    scene = ground.scene
    if others := [base.name for base in scene.robot.bases if base.joint > 1]:
        raise SceneError(f"bodies: peers take one free body, the first, not {', '.join(others)}")
    simulation = build_simulation(scene)
    x = simulation.system.expand(simulation.start(scene.initial))
    rows = Rows(scene, [x, *states])
    for entry in ground.constraints:
        rows.add(entry)
    return Task(
        np.array(scene.robot.model.gravity.linear),
        (None, *_bodies(scene, ground.forces)),
        scene.robot.floating,
        x.q,
        x.v,
        (*_couplings(scene), *rows.follows),
        tuple(rows.points),
        tuple(rows.welds),
        tuple(rows.bars),
        tuple(_springs(scene, ground.forces)),
    )


class Ground(NamedTuple):
    """The common ground of all packages.

    Attributes:
        scene: The scene without the loads that no peer has.
        constraints: Rest of that section.
        forces: Rest of that section.
        left: Parts that were left out, such as `forces[1] (switching_force)`.
    """

    scene: Scene
    constraints: tuple[Entry, ...]
    forces: tuple[Entry, ...]
    left: tuple[str, ...]


class Entry(NamedTuple):
    """A part of a scene that peers are told.

    Attributes:
        kind: Its `type`.
        words: All its keys, those that the scene leaves out with their defaults.
        where: File and key.
    """

    kind: str
    words: Mapping[str, Any]
    where: str


def _bodies(scene: Scene, forces: Sequence[Entry]) -> Iterator[Body]:
    robot = scene.robot
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, robot.neutral(), np.zeros(model.nv))
    names = {joint.v: joint.name for joint in robot.joints}
    for i in range(1, model.njoints):
        joint, place, inertia = model.joints[i], model.jointPlacements[i], model.inertias[i]
        common = int(model.parents[i]), place
        if joint.nv > 1:
            yield Body("base", *common, np.zeros(3), False, inertia)
            continue
        subspace = np.asarray(data.joints[i].S).reshape(6)
        slides = bool(subspace[:3].any())
        axis = subspace[:3] if slides else subspace[3:]
        name = names[joint.idx_v]
        loads = _joint_loads(name, forces)
        armature = float(model.armature[joint.idx_v])
        yield Body(name, *common, axis, slides, inertia, armature, *loads)


class Body(NamedTuple):
    """A body and the joint that carries it, whose frame is the frame of the body.

    Attributes:
        name: Of the joint; `base` for a free one.
        parent: Index of the body that carries the joint; 0 is the world.
        place: Frame of the joint in that body at position 0, an SE3.
        axis: In the axes of the joint, shape (3,); zero for a free body.
        slides: Whether the joint is prismatic.
        inertia: Mass, centre and moments in the axes of the joint, a spatial inertia.
        armature: Inertia that a drive adds to the joint [kg·m^2 or kg].
        stiffness: Of springs in the joint [N·m/rad or N/m].
        rest: Position without spring force [rad or m].
        damping: [N·m·s/rad or N·s/m].
        torque: Constant [N·m or N].
    """

    name: str
    parent: int
    place: Any
    axis: Array
    slides: bool
    inertia: Any
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    torque: float = 0.0


def _joint_loads(name: str, forces: Sequence[Entry]) -> tuple[float, float, float, float]:
    """Stiffness, rest position, damping and torque of all that acts in a joint.

    Springs add up to one at the position at which they are in balance.
    """
    stiffness = moment = damping = torque = 0.0
    for _, words, _ in (entry for entry in forces if entry.words.get("joint") == name):
        k = float(words.get("stiffness", 0.0))
        stiffness, moment = stiffness + k, moment + k * float(words.get("rest", 0.0))
        damping += float(words.get("damping", 0.0)) + float(words.get("viscous", 0.0))
        torque += float(words.get("torque", 0.0))
    return stiffness, moment / stiffness if stiffness else 0.0, damping, torque


def _couplings(scene: Scene) -> Iterator[Follow]:
    by_joint = scene.entries.get("couplings", {})
    model = scene.robot.model
    bodies = {int(joint.idx_v): i for i, joint in enumerate(model.joints) if i}
    links = zip(scene.couplings.dependent, scene.couplings.pairs, strict=True)
    for name, link in links:
        if isinstance(link.function, Linear):
            coefficients: tuple[float, ...] = (link.function.offset, link.function.factor)
        elif "polynomial" in by_joint[name]:
            coefficients = tuple(float(c) for c in by_joint[name]["polynomial"])
        else:
            kind = coupling_kinds(scene)[name]
            raise SceneError(f"couplings.{name}: peers take polynomials, not {kind}")
        yield Follow(bodies[link.child_v], bodies[link.parent_v], coefficients)


class Follow(NamedTuple):
    """child = c0 + c1 parent + c2 parent^2 + .., with indices of bodies."""

    child: int
    parent: int
    coefficients: tuple[float, ...]


def _springs(scene: Scene, forces: Sequence[Entry]) -> Iterator[Spring]:
    for _, words, _ in (entry for entry in forces if entry.kind == "point_spring"):
        ends = (end_of(scene, words[f"frame_{c}"], words[f"point_{c}"]) for c in "ab")
        numbers = (float(words[key]) for key in ("stiffness", "damping", "length"))
        yield Spring(*ends, *numbers)


class Spring(NamedTuple):
    """Spring and damper between two points."""

    a: End
    b: End
    stiffness: float
    damping: float
    length: float


class End(NamedTuple):
    """A frame that travels with a body: index of the body, and its place there as SE3."""

    body: int
    place: Any


def end_of(
    scene: Scene, frame: str, point: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)
) -> End:
    """A point of a link, with axes turned by roll, pitch and yaw [m, rad]."""
    link = scene.robot.model.frames[scene.robot.frame(frame)]
    rotation = pin.rpy.rpyToMatrix(np.array(rpy, dtype=np.float64))
    at = pin.SE3(rotation, np.array(point, dtype=np.float64))
    return End(int(link.parentJoint), link.placement * at)


class Task(NamedTuple):
    """A scene for other packages.

    Attributes:
        gravity: [m/s^2], shape (3,).
        bodies: The world's place stands first and is None; parents before children.
        is_floating: Whether body 1 is free: its coordinates come first in q and v.
        q: Assembled start [rad or m], shape (nq,); that of a free body is x, y, z, then the
            quaternion x, y, z, w.
        v: Its velocity, shape (nv,); that of a free body is linear, then angular, in its axes.
        follows: Joints that follow others.
        points: Pairs of frames whose origins coincide.
        welds: Pairs of frames that coincide.
        bars: Pairs of frames whose origins keep a distance [m].
        springs: Springs between points.
    """

    gravity: Array
    bodies: tuple[Body | None, ...]
    is_floating: bool
    q: Array
    v: Array
    follows: tuple[Follow, ...]
    points: tuple[tuple[End, End], ...]
    welds: tuple[tuple[End, End], ...]
    bars: tuple[tuple[End, End, float], ...]
    springs: tuple[Spring, ...]

    @property
    def has_rows(self) -> bool:
        """Whether anything but joints constrains the motion."""
        return bool(self.follows or self.points or self.welds or self.bars)

    @property
    def moving(self) -> tuple[Body, ...]:
        """The bodies without the world."""
        return tuple(body for body in self.bodies if body is not None)

    @property
    def torques(self) -> Array:
        """Constant torques [N·m or N], shape (nv,)."""
        return np.array([0.0] * (6 * self.is_floating) + [body.torque for body in self.joints])

    @property
    def joints(self) -> tuple[Body, ...]:
        """The bodies with one coordinate."""
        return self.moving[int(self.is_floating) :]


class Rows:
    """Constraints as pairs of frames.

    Args:
        states: Of all joints, on its motion.
    """

    def __init__(self, scene: Scene, states: Sequence[State]) -> None:
        self._scene, self._states = scene, states
        self.points: list[tuple[End, End]] = []
        self.welds: list[tuple[End, End]] = []
        self.bars: list[tuple[End, End, float]] = []
        self.follows: list[Follow] = []

    def add(self, entry: Entry) -> None:
        """Take one constraint.

        Raises:
            SceneError: Peers cannot express it.
        """
        adds = {
            "loop_closure": self._loop,
            "frame_anchor": self._anchor,
            "distance": self._bar,
            "screw": self._screw,
        }
        if entry.kind not in adds:
            known = ", ".join(adds)
            raise SceneError(f"{entry.where}: peers take {known}, not {entry.kind}")
        adds[entry.kind](entry)

    def _loop(self, entry: Entry) -> None:
        words = entry.words
        a, b = (
            end_of(self._scene, words[f"frame_{c}"], words[f"point_{c}"], words[f"rpy_{c}"])
            for c in "ab"
        )
        free = [i for i, axis in enumerate("xyz") if axis not in words["directions"]]
        if free and not self._stays_closed(a, b, free):
            raise SceneError(
                f"{entry.where}: peers close all directions, not only {words['directions']}"
            )
        if words["kind"] == "full":
            self.welds.append((a, b))
            return
        self.points.append((a, b))
        if words["kind"] == "revolute":
            step = pin.SE3(np.eye(3), _LEVER * np.eye(3)["xyz".index(words["axis"])])
            self.points.append((End(a.body, a.place * step), End(b.body, b.place * step)))

    def _anchor(self, entry: Entry) -> None:
        words = entry.words
        held = end_of(self._scene, words["frame"], words["point"], words["rpy"])
        turned = words["orientation"] or (0.0, 0.0, 0.0)
        place = end_of(self._scene, "universe", words["position"], turned)
        (self.welds if words["kind"] == "full" else self.points).append((place, held))

    def _bar(self, entry: Entry) -> None:
        words = entry.words
        a, b = (end_of(self._scene, words[f"frame_{c}"], words[f"point_{c}"]) for c in "ab")
        self.bars.append((a, b, float(words["distance"])))

    def _screw(self, entry: Entry) -> None:
        joint, parent = (_body_of(self._scene, entry.words[key]) for key in ("joint", "parent"))
        lead = float(entry.words["pitch"]) / (2.0 * math.pi)
        self.follows.append(Follow(joint, parent, (float(entry.words["offset"]), lead)))

    def _stays_closed(self, a: End, b: End, free: Sequence[int]) -> bool:
        """Whether the origins do not part along some axes of a, at any known state."""
        model = self._scene.robot.model
        data = model.createData()
        for x in self._states:
            pin.forwardKinematics(model, data, x.q)
            between = (data.oMi[a.body] * a.place).actInv(data.oMi[b.body] * b.place)
            if np.abs(between.translation[list(free)]).max() > _CLOSED:
                return False
        return True


def _body_of(scene: Scene, joint: str) -> int:
    return int(scene.robot.model.getJointId(scene.robot.joint(joint).urdf_name))


def common_ground(scene: Scene) -> Ground:
    """The scene without the loads that no peer has.

    Stops and stiction of peers are soft under all settings; they do not know other forces.
    """
    scene_entries, foreign = scene.entries, list(keys(scene.sections))[len(SECTIONS) :]
    scene, left = scene.without(foreign), [f"{key} (section of others)" for key in foreign]
    common_parts: dict[str, tuple[Any, ...]] = {}
    entries: dict[str, tuple[Entry, ...]] = {}
    for section, parts in (("constraints", scene.constraints), ("forces", scene.forces)):
        pairs = [
            (part, _entry(part, entry, f"{section}[{i}]"))
            for i, (part, entry) in enumerate(
                zip(parts, scene_entries.get(section, ()), strict=True)
            )
        ]
        expressible = [pair for pair in pairs if _is_told(*pair)]
        left += [
            f"{entry.where} ({entry.kind})" for part, entry in pairs if not _is_told(part, entry)
        ]
        common_parts[section] = tuple(part for part, _ in expressible)
        entries[section] = tuple(entry for _, entry in expressible)
    scene = scene.holding(**common_parts) if left else scene
    return Ground(scene, entries["constraints"], entries["forces"], tuple(left))


def _entry(part: Any, part_entry: Mapping[str, Any], where: str) -> Entry:
    accepted = inspect.signature(type(part)).parameters.values()
    defaults = {p.name: p.default for p in accepted if p.default is not inspect.Parameter.empty}
    kind = part_entry["type"]  # a class, where Python made the scene
    return Entry(
        kind if isinstance(kind, str) else kind.__name__, {**defaults, **part_entry}, where
    )


def _is_told(part: Any, entry: Entry) -> bool:
    if entry.kind in _FORCES:
        return entry.words.get("coulomb", 0.0) == 0.0
    return isinstance(part, Constraint) and part.law.kind in (Kind.BILATERAL, Kind.DRIVE)
