"""Read motions, wrenches and markers from tables and bags.

`metadata_of` describes in a result what it was computed from.
"""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.poses import with_continuous_signs
from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.state import Array, BodyMotion, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.body_columns import ACCELERATION, POSE, TWIST, names_of
from mbd_ros.files.formats import is_bag
from mbd_ros.files.laboratory.markers import SCREEN
from mbd_ros.files.laboratory.storage import REMARKS, is_storage, joint_columns, other_labels
from mbd_ros.files.recording import NO_BODIES, Recording
from mbd_ros.files.table import MAIN, TIME, Column, Result, Table, motion_stamps, read_result
from msg_adapters.pose import OFF_UNIT

if TYPE_CHECKING:
    from mbd_ros.scene.built_scene import Scene

Source = str | Path | Result  # of a motion
CSV = (".csv", ".csv.gz")  # nan is accepted in some columns only
_WRENCHES = "wrenches"  # table of the plates of a .c3d
_IN_MEMORY = "the result"
_FROM_MARKERS = "kinematics"  # the job
UNITS = {"m": 1.0, "mm": 1.0e-3, "cm": 1.0e-2}
_AXES = ("x", "y", "z")
_JOINT_FIELDS = ("position", "velocity", "acceleration", "effort", "command")
_ENDINGS = (".{}", ".position_{}", ".position.{}", "_{}")  # of the columns of a marker
_FAR = 50.0  # [m], a distance between markers that no laboratory has


def read_motion(
    source: Source,
    joints: Sequence[str],
    *,
    topic: str = "/joint_states",
    required: Collection[str] | None = None,
    bodies: Mapping[str, str] = NO_BODIES,
    members: Collection[str] = (),
    sliding: Collection[str] = (),
    assumed: Callable[[str], float] | None = None,
) -> Recording:
    """Read the samples of joints and free bodies; other joints in the file are ignored.

    A bag message is dropped, and counted, if it is malformed, if a required joint has no finite
    position, or if its stamp is not newer than all before. Velocities and efforts that are not
    finite count as missing. If one stamp is zero, the log times replace all stamps. Every named
    robot and every free body has its own topic; messages with the same stamp make a sample, and
    incomplete samples are dropped and counted.

    Args:
        source: A result, or a file of one, with columns `<joint>.position`, `.velocity`,
            `.acceleration`, `.effort`, `.command`; or a bag, which has no accelerations and
            commands.
        joints: Names of the joints, in the order of the columns of the motion.
        topic: JointState topic of a bag.
        required: Joints that must have a position; by default all. The others may be NaN.
        bodies: Free bodies, which must have a pose, and their links.
        members: Names of robots and bodies that are prefixes of joints, see `topics`.
        sliding: Prismatic joints, which are in metres in a .mot or .sto file in degrees.
        assumed: Function that returns the position of a required joint that a laboratory file
            does not have; by default all required joints must be in the file.

    Raises:
        DataError: The file cannot be read, a required joint is missing, or no message on the topic
            can be used.
    """
    needed = [name for name in joints if required is None or name in required]
    if not isinstance(source, Result) and is_bag(source):
        from mbd_ros.files.bags.bag_recordings import Wanted, bag_motion

        wanted = Wanted(tuple(joints), tuple(needed), bodies, frozenset(members))
        recorded = bag_motion(Path(source), topic, wanted)
        fields = (getattr(recorded.motion, key) for key in _JOINT_FIELDS)
        refuse_huge(str(source), joints, *fields)
        return recorded
    table, where, labels, remarks, of_laboratory = _samples(source, (), joints, sliding)
    missing: list[str] = []
    if labels is not None and assumed is not None:
        missing = [name for name in needed if f"{name}.position" not in table]
        table = Table([*table.columns, *(_constant(table, n, assumed(n)) for n in missing)])
    poses = [name for body in bodies for name in names_of(body, POSE)]
    _check_columns(table, where, [*(f"{name}.position" for name in needed), *poses])
    position, velocity, acceleration, effort, command = (
        _columns(table, [f"{name}.{field}" for name in joints])
        for field in ("position", "velocity", "acceleration", "effort", "command")
    )
    if position is None:
        position = np.full((table.rows, len(joints)), np.nan)
    fields = position, velocity, acceleration, effort, command
    body_motions = tuple(_body(table, where, name) for name in bodies)
    motion = Motion(tuple(joints), motion_stamps(table, where), *fields, body_motions)
    return Recording(motion, Counter(), False, tuple(missing), labels, remarks, of_laboratory)


