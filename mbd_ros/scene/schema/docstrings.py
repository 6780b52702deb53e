"""The text of each argument in a Google docstring."""

import inspect
import re

_SECTION = re.compile(r"(\w[\w ]*):")  # a line of its own, at the left
_ENTRY = re.compile(r"\*{0,2}(\w+)(?: \([^)]*\))?:\s*(.*)")  # `name: text` or `name (type): text`


def entries(docstring: str | None, section: str = "Args") -> dict[str, str]:
    """The entries of a section of a docstring.

    Args:
        docstring: As written, None where there is none.
        section: Heading, such as `Args` or `Attributes`.

    Returns:
        Name -> text in one line, in the order of the docstring; empty without the section.
    """
    found: dict[str, list[str]] = {}
    width = name = None
    for line in _lines(docstring or "", section):
        indent = len(line) - len(line.lstrip())
        width = indent if width is None else width
        entry = _ENTRY.fullmatch(line.strip()) if indent == width else None
        if entry:
            name = entry[1]
            found[name] = [entry[2]]
        elif name is not None:
            found[name].append(line.strip())
    return {key: " ".join(part for part in parts if part) for key, parts in found.items()}


def _lines(docstring: str, section: str) -> list[str]:
    """Lines of a section that are not empty, without its heading."""
    inside, lines = False, []
    for line in inspect.cleandoc(docstring).splitlines():
        if line and not line[0].isspace():
            heading = _SECTION.fullmatch(line.rstrip())
            inside = heading is not None and heading[1] == section
        elif inside and line.strip():
            lines.append(line)
    return lines
