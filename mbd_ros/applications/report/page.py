"""A report as one page that needs nothing but itself: style and pictures inside, no scripts.

A section has texts, tables, pictures, and lines to paste. The headlines also go into another page:
`mbd-ros report --readme`.
"""

from __future__ import annotations

import json
import os
import re
from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from mbd_ros.applications.report.items import Section, Table
from mbd_ros.errors import DataError
from mbd_ros.files.output_folder import make_folder, place_in
from mbd_ros.files.text_file import replacing
from mbd_ros.jobs.workers.opening import duration_text
from mbd_ros.regular_file import open_regular

# A section of the page: texts, tables, pictures, and lines to paste.
_NUMBER = re.compile(
    r"[<>≤≥~≈]? ?[-+−]?(\d[\d.,' ]*([eE][-+−]?\d+)?|nan|inf)( ?(x|×|%|[µmk]?s|min|h))?( ?[*★●])*"
)
_NOTHING = ("", "-", "–", "—")
_STATES = ("converged", "bounded", "stopped", "wrong")
_WIDE = 1000  # pixels; what has more is panned on a phone
_MANY = 3  # subjects that deserve links
_DENSE = 9  # columns; what has more is printed smaller
_LABEL = 40  # characters; a first column with more is text and not a label that stays in sight
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_LABELS = {"cpu": "CPU"}
BEGIN, END = "<!-- report: begin -->", "<!-- report: end -->"
_BETWEEN = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
_PLOT = ("images", "report.png")


def page(
    facts: Mapping[str, Any], sections: Mapping[str, Section], pictures: Mapping[str, bytes]
) -> str:
    """The page.

    Args:
        facts: When, where, from what, and what is wrong.
        sections: Kind -> section, in their order.
        pictures: Name of a figure -> PNG.

    Returns:
        HTML.
    """
    style = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
    body = [*_head(facts), *_navigation(sections), *_scenes(facts["pages"])]
    for kind, section in sections.items():
        body += section_lines(kind, section, pictures)
    body += _foot(facts)
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',
            f"<title>mbd_ros report</title><style>{style}</style></head><body>",
            *body,
            "</body></html>\n",
        ]
    )


def _head(facts: Mapping[str, Any]) -> Iterator[str]:
    yield "<header><h1>Report of mbd_ros</h1>"
    where = f"{facts['machine']['cpu']}, {facts['machine']['cores']} cores"
    what = "a quick one, " if facts["quick"] else ""
    scenes = f" Scenes: {', '.join(facts['scenes'])}." if facts["scenes"] else ""
    summary = f"{facts['date'][:16].replace('T', ' ')} UTC, {what}on {where}.{scenes}"
    yield f'<p class="facts">{escape(summary)}</p>'
    if facts["wrong"]:
        lines = "".join(f"<li>{escape(line)}</li>" for line in facts["wrong"])
        yield f'<div class="verdict bad"><strong>Wrong: {len(facts["wrong"])}</strong>'
        yield f"<ul>{lines}</ul></div>"
    else:
        yield '<div class="verdict"><strong>Nothing is wrong.</strong></div>'
    if facts["changed"]:
        names = escape(", ".join(facts["changed"]))
        yield f'<div class="verdict bad"><strong>Changed while this ran: {names}.</strong>'
        yield "<p>What depends on it is not kept: run the report again.</p></div>"
    yield "</header>"


def _navigation(sections: Mapping[str, Section]) -> Iterator[str]:
    links = (f'<li><a href="#{k}">{escape(s.title)}</a></li>' for k, s in sections.items())
    yield f'<nav><ul>{"".join(links)}<li><a href="#made">How it was made</a></li></ul></nav>'


def _scenes(pages: Mapping[str, str]) -> Iterator[str]:
    """Links to what moves: those pages run scripts, this one does not."""
    if pages:
        links = (
            f'<li><a href="{escape(quote(file), quote=True)}">{escape(name)}</a></li>'
            for name, file in pages.items()
        )
        yield f'<p>Scenes, moving:</p><nav class="small"><ul>{"".join(links)}</ul></nav>'


def _foot(facts: Mapping[str, Any]) -> Iterator[str]:
    git = facts["git"]
    changed = " with changes that are not committed" if git.get("changed") else ""
    rows = {
        "Git": f"{git['commit']}{changed}" if git else "not a checkout",
        "Work": f"{duration_text(facts['work'])} of computation, "
        f"{duration_text(facts['duration'])} in this run",
        **{_LABELS.get(k, k.capitalize()): str(v) for k, v in facts["machine"].items()},
        "Versions": ", ".join(f"{name} {v}" for name, v in facts["versions"].items()),
    }
    yield '<section id="made"><h2>How it was made</h2>'
    if facts["timed"]:
        yield f"<p>{escape(_timing(facts))}</p>"
    pairs = (f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in rows.items())
    yield f"<dl>{''.join(pairs)}</dl></section>"


