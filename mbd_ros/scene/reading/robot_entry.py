"""Sections `robot`, `robots`, `bodies` and `gravity` of a scene -> one robot."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import ModelSource, Robot
from mbd_ros.core.model.robot_reader import EARTH_GRAVITY, read_robots, root_link
from mbd_ros.core.model.urdf import MAX_CHARACTERS, parse_urdf
from mbd_ros.core.ranges import LARGEST, Length, Positive, Unit, Vector
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.single_entries import read_pose
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file
from mbd_ros.scene.schema.strict_yaml import read_text

_NAME = re.compile("[A-Za-z_][A-Za-z0-9_]{0,99}")  # topics are named after robots and bodies
Metres = Annotated[Positive, Unit("m")]
_Sides = Annotated[Sequence[Positive], Length(3), Unit("m")]


def _box(size: _Sides) -> Array:
    """Moments of inertia of 1 kg [m^2], shape (3,)."""
    squares = np.square(size)
    moments: Array = (squares.sum() - squares) / 12.0
    return moments


def _sphere(size: Metres) -> Array:
    return np.full(3, 0.4 * size**2)


def _cylinder(radius: Metres, length: Metres) -> Array:
    across = radius**2 / 4.0 + length**2 / 12.0
    return np.array((across, across, radius**2 / 2.0))


def _capsule(radius: Metres, length: Metres) -> Array:
    """A cylinder between two half spheres, whose centres of mass lie 3/8 r beyond its ends."""
    share = length / (length + 4.0 / 3.0 * radius)  # of the mass, in the cylinder
    half = 0.4 * radius**2 + length**2 / 4.0 + 0.375 * length * radius
    across = share * (radius**2 / 4.0 + length**2 / 12.0) + (1.0 - share) * half
    along = share * radius**2 / 2.0 + (1.0 - share) * 0.4 * radius**2
    return np.array((across, across, along))


_SHAPES: Mapping[str, Any] = {
    "box": _box,
    "sphere": _sphere,
    "cylinder": _cylinder,
    "capsule": _capsule,
}
_BY_KEYS = ("cylinder", "capsule")
_KINDS = "box, sphere, cylinder, capsule, mesh"


def build_robot(site: Site, value: Any) -> Robot:
    """The robot of the section `robot`, with those of `robots` and with `bodies`.

    Raises:
        SceneError: Names file, key and what is wrong.
    """
    others = [*site.parts.get("robots", {}).values(), *site.parts.get("bodies", {}).values()]
    gravity = site.parts.get("gravity")
    if value is site.section.absent:
        if not others:
            raise SceneError(f"{site.origin.name}: key 'robot' is missing, or robots, or bodies")
        return _read(others, gravity or EARTH_GRAVITY, site.origin.name)
    text = site.origin.description
    entry = read_entry(site.where, value, site.origin.path is None and text is not None)
    if gravity is not None and entry.gravity is not None:
        raise SceneError(f"{site.where}.gravity: given twice, there is a section 'gravity'")
    gravity = gravity or entry.gravity or EARTH_GRAVITY
    model_source = _model_source(site, entry)
    where = site.origin.name if others else site.where
    try:
        robot = _read([model_source, *others], gravity, where)
    except SceneError as error:
        raise SceneError(f"{error}{_joints_to_lock(model_source)}") from error
    model = site.origin.model
    if (entry.osim or entry.mjcf) is None or model is None:
        return robot
    return replace(robot, ignored=(*robot.ignored, *model.left_out))


def _read(model_sources: Sequence[ModelSource], gravity: Sequence[float], where: str) -> Robot:
    try:
        return read_robots(model_sources, gravity)
    except ModelError as error:
        raise SceneError(f"{where}: {error}") from error


def _model_source(site: Site, entry: RobotEntry) -> ModelSource:
    where, text = site.where, site.origin.description
    if (entry.osim or entry.mjcf) is not None:
        assert site.origin.model is not None
        source, text = site.origin.model[:2]
    elif entry.urdf is not None:
        source, text = _read_urdf(site, entry.urdf, where)
    elif text is None:
        raise SceneError(
            f"{where}: the description comes from topic {entry.description_topic}, which only a "
            "node can read; give 'urdf' to use the scene offline"
        )
    else:
        source = f"topic {entry.description_topic}" if entry.description_topic else "URDF text"
    pose = _placed(entry.pose, where)
    model_source = ModelSource(
        text, source, entry.base, entry.locked, entry.rename, None, "", pose
    )
    return model_source._replace(any_inertias=entry.any_inertias)


def _read_urdf(site: Site, name: str, entry: str) -> tuple[str, str]:
    where = f"{entry}.urdf"
    file = find_file(site.origin.folder, name, where)
    try:
        return str(file), read_text(file, MAX_CHARACTERS, "robot description")
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error


def _placed(pose: Mapping[str, Any] | None, where: str) -> Any:
    if pose is None:
        return None
    return pin.XYZQUATToSE3(read_pose(pose, f"{where}.pose"))


def _joints_to_lock(model_source: ModelSource) -> str:
    """The joints there are, where nothing but `locked` is wrong."""
    if not model_source.locked:
        return ""
    try:
        robot = read_robots([model_source._replace(locked=None)])
    except ModelError:
        return ""
    return f"; the robot has {', '.join(joint.name for joint in robot.joints)}"


@dataclass(frozen=True)
class RobotEntry:
    """The `robot` section."""

    urdf: str | None = None
    description_topic: str | None = None
    gravity: Sequence[float] | None = None
    base: str = "fixed"
    locked: Mapping[str, float] | None = None
    rename: Mapping[str, str] | None = None
    pose: Mapping[str, Any] | None = None
    osim: str | None = None
    any_inertias: bool = False
    mjcf: str | None = None


def read_entry(where: str, value: Any, has_text: bool = False) -> RobotEntry:
    """The section `robot`, checked.

    Args:
        where: File and key, for the messages.
        value: What the file holds.
        has_text: Whether a description came with the scene, so that none need be named.

    Raises:
        SceneError: Names file and key.
    """
    entry: RobotEntry = schema.call(RobotEntry, value, where)
    descriptions = (entry.urdf, entry.description_topic, entry.osim, entry.mjcf)
    named = sum(one is not None for one in descriptions)
    if named != 1 and not (has_text and not named):
        raise SceneError(f"{where}: give either 'urdf', 'osim', 'mjcf' or 'description_topic'")
    if entry.gravity is not None and len(entry.gravity) != 3:
        raise SceneError(f"{where}.gravity: expected 3 numbers, got {entry.gravity}")
    return entry


def build_robots(site: Site, entry: Any) -> dict[str, ModelSource]:
    """The section `robots`.

    Raises:
        SceneError: Names file, key and what is wrong.
    """
    return _each(site, entry, _robot)


def _each(site: Site, mapping: Any, read: Callable[..., ModelSource]) -> dict[str, ModelSource]:
    model_sources = {}
    for name, entry in schema.value(mapping, Mapping[str, Any], site.where).items():
        where = f"{site.where}.{name}"
        if not _NAME.fullmatch(str(name)):
            raise SceneError(
                f"{where}: is no ROS name, accepted: letters, digits and _, no digit first"
            )
        model_sources[name] = schema.call(read, entry, where, site, where, name)
    return model_sources


def _robot(
    site: Site,
    where: str,
    name: str,
    *,
    urdf: str,
    pose: Mapping[str, Any] | None = None,
    base: str = "fixed",
    locked: Mapping[str, float] | None = None,
    rename: Mapping[str, str] | None = None,
) -> ModelSource:
    source, text = _read_urdf(site, urdf, where)
    return ModelSource(text, source, base, locked, rename, None, name, _placed(pose, where))


def build_bodies(site: Site, entry: Any) -> dict[str, ModelSource]:
    """The section `bodies`.

    Raises:
        SceneError: Names file, key and what is wrong.
    """
    return _each(site, entry, _body)


def _body(
    site: Site,
    where: str,
    name: str,
    *,
    urdf: str | None = None,
    shape: Mapping[str, Any] | None = None,
    mass: Positive | None = None,
    inertia: Sequence[Any] | None = None,
    free: bool = True,
    pose: Mapping[str, Any] | None = None,
) -> ModelSource:
    if (urdf is None) == (shape is None):
        raise SceneError(f"{where}: give either 'urdf' or 'shape'")
    if urdf is not None:
        if mass is not None or inertia is not None:
            raise SceneError(f"{where}: mass and inertia are those of the 'urdf'")
        source, text = _read_urdf(site, urdf, where)
        model_source = ModelSource(text, source, name=name)
    elif mass is None and (free or inertia is not None):
        raise SceneError(f"{where}: key 'mass' is missing")
    else:
        model_source = shaped(name, where, shape, mass, inertia)
    return model_source._replace(base="floating" if free else "fixed", pose=_placed(pose, where))


def build_gravity(site: Site, entry: Any) -> Sequence[float]:
    """The section `gravity` [m/s^2].

    Raises:
        SceneError: It is no vector.
    """
    gravity: Sequence[float] = schema.value(entry, Vector, site.where)
    return gravity


def shaped(
    name: str, where: str, shape_values: Any, mass: float | None, inertia: Sequence[Any] | None
) -> ModelSource:
    """A body of one link, its origin in the centre of its shape, which its mass fills evenly.

    Args:
        name: Of the body and its link, a ROS name.
        where: File and key, for the messages.
        shape_values: `{box: [x, y, z]}`, `{sphere: r}`, `{cylinder: {radius, length}}` or
            `{capsule: {radius, length}}`, the last two along z; a capsule is longer than `length`
            by its two half spheres.
        mass: [kg]; None for a body that does not move.
        inertia: About the centre [kg·m^2], shape (3,) for its diagonal or (3, 3); None for that
            of the shape.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    entry = schema.value(shape_values, Mapping[str, Any], f"{where}.shape")
    if len(entry) != 1 or next(iter(entry)) not in _SHAPES:
        names = ", ".join(_SHAPES)
        raise SceneError(
            f"{where}.shape: expected one of {names}, got {', '.join(entry) or 'none'}"
        )
    kind, sizes = next(iter(entry.items()))
    key = f"{where}.shape.{kind}"
    arguments = sizes if kind in _BY_KEYS else {"size": sizes}
    moments = schema.call(_SHAPES[kind], arguments, key)
    text = f'<robot name="{name}"><link name="{name}"/></robot>'
    source = f"bodies.{name}.shape"
    if mass is None:
        return ModelSource(text, source, name=name, shape=(kind, sizes))
    tensor = np.diag(moments) * mass if inertia is None else _tensor(inertia, where)
    inertias = {name: (mass, np.zeros(3), tensor)}
    return ModelSource(text, source, inertias=inertias, name=name, shape=(kind, sizes))


