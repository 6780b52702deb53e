"""Code of others that a scene names, and the permission to import it.

A scene is data, and one from elsewhere must not run code unasked: its code is imported only where
`permitting` allows it.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from mbd_ros.errors import SceneError
from mbd_ros.scene.schema.sections import SECTIONS

HOW = "--allow-code on the command line, parameter allow_code of a node"
_is_permitted: ContextVar[bool] = ContextVar("permitted", default=False)


@contextmanager
def permitting(allow_code: bool) -> Iterator[None]:
    """Whether scenes may import code of others, while this context lasts and in it alone."""
    token = _is_permitted.set(allow_code)
    try:
        yield
    finally:
        _is_permitted.reset(token)


def is_permitted() -> bool:
    """Whether `permitting` allows it here; to be handed to other processes."""
    return _is_permitted.get()


def code_of_others(entries: Mapping[str, Any], foreign: Sequence[str] = ()) -> dict[str, str]:
    """Types that a scene would import from outside this package.

    Args:
        entries: The file, as read; entries that are no parts are judged while building.
        foreign: Keys of sections of other packages.

    Returns:
        Key, such as `forces[0].type`, -> `package.module:Class`.
    """
    code = {}
    for key in (*(section.key for section in SECTIONS if section.has_types), *foreign):
        for where, entry in _entries(key, entries.get(key)):
            name = entry.get("type") if isinstance(entry, Mapping) else None
            if isinstance(name, str) and ":" in name:
                code[f"{where}.type"] = name
    return code


def _entries(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Every mapping that may be a part, with its key: the section itself and what it holds."""
    yield key, value
    if isinstance(value, Mapping):
        yield from ((f"{key}.{name}", entry) for name, entry in value.items())
    elif isinstance(value, Sequence) and not isinstance(value, str):
        yield from ((f"{key}[{i}]", entry) for i, entry in enumerate(value))


def require_permission(where: str, code: Mapping[str, str]) -> None:
    """Refuse code of others that nobody allowed.

    Args:
        where: File or option, for the message.
        code: As `code_of_others` gives it; nothing is fine.

    Raises:
        SceneError: Lists all of it, and how it is allowed.
    """
    if code and not _is_permitted.get():
        listed = ", ".join(f"{key} '{name}'" for key, name in code.items())
        raise SceneError(
            f"{where}: names code of others, of which nothing was imported: {listed}. Where you "
            f"trust it, allow it ({HOW})"
        )


def module_path() -> str:
    """Where modules are looked for, for the message that there is none."""
    folders = ", ".join(folder or "the current folder" for folder in sys.path)
    return (
        f"looked for in {folders}: PYTHONPATH adds a folder, or install the package; the folder "
        "of the scene is not searched"
    )
