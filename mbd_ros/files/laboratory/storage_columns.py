"""Columns of joints from the labels of a laboratory's storage (.mot, .sto)."""

import re
from collections.abc import Collection, Mapping

import numpy as np

from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.files.times import TIME

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