def _tensor(inertia: Sequence[Any], where: str) -> Array:
    try:
        tensor = np.array(inertia, dtype=np.float64)
    except (TypeError, ValueError):
        tensor = np.zeros(0)
    if tensor.shape not in ((3,), (3, 3)):
        raise SceneError(f"{where}.inertia: expected 3 numbers or 3 x 3, got {inertia}")
    return np.diag(tensor) if tensor.ndim == 1 else tensor


def geometry_of(model_source: ModelSource, element: ElementTree.Element, where: str) -> Collision:
    """The geometry of a `<collision>` or `<visual>` element.

    Args:
        model_source: What the element is from.
        where: File and key, for the messages.

    Raises:
        SceneError: It is not understood, or names a package that is not installed.
    """
    origin, geometry = element.find("origin"), element.find("geometry")
    xyz = _numbers(origin, "xyz", "0 0 0", 3, where)
    rpy = _numbers(origin, "rpy", "0 0 0", 3, where)
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is None:
        raise SceneError(f"{where}: has no geometry, accepted: {_KINDS}")
    if shape.tag == "box":
        return Collision("box", _numbers(shape, "size", "", 3, where), xyz, rpy)
    if shape.tag == "sphere":
        return Collision("sphere", _numbers(shape, "radius", "", 1, where)[0], xyz, rpy)
    if shape.tag in ("cylinder", "capsule"):
        sizes = {key: _numbers(shape, key, "", 1, where)[0] for key in ("radius", "length")}
        return Collision(shape.tag, sizes, xyz, rpy)
    if shape.tag != "mesh" or not shape.get("filename"):
        raise SceneError(f"{where}: geometry <{shape.tag}>, accepted: {_KINDS} with its filename")
    name = shape.get("filename", "").removeprefix("file://")
    file = find_file(Path(model_source.source).parent, name, where)
    scale = _numbers(shape, "scale", "1 1 1", 3, where)
    return Collision("mesh", {"file": str(file), "scale": scale}, xyz, rpy)


