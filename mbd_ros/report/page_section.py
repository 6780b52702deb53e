"""A section of the page: texts, tables, pictures, and lines to paste."""

import re
from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape

from mbd_ros.report.items import Section, Table

_NUMBER = re.compile(
    r"[<>≤≥~≈]? ?[-+−]?(\d[\d.,' ]*([eE][-+−]?\d+)?|nan|inf)( ?(x|×|%|[µmk]?s|min|h))?( ?[*★●])*"
)
_NOTHING = ("", "-", "–", "—")
_STATES = ("converged", "bounded", "stopped", "wrong")
_WIDE = 1000  # pixels; what has more is panned on a phone
_MANY = 3  # subjects that deserve links


def section_lines(kind: str, section: Section, pictures: Mapping[str, bytes]) -> Iterator[str]:
    """A section as HTML.

    Args:
        kind: Its anchor.
        section: What it says.
        pictures: Name of a figure -> PNG.

    Yields:
        HTML, a part a time.
    """
    yield f'<section id="{kind}"><h2>{escape(section.title)}</h2>'
    if section.wrong:
        lines = "".join(f"<li>{escape(line)}</li>" for line in section.wrong)
        yield f'<div class="verdict bad"><strong>Wrong</strong><ul>{lines}</ul></div>'
    yield from (f"<p>{escape(text)}</p>" for text in section.text)
    figures, snippets = list(section.figures), dict(section.snippets)
    subjects = [_subject(table) for table in section.tables]
    yield from _links(kind, [s for s in dict.fromkeys(subjects) if s])
    for i, (table, subject) in enumerate(zip(section.tables, subjects, strict=True)):
        if subject and subject not in subjects[:i]:
            yield f'<div id="{_anchor(kind, subject)}"></div>'
        yield from _table(table)
        if subject and subject not in subjects[i + 1 :]:
            for name in [name for name in figures if name.endswith(subject)]:
                figures.remove(name)
                yield _figure(name, pictures[name])
            for title in [title for title in snippets if title.startswith(subject)]:
                yield _snippet(title, snippets.pop(title))
    yield from (_figure(name, pictures[name]) for name in figures)
    yield from (_snippet(title, lines) for title, lines in snippets.items())
    yield "</section>"


def _subject(table: Table) -> str:
    """What stands before the colon of a title."""
    before, colon, _ = table.title.partition(": ")
    return before if colon else ""


def _links(kind: str, subjects: Sequence[str]) -> Iterator[str]:
    if len(subjects) >= _MANY:
        links = (f'<li><a href="#{_anchor(kind, s)}">{escape(s)}</a></li>' for s in subjects)
        yield f'<nav class="small"><ul>{"".join(links)}</ul></nav>'


def _anchor(kind: str, subject: str) -> str:
    return f"{kind}-{re.sub(r'[^A-Za-z0-9_-]', '_', subject)}"


def _snippet(title: str, lines: str) -> str:
    return f"<h3>{escape(title)}</h3><pre>{escape(lines)}</pre>"


def _figure(name: str, png: bytes) -> str:
    alt = escape(name.replace("_", " "), quote=True)
    wide, high = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))  # IHDR
    return (
        f'<figure{_class(["wide"] if wide > _WIDE else [])}><img alt="{alt}" width="{wide}" '
        f'height="{high}" src="data:image/png;base64,{b64encode(png).decode()}"></figure>'
    )


def _table(table: Table) -> Iterator[str]:
    columns = [[row[i].strip() for row in table.rows] for i in range(len(table.columns))]
    numeric = [_is_numeric(cells) for cells in columns]
    heads = (
        f'<th scope="col"{_class(["number"] if number else [])}>{escape(text)}</th>'
        for text, number in zip(table.columns, numeric, strict=True)
    )
    yield f'<h3>{escape(table.title)}</h3><div class="scroll"><table>'
    yield f"<thead><tr>{''.join(heads)}</tr></thead><tbody>"
    for row in table.rows:
        yield f"<tr>{''.join(_cells(row, numeric))}</tr>"
    yield "</tbody></table></div>"


def _is_numeric(cells: Sequence[str]) -> bool:
    said = [cell for cell in cells if cell not in _NOTHING]
    return bool(said) and all(_NUMBER.fullmatch(cell) for cell in said)


def _cells(row: Sequence[str], numeric: Sequence[bool]) -> Iterator[str]:
    for i, (text, number) in enumerate(zip(row, numeric, strict=True)):
        if i == 0 and not number:
            yield f'<th scope="row">{escape(text)}</th>'
            continue
        words = text.lower().split(maxsplit=1)
        states = [state for state in _STATES if words and words[0].rstrip(":,;") == state]
        yield f"<td{_class([*states, *(['number'] if number else [])])}>{escape(text)}</td>"


def _class(names: Iterable[str]) -> str:
    joined = " ".join(names)
    return f' class="{joined}"' if joined else ""