def _timing(facts: Mapping[str, Any]) -> str:
    return (
        f"{facts['timed']} items time a run. They ran one at a time in worker processes with one"
        " thread, several of them one after the other in the same process, and nothing else of the"
        f" report ran beside them. On: {', '.join(facts['cpus'])}."
    )


def section_lines(kind: str, section: Section, pictures: Mapping[str, bytes]) -> Iterator[str]:
    """A section as HTML.

    Args:
        section: What it says.
        pictures: Name of a figure -> PNG.

    Yields:
        HTML, a part a time.
    """
    yield f'<section id="{kind}"><h2>{escape(section.title)}</h2>'
    if section.wrong:
        lines = "".join(f"<li>{escape(line)}</li>" for line in section.wrong)
        yield f'<div class="verdict bad"><strong>Wrong</strong><ul>{lines}</ul></div>'
    paragraphs = "".join(f"<p>{escape(text)}</p>" for text in section.text)
    yield f'<div class="text">{paragraphs}</div>'
    subjects = [_subject(table) for table in section.tables]
    named = [s for s in dict.fromkeys(subjects) if s]
    figures = {n: _longest(s for s in named if n.endswith(s)) for n in section.figures}
    snippets = {t: _longest(s for s in named if t.startswith(s)) for t in section.snippets}
    yield from _links(kind, named)
    for i, (table, subject) in enumerate(zip(section.tables, subjects, strict=True)):
        if subject and subject not in subjects[:i]:
            yield f'<div id="{_anchor(kind, subject)}"></div>'
        yield from _table(table)
        if subject and subject not in subjects[i + 1 :]:
            yield from _beside(section, pictures, _of(subject, figures), _of(subject, snippets))
    yield from _beside(section, pictures, _of("", figures), _of("", snippets))
    yield "</section>"


def _subject(table: Table) -> str:
    """Return the part of a title before its colon."""
    before, colon, _ = table.title.partition(": ")
    return before if colon else ""


def _longest(subjects: Iterable[str]) -> str:
    """The subject that is meant where one is part of another: arm, arm_coupled."""
    return max(subjects, key=len, default="")


def _links(kind: str, subjects: Sequence[str]) -> Iterator[str]:
    if len(subjects) >= _MANY:
        links = (f'<li><a href="#{_anchor(kind, s)}">{escape(s)}</a></li>' for s in subjects)
        yield f'<nav class="small"><ul>{"".join(links)}</ul></nav>'


def _anchor(kind: str, subject: str) -> str:
    return f"{kind}-{re.sub(r'[^A-Za-z0-9_-]', '_', subject)}"


def _table(table: Table) -> Iterator[str]:
    columns = [[row[i].strip() for row in table.rows] for i in range(len(table.columns))]
    numeric = [_is_numeric(cells) for cells in columns]
    is_named = columns and not numeric[0] and all(len(text) <= _LABEL for text in columns[0])
    heads = (
        f'<th scope="col"{_class(["number"] if number else [])}>{escape(text)}</th>'
        for text, number in zip(table.columns, numeric, strict=True)
    )
    dense = _class(["dense"] if len(columns) > _DENSE else [])
    yield f'<h3>{escape(table.title)}</h3><div class="scroll"><table{dense}>'
    yield f"<thead><tr>{''.join(heads)}</tr></thead><tbody>"
    for row in table.rows:
        cells = [_cell(text, number) for text, number in zip(row, numeric, strict=True)]
        yield f"<tr>{''.join([_label(row[0]), *cells[1:]] if is_named else cells)}</tr>"
    yield "</tbody></table></div>"


def _is_numeric(cells: Sequence[str]) -> bool:
    said = [cell for cell in cells if cell not in _NOTHING]
    return bool(said) and all(_NUMBER.fullmatch(cell) for cell in said)


def _class(names: Iterable[str]) -> str:
    joined = " ".join(names)
    return f' class="{joined}"' if joined else ""


def _cell(text: str, is_numeric: bool) -> str:
    words = text.lower().split(maxsplit=1)
    states = [state for state in _STATES if words and words[0].rstrip(":,;") == state]
    return f"<td{_class([*states, *(['number'] if is_numeric else [])])}>{escape(text)}</td>"


