"""Where entries of paths that wrap stand in a scene."""

from collections.abc import Mapping
from typing import NamedTuple

from mbd_ros.scene.built_scene import Scene

_SECTIONS = ("muscles", "forces", "actuators", "constraints")


class Place(NamedTuple):
    """Where the entry of a path stands: section, and place or key there."""

    section: str
    at: int | str


def wrapping(scene: Scene) -> list[Place]:
    """Entries of paths that wrap."""
    paths = scene.entries.get("paths") or {}
    found = [Place("paths", name) for name, one in paths.items() if one.get("wraps")]
    for section in _SECTIONS:
        for i, one in enumerate(scene.entries.get(section) or ()):
            path = one.get("path")
            if isinstance(path, Mapping) and path.get("wraps"):
                found.append(Place(section, i))
    return found
