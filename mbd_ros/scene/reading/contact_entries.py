"""Section `contacts`: pairs of shapes -> contacts."""

from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.core.geometry.shapes import Between
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.contact_shapes import read_side
from mbd_ros.scene.reading.part_entries import MAX_ROWS, build_section
from mbd_ros.scene.schema import schema


def build_contacts(site: Site, entries: Any) -> Any:
    """The `contacts` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    listed = schema.value(entries, Sequence[Any], site.where)
    given = [
        entry if i in site.kept else with_shapes(site, entry, f"{site.where}[{i}]")
        for i, entry in enumerate(listed)
    ]
    parts = build_section(site, given)
    rows = sum(len(getattr(part, "rows", ())) for part in parts)
    if rows > MAX_ROWS:
        raise SceneError(f"{site.where}: {rows} rows, accepted are {MAX_ROWS}")
    return parts


def with_shapes(site: Site, given: Any, where: str) -> Any:
    """An entry whose `between` is read; what else is wrong with it is told where it is built.

    Args:
        site: Where the section is built.
        given: The entry.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if not isinstance(given, Mapping) or "between" not in given:
        return given
    sides = schema.value(given["between"], Sequence[Any], f"{where}.between")
    if len(sides) != len(Between._fields):
        raise SceneError(f"{where}.between: expected two sides, [a, b], got {len(sides)}")
    a, b = (read_side(site, side, f"{where}.between[{i}]") for i, side in enumerate(sides))
    return {**given, "between": Between(a, b)}
