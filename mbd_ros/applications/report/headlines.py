"""The headlines of a report in a page: `mbd-ros report --readme`."""

import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mbd_ros.errors import DataError
from mbd_ros.files.output_file import replacing

BEGIN, END = "<!-- report: begin -->", "<!-- report: end -->"
_BETWEEN = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
_PLOT = Path("images/report.png")


def put_headlines(readme: Path, folder: Path) -> Iterator[str]:
    """Replace what is between the marks of a page, and the plot in `images` beside it.

    Args:
        readme: The page.
        folder: That of a report.

    Yields:
        What was written.

    Raises:
        DataError: There is no report, or the page has no marks.
    """
    numbers = _load(folder / "report.json")
    try:
        text = readme.read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(f"{readme}: cannot be read ({error.strerror})") from error
    if len(_BETWEEN.findall(text)) != 1:
        raise DataError(f"{readme}: expected {BEGIN} and {END} once")
    lines = [BEGIN, *_made(numbers), *_tables(numbers)]
    figures = [f for s in numbers["sections"].values() for f in s["figures"] if f in s["headline"]]
    if figures:
        target = readme.parent / _PLOT
        target.parent.mkdir(exist_ok=True)
        with replacing(target) as file:
            file.write((folder / f"{figures[0]}.png").read_bytes())
        lines += [f"![{figures[0].replace('_', ' ')}]({_PLOT.as_posix()})", ""]
        yield f"{figures[0]} -> {target}"
    new = _BETWEEN.sub(lambda _: "\n".join([*lines, END]), text)
    with replacing(readme) as file:
        file.write(new.encode())
    yield f"headlines of {os.fspath(folder)} -> {readme}"


def _load(path: Path) -> dict[str, Any]:
    try:
        loaded: dict[str, Any] = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: no report that can be read ({error})") from error
    return loaded


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
