"""Tables of a result in one file, or side by side where a format holds one a file."""

from pathlib import Path

from mbd_ros.files.formats import format_of, suffix_of
from mbd_ros.files.table import MAIN, Result
from mbd_ros.jobs.progress import Say


def write_tables(result: Result, out: Path, say: Say) -> None:
    """Write all tables, `samples` first and to the given place.

    Tables beside `samples` that the format cannot hold, since they have words, are left out.

    Args:
        out: Its suffix chooses the format.
        say: Is told what went where, a line a file.
    """
    chosen = format_of(out)
    if not chosen.one_table:
        result.to(out)
        say(f"{', '.join(result)} -> {out}")
        return
    for name, table in sorted(result.tables.items(), key=lambda pair: pair[0] != MAIN):
        place = out if name == MAIN else beside(out, name)
        if name != MAIN and not all(map(chosen.holds, table.columns)):
            say(f"{name} is left out, a file holds {chosen.content}; .npz holds all tables")
            continue
        Result({MAIN: table}, result.metadata).to(place)
        say(f"{name}, {table.rows} rows -> {place}")


def beside(out: Path, table: str) -> Path:
    """Where a table goes whose format holds one a file: o.csv.gz -> o.gaits.csv.gz."""
    suffix = suffix_of(out)
    return out.with_name(f"{out.name.removesuffix(suffix)}.{table}{suffix}")