def _label(text: str) -> str:
    return f'<th scope="row">{escape(text).replace("_", "_<wbr>")}</th>'


def _beside(
    section: Section, pictures: Mapping[str, bytes], figures: list[str], snippets: list[str]
) -> Iterator[str]:
    """Pictures and lines, next to one another where there is room."""
    if figures or snippets:
        yield '<div class="beside">'
        yield from (_figure(name, pictures[name]) for name in figures)
        if snippets:
            lines = (_snippet(title, section.snippets[title]) for title in snippets)
            yield f'<div class="snippets">{"".join(lines)}</div>'
        yield "</div>"


def _figure(name: str, png: bytes) -> str:
    alt = escape(name.replace("_", " "), quote=True)
    wide, high = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))  # IHDR
    looks = [*(["wide"] if wide > _WIDE else []), *(["tall"] if high > wide > _WIDE else [])]
    return (
        f'<figure{_class(looks)}><img alt="{alt}" width="{wide}" height="{high}" '
        f'src="data:image/png;base64,{b64encode(png).decode()}"></figure>'
    )


def _snippet(title: str, lines: str) -> str:
    return f"<h3>{escape(title)}</h3><pre>{escape(lines)}</pre>"


def _of(subject: str, owners: Mapping[str, str]) -> list[str]:
    return [name for name, owner in owners.items() if owner == subject]


def put_headlines(readme: Path, folder: Path) -> Iterator[str]:
    """Replace what is between the marks of a page, and the plot in `images` beside it.

    Args:
        folder: That of a report.

    Yields:
        What was written.

    Raises:
        DataError: There is no report, or the page has no marks.
    """
    report = place_in(folder, "report.json")
    numbers = _load(report)
    try:
        text = _bytes(readme).decode("utf-8")
    except UnicodeDecodeError as error:
        raise DataError(f"{readme}: is not UTF-8 text: {error.reason}") from error
    if len(_BETWEEN.findall(text)) != 1:
        raise DataError(f"{readme}: expected {BEGIN} and {END} once")
    try:
        lines = [BEGIN, *_made(numbers), *_tables(numbers)]
        sections = numbers["sections"].values()
        figures = [str(f) for s in sections for f in s["figures"] if f in s["headline"]]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{report}: no report that can be read ({error!r})") from error
    if figures:
        target = place_in(readme.parent, *_PLOT)
        picture = _bytes(place_in(folder, f"{figures[0]}.png"))
        make_folder(target.parent)
        with replacing(target) as file:
            file.write(picture)
        lines += [f"![{figures[0].replace('_', ' ')}]({'/'.join(_PLOT)})", ""]
        yield f"{figures[0]} -> {target}"
    new = _BETWEEN.sub(lambda _: "\n".join([*lines, END]), text)
    with replacing(readme) as file:
        file.write(new.encode())
    yield f"headlines of {os.fspath(folder)} -> {readme}"


def _load(path: Path) -> dict[str, Any]:
    try:
        loaded: dict[str, Any] = json.loads(_bytes(path))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: no report that can be read ({error})") from error
    return loaded


def _bytes(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return file.read()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error


def _made(numbers: Mapping[str, Any]) -> Iterator[str]:
    machine, git = numbers["machine"], numbers["git"]
    commit = f", commit {git['commit'][:10]}" if git else ""
    changed = " with changes" if git.get("changed") else ""
    quick = " --quick" if numbers["quick"] else ""
    versions = (f"{n} {v}" for n, v in numbers["versions"].items() if n not in ("mbd_ros", "dask"))
    yield (
        f"Made by `mbd-ros report{quick}` on {numbers['date'][:10]}{commit}{changed}; "
        f"{machine['cpu']}, {machine['cores']} cores; {', '.join(versions)}."
    )
    if numbers["wrong"]:
        yield f"**{len(numbers['wrong'])} cells are wrong.**"
    yield ""


def _tables(numbers: Mapping[str, Any]) -> Iterator[str]:
    for section in numbers["sections"].values():
        for title, columns, rows in section["tables"]:
            if title in section["headline"]:
                yield f"{title}:"
                yield ""
                yield _row(columns)
                yield "|---" * len(columns) + "|"
                yield from map(_row, rows)
                yield ""


def _row(cells: list[str]) -> str:
    escaped = (cell.replace("|", r"\|") for cell in cells)
    return f"| {' | '.join(escaped)} |"
