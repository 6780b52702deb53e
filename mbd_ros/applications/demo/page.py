"""The page of a demo, in one file, and what it says in the end: tables and checks."""

from __future__ import annotations

import platform
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from mbd_ros.applications.demo.files import PAGE, PICTURE
from mbd_ros.applications.demo.processes import Failed
from mbd_ros.errors import install_hint
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.frames import Frames
from mbd_ros.view.motion import ViewedMotion, viewed_motion
from mbd_ros.view.recording import POLICY

_STYLE = """
.plots { display: grid; gap: 0 1.5rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); }
.plots figure { margin: .8rem 0; } .plots figcaption { font-weight: 600; margin-bottom: .3rem; }
.moving { margin: 1.2rem 0; } .moving figcaption { color: var(--soft); font-size: .9rem; }
.moving iframe { width: 100%; max-width: 60rem; height: min(30rem, 75vh);
  border: 1px solid var(--line); border-radius: .4rem; }
table { width: auto; } thead th.number { white-space: normal; }
@media (max-width: 40rem) { td.number { white-space: normal; }
  tr > :first-child { max-width: none; overflow-wrap: normal; } }
@media print { .moving { display: none; } .plots { display: block; }
  .plots figure { display: inline-block; width: 48%; vertical-align: top; }
  .plots figure img { max-height: 165mm; } }
"""


def write_page(folder: Path, overview: bytes, content: Content) -> None:
    """Write the page of a demo, and its overview as a picture of its own."""
    (folder / PICTURE).write_bytes(overview)
    (folder / PAGE).write_text(page(content), encoding="utf-8")


def conclusion(content: Content, files: str, out: Path) -> Iterator[str]:
    """Yield the tables of a demo for a terminal, and where its files are.

    Args:
        files: What the folder holds besides picture and page.

    Raises:
        Failed: A check is not met.
    """
    for table in content.tables:
        yield from lines(table)
    yield f"\n{files}, picture and page: {out}; open {PAGE} there"
    if content.failed:
        raise Failed("; ".join(content.failed))


def machine(packages: Sequence[str]) -> dict[str, str]:
    """Versions of packages and the machine, as `Content.made` tells them."""
    return {
        "Versions": ", ".join(f"{name} {version(name)}" for name in packages),
        "Machine": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    }


def page(content: Content) -> str:
    """The page as HTML."""
    shared = Path(__file__).parents[1] / "report/page.css"
    style = shared.read_text(encoding="utf-8") + _STYLE
    html, caption = content.moving
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',
            f"<title>{escape(content.title)}</title><style>{style}</style></head><body>",
            f"<header><h1>{escape(content.title)}</h1>",
            f'<p class="facts">{escape(content.facts)}</p>',
            _verdict(content.failed),
            *(f"<p>{escape(text)}</p>" for text in content.text),
            "</header>",
            f'<figure class="moving">{html}<figcaption>{escape(caption)}</figcaption></figure>',
            '<section class="plots">',
            *(_figure(caption, png) for caption, png in content.pictures.items()),
            "</section><section>",
            *(line for table in content.tables for line in _table(table)),
            "</section><section><h2>How it was made</h2>",
            f"<dl>{_pairs(content.made)}</dl></section>",
            "</body></html>\n",
        ]
    )


def _verdict(failed: Sequence[str]) -> str:
    if not failed:
        return '<div class="verdict"><strong>All checks are met.</strong></div>'
    rows = "".join(f"<li>{escape(line)}</li>" for line in failed)
    return f'<div class="verdict bad"><strong>Not met:</strong><ul>{rows}</ul></div>'


def _figure(caption: str, png: bytes) -> str:
    data, text = b64encode(png).decode(), escape(caption, quote=True)
    image = f'<img alt="{text}" src="data:image/png;base64,{data}">'
    return f"<figure><figcaption>{text}</figcaption>{image}</figure>"


def _table(table: Table) -> Iterator[str]:
    yield f'<h3>{escape(table.title)}</h3><div class="scroll"><table><thead><tr>'
    for i, text in enumerate(table.columns):
        number = ' class="number"' if i else ""
        yield f'<th scope="col"{number}>{escape(text)}</th>'
    yield "</tr></thead><tbody>"
    for name, *cells in table.rows:
        numbers = "".join(f'<td class="number">{escape(cell)}</td>' for cell in cells)
        label = escape(name).replace("/", "/<wbr>").replace("_", "_<wbr>")
        yield f'<tr><th scope="row">{label}</th>{numbers}</tr>'
    yield "</tbody></table></div>"


def _pairs(made: Mapping[str, str]) -> str:
    return "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in made.items())


class Content(NamedTuple):
    """Contents of a page.

    Attributes:
        facts: Line below it.
        failed: Checks that are not met.
        moving: What moves, HTML, and a line below it.
        pictures: Caption -> PNG.
        made: Name -> value, how it was made.
    """

    title: str
    facts: str
    failed: Sequence[str]
    text: Sequence[str]
    moving: tuple[str, str]
    pictures: Mapping[str, bytes]
    tables: Sequence[Table]
    made: Mapping[str, str]


class Table(NamedTuple):
    """Texts, ready to be shown; the first column names the row."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


class Check(NamedTuple):
    """Something that must hold."""

    what: str
    is_met: bool
    value: str


def lines(table: Table) -> Iterator[str]:
    """A table for a terminal: names to the left, numbers to the right."""
    widths = [
        max(len(cell) for cell in column)
        for column in zip(table.columns, *table.rows, strict=True)
    ]
    yield ""
    yield table.title
    for row in (table.columns, *table.rows):
        cells = [row[0].ljust(widths[0])]
        cells += [c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True)]
        yield "  " + "  ".join(cells).rstrip()


def check_table(checks: Sequence[Check]) -> Table:
    """The checks of a demo, a row each."""
    rows = [(c.what, "yes" if c.is_met else "NO", c.value) for c in checks]
    return Table("Checks", ("", "met", "found"), rows)


def inlined(scene: Scene, motion: ViewedMotion, title: str, slower: float = 1.0) -> str:
    """A frame around an animated page, or a line on what is not installed."""
    if find_spec("viser") is None:
        return f"<p>Nothing moves here: {escape(install_hint('viser'))}</p>"
    from mbd_ros.view.recording import animated_page

    text = escape(animated_page(scene, motion, title, slower=slower).text, quote=True)
    name = escape(title, quote=True)
    return f'<iframe title="{name}" sandbox="allow-scripts" srcdoc="{text}"></iframe>'


def moving_result(scene: Scene, result: Source, title: str, slower: float) -> str:
    """A simulated motion, `slower` times slower, as HTML to inline."""
    return inlined(scene, viewed_motion(scene, result, Frames(scene).rows), title, slower)