def _numbers(
    element: ElementTree.Element | None, key: str, default: str, count: int, where: str
) -> list[float]:
    text = default if element is None else element.get(key, default)
    values = list(_finite(text))
    if len(values) != count:
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise SceneError(f"{where}: {key}='{text}', expected {expected}")
    return values


def _finite(text: str) -> Iterator[float]:
    for word in text.split():
        try:
            value = float(word)
        except ValueError:
            return
        if not math.isfinite(value) or abs(value) > LARGEST:
            return
        yield value


def collisions_of(robot: Robot, name: str, where: str) -> list[Collision]:
    """All collision geometries of a link.

    Args:
        name: Of the link, as the scene calls it.
        where: File and key, for the messages.

    Raises:
        SceneError: The link has none, or one that is not understood; names it.
    """
    having = list[str]()
    for model_source in robot.model_sources:
        tree = parse_urdf(model_source.text, model_source.source)
        for link in tree.findall("link"):
            known = names_of_link(model_source, tree, link.get("name", ""))
            elements = link.findall("collision")
            if name in known and elements:
                texts = enumerate(elements)
                return [
                    geometry_of(model_source, one, f"{where}: {name}: <collision> {i}")
                    for i, one in texts
                ]
            having += known[:1] if elements else []
        if model_source.shape is not None:
            having.append(model_source.name)
    found = ", ".join(having) or "none has one"
    raise SceneError(
        f"{where}: link '{name}' has no <collision>; with one or a shape: {found}; or give the "
        f"shape here, such as {{frame: {name}, sphere: 0.1}}"
    )


def names_of_link(source: ModelSource, tree: ElementTree.Element, link: str) -> list[str]:
    """Return the names of a link in the scene; the root has the name of its member, too."""
    is_root = bool(source.name) and link == root_link(tree)
    return [source.name, source.scoped(link)] if is_root else [source.scoped(link)]


class Collision(NamedTuple):
    """One geometry of a link.

    Attributes:
        kind: As scenes call it.
        size: Its sizes, as scenes write them.
        xyz: Its place on the link [m].
        rpy: Its axes there [rad].
    """

    kind: str
    size: Any
    xyz: list[float]
    rpy: list[float]