def _samples(
    source: Source,
    may_lack: Collection[str],
    joints: Sequence[str] = (),
    sliding: Collection[str] = (),
    prefers: str = MAIN,
) -> _Samples:
    """Read the table `samples` of a result or file.

    Args:
        source: Result or file.
        may_lack: Columns of a .csv that may contain nan.
        joints: Joints that a laboratory file may name by its own labels.
        sliding: Prismatic joints among them.
        prefers: Table that is read instead of `samples` if it exists.
    """
    where = name_of(source)
    if not isinstance(source, Result):
        path = Path(source)
        options = {"nan_allowed": may_lack.__contains__} if path.name.endswith(CSV) else {}
        source = read_result(path, **options)
    if MAIN not in source:
        raise DataError(
            f"{where}: has no table {MAIN}; its tables are: {', '.join(source) or 'none'}"
        )
    table = source[prefers if prefers in source else MAIN]
    _check_columns(table, where, [TIME])
    if not table.rows:
        raise DataError(f"{where}: table {MAIN} has no rows")
    plain = {name: column for name, column in table.items() if column.ndim == 1}
    refuse_huge(where, list(plain), *plain.values())
    if not is_storage(source):
        return _Samples(table, where, of_laboratory=source.metadata.get("job") == _FROM_MARKERS)
    unused, remarks = tuple(other_labels(table, joints)), tuple(source.metadata[REMARKS])
    table = joint_columns(source, table, where, joints, sliding)
    return _Samples(table, where, unused, remarks, of_laboratory=True)


def refuse_huge(
    where: str, names: Sequence[str], *columns: Array | None, largest: float = LARGEST
) -> None:
    """Refuse numbers whose products would overflow.

    Args:
        where: File, for the message.
        names: Names along the last axis of columns with several numbers per row, otherwise names
            of the columns.
        columns: Numbers, one row per sample; numbers that are not finite are ignored here.
        largest: Largest accepted size.

    Raises:
        DataError: A number is too large; the message names file, column and number.
    """
    for i, values in enumerate(columns):
        if values is None or values.dtype.kind != "f":
            continue
        huge = np.isfinite(values) & (np.abs(values, dtype=np.float64) > largest)
        if huge.any():
            at = tuple(np.argwhere(huge)[0])
            name = names[at[-1]] if len(at) > 1 else names[i]
            raise DataError(
                f"{where}: {name} is {values[at]:g} in row {at[0] + 1}, but its size must be at "
                f"most {largest:g}"
            )


class _Samples(NamedTuple):
    """Table `samples` of a source.

    Attributes:
        table: The table.
        where: Name of the source, for messages.
        unused: Labels of a laboratory file that belong to no joint; None for other sources.
        remarks: Remarks on irregularities of a laboratory file.
        of_laboratory: Whether the source is a laboratory file, or computed from markers.
    """

    table: Table
    where: str
    unused: tuple[str, ...] | None = None
    remarks: tuple[str, ...] = ()
    of_laboratory: bool = False


def _check_columns(table: Table, where: str, names: Iterable[str]) -> None:
    """Raise a DataError if columns of numbers are missing."""
    missing = [name for name in names if not _is_plain(table, name)]
    if missing:
        existing = ", ".join(name for name in table if _is_plain(table, name))
        raise DataError(f"{where}: no column {', '.join(missing)}; there are: {existing}")


def _is_plain(table: Table, name: str) -> bool:
    return name in table and table[name].ndim == 1 and table[name].dtype.kind in "fiu"


def _constant(table: Table, joint: str, position: float) -> Column:
    return Column(f"{joint}.position", np.full(table.rows, position))


def _columns(table: Table, names: list[str]) -> Array | None:
    """Return the named columns, NaN for missing ones, or None if all are missing."""
    existing = [name for name in names if _is_plain(table, name)]
    if not existing:
        return None
    values = np.full((table.rows, len(names)), np.nan)
    for name in existing:
        values[:, names.index(name)] = table[name]
    return values


def _body(table: Table, where: str, name: str) -> BodyMotion:
    """Return the motion of a free body, whose pose columns have been checked."""
    pose, twist, acceleration = (
        _columns(table, names_of(name, fields)) for fields in (POSE, TWIST, ACCELERATION)
    )
    assert pose is not None
    with np.errstate(over="ignore"):
        length = np.linalg.norm(pose[:, 3:], axis=1)
    invalid = np.flatnonzero(~(np.abs(length - 1.0) <= OFF_UNIT))
    if len(invalid):
        raise DataError(
            f"{where}: {name}.orientation at {table[TIME][invalid[0]]:.9g} s has the length "
            f"{length[invalid[0]]:.3g}, but a unit quaternion has 1"
        )
    return BodyMotion(name, with_continuous_signs(pose), twist, acceleration)


