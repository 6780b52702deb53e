"""Gaits on one page that needs nothing else."""

import base64
import html
from collections.abc import Iterator
from pathlib import Path

from mbd_ros.features.gait.pictures import basin, diagram, portrait
from mbd_ros.features.gait.tables import BASIN, BRANCHES, GAITS, MARKS
from mbd_ros.files.replacing import replacing
from mbd_ros.files.table import MAIN, Result, Table

_STYLE = (
    "body{font:15px sans-serif;max-width:60em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse;font-size:13px}td,th{padding:.2em .7em;text-align:right;"
    "border-bottom:1px solid #ccc}img{max-width:100%}"
)


def write_page(result: Result, path: Path, parameter: str) -> None:
    """Write the page; names in it come from files of others and are escaped.

    Args:
        result: Of `run_gait`.
        path: The page.
        parameter: Of the continuation; empty without one.
    """
    title = html.escape(f"Gaits of {result.metadata['scene']}")
    lines = [
        "<!doctype html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{title}</title>',
        '<meta name="viewport" content="width=device-width">',
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>",
        *_sections(result, parameter),
        "</body></html>",
    ]
    with replacing(path) as file:
        file.write("\n".join(lines).encode())


def _sections(result: Result, parameter: str) -> Iterator[str]:
    yield from _transposed(result[GAITS])
    yield "<h2>The first gait</h2>"
    yield _image(portrait(result[MAIN])._repr_png_(), "positions and velocities over a cycle")
    if BRANCHES in result:
        yield f"<h2>Gaits by {html.escape(parameter)}</h2>"
        yield "<p>Unstable parts are dotted. Squares are folds, diamonds period doublings.</p>"
        yield _image(diagram(result[BRANCHES], parameter)._repr_png_(), "branches")
        yield from _marks(result[BRANCHES], parameter)
    if BASIN in result:
        yield "<h2>Starts</h2>"
        drawn = basin(result[BASIN])
        if drawn is not None:
            yield _image(drawn._repr_png_(), "outcome of each start")
        total, table = result[BASIN].rows, result[BASIN]
        came = int((table["outcome"] > 0).sum())
        yield f"<p>{came} of {total} starts come to a gait.</p>"


def _transposed(table: Table) -> Iterator[str]:
    """A line a column: gaits stand side by side."""
    yield "<table>"
    for column in table.columns:
        cells = "".join(f"<td>{html.escape(_text(value))}</td>" for value in column.values)
        yield f"<tr><th>{html.escape(column.label)}</th>{cells}</tr>"
    yield "</table>"


def _marks(table: Table, parameter: str) -> Iterator[str]:
    rows = [i for i, mark in enumerate(table["mark"]) if mark]
    if not rows:
        return
    yield f"<table><tr><th>branch</th><th>what</th><th>{html.escape(parameter)}</th></tr>"
    for i in rows:
        word = MARKS[int(table["mark"][i])]
        yield (
            f"<tr><td>{table['branch'][i]}</td><td>{word}</td>"
            f"<td>{table['parameter'][i]:.12g}</td></tr>"
        )
    yield "</table>"


def _text(value: object) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _image(png: bytes, text: str) -> str:
    return f'<img alt="{text}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'
