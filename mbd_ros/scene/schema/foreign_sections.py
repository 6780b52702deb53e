"""Sections that other packages add, by entry points of the group `mbd_ros.sections`.

    [project.entry-points."mbd_ros.sections"]
    cables = "my_package.cables:SECTION"

`SECTION` is a `sections.Section` with that key. The group is looked up only where a scene has a
key that this package does not know, and a section of others is code of others: it is imported
where `code_permission.permitting` allows it, and not before.
"""

from collections.abc import Iterable
from importlib.metadata import entry_points
from string import Formatter

from mbd_ros.errors import SceneError
from mbd_ros.scene.schema.registry import imported
from mbd_ros.scene.schema.sections import SECTIONS, Section, keys

GROUP = "mbd_ros.sections"
_FIELDS = ("kind", "name", "at", "law", "rows", "part")  # of a text of `check`


def declared(unknown: Iterable[str]) -> dict[str, str]:
    """Key -> `module:NAME` of those keys that installed packages declare; imports nothing."""
    return {key: point.value for key in unknown for point in entry_points(group=GROUP, name=key)}


def import_section(key: str, target: str, where: str) -> Section:
    """The section behind an entry point; permission is up to the caller.

    Args:
        key: Its key in the scene.
        target: `module:NAME`.
        where: File, for the messages.

    Raises:
        SceneError: It cannot be imported, or it is no section of that key.
    """
    module, _, attribute = target.partition(":")
    section = imported(module, attribute, f"{where}: {key}: entry point '{target}'")
    if not isinstance(section, Section) or section.key != key:
        raise SceneError(f"{where}: {key}: '{target}' is no Section with the key '{key}'")
    unknown = [name for name in section.after if name not in (*keys(SECTIONS), key)]
    if unknown:
        raise SceneError(f"{where}: {key}: '{target}' comes after unknown {', '.join(unknown)}")
    fields = {word or "" for _, word, _, _ in Formatter().parse(section.check)} - {""}
    odd = [word for word in fields if word.partition(".")[0] not in _FIELDS]
    if odd:
        accepted = ", ".join(_FIELDS)
        raise SceneError(f"{where}: {key}: text of check: unknown {odd[0]}, accepted: {accepted}")
    return section