def read_columns(
    source: Source, names: Sequence[str], joints: Sequence[str] = (), sliding: Collection[str] = ()
) -> Array | None:
    """Read columns of the samples by name, shape (n, len(names)), NaN for missing columns.

    Args:
        source: Result, file or bag.
        names: Names of the columns.
        joints: Joints that a laboratory file may name by its own labels.
        sliding: Prismatic joints among them.

    Returns:
        The columns, or None if the source has none of them; a bag has none.
    """
    if not names or (not isinstance(source, Result) and is_bag(source)):
        return None
    return _columns(_samples(source, (), joints, sliding).table, list(names))


def read_wrenches(
    source: Source, names: Mapping[str, str | None], *, dropped: Counter[str] | None = None
) -> dict[str, WrenchSamples]:
    """Read the measured wrench of every load, about the origin of its frame.

    In a table, columns `<name>.point.{x,y,z}` are the point of application: the torque about the
    origin is torque + point x force. A point may be `nan` where the force is 0.

    Args:
        source: A result, or a file of one, with columns `<name>.force.{x,y,z}` [N],
            `<name>.torque.{x,y,z}` [N·m], and perhaps `<name>.point.{x,y,z}` [m]; or a bag.
        names: Loads -> WrenchStamped topic, which only a bag needs.
        dropped: Counts the messages of a bag that are left out, by reason: not finite, or not
            newer than all before.

    Raises:
        DataError: The file cannot be read, a column or topic is missing, or no message can be
            used.
    """
    if not names:
        return {}
    if not isinstance(source, Result) and is_bag(source):
        from mbd_ros.files.bags.bag_recordings import bag_wrenches

        wrenches = bag_wrenches(Path(source), names, Counter() if dropped is None else dropped)
        for name, samples in wrenches.items():
            refuse_huge(str(source), [f"wrench {name}"] * 6, samples.wrench)
        return wrenches
    points = {f"{name}.point.{axis}" for name in names for axis in "xyz"}
    table, where, *_ = _samples(source, points, prefers=_WRENCHES)
    stamps = motion_stamps(table, where)
    return {name: WrenchSamples(stamps, _wrench(table, where, name)) for name in names}


def _wrench(table: Table, where: str, name: str) -> Array:
    fields = ["force", "torque"]
    if any(column.startswith(f"{name}.point.") for column in table):
        fields.append("point")
    columns = [f"{name}.{field}.{axis}" for field in fields for axis in "xyz"]
    _check_columns(table, where, columns)
    values = np.column_stack([table[column] for column in columns])
    if len(fields) == 2:
        return values
    force, torque, point = values[:, :3], values[:, 3:6], values[:, 6:]
    is_loaded = (force != 0).any(axis=1)
    torque[is_loaded] += np.cross(point[is_loaded], force[is_loaded])
    return values[:, :6]


def name_of(source: Source) -> str:
    """Return the name of a source for messages."""
    return _IN_MEMORY if isinstance(source, Result) else str(source)


def read_capture(source: Source, unit: str | None = None) -> Capture:
    """Read the markers of a file or result.

    Columns are `<label>.x`, `.y`, `.z`, or `<label>.position_x` as simulations write them, or
    `<label>` with three numbers per row.

    Args:
        source: A result, or a file of one.
        unit: Unit of the positions: m, mm or cm; by default that of the columns, or m.

    Raises:
        DataError: The file cannot be read, has no markers, or its positions are not in metres.
    """
    where = name_of(source)
    if unit is not None and unit not in UNITS:
        raise DataError(f"{where}: unknown unit '{unit}', accepted: {', '.join(UNITS)}")
    if not isinstance(source, Result):
        if is_bag(source):
            raise DataError(f"{where}: markers in a bag are not accepted; use a table of markers")
        source = read_result(source)
    if MAIN not in source or TIME not in source[MAIN]:
        raise DataError(f"{where}: no table {MAIN} with a column {TIME}")
    table = source[MAIN]
    markers = _markers(table)
    if not markers:
        raise DataError(
            f"{where}: no markers; accepted are columns <label>.x, .y and .z, there are: "
            f"{', '.join(list(table)[:8])}"
        )
    places = np.stack([np.asarray(p, dtype=np.float64) for p, _ in markers.values()], axis=1)
    file_unit = next((column_unit for _, column_unit in markers.values() if column_unit), "")
    if unit and file_unit and unit != file_unit:
        raise DataError(
            f"{where}: markers are in {file_unit} according to the file, not in {unit}; leave the "
            "unit out"
        )
    scales = [UNITS[unit or column_unit or "m"] for _, column_unit in markers.values()]
    places = places * np.array(scales)[:, None]
    refuse_huge(where, [*markers], *places.swapaxes(0, 1))
    times = np.asarray(table[TIME], dtype=np.float64)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) <= 0.0).any():
        raise DataError(f"{where}: column {TIME}: must be finite and increase from row to row")
    _refuse_millimetres(where, tuple(markers), places, times)
    return Capture(where, tuple(markers), times, places, tuple(source.metadata.get(SCREEN, ())))


