"""Tables of a result in one file, or in several where a format holds one table each."""

from pathlib import Path

from mbd_ros.files.formats import format_of, suffix_of
from mbd_ros.files.table import MAIN, Result
from mbd_ros.jobs.progress import Say


def write_tables(result: Result, out: Path, say: Say) -> None:
    """Write all tables, and `samples` to the given path.

    A format that holds numbers only leaves out tables with text, except `samples`.

    Args:
        out: Path whose suffix chooses the format.
        say: Called with one line for each file.
    """
    chosen = format_of(out)
    if not chosen.one_table:
        result.to(out)
        say(f"{', '.join(result)} -> {out}")
        return
    for name, table in sorted(result.tables.items(), key=lambda pair: pair[0] != MAIN):
        place = out if name == MAIN else beside(out, name)
        if name != MAIN and not all(map(chosen.holds, table.columns)):
            say(f"table {name} is left out, {suffix_of(out)} holds {chosen.content}; use .npz")
            continue
        Result({MAIN: table}, result.metadata).to(place)
        say(f"{name}, {table.rows} rows -> {place}")


def beside(out: Path, table: str) -> Path:
    """Return the path of a table beside the main one: o.csv.gz -> o.gaits.csv.gz."""
    suffix = suffix_of(out)
    return out.with_name(f"{out.name.removesuffix(suffix)}.{table}{suffix}")
