"""XML text -> a tree of elements, in a time proportional to the text.

Files of models are read leniently: comments may hold anything, blanks may stand before the XML
declaration, and prefixes of names need no namespace. Nothing is taken from elsewhere: a document
that declares a type or entities is refused.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.parsers import expat

MAX_DEPTH = 256  # elements inside elements; each level takes a frame of Python in some readers
_COMMENT, _DATA = ("<!--", "-->"), ("<![CDATA[", "]]>")
_DECLARED = "DOCTYPE and ENTITY declarations are refused"


class MarkupError(ValueError):
    """The text is no XML that is accepted; the message says why, and where there is a line."""


def decoded(data: bytes) -> str:
    """Return the text of a file in UTF-8 or, as old ones are, in Latin-1."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")  # names of authors


def xml_tree(text: str) -> ElementTree.Element:
    """Return the outermost element of a document.

    Names stay as they are written, with their prefixes; `::` in the name of an element becomes
    `__`. An encoding that the document declares is ignored.

    Raises:
        MarkupError: No XML, a declaration of a type or an entity, or elements nested too deep.
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
    """Builds a tree of bounded depth."""

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
    """The text without its comments, each line of it at its number."""
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
    """The text without its XML declaration, each line of it at its number."""
    start = len(text) - len(text.lstrip())
    end = text.find("?>", start)
    if end < 0 or not text.startswith("<?xml", start):
        return text
    return "\n" * text.count("\n", 0, end) + text[end + 2 :]