def _markers(table: Table) -> dict[str, tuple[Array, str]]:
    """Return label -> positions and their unit, in the order of the columns."""
    markers: dict[str, tuple[Array, str]] = {}
    for column in table.columns:
        if column.values.ndim == 2 and column.values.shape[1] == len(_AXES):
            markers[column.name] = column.values, _unit(column.unit)
            continue
        for ending in _ENDINGS:
            first = ending.format(_AXES[0])
            label = column.name.removesuffix(first)
            names = [label + ending.format(axis) for axis in _AXES]
            if column.name.endswith(first) and label and all(name in table for name in names):
                if all(table[name].ndim == 1 for name in names):
                    places = np.column_stack([table[name] for name in names])
                    markers.setdefault(label, (places, _unit(column.unit)))
                break
    return markers


def _unit(text: str) -> str:
    return text if text in UNITS else ""


def _refuse_millimetres(where: str, labels: Sequence[str], places: Array, times: Array) -> None:
    """Refuse positions that look like millimetres."""
    with np.errstate(invalid="ignore"):
        apart = np.nanmax(places, axis=1, initial=-np.inf, where=np.isfinite(places))
        apart = apart - np.nanmin(places, axis=1, initial=np.inf, where=np.isfinite(places))
    apart = np.where(np.isfinite(apart), apart, 0.0).max(axis=1)
    at = int(np.argmax(np.median(apart) if len(apart) == 0 else apart))
    if np.median(apart) > _FAR:
        raise DataError(
            f"{where}: markers are {apart[at]:.4g} m apart at t = {times[at]:.9g} s, which looks "
            f"like millimetres ({len(labels)} markers); give --unit mm"
        )


class Capture(NamedTuple):
    """Recorded markers.

    Attributes:
        where: File, for messages.
        labels: Labels of the markers.
        times: Times [s], increasing, shape (N,).
        places: Positions in the world [m], NaN where a marker was not seen, shape (N, n, 3).
        screen: Recorded axes that point to the right and upwards on a screen, such as `+X`, `+Z`;
            empty if the recording does not state them.
    """

    where: str
    labels: tuple[str, ...]
    times: Array
    places: Array
    screen: tuple[str, ...] = ()

    def between(self, begin: float | None, end: float | None) -> Capture:
        """Return the frames of a range of times.

        Raises:
            DataError: The range contains no frame.
        """
        low, high = (-np.inf if begin is None else begin), (np.inf if end is None else end)
        inside = (self.times >= low - 1e-9) & (self.times <= high + 1e-9)
        if not inside.any():
            raise DataError(
                f"{self.where}: no frame from {low:g} to {high:g} s; there are frames from "
                f"{self.times[0]:g} to {self.times[-1]:g} s"
            )
        return self._replace(times=self.times[inside], places=self.places[inside])


def metadata_of(
    job: str, scene: Scene, inputs: Mapping[str, Any], topics: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the metadata of a result.

    Args:
        job: Name of the command.
        scene: The scene.
        inputs: Arguments of the job; files are recorded by name, and None is left out.
        topics: Topics of a bag, see `bag_streams`.
    """
    recorded = {key: _plain(value) for key, value in inputs.items() if value is not None}
    return {
        "job": job,
        "scene": scene.name,
        "inputs": recorded,
        "versions": dict(_versions()),
        "topics": dict(topics),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, Result):
        return {"job": value.metadata.get("job", ""), "inputs": value.metadata.get("inputs", {})}
    return value if isinstance(value, int | float | str | list | dict) else name_of(value)


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    from importlib.metadata import PackageNotFoundError, version  # only where a result is made

    versions = [("python", platform.python_version())]
    for package, name in (("mbd_ros", "mbd_ros"), ("pinocchio", "pin"), ("numpy", "numpy")):
        try:
            versions.append((package, version(name)))
        except PackageNotFoundError:  # colcon and conda install without metadata of pip
            versions.append((package, "unknown"))
    return tuple(versions)
