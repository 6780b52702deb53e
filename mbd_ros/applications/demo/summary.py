"""What a demo says in the end, for terminal and page: tables and checks."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple


class Table(NamedTuple):
    """Texts, ready to be shown; the first column names the row."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


class Check(NamedTuple):
    """Something that must hold."""

    what: str
    is_met: bool
    found: str


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
    rows = [(c.what, "yes" if c.is_met else "NO", c.found) for c in checks]
    return Table("Checks", ("", "met", "found"), rows)
