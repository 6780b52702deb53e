"""Storages of OpenSim, .mot and .sto.

A storage names coordinates as a model does: `knee_angle_r`, or by the path of the state,
`/jointset/knee_r/knee_angle_r/value` and `/speed`. `joint_columns` gives the joints of a scene
their columns. What this package writes has a header line of its own with names, units, frames and
metadata, so that it comes back as it was; OpenSim takes no notice of it.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.table import MAIN, STAMP, TIME, Column, Result, Table
from mbd_ros.files.tables.description import column_of, describe, described
from mbd_ros.files.text_file import (
    MAX_COLUMNS,
    Lines,
    check_times,
    labels_of,
    numbers_of,
    reading,
    repeated_among,
    replacing,
)

_OURS = "mbd_ros"
_KEY = re.compile(r"([A-Za-z_]\w*)\s*=\s*(.*)")
_SIMM = re.compile(r"(datacolumns|datarows|range|name|otherdata)\s+(.*)", re.IGNORECASE)
_DEGREE = np.pi / 180.0
_ANGULAR = ("rad", "rad/s", "rad/s^2")
_SUFFIX = {  # end and unit of a column -> end of its label
    (".position", "rad"): "",
    (".position", "m"): "",
    (".velocity", "rad/s"): "_u",
    (".velocity", "m/s"): "_u",
    (".effort", "N·m"): "_moment",
    (".effort", "N"): "_force",
}
_MOST_HEADER = 10_000  # lines
DEGREES = "in_degrees"  # metadata of what others wrote: whether rotations are in degrees
REPEATED = "repeated"  # its labels that stand there more than once
REMARKS = "remarks"  # what is odd about it, for people
_PATH = re.compile(r"/(?:.+/)?([^/]+)/(value|speed)")
_STATE = re.compile(r"/(?:.+/)?([^/]+)/([^/]+)")
_QUANTITY = {"value": "position", "speed": "velocity"}
_ENDS = {"": "position", "_u": "velocity", "_moment": "effort", "_force": "effort"}
_RADIANS, _METRES = (
    {"position": "rad", "velocity": "rad/s", "effort": "N·m"},
    {"position": "m", "velocity": "m/s", "effort": "N"},
)


class Storage:
    """One table of numbers, `time` first; `.gz` where the name ends so."""

    content = "one finite number or nan a row"
    one_table = True

    def holds(self, column: Column) -> bool:
        """Whether it is a finite number, or nan, a row, under a name without tabs."""
        values, name = column.values, column.name
        if values.ndim != 1 or values.dtype.kind not in "fiub":
            return False
        if name != name.strip() or not name.isprintable():
            return False
        return values.dtype.kind != "f" or not np.isinf(values).any()

    def read(self, path: Path) -> Result:
        """Its columns; those of others by their labels, with `metadata["in_degrees"]`.

        Rows at the time of the row before are left out, as a run that ends twice writes them. Of
        columns with one label the second is `label (2)`; whoever asks for the label is refused.
        `metadata["remarks"]` says so.

        Raises:
            DataError: File, line and column of what is not acceptable.
        """
        with reading(path) as file:
            lines = Lines(path, file)
            header = _header(path, lines)
            labels = labels_of(path, next(lines, b""), header.lines + 1)
            values = numbers_of(path, lines, labels, header.lines + 2)
        labels, values = _with_time(path, header, labels, values)
        remarks = _size_remarks(path, header, labels, values, lines.ended)
        if _OURS in header.keys:
            check_times(path, values[:, 0])
            return _restored(path, header, values)
        repeated = repeated_among(labels)
        anew = np.concatenate([[True], np.diff(values[:, 0]) != 0.0])[: len(values)]
        values = values[anew]
        check_times(path, values[:, 0])
        if not anew.all():
            remarks.append(f"{(~anew).sum()} rows at the time of the row before are left out")
        columns = [Column(TIME, values[:, 0], "s")]
        named = zip(_numbered(labels)[1:], values[:, 1:].T, strict=True)
        columns += [Column(label, column) for label, column in named]
        metadata = {"name": header.name, DEGREES: header.in_degrees, REPEATED: repeated}
        return Result({MAIN: Table(columns)}, {**metadata, REMARKS: remarks})

    def write(self, path: Path, result: Result, degrees: bool = False) -> None:
        """Write a table; its `stamp`, the time in nanoseconds, is left out.

        Args:
            result: Its table has the column `time`.
            degrees: Whether angles, their speeds and accelerations are in degrees in the file.

        Raises:
            DataError: No `time`, too many columns, labels that meet, or a place that cannot be
                written to.
        """
        ((name, table),) = result.tables.items()
        columns = [column for column in table.columns if column.name != STAMP]
        if not columns or columns[0].name != TIME:
            raise DataError(f"{path}: the first column of table {name} is no time")
        if len(columns) > MAX_COLUMNS:
            raise DataError(f"{path}: {len(columns)} columns, accepted are {MAX_COLUMNS}")
        labels = [_label(column) for column in columns]
        if repeated := repeated_among(labels):
            raise DataError(f"{path}: columns would meet at label {', '.join(repeated)}")
        kinds = {column.name: {"dtype": column.values.dtype.str} for column in columns}
        told = describe(Result({name: Table(columns)}, result.metadata), {name: kinds})
        head = (
            f"{name}\nversion=1\nnRows={table.rows}\nnColumns={len(columns)}\n"
            f"inDegrees={'yes' if degrees else 'no'}\n{_OURS}={told}\nendheader\n"
        )
        values = np.column_stack([_scaled(column, degrees) for column in columns])
        with replacing(path) as file:
            file.write((head + "\t".join(labels) + "\n").encode())
            for row in values:
                file.write(("\t".join(map(repr, row.tolist())) + "\n").encode())


class _Header(NamedTuple):
    """The header of the file, above the labels.

    Attributes:
        keys: Of lines `key=value` or, in old files, `key value`, in small letters.
        lines: How many there are.
        is_simm: Whether it is of the old kind, whose rotations are in degrees.
    """

    name: str
    keys: Mapping[str, str]
    lines: int
    is_simm: bool

    @property
    def in_degrees(self) -> bool:
        given = self.keys.get("indegrees")
        return self.is_simm if given is None else given.lower() in ("yes", "y", "true")


def _header(path: Path, lines: Iterator[bytes]) -> _Header:
    keys: dict[str, str] = {}
    name, is_simm = "", False
    for number, line in enumerate(lines, 1):
        text = line.decode("utf-8", "replace").strip()
        if text.lower() == "endheader":
            return _Header(name, keys, number, is_simm and "version" not in keys)
        name = text if number == 1 else name
        if found := _KEY.fullmatch(text):
            keys.setdefault(found[1].lower(), found[2])
        elif found := _SIMM.fullmatch(text):
            keys.setdefault(found[1].lower(), found[2])
            is_simm = True
        if number > _MOST_HEADER:
            break
    raise DataError(f"{path}: no line 'endheader', so it is no storage of OpenSim, or it is cut")


def _with_time(
    path: Path, header: _Header, labels: list[str], values: Array
) -> tuple[list[str], Array]:
    """Labels and values with the time in front; old files may give its range alone."""
    if labels and labels[0].lower() == TIME:
        return labels, values
    try:
        first, last = map(float, header.keys["range"].split())
    except (KeyError, ValueError):
        shown = labels[0][:40] if labels else ""
        raise DataError(
            f"{path}: line {header.lines + 1}: first column is {shown!r}, expected 'time'"
        ) from None
    return [TIME, *labels], np.column_stack([np.linspace(first, last, len(values)), values])


def _numbered(labels: Sequence[str]) -> list[str]:
    """Labels of their own: a second `a` is `a (2)`."""
    seen: Counter[str] = Counter()
    names = []
    for label in labels:
        seen[label] += 1
        names.append(f"{label} ({seen[label]})" if seen[label] > 1 else label)
    return names


def _size_remarks(
    path: Path, header: _Header, labels: list[str], values: Array, ended: bool
) -> list[str]:
    """Refuse a table that is cut or of other columns than the header says; say other rows.

    Files of laboratories often have other rows than their header says, since somebody took some
    out: then the last line has its end.
    """
    columns, rows = (
        next((header.keys[key].strip() for key in keys if key in header.keys), None)
        for keys in (("ncolumns", "datacolumns"), ("nrows", "datarows"))
    )
    allowed = {len(labels), len(labels) - 1} if header.is_simm else {len(labels)}
    if columns is not None and not (columns.isdigit() and int(columns) in allowed):
        raise DataError(f"{path}: has {len(labels)} columns, its header says {columns[:20]}")
    if rows is None or (rows.isdigit() and int(rows) == len(values)):
        return []
    text = f"has {len(values)} rows, its header says {rows[:20]}"
    if not ended:
        raise DataError(f"{path}: {text}, and the last line has no end: it is cut")
    return [text]


def _restored(path: Path, header: _Header, values: Array) -> Result:
    """The result that this package wrote."""
    tables, metadata = described(header.keys[_OURS], str(path))
    ((name, entries),) = tables.items() if len(tables) == 1 else (("", ()),)
    if len(entries) != values.shape[1]:
        raise DataError(f"{path}: its header describes {len(entries)} columns")
    columns = []
    for entry, found in zip(entries, values.T, strict=True):
        scale = _DEGREE if header.in_degrees and entry["unit"] in _ANGULAR else 1.0
        columns.append(column_of(entry, _typed(path, entry, scale * found)))
    return Result({name: Table(columns)}, metadata)


def _typed(path: Path, entry: Mapping[str, Any], values: Array) -> Any:
    try:
        return values.astype(np.dtype(entry["dtype"]))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: column {entry['name']}: of no known kind") from error


def _label(column: Column) -> str:
    """The label that OpenSim gives to what a column holds, or its name."""
    for (end, unit), suffix in _SUFFIX.items():
        if column.name.endswith(end) and column.unit == unit:
            return column.name.removesuffix(end) + suffix
    return column.name


def _scaled(column: Column, degrees: bool) -> Array:
    values = np.asarray(column.values, dtype=np.float64)
    return values / _DEGREE if degrees and column.unit in _ANGULAR else values


def is_storage(result: Result) -> bool:
    """Whether labels are those of a laboratory."""
    return DEGREES in result.metadata


def joint_columns(
    result: Result, table: Table, where: str, joints: Collection[str], sliding: Collection[str]
) -> Table:
    """The columns of a storage, those of joints under names of this package, in radians.

    `<joint>` and `<..>/<joint>/value` become `<joint>.position`, `<joint>_u` and `<..>/speed`
    `<joint>.velocity`, `<joint>_moment` and `<joint>_force` `<joint>.effort`; paths of other
    states, `/forceset/soleus_r/activation`, `soleus_r.activation`; all others stay.

    Args:
        result: Its metadata say whether rotations are in degrees.
        table: One of its tables.
        where: File, for the messages.
        joints: Names of joints.
        sliding: Those of them that slide: they are in metres whatever the header says.

    Raises:
        DataError: Two labels for one quantity, or one that is not a number at some time.
    """
    columns, labels, joints, taken = [], dict[str, str](), frozenset(joints), set(table)
    for column in table.columns:
        joint, quantity = _meaning(column.name, joints)
        if not joint:
            columns.append(_state(column, taken))
            continue
        name = f"{joint}.{quantity}"
        if name in labels:
            raise DataError(f"{where}: columns {labels[name]} and {column.name} are both {name}")
        if column.name in result.metadata.get(REPEATED, ()):
            raise DataError(f"{where}: several columns are called {column.name}")
        labels[name] = column.name
        columns.append(_converted(result.metadata, column, name, joint in sliding))
        _check_finite(where, table, column)
    return Table(columns)


def other_labels(table: Table, joints: Collection[str]) -> list[str]:
    """Labels of a storage that are of no joint."""
    known = frozenset(joints)
    return [label for label in table if label != TIME and not _meaning(label, known)[0]]


def _meaning(label: str, joints: Collection[str]) -> tuple[str, str]:
    """Joint and quantity of a label; empty where it is of none."""
    if found := _PATH.fullmatch(label):
        return (found[1], _QUANTITY[found[2]]) if found[1] in joints else ("", "")
    for end, quantity in _ENDS.items():
        if label.endswith(end) and (joint := label.removesuffix(end)) in joints:
            return joint, quantity
    return "", ""


def _state(column: Column, taken: set[str]) -> Column:
    """A column of a state that is of no joint, under the name of its part if that is free."""
    found = _STATE.fullmatch(column.name)
    if not found or (name := f"{found[1]}.{found[2]}") in taken:
        return column
    taken.add(name)
    return column._replace(name=name)


def _converted(metadata: Mapping[str, object], column: Column, name: str, slides: bool) -> Column:
    quantity = name.rpartition(".")[2]
    turned = metadata[DEGREES] and not slides and quantity != "effort"
    values = np.deg2rad(column.values) if turned else column.values
    return Column(name, values, (_METRES if slides else _RADIANS)[quantity])


def _check_finite(where: str, table: Table, column: Column) -> None:
    lost = np.flatnonzero(~np.isfinite(column.values))
    if lost.size:
        time = table[TIME][lost[0]]
        raise DataError(f"{where}: column {column.name}: no number at {time:.9g} s")
