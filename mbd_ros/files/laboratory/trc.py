"""Marker trajectories, .trc: positions of labelled points at a steady rate.

Five lines stand above the numbers: the type of the file, names and values of its keys (rate,
numbers of frames and markers, units), labels, and axes. A marker that was not seen has empty cells
or nan.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.laboratory.markers import GROUND, MARKERS, METRES, RATE
from mbd_ros.files.table import MAIN, STAMP, TIME, Column, Result, Table
from mbd_ros.files.text_file import MAX_CELLS, Lines, cell_number, check_times, reading, replacing

_HEADER = 5  # lines
_AXES = "XYZ"
_MOST = 3_000  # markers


class Trc:
    """One table: `time` and three numbers a marker, in m, nan where it was not seen."""

    content = "three numbers a row, of a marker"
    one_table = True

    def holds(self, column: Column) -> bool:
        """Whether it is a point a row, or the time."""
        values = column.values
        if column.name in (TIME, STAMP):
            return values.ndim == 1
        if values.shape[1:] != (3,) or values.dtype.kind != "f" or np.isinf(values).any():
            return False
        return column.name == column.name.strip() and column.name.isprintable()

    def read(self, path: Path) -> Result:
        """Markers by their labels in m, `metadata["markers"]` and `metadata["rate"]`.

        Raises:
            DataError: File, line and column of what is not acceptable.
        """
        with reading(path) as file:
            lines = Lines(path, file)
            head = [next(lines, b"") for _ in range(_HEADER)]
            keys = _keys(path, head)
            labels = _labels(path, head[3], keys)
            times, values = _rows(path, lines, labels)
        if len(times) != (told := _integer(path, keys, "NumFrames")):
            raise DataError(f"{path}: has {len(times)} frames, its header says {told}")
        check_times(path, times)
        scale = _scale(path, keys)
        columns = [Column(TIME, times, "s")]
        columns += [Column(n, scale * values[:, i], "m", GROUND) for i, n in enumerate(labels)]
        metadata = {MARKERS: list(labels), RATE: _number(path, keys, "DataRate")}
        return Result({MAIN: Table(columns)}, metadata)

    def write(self, path: Path, result: Result, unit: str = "m") -> None:
        """Write the markers of a table; its `stamp`, the time in nanoseconds, is left out.

        Args:
            result: Its table has the column `time`, and points in m.
            unit: m, cm or mm, of the numbers in the file.

        Raises:
            DataError: No time, another unit, or a place that cannot be written to.
        """
        ((name, table),) = result.tables.items()
        if TIME not in table or unit not in METRES:
            raise DataError(
                f"{path}: expected a column time, and the unit {', '.join(METRES)}, not '{unit}'"
            )
        labels = [label for label in table if label not in (TIME, STAMP)]
        times = table[TIME]
        usual = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        rate = result.metadata.get(RATE) or (1.0 / usual if usual else 0.0)
        with replacing(path) as file:
            file.write(_head(name, labels, len(times), float(rate), unit).encode())
            for i, time in enumerate(times.tolist()):
                cells = [repr(v) for n in labels for v in (table[n][i] / METRES[unit]).tolist()]
                cells = ["" if cell == "nan" else cell for cell in cells]
                file.write(("\t".join([str(i + 1), repr(time), *cells]) + "\n").encode())


def _head(name: str, labels: Sequence[str], frames: int, rate: float, unit: str) -> str:
    keys = {"DataRate": rate, "CameraRate": rate, "NumFrames": frames, "NumMarkers": len(labels)}
    keys |= {"Units": unit, "OrigDataRate": rate, "OrigDataStartFrame": 1, "OrigNumFrames": frames}
    axes = [f"{axis}{i}" for i in range(1, len(labels) + 1) for axis in _AXES]
    rows = [
        ["PathFileType", "4", "(X/Y/Z)", f"{name}.trc"],
        [*keys],
        [str(value) for value in keys.values()],
        ["Frame#", "Time", *(cell for label in labels for cell in (label, "", ""))],
        ["", "", *axes],
    ]
    return "".join("\t".join(row).rstrip("\t") + "\n" for row in rows)


def _keys(path: Path, head: Sequence[bytes]) -> dict[str, str]:
    """Keys of the second line, in small letters, and their values in the third."""
    if not head[0].strip().lower().removeprefix(b"\xef\xbb\xbf").startswith(b"pathfiletype"):
        raise DataError(f"{path}: line 1 does not begin with PathFileType, so it is no .trc")
    names, values = (line.decode("utf-8", "replace").split() for line in head[1:3])
    if len(names) != len(values):
        raise DataError(f"{path}: line 2 has {len(names)} keys, line 3 {len(values)} values")
    return dict(zip((name.lower() for name in names), values, strict=True))


def _value(path: Path, keys: Mapping[str, str], key: str) -> str:
    if key.lower() not in keys:
        raise DataError(f"{path}: line 2 has no key {key}; there are: {', '.join(keys)}")
    return keys[key.lower()]


def _number(path: Path, keys: Mapping[str, str], key: str) -> float:
    return cell_number(path, key, _value(path, keys, key).encode(), 3)


def _integer(path: Path, keys: Mapping[str, str], key: str) -> int:
    value = _number(path, keys, key)
    if not (value >= 0 and value == int(value)):
        raise DataError(f"{path}: line 3: {key} {value:g} is no whole number")
    return int(value)


def _scale(path: Path, keys: Mapping[str, str]) -> float:
    unit = _value(path, keys, "Units")
    if unit.lower() not in METRES:
        raise DataError(f"{path}: line 3: Units '{unit}', accepted: {', '.join(METRES)}")
    return METRES[unit.lower()]


def _labels(path: Path, line: bytes, keys: Mapping[str, str]) -> tuple[str, ...]:
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: line 4 is not text, expected labels") from error
    cells = [cell.strip() for cell in text.split("\t")] if "\t" in text else text.split()
    if [cell.lower() for cell in cells[:2]] != ["frame#", "time"]:
        raise DataError(f"{path}: line 4 does not begin with Frame# and Time")
    labels = tuple(cell for cell in cells[2:] if cell)
    told = _integer(path, keys, "NumMarkers")
    if len(labels) != told or len(labels) > _MOST:
        raise DataError(f"{path}: line 4 has {len(labels)} labels, NumMarkers says {told}")
    repeated = sorted({label for label in labels if labels.count(label) > 1 or label == TIME})
    if repeated:
        raise DataError(f"{path}: line 4 repeats label {', '.join(repeated)}")
    return labels


def _rows(path: Path, lines: Iterator[bytes], labels: Sequence[str]) -> tuple[Array, Array]:
    """Times, shape (n,), and positions in units of the file, shape (n, markers, 3)."""
    names = ["Frame#", "Time", *(f"{label} {axis}" for label in labels for axis in _AXES)]
    times, rows = [], []
    for number, line in enumerate(lines, _HEADER + 1):
        if not line.strip():
            continue
        row = _row(path, line, names, number)
        times.append(row[1])
        rows.append(row[2:])
        if len(rows) * len(names) > MAX_CELLS:
            raise DataError(f"{path}: more than {MAX_CELLS} numbers are not accepted")
    values = np.array(rows).reshape(-1, len(labels), 3)
    lost = np.isnan(values)
    halves = np.argwhere(lost.any(axis=2) & ~lost.all(axis=2))
    if halves.size:
        frame, marker = halves[0]
        where = f"{path}: marker {labels[marker]} at {times[frame]:.9g} s"
        raise DataError(f"{where} lacks some of its coordinates")
    return np.array(times), values


def _row(path: Path, line: bytes, names: Sequence[str], number: int) -> list[float]:
    """Numbers of a line, nan where a cell is empty or behind the end of the line."""
    cells = line.split(b"\t") if b"\t" in line else line.split()
    cells = [cell.strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()
    if not 2 <= len(cells) <= len(names):
        raise DataError(f"{path}: line {number} has {len(cells)} cells, expected {len(names)}")
    cells += [b""] * (len(names) - len(cells))
    pairs = zip(names[1:], cells[1:], strict=True)
    return [0.0, *(cell_number(path, n, c, number) if c else np.nan for n, c in pairs)]
