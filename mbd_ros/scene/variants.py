"""A scene with other sections, inertias or numbers, built again as far as they change it.

The new scene is of the class of the old one.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar

import numpy as np

from mbd_ros.core.model import robot_reader
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.from_python import plain
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.reader import build_scene
from mbd_ros.scene.reading.building import Prebuilt, present
from mbd_ros.scene.schema.code_permission import code_of_others, is_permitted, permitting
from mbd_ros.scene.schema.nearest import nearest
from mbd_ros.scene.schema.sections import SECTIONS, Form, Section, keys, ordered, parts_in

_OF_LINKS = ("mass", "com", "inertia")
SceneKind = TypeVar("SceneKind", bound=Scene)
AnyKind = TypeVar("AnyKind")


def with_sections(scene: AnyKind, /, **sections: Any) -> AnyKind:
    """A scene with other sections; sections that do not come after them are reused.

    Args:
        scene: A scene of robots, or of particles.
        **sections: As `scene_from` takes them; None removes a section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    origin = scene.origin.changed()
    changes = plain(sections, origin.name)
    entries = present({**scene.entries, **changes})
    if isinstance(scene, Scene):
        return _rebuilt(scene, origin, entries, changes)
    from mbd_ros.scene.particles.particle_scene import build_particle_scene

    return _of_class(scene, build_particle_scene(origin, entries))


def with_inertias(scene: SceneKind, inertias: Mapping[str, Any]) -> SceneKind:
    """A scene whose robot has other inertias, as `robot_reader.with_inertias` takes them.

    Raises:
        SceneError: Names link, value and condition.
    """
    origin = scene.origin.changed()
    try:
        robot = robot_reader.with_inertias(scene.parts["robot"], inertias)
    except ModelError as error:
        raise SceneError(f"{origin.name}: robot: {error}") from error
    return _rebuilt(scene, origin, scene.entries, {"robot"}, Prebuilt({"robot": robot}))


def with_numbers(scene: SceneKind, numbers: Mapping[str, Any]) -> SceneKind:
    """A scene with other numbers; parts, and sections that depend on none of them, are reused.

    Args:
        numbers: Numbers, or lists of them, by `<name>.<argument>`; inertias of links by
            `<link>.mass`, `.com` and `.inertia`; where the argument is a
            mapping, by `<name>.<argument>.<key>`.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    origin, places = scene.origin.changed(), places_of(scene)
    numbers, inertias = _without_inertias(scene, origin, places, numbers)
    if inertias:
        scene = with_inertias(scene, inertias)
    if not numbers:
        return scene
    entries, changed = dict(scene.entries), set[Place]()
    for key, number in numbers.items():
        place, path = found_place(origin, places, key)
        value = plain(number, f"{origin.name}: {key}")
        if not _is_number(value):
            raise SceneError(f"{origin.name}: {key}: expected a number, got {value!r}")
        set_value(entries, place, path, value)
        changed.add(place)
    touched = [
        section for section in scene.sections if section.key in {p.section for p in changed}
    ]
    made = Prebuilt()
    if all(section.has_types for section in touched):
        made = Prebuilt(
            parts={section.key: _others(scene, section, changed) for section in touched}
        )
        variant = _rebuilt(scene, origin, entries, keys(touched), made, keys(SECTIONS))
        if np.array_equal(variant.robot.model.armature, scene.robot.model.armature):
            return variant  # of other parts, ours depend on the inertia of drives only
    # What is no part of its own, such as a path, may be what other parts are made of.
    return _rebuilt(scene, origin, entries, keys(touched), made)


def _rebuilt(
    scene: SceneKind,
    origin: Origin,
    entries: Mapping[str, Any],
    changed: Iterable[str],
    made: Prebuilt = Prebuilt(),  # noqa: B008, a constant
    untouched: Sequence[str] = (),
) -> SceneKind:
    """The scene of other entries, without building again what they do not change.

    Args:
        origin: Of the new one.
        entries: Of the new one.
        changed: Keys of sections that are built again, and with them what comes after them.
        made: What of those is built already.
        untouched: Keys of sections that come after them and do not depend on what is changed.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    anew = set(changed)
    for section in ordered(scene.sections):
        if anew.intersection(section.after) and section.key not in untouched:
            anew.add(section.key)
    unchanged = {key: part for key, part in scene.parts.items() if key not in anew}
    trusted = set(scene.code.values())  # was permitted when the scene was built
    code = code_of_others(entries, tuple(key for key in entries if key in scene.code))
    is_known = trusted.issuperset(code.values()) and set(entries) <= set(keys(scene.sections))
    with permitting(is_permitted() or (bool(trusted) and is_known)):
        built = build_scene(origin, entries, Prebuilt({**unchanged, **made.sections}, made.parts))
    return _of_class(scene, built)


