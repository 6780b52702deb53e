"""Parse XML text into a tree of elements, in time proportional to the length of the text.

Model files are parsed leniently: comments may contain anything, blanks may precede the XML
declaration, and prefixes of names need no namespace. Nothing is loaded from elsewhere: a document
with a DOCTYPE or ENTITY declaration is refused.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.parsers import expat

MAX_DEPTH = 256  # of nested elements; some readers recurse once per level
_COMMENT, _DATA = ("<!--", "-->"), ("<![CDATA[", "]]>")
_DECLARED = "DOCTYPE and ENTITY declarations are refused"


class MarkupError(ValueError):
    """The text is not accepted XML; the message says why, with the line if there is one."""


def decoded(data: bytes) -> str:
    """Return the text of a file in UTF-8 or, as in old files, in Latin-1."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")  # names of authors


def xml_tree(text: str) -> ElementTree.Element:
    """Return the outermost element of a document.

    Names stay as they are written, with their prefixes; `::` in the name of an element becomes
    `__`. An encoding that the document declares is ignored.

    Raises:
        MarkupError: The text is not XML, declares a DOCTYPE or ENTITY, or is nested too deep.
    """
    builder = _Tree()
    parser = expat.ParserCreate("utf-8")
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = _refuse_declaration
    try:
        parser.Parse(_without_declaration(_without_comments(text)), True)
    except (expat.ExpatError, UnicodeEncodeError) as error:
        raise MarkupError(f"not well-formed XML: {error}") from error
    root: ElementTree.Element = builder.close()
    return root


class _Tree(ElementTree.TreeBuilder):
    """Tree builder that limits the depth."""

    _depth = 0

    def start(self, tag: str, attributes: dict[str, str]) -> ElementTree.Element:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise MarkupError(f"elements are nested deeper than {MAX_DEPTH}")
        return super().start(tag.replace("::", "__"), attributes)  # a class inside one of C++

    def end(self, tag: str) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag.replace("::", "__"))


def _refuse_declaration(*_: object) -> None:
    raise MarkupError(_DECLARED)


def _without_comments(text: str) -> str:
    """Return the text without comments; lines keep their numbers."""
    pieces, at = [], 0
    while (start := text.find("<!", at)) >= 0:
        opening, closing = _DATA if text.startswith(_DATA[0], start) else _COMMENT
        if not text.startswith(opening, start):
            raise MarkupError(_DECLARED)
        end = text.find(closing, start + len(opening))
        if end < 0:
            break  # the parser says where it begins
        end += len(closing)
        pieces.append(text[at:start])
        if opening == _DATA[0]:
            pieces.append(text[start:end])
        else:
            pieces.append("\n" * text.count("\n", start, end))
        at = end
    return "".join([*pieces, text[at:]])


def _without_declaration(text: str) -> str:
    """Return the text without its XML declaration; lines keep their numbers."""
    start = len(text) - len(text.lstrip())
    end = text.find("?>", start)
    if end < 0 or not text.startswith("<?xml", start):
        return text
    return "\n" * text.count("\n", 0, end) + text[end + 2 :]
