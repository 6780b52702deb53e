"""External loads of OpenSim: an .xml that says which columns of a storage push which body."""

import re
from collections.abc import Callable, Collection, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.xml_tree import MarkupError, decoded, xml_tree
from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.laboratory.markers import GROUND
from mbd_ros.files.laboratory.storage import REMARKS, REPEATED
from mbd_ros.files.table import MAIN, TIME, Result, Table, motion_stamps, read_result
from mbd_ros.files.text_file import reading

_LARGEST = 16_000_000  # bytes
_NOTHING = ("", "unassigned")
_FARTHEST = 100.0  # m from the origin, beyond which a point can only be in mm


class ExternalLoad(NamedTuple):
    """One force of the file, with its samples.

    Attributes:
        name: Its name as parts of scenes have one.
        body: The link that it acts on.
        frame: In whose axes force, torque and point are; `ground`, or a link.
        source: File of the samples.
        stamps: Times [ns], increasing, shape (n,).
        force: [N], shape (n, 3).
        point: Where the force acts, from the origin of `frame` [m], shape (n, 3).
        torque: Free moment [N·m], shape (n, 3).
        remarks: What is odd about the file, for people.
    """

    name: str
    body: str
    frame: str
    source: Path
    stamps: NDArray[np.int64]
    force: Array
    point: Array
    torque: Array
    remarks: tuple[str, ...] = ()


def read_external_loads(path: str | Path) -> list[ExternalLoad]:
    """The forces of an .xml that are not disabled, in their order.

    The columns stand in `datafile` or else in the `data_source_name` of each force; relative to
    the .xml, folders parted as in Windows or not, or beside the .xml.

    Args:
        path: The .xml, perhaps .gz.

    Raises:
        DataError: A file that cannot be read, or what does not fit: names force, key and columns.
    """
    path = Path(path)
    loads = _element(path)
    forces, data_file = loads.findall("objects/ExternalForce"), _text(loads, "datafile")
    read = cache(read_result)
    external_loads = [_load(path, force, data_file, read) for force in forces if _acts(force)]
    if not external_loads:
        raise DataError(f"{path}: no ExternalForce that is switched on")
    names = [load.name for load in external_loads]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise DataError(f"{path}: several forces are called {', '.join(repeated)}")
    return external_loads


def _element(path: Path) -> ElementTree.Element:
    with reading(path) as file:
        data = file.read(_LARGEST + 1)
    if len(data) > _LARGEST:
        raise DataError(f"{path}: more than {_LARGEST} bytes are not accepted")
    try:
        root = xml_tree(decoded(data))
    except MarkupError as error:
        raise DataError(f"{path}: {error}") from error
    loads = root if root.tag == "ExternalLoads" else root.find("ExternalLoads")
    if loads is None:
        raise DataError(
            f"{path}: <{root.tag}> without <ExternalLoads>: these are no external loads of OpenSim"
        )
    return loads


def _text(element: ElementTree.Element, key: str) -> str:
    """Text of a child, empty where it says nothing."""
    text = (element.findtext(key) or "").strip()
    return "" if text.lower() in _NOTHING else text


def _acts(force: ElementTree.Element) -> bool:
    disabled = _text(force, "isDisabled").lower() in ("true", "1")
    return not disabled and _text(force, "appliesForce").lower() not in ("false", "0")


def _load(
    path: Path, force: ElementTree.Element, data_file: str, read: Callable[[Path], Result]
) -> ExternalLoad:
    given = force.get("name") or "force"
    where, name = f"{path}: ExternalForce {given}", _part_name(given)
    body = _text(force, "applied_to_body")
    if not body or body == GROUND:
        raise DataError(f"{where}: applied_to_body '{body}', expected a body that moves")
    place = data_file or _text(force, "data_source_name")
    if not place:
        raise DataError(f"{where}: neither datafile nor data_source_name names a file")
    source = _existing_file(path, place)
    result = read(source)
    table, repeated = result[MAIN], result.metadata.get(REPEATED, ())
    at = f"{where}: {source}"
    keys = ("force_identifier", "point_identifier", "torque_identifier")
    pushes, acts, turns = (_columns(at, table, k, _text(force, k), repeated) for k in keys)
    if pushes is None and turns is None:
        raise DataError(f"{where}: neither force_identifier nor torque_identifier")
    nothing = np.zeros((table.rows, 3))
    if acts is not None and float(np.abs(acts).max(initial=0.0)) > _FARTHEST:
        raise DataError(f"{at}: points more than {_FARTHEST:g} m away, are they in mm?")
    values = [nothing if one is None else one for one in (pushes, acts, turns)]
    frame = _frame(where, force, acts is not None)
    stamps, remarks = motion_stamps(table, str(source)), result.metadata.get(REMARKS, ())
    return ExternalLoad(name, body, frame, source, stamps, *values, tuple(remarks))


def _frame(where: str, force: ElementTree.Element, has_point: bool) -> str:
    axes = _body(_text(force, "force_expressed_in_body"))
    origin = _body(_text(force, "point_expressed_in_body"))
    if has_point and axes != origin:
        raise DataError(
            f"{where}: force_expressed_in_body '{axes}' and point_expressed_in_body '{origin}': "
            "accepted is one body for both"
        )
    return axes


def _body(text: str) -> str:
    """Name of a body, which may stand in a path: `/bodyset/calcn_r`."""
    return text.rpartition("/")[2] or GROUND


def _part_name(text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    return f"_{name}" if name[0].isdigit() else name


def _existing_file(path: Path, text: str) -> Path:
    """The file that an .xml names."""
    words = text.replace("\\", "/")
    tried = [path.parent / words, path.parent / words.rpartition("/")[2]]
    for file in tried:
        if file.exists():
            return file
    places = " and ".join(dict.fromkeys(map(str, tried)))
    raise DataError(f"{path}: data file '{text}' does not exist, looked for {places}")


def _columns(
    where: str, table: Table, key: str, identifier: str, repeated: Collection[str]
) -> Array | None:
    """Three columns of an identifier, shape (n, 3); None without one."""
    if not identifier:
        return None
    names: Sequence[str] = [f"{identifier}{axis}" for axis in "xyz"]
    if not all(name in table for name in names):
        names = [name for name in table if name != TIME and name.startswith(identifier)]
    if len(names) != 3:
        there = ", ".join(list(table)[1:9])
        raise DataError(
            f"{where}: {key} '{identifier}' begins {len(names)} columns, expected x, y and z; "
            f"there are: {there} .."
        )
    if not set(names).isdisjoint(repeated):
        raise DataError(f"{where}: several columns are called {', '.join(names)}")
    values = np.column_stack([table[name] for name in names])
    lost = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if lost.size:
        raise DataError(f"{where}: {', '.join(names)}: no number at {table[TIME][lost[0]]:.9g} s")
    huge = np.flatnonzero((np.abs(values, dtype=np.float64) > LARGEST).any(axis=1))
    if huge.size:
        raise DataError(
            f"{where}: {', '.join(names)}: at {table[TIME][huge[0]]:.9g} s beyond a size of "
            f"{LARGEST:g}"
        )
    return values