def _of_class(scene: Any, built: Any) -> Any:
    """A built scene of the class of another one."""
    if type(built) is type(scene):
        return built
    return type(scene)(*(getattr(built, field.name) for field in fields(built) if field.init))


class Place(NamedTuple):
    """Where an entry stands: its section, and its place or key there, None where it is alone."""

    section: str
    at: int | str | None = None


def _without_inertias(
    scene: Scene, origin: Origin, places: Mapping[str, Place], numbers: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Numbers of parts, and inertias of links: `<link>.mass`, `.com` and `.inertia`.

    The inertia is about the mass centre and in the axes of the link: xx, xy, xz, yy, yz, zz, or
    3 x 3; what is not given stays, moments keep their share of the mass.
    """
    link_numbers = [key for key in numbers if str(key).rpartition(".")[2] in _OF_LINKS]
    link_numbers = [key for key in link_numbers if str(key).rpartition(".")[0] not in places]
    if not link_numbers:
        return dict(numbers), {}
    links, changed = scene.robot.inertias(), dict[str, Any]()
    for key in link_numbers:
        link, _, word = str(key).rpartition(".")
        if link not in links:
            close = ", ".join(nearest(link, [*places, *links]) or links)
            raise SceneError(
                f"{origin.name}: {key}: nothing is called '{link}'; there are {close}"
            )
        value = plain(numbers[key], f"{origin.name}: {key}")
        if not _is_number(value):
            raise SceneError(f"{origin.name}: {key}: expected a number, got {value!r}")
        inertial = links[link]
        mass, centre, moments = changed.get(
            link, (inertial.mass, inertial.lever, inertial.inertia)
        )
        if word == "mass":
            share = value / mass if f"{link}.inertia" not in numbers and mass else 1.0
            mass, moments = value, share * np.asarray(moments)
        changed[link] = {
            "mass": (mass, centre, moments),
            "com": (mass, value, moments),
            "inertia": (mass, centre, _tensor(value)),
        }[word]
    return {key: value for key, value in numbers.items() if key not in link_numbers}, changed


def _tensor(value: Any) -> Any:
    """3 x 3 of six moments."""
    if not isinstance(value, list) or len(value) != 6 or isinstance(value[0], list):
        return value
    xx, xy, xz, yy, yz, zz = value
    return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]


def places_of(scene: Scene) -> dict[str, Place]:
    """Name -> place of every entry of which parts were built."""
    places: dict[str, Place] = {}
    for section in scene.sections:
        named, built = scene.entries.get(section.key, {}), scene.parts.get(section.key)
        if section.form is Form.SINGLE:
            places.setdefault(section.key, Place(section.key))
        elif section.form is Form.NAMED:
            places |= {name: Place(section.key, name) for name in named}
        elif built is not None and len(built) == len(named):  # else it holds parts of others
            places |= {part.name: Place(section.key, i) for i, part in enumerate(built)}
    return places


def found_place(origin: Origin, places: Mapping[str, Place], key: Any) -> tuple[Place, list[str]]:
    """Where the number of a key stands: its entry, and the way to it in there.

    Raises:
        SceneError: Nothing is called so; names what is close.
    """
    name, *path = str(key).split(".")
    if not path or "" in path:
        raise SceneError(f"{origin.name}: expected <name>.<argument>, got {key!r}")
    if name not in places:
        close = ", ".join(nearest(name, places) or places)
        raise SceneError(f"{origin.name}: {key}: nothing is called '{name}'; there are {close}")
    return places[name], path


def _is_number(value: Any) -> bool:
    if isinstance(value, list):
        return all(_is_number(one) for one in value)
    return type(value) in (int, float)


def set_value(entries: dict[str, Any], place: Place, path: list[str], value: Any) -> None:
    """Write into copies of what holds the value; the entries of the other scene stay."""
    inner: Any = entries
    *steps, last = (place.section, *([] if place.at is None else [place.at]), *path)
    for step in steps:
        held = inner.get(step) if isinstance(inner, dict) else inner[step]
        inner[step] = held.copy() if isinstance(held, dict | list) else {}
        inner = inner[step]
    inner[last] = value


def _others(scene: Scene, section: Section, changed: set[Place]) -> dict[Any, Any]:
    """Parts of a section whose entries do not change."""
    if section.form is Form.SINGLE or not section.has_types:
        return {}
    built = scene.parts[section.key]
    places = built if isinstance(built, Mapping) else range(len(built))
    every = zip(places, parts_in(section, built), strict=True)
    return {at: part for at, part in every if Place(section.key, at) not in changed}
