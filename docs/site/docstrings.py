"""Convert Google docstrings for pages: to Markdown, and to text that reStructuredText reads."""

import inspect
import re
from typing import Any

_HEADING = re.compile(r"(Args|Attributes|Returns|Raises|Yields):")
_SOURCE = re.compile(r"Source: ")
_MARKED = re.compile(r"(?<!\\)([|*]|(?<=\w)_(?!\w))")
_LITERAL = re.compile(r"(`[^`]*`)")


def setup(app: Any) -> dict[str, bool]:
    """Make Sphinx call `without_markup` before any other reader of docstrings."""
    app.connect("autodoc-process-docstring", without_markup, priority=100)
    app.connect("autodoc-skip-member", _is_field)
    return {"parallel_read_safe": True}


def without_markup(
    app: Any, kind: str, name: str, documented: Any, options: Any, lines: list[str]
) -> None:
    """Escape the signs of reStructuredText in place: |e|, a * b, f_."""
    for i, line in enumerate(lines):
        if line.lstrip().startswith(("*", "**")) and ":" in line:  # `*words:` of Args
            continue
        pieces = _LITERAL.split(line)
        pieces[::2] = [_MARKED.sub(r"\\\1", piece) for piece in pieces[::2]]
        lines[i] = "".join(pieces)


def _is_field(
    app: Any, kind: str, name: str, member: Any, skip: bool, options: Any
) -> bool | None:
    """Return whether a member is a field of a named tuple, which its class describes."""
    return True if (inspect.getdoc(member) or "").startswith("Alias for field") else None


def summary(documented: Any) -> str:
    """Return the first paragraph of a docstring, in one line."""
    return " ".join((inspect.getdoc(documented) or "").partition("\n\n")[0].split())


def body(documented: Any) -> str:
    """Return a docstring without its first paragraph and its lists of arguments.

    Equations are indented in docstrings, which makes them blocks in Markdown as well.
    """
    lines = []
    inside = False
    text = (inspect.getdoc(documented) or "").partition("\n\n")[2]
    for line in text.splitlines():
        if line and not line[0].isspace():
            inside = _HEADING.fullmatch(line.rstrip()) is not None
        if not inside:
            lines.append(line)
    return _sources_on_one_line("\n".join(lines)).strip()


def _sources_on_one_line(text: str) -> str:
    """Return the text with each source on one line."""
    lines: list[str] = []
    inside = False
    for line in text.splitlines():
        if inside and line.startswith("    "):
            lines[-1] += " " + line.strip()
            continue
        inside = bool(_SOURCE.match(line))
        lines.append(line)
    return "\n".join(lines)
