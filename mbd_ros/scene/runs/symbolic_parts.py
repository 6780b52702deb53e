"""Parts of a scene with symbols instead of some of their numbers, and what is traced of them."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from mbd_ros.core.contracts.parts import Part, Slots
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Mode
from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.from_python import changed_origin
from mbd_ros.scene.numbers import Place, found_place, places_of, set_value
from mbd_ros.scene.reading.building import Site, parts_in
from mbd_ros.scene.reading.part_entries import part_of
from mbd_ros.scene.reading.part_names import named_entry

if TYPE_CHECKING:
    from mbd_ros.compiled.symbols.trace import Traced

_OF_LINKS = ("mass", "com", "inertia")


def traced(
    scene: Scene,
    system: System | None = None,
    parameters: Sequence[str] = (),
    mode: Mode = (),
) -> "Traced":
    """The functions of a scene, with numbers of its parts as arguments.

    Args:
        scene: The scene.
        system: One that it made; a new one by default.
        parameters: `<name of a part>.<argument>`, as `Scene.with_` takes them: p, in this order.
        mode: Of rows that give way at events.

    Raises:
        Untraceable: Names the part and why.
        SceneError: Names a parameter that no part has.
    """
    from mbd_ros.compiled.symbols.trace import trace

    made = partial(parts_of_symbols, scene)
    return trace(scene.system() if system is None else system, parameters, mode, made)


def parts_of_symbols(scene: Scene, symbols: Mapping[str, Any]) -> dict[str, Part]:
    """The parts of which numbers are replaced, by name; those of the scene stay.

    Args:
        scene: The scene.
        symbols: Symbols by `<name of a part>.<argument>`.

    Raises:
        SceneError: Names a parameter that no part has.
    """
    origin, places = changed_origin(scene), places_of(scene)
    entries, changed = dict(scene.entries), dict[Place, str]()
    for key, symbol in symbols.items():
        link, _, number = key.rpartition(".")
        if link in scene.robot.inertias() and number in _OF_LINKS:
            raise SceneError(
                f"{origin.name}: {key} is no number of a part; accepted: numbers of parts, such "
                "as <spring>.stiffness, or values of it one after the other (continuation)"
            )
        place, path = found_place(origin, places, key)
        set_value(entries, place, path, symbol)
        changed.setdefault(place, key)
    sections = {section.key: section for section in scene.sections}
    found: dict[str, Part] = {}
    for place, key in changed.items():
        section = sections[place.section]
        if not section.has_types or place.at is None:
            raise SceneError(f"{origin.name}: {key} is no number of a part")
        built = scene.parts[place.section]
        names = built if isinstance(built, Mapping) else range(len(built))
        old = dict(zip(names, parts_in(section, built), strict=True))[place.at]
        site = Site(section, origin, scene.robot, scene.parts)
        entry = named_entry(entries[place.section][place.at], f"{site.where}.{old.name}")
        part = part_of(section, entry.given, entry.where, site)
        part.name = old.name
        part.bind(Slots(old.u, old.z))
        found[old.name] = part
    return found
