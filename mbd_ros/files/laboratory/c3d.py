"""Recordings of motion capture, .c3d: markers, and force plates as wrenches. Needs ezc3d."""

import os
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, install_hint
from mbd_ros.files.laboratory.c3d_counts import LONGEST, check_counts
from mbd_ros.files.laboratory.markers import GROUND, MARKERS, METRES, RATE, SCREEN
from mbd_ros.files.laboratory.trc import Trc
from mbd_ros.files.table import MAIN, STAMP, TIME, Column, Result, Table
from mbd_ros.files.text_file import reading, replacing

PLATES = "wrenches"  # table of the force plates
_NO_MARKERS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")  # modelled, among the points
_CENTRED = 1  # type of plates that give their centre of pressure
_BROKEN = (OSError, RuntimeError, ValueError, KeyError, IndexError, TypeError, MemoryError)


class C3d:
    """Table `samples` of markers and, where there are force plates, table `wrenches` of these.

    A plate is `plate1.force.x`, .. [N] and `plate1.torque.x`, .. [N·m] about the origin of the
    laboratory, in its axes, with the signs of the file: what acts on the body above. Markers are
    written with the precision of the format, 7 digits.

    Raises:
        DataError: ezc3d is not installed.
    """

    content = Trc.content
    one_table = True

    def __init__(self) -> None:
        try:
            import ezc3d
        except ModuleNotFoundError as error:
            raise DataError(f".c3d: {install_hint('ezc3d')}") from error
        self._ezc3d = ezc3d

    def holds(self, column: Column) -> bool:
        """Whether it is a point a row, or the time."""
        return Trc().holds(column)

    def read(self, path: Path) -> Result:
        """Markers by their labels in m, and wrenches of force plates.

        Raises:
            DataError: It is no .c3d, or cut, or in another unit.
        """
        with reading(path) as file:
            start, size = file.read(LONGEST), os.fstat(file.fileno()).st_size
        check_counts(path, start, size)
        try:
            content = self._ezc3d.c3d(str(path))
            has_plates = _parameter(content, "FORCE_PLATFORM", "USED", [0])[0] > 0
            if has_plates:
                content = self._ezc3d.c3d(str(path), extract_forceplat_data=True)
            tables = {MAIN: _markers(path, content)}
            if has_plates:
                tables[PLATES] = _plates(path, content)
        except _BROKEN as error:
            raise DataError(f"{path}: cannot be read as .c3d, or is cut ({error})") from error
        labels = [name for name in tables[MAIN] if name != TIME]
        about = {MARKERS: labels, RATE: _rate(content, "POINT")}
        screen = [_parameter(content, "POINT", f"{axis}_SCREEN", [""])[0] for axis in "XY"]
        return Result(tables, {**about, SCREEN: screen} if all(screen) else about)

    def write(self, path: Path, result: Result) -> None:
        """Write the markers of a table, in mm.

        Raises:
            DataError: Times that are not evenly spaced, or a place that cannot be written to.
        """
        (table,) = result.tables.values()
        labels = [label for label in table if label not in (TIME, STAMP)]
        times = table.get(TIME, np.zeros(0))
        steps = np.diff(times)
        if not labels or not len(steps) or np.ptp(steps) > 1e-3 * steps.mean():
            raise DataError(f"{path}: .c3d holds markers at a steady rate, these are none")
        rate = float(result.metadata.get(RATE) or 1.0 / steps.mean())
        content = self._ezc3d.c3d()
        points = content["parameters"]["POINT"]
        points["UNITS"]["value"], points["RATE"]["value"] = ["mm"], [rate]
        points["LABELS"]["value"] = labels
        values = np.stack([table[label].T for label in labels], axis=1)  # (3, markers, n)
        content["data"]["points"] = np.concatenate(
            [1000.0 * values, np.ones((1, *values.shape[1:]))]
        )
        content["header"]["points"]["first_frame"] = round(float(times[0]) * rate)
        with TemporaryDirectory() as folder, replacing(path) as file:
            content.write(f"{folder}/markers.c3d")
            file.write(Path(f"{folder}/markers.c3d").read_bytes())


def _parameter(content: Any, group: str, name: str, other: Any) -> Any:
    found = content["parameters"].get(group, {}).get(name, {}).get("value", other)
    return other if len(found) == 0 else found


def _rate(content: Any, kind: str) -> float:
    return float(_parameter(content, kind, "RATE", [0.0])[0])


def _times(content: Any, kind: str, count: int) -> Column:
    """Times from the frame that the recording begins with."""
    first = content["header"]["points"]["first_frame"] / _rate(content, "POINT")
    return Column(TIME, first + np.arange(count) / _rate(content, kind), "s")


def _metres(path: Path, unit: str) -> float:
    if unit.strip().lower() not in METRES:
        raise DataError(f"{path}: POINT:UNITS '{unit}', accepted: {', '.join(METRES)}")
    return METRES[unit.strip().lower()]


def _markers(path: Path, content: Any) -> Table:
    values = np.asarray(content["data"]["points"])[:3]
    labels = [str(label).strip() for label in _parameter(content, "POINT", "LABELS", [])]
    if len(labels) != values.shape[1]:
        raise DataError(f"{path}: {values.shape[1]} points with {len(labels)} labels")
    if not values.shape[2] or not _rate(content, "POINT") > 0.0:
        raise DataError(f"{path}: no frame, or no rate")
    scale = _metres(path, _parameter(content, "POINT", "UNITS", ["mm"])[0])
    modelled = {str(n) for kind in _NO_MARKERS for n in _parameter(content, "POINT", kind, [])}
    kept = [i for i, label in enumerate(labels) if label and label not in modelled]
    columns = [Column(labels[i], scale * values[:, i].T, "m", GROUND) for i in kept]
    return Table([_times(content, "POINT", values.shape[2]), *columns])


def _plates(path: Path, content: Any) -> Table:
    plates, types = content["data"]["platform"], content["parameters"]["FORCE_PLATFORM"]["TYPE"]
    columns = [_times(content, "ANALOG", plates[0]["force"].shape[1])]
    for i, (plate, kind) in enumerate(zip(plates, types["value"], strict=True), 1):
        force, torque = _wrench(path, plate, int(kind))
        parts = (("force", force, "N"), ("torque", torque, "N·m"))
        for quantity, values, unit in parts:
            for axis, column in zip("xyz", values.T, strict=True):
                columns.append(Column(f"plate{i}.{quantity}.{axis}", column, unit, GROUND))
    return Table(columns)


def _wrench(path: Path, plate: Mapping[str, Any], kind: int) -> tuple[Array, Array]:
    """Force [N] and torque about the origin of the laboratory [N·m], shape (n, 3) each.

    Forces and moments of the library are about the middle of the four corners, in axes of the
    laboratory; a plate of type 1 gives its centre of pressure and free moment.
    """
    if plate["unit_force"] != "N":
        raise DataError(f"{path}: FORCE_PLATFORM:UNITS '{plate['unit_force']}', accepted: N")
    scale = _metres(path, plate["unit_position"])
    force = np.asarray(plate["force"]).T
    if kind == _CENTRED:
        point, moment = scale * plate["center_of_pressure"].T, scale * plate["Tz"].T
    else:
        point = scale * np.asarray(plate["corners"]).mean(axis=1)
        moment = scale * np.asarray(plate["moment"]).T
    return force, moment + np.cross(point, force)
