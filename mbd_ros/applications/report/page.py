"""One page that needs nothing but itself: style and pictures inside, no scripts."""

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from mbd_ros.applications.report.items import Section
from mbd_ros.applications.report.page_section import section_lines
from mbd_ros.jobs.workers.remaining import spoken

_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_LABELS = {"cpu": "CPU"}


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
        "Work": f"{spoken(facts['work'])} of computation, {spoken(facts['duration'])} in this run",
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
