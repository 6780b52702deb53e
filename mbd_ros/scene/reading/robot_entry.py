"""Sections `robot`, `robots`, `bodies` and `gravity` of a scene -> one robot."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pinocchio as pin

from mbd_ros.core.model.model_source import Recipe
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.robot_reader import EARTH_GRAVITY, read_robots
from mbd_ros.core.model.urdf import MAX_CHARACTERS
from mbd_ros.core.ranges import Positive, Vector
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file
from mbd_ros.scene.schema.strict_yaml import read_text

_NAME = re.compile("[A-Za-z_][A-Za-z0-9_]{0,99}")  # topics are named after robots and bodies


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


def read_entry(where: str, given: Any, has_text: bool = False) -> RobotEntry:
    """The section `robot`, checked.

    Args:
        where: File and key, for the messages.
        given: What the file holds.
        has_text: Whether a description came with the scene, so that none need be named.

    Raises:
        SceneError: Names file and key.
    """
    entry: RobotEntry = schema.call(RobotEntry, given, where)
    given = (entry.urdf, entry.description_topic, entry.osim, entry.mjcf)
    named = sum(one is not None for one in given)
    if named != 1 and not (has_text and not named):
        raise SceneError(f"{where}: give either 'urdf', 'osim', 'mjcf' or 'description_topic'")
    if entry.gravity is not None and len(entry.gravity) != 3:
        raise SceneError(f"{where}.gravity: expected 3 numbers, got {entry.gravity}")
    return entry


def build_robot(site: Site, given: Any) -> Robot:
    """The robot of the section `robot`, with those of `robots` and with `bodies`.

    Raises:
        SceneError: Names file, key and what is wrong.
    """
    others = [*site.parts.get("robots", {}).values(), *site.parts.get("bodies", {}).values()]
    gravity = site.parts.get("gravity")
    if given is site.section.absent:
        if not others:
            raise SceneError(f"{site.origin.name}: key 'robot' is missing, or robots, or bodies")
        return _read(others, gravity or EARTH_GRAVITY, site.origin.name)
    text = site.origin.description
    entry = read_entry(site.where, given, site.origin.path is None and text is not None)
    if gravity is not None and entry.gravity is not None:
        raise SceneError(f"{site.where}.gravity: given twice, there is a section 'gravity'")
    gravity = gravity or entry.gravity or EARTH_GRAVITY
    recipe = _recipe(site, entry)
    where = site.origin.name if others else site.where
    try:
        robot = _read([recipe, *others], gravity, where)
    except SceneError as error:
        raise SceneError(f"{error}{_joints_to_lock(recipe)}") from error
    model = site.origin.model
    if (entry.osim or entry.mjcf) is None or model is None:
        return robot
    return replace(robot, ignored=(*robot.ignored, *model.left_out))


def build_robots(site: Site, given: Any) -> dict[str, Recipe]:
    """The section `robots`.

    Raises:
        SceneError: Names file, key and what is wrong.
    """
    return _each(site, given, _robot)


def build_bodies(site: Site, given: Any) -> dict[str, Recipe]:
    """The section `bodies`.

    Raises:
        SceneError: Names file, key and what is wrong.
    """
    return _each(site, given, _body)


def build_gravity(site: Site, given: Any) -> Sequence[float]:
    """The section `gravity` [m/s^2].

    Raises:
        SceneError: It is no vector.
    """
    gravity: Sequence[float] = schema.value(given, Vector, site.where)
    return gravity


def _each(site: Site, given: Any, read: Callable[..., Recipe]) -> dict[str, Recipe]:
    recipes = {}
    for name, entry in schema.value(given, Mapping[str, Any], site.where).items():
        where = f"{site.where}.{name}"
        if not _NAME.fullmatch(str(name)):
            raise SceneError(
                f"{where}: is no ROS name, accepted: letters, digits and _, no digit first"
            )
        recipes[name] = schema.call(read, entry, where, site, where, name)
    return recipes


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
) -> Recipe:
    source, text = _read_urdf(site, urdf, where)
    return Recipe(text, source, base, locked, rename, None, name, _placed(pose, where))


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
) -> Recipe:
    if (urdf is None) == (shape is None):
        raise SceneError(f"{where}: give either 'urdf' or 'shape'")
    if urdf is not None:
        if mass is not None or inertia is not None:
            raise SceneError(f"{where}: mass and inertia are those of the 'urdf'")
        source, text = _read_urdf(site, urdf, where)
        recipe = Recipe(text, source, name=name)
    elif mass is None and (free or inertia is not None):
        raise SceneError(f"{where}: key 'mass' is missing")
    else:
        from mbd_ros.scene.reading.body_entry import shaped

        recipe = shaped(name, where, shape, mass, inertia)
    return recipe._replace(base="floating" if free else "fixed", pose=_placed(pose, where))


def _placed(pose: Mapping[str, Any] | None, where: str) -> Any:
    if pose is None:
        return None
    from mbd_ros.scene.reading.pose_entry import read_pose

    return pin.XYZQUATToSE3(read_pose(pose, f"{where}.pose"))


def _recipe(site: Site, entry: RobotEntry) -> Recipe:
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
    recipe = Recipe(text, source, entry.base, entry.locked, entry.rename, None, "", pose)
    return recipe._replace(any_inertias=entry.any_inertias)


def _read(recipes: Sequence[Recipe], gravity: Sequence[float], where: str) -> Robot:
    try:
        return read_robots(recipes, gravity)
    except ModelError as error:
        raise SceneError(f"{where}: {error}") from error


def _joints_to_lock(recipe: Recipe) -> str:
    """The joints there are, where nothing but `locked` is wrong."""
    if not recipe.locked:
        return ""
    try:
        robot = read_robots([recipe._replace(locked=None)])
    except ModelError:
        return ""
    return f"; the robot has {', '.join(joint.name for joint in robot.joints)}"


def _read_urdf(site: Site, name: str, entry: str) -> tuple[str, str]:
    where = f"{entry}.urdf"
    file = find_file(site.origin.folder, name, where)
    try:
        return str(file), read_text(file, MAX_CHARACTERS, "robot description")
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error
