"""Columns of a result, and the messages of a bag that hold them.

`metadata["topics"]` of a result maps its `samples`: topic -> field of a JointState ->
quantity, so that the joints on a topic are those with a column `<joint>.<quantity>` of the first
field, or -> name -> column; or topic -> `data` -> columns of a Float64MultiArray; or topic ->
`body` -> the free body whose pose and twist it carries as Odometry. Numbers that no such topic
takes are in a Float64MultiArray on `/<table>`, whose layout labels are their names.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_rows import Rows
from mbd_ros.files.bags.bag_types import new_message, to_cdr
from mbd_ros.files.body_columns import POSE, TWIST, names_of
from mbd_ros.files.table import MAIN, Column, Table
from msg_adapters.joint_state_rows import joint_state_rows
from msg_adapters.odometry import OdometryCdrWriter
from msg_adapters.rows import refilled

JOINT_STATE, MULTI_ARRAY = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
ODOMETRY = "nav_msgs/msg/Odometry"
FIELDS = ("position", "velocity", "effort")  # of a JointState
BODY_FIELDS = {"pose": POSE, "twist": TWIST}  # of an Odometry
TOPICS = {"/joint_states": {field: field for field in FIELDS}}  # where a result says nothing
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")


class Stream(NamedTuple):
    """Contents of a topic.

    Attributes:
        topic: Its name.
        msgtype: JointState, Odometry or Float64MultiArray.
        names: Joints, frames of pose and twist, or labels; empty labels are not written.
        fields: Field of the message -> its values, shape (n, width).
    """

    topic: str
    msgtype: str
    names: tuple[str, ...]
    fields: Mapping[str, Array]

    def rows(self, stamps: NDArray[np.int64], chosen: slice | NDArray[np.intp]) -> Rows:
        """Serialized messages of some rows.

        Args:
            stamps: Of the chosen rows [ns], shape (n,).
            chosen: The rows.

        Raises:
            MessageError: What no message can carry.
        """
        fields = {name: values[chosen] for name, values in self.fields.items()}
        if self.msgtype == JOINT_STATE:
            cdr = joint_state_rows(self.names, stamps, fields)
        elif self.msgtype == ODOMETRY:
            cdr = OdometryCdrWriter(*self.names).rows(stamps, fields["pose"], fields["twist"])
        else:
            template = self._template()
            cdr = refilled(template, {len(template) - 8 * self.width: fields["data"]})
        return Rows(self.topic, self.msgtype, stamps, cdr)

    @property
    def width(self) -> int:
        """Numbers in a row of the first field."""
        return int(next(iter(self.fields.values())).shape[1])

    def _template(self) -> bytes:
        """A serialized Float64MultiArray of zeros, which stand at its end."""
        message = new_message(MULTI_ARRAY)
        message.data = np.zeros(self.width)
        for name in self.names:
            dimension = new_message("std_msgs/msg/MultiArrayDimension")
            dimension.label, dimension.size, dimension.stride = name, 1, 1
            message.layout.dim.append(dimension)
        return bytes(to_cdr(message, MULTI_ARRAY))


def streams_of(
    name: str, table: Table, topics: Mapping[str, Mapping[str, Any]] | None
) -> tuple[list[Stream], dict[str, dict[str, Any]]]:
    """Streams of a table, and where each column is: topic, field, place in it, shape and kind.

    Args:
        name: Of the table.
        table: Columns of numbers.
        topics: Those of the metadata, or None.

    Raises:
        DataError: A name that no topic can have.
    """
    if not _NAME.fullmatch(name):
        raise DataError(
            f"table {name!r}: no name of a topic, accepted are letters, digits, _ and /"
        )
    streams: list[Stream] = []
    where: dict[str, dict[str, Any]] = {}
    chosen = _checked(topics or TOPICS) if name == MAIN else {}
    arrays = {column for fields in chosen.values() for column in fields.get("data", ())}
    others = Table(column for column in table.columns if column.name not in arrays)
    for topic, fields in chosen.items():
        if "data" in fields:
            taken = _multi_array(topic, fields, table)
        elif "body" in fields:
            taken = _odometry(topic, fields["body"], table)
        else:
            taken = _joint_states(topic, fields, others)
        if taken is not None:
            streams.append(taken[0])
            where = taken[1] | where
    rest = [column for column in table.columns if column.name not in where]
    stream, places = _rest(f"/{name}", rest, table.rows)
    return [*streams, stream], where | places


def _checked(topics: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    for topic, fields in topics.items():
        if not set(fields) <= {*FIELDS} and list(fields) not in (["data"], ["body"]):
            raise DataError(
                f"metadata topics: {topic}: fields {', '.join(fields)}, accepted: "
                f"{', '.join(FIELDS)}, or data or body alone"
            )
    return dict(topics)


def _joint_states(
    topic: str, fields: Mapping[str, Any], table: Table
) -> tuple[Stream, dict[str, dict[str, Any]]] | None:
    first = _columns(next(iter(fields.values())), table)
    names = tuple(name for name, column in first.items() if _is_plain(table, column))
    columns = {}
    for field, quantity in fields.items():
        found = _columns(quantity, table)
        if names and all(_is_plain(table, found.get(name, "")) for name in names):
            columns[field] = [found[name] for name in names]
    if not columns:
        return None
    values, where = _fields(topic, columns, table)
    return Stream(topic, JOINT_STATE, names, values), where


def _fields(
    topic: str, columns: Mapping[str, Sequence[str]], table: Table
) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
    """Values of each field from its columns, and where each column stands."""
    values = {f: np.column_stack([table[name] for name in named]) for f, named in columns.items()}
    where = {
        name: {"topic": topic, "field": field, "at": i}
        for field, named in columns.items()
        for i, name in enumerate(named)
    }
    return values, where


def _columns(quantity: str | Mapping[str, str], table: Table) -> Mapping[str, str]:
    """Name on the topic -> column."""
    if not isinstance(quantity, str):
        return quantity
    end = f".{quantity}"
    return {name.removesuffix(end): name for name in table if name.endswith(end)}


def _multi_array(
    topic: str, fields: Mapping[str, Any], table: Table
) -> tuple[Stream, dict[str, dict[str, Any]]] | None:
    names = fields["data"]
    if not all(_is_plain(table, name) for name in names):
        return None
    values = np.column_stack([table[name] for name in names])
    where = {name: {"topic": topic, "field": "data", "at": i} for i, name in enumerate(names)}
    return Stream(topic, MULTI_ARRAY, (), {"data": values}), where


def _odometry(
    topic: str, body: str, table: Table
) -> tuple[Stream, dict[str, dict[str, Any]]] | None:
    columns = {field: names_of(body, words) for field, words in BODY_FIELDS.items()}
    if not all(_is_plain(table, name) for names in columns.values() for name in names):
        return None
    values, where = _fields(topic, columns, table)
    frames = tuple(table.column(names[0]).frame for names in columns.values())
    return Stream(topic, ODOMETRY, frames, values), where


def _rest(
    topic: str, columns: list[Column], rows: int
) -> tuple[Stream, dict[str, dict[str, Any]]]:
    where: dict[str, dict[str, Any]] = {}
    labels: list[str] = []
    for name, values, *_ in columns:
        shape = values.shape[1:]
        where[name] = {"topic": topic, "field": "data", "at": len(labels)}
        where[name] |= {"shape": shape, "dtype": values.dtype.str}
        places = [f"[{','.join(map(str, at))}]" for at in np.ndindex(shape)] if shape else [""]
        labels += [f"{name}{place}" for place in places]
    flat = [
        values.reshape(rows, int(np.prod(values.shape[1:]))).astype(np.float64)
        for _, values, *_ in columns
    ]
    data = np.hstack([np.zeros((rows, 0)), *flat])
    return Stream(topic, MULTI_ARRAY, tuple(labels), {"data": data}), where


def _is_plain(table: Table, name: str) -> bool:
    return name in table and table[name].ndim == 1 and table[name].dtype == np.float64
