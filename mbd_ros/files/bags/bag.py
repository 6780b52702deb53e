"""Bags: a rosbag2 folder, .mcap or .db3. Results are joint states and other columns.

`metadata["topics"]` of a result maps its `samples`: topic -> field of a JointState ->
quantity, so that the joints on a topic are those with a column `<joint>.<quantity>` of the first
field, or -> name -> column; or topic -> `data` -> columns of a Float64MultiArray; or topic ->
`body` -> the free body whose pose and twist it carries as Odometry. Numbers that no such topic
takes are in a Float64MultiArray on `/<table>`, whose layout labels are their names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_reader import messages, topic_types
from mbd_ros.files.bags.bag_recordings import Wanted, bag_motion
from mbd_ros.files.bags.bag_types import (
    JOINT_STATE,
    MULTI_ARRAY,
    ODOMETRY,
    STRING,
    new_message,
    to_cdr,
)
from mbd_ros.files.bags.bag_writer import BagWriter, Rows
from mbd_ros.files.body_columns import POSE, TWIST, names_of
from mbd_ros.files.table import MAIN, STAMP, TIME, Column, Result, Table, stamps_of, time_columns
from mbd_ros.files.tables.description import column_of, describe, described
from msg_adapters.cdr import refilled
from msg_adapters.errors import MessageError
from msg_adapters.joint_state_cdr import joint_state_rows
from msg_adapters.pose import OdometryCdrWriter, read_odometry

DESCRIPTION = "/result"  # topic
FIELDS = ("position", "velocity", "effort")  # of a JointState
BODY_FIELDS = {"pose": POSE, "twist": TWIST}  # of an Odometry
TOPICS = {"/joint_states": {field: field for field in FIELDS}}  # where a result says nothing
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")
RECORDED = "recorded"  # metadata `stamps`: those of a motion that was read
_WHOLE = 2**53  # up to which a float64 tells whole numbers apart
_SPAN = 8192  # rows of tables whose messages are made at once
_UNITS = {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "N·m or N"}


class Bag:
    """Messages of ROS 2; the topic `/result` names their columns (String, JSON)."""

    content = "numbers"
    one_table = False

    def holds(self, column: Column) -> bool:
        """Whether it is numbers of any shape that float64 tells apart."""
        values = column.values
        if values.dtype.kind in "iu" and column.name != STAMP:
            return bool((np.abs(values.astype(np.float64)) <= _WHOLE).all())
        return values.dtype.kind in "fiub"

    def write(self, path: Path, result: Result) -> None:
        """Write all tables; see `bag_streams`.

        A time of 0 becomes 1 ns, since 0 is no stamp in ROS; stamps of a recording stay.

        Raises:
            DataError: A place that cannot be written to, or times that messages cannot hold.
        """
        self.write_blocks(path, [result])

    def write_blocks(self, path: Path, results: Iterable[Result]) -> None:
        """Write a result that comes piece by piece, in the order of time.

        Args:
            results: The pieces, at least one; all have the columns and metadata of the first.

        Raises:
            DifferentPieceError: A piece has other columns or metadata.
        """
        description = ""
        with BagWriter(path) as bag:
            for result in results:
                timed, more = _streams(result)
                described_here = describe(result, more)
                if not description:
                    description, said = described_here, new_message(STRING)
                    said.data = description
                    first = min((int(times[0]) for times, _ in timed if len(times)), default=1)
                    bag.write(DESCRIPTION, STRING, first, said)
                if described_here != description:
                    raise DifferentPieceError(f"{path}: pieces of a result have other columns")
                for parts in _parts(path, timed):
                    bag.write_rows(parts)

    def read(self, path: Path, topic: str = "/joint_states") -> Result:
        """The result that `write` wrote; of other bags the joint states of a topic.

        Args:
            topic: For a bag of another program.

        Raises:
            DataError: No readable bag, or nothing usable on the topic.
        """
        types = topic_types(path)
        if types.get(DESCRIPTION) != STRING:
            return _recorded(path, topic)
        said = next(messages(path, {DESCRIPTION: STRING}))[2].data
        tables, metadata = described(said, str(path))
        try:
            wanted = {entry["topic"] for entries in tables.values() for entry in entries}
            values = _values(path, {t: types[t] for t in wanted if t in types})
            return Result(
                {
                    name: Table(column_of(e, _picked(values, e)) for e in entries)
                    for name, entries in tables.items()
                },
                metadata,
            )
        except (KeyError, ValueError, TypeError, IndexError) as error:  # a MessageError too
            raise DataError(f"{path}: its messages do not fit {DESCRIPTION} ({error})") from error


class DifferentPieceError(DataError):
    """Pieces of a result that do not fit together."""


def _parts(path: Path, timed: Sequence[tuple[Array, Sequence[Stream]]]) -> Iterator[list[Rows]]:
    """Messages of all streams, in spans of time that follow each other."""
    every = np.sort(np.concatenate([stamps for stamps, _ in timed] or [np.zeros(0)]))
    edges = np.unique(every[::_SPAN])
    for begin, end in zip(edges, [*edges[1:], None], strict=True):
        parts = []
        for stamps, streams in timed:
            inside = stamps >= begin if end is None else (stamps >= begin) & (stamps < end)
            rows = np.flatnonzero(inside)
            if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
                rows = slice(rows[0], rows[-1] + 1)  # a view of them
            for stream in streams:
                try:
                    parts.append(stream.rows(stamps[rows], rows))
                except MessageError as error:
                    raise DataError(f"{path}: topic {stream.topic}: {error}") from error
        yield parts


class Stream(NamedTuple):
    """Contents of a topic.

    Attributes:
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


def _recorded(path: Path, topic: str) -> Result:
    """Joint states of others: the finite values of every joint that a message names."""
    named = (msg.name for _, _, msg in messages(path, {topic: JOINT_STATE}))
    names = list(dict.fromkeys(name for each in named for name in each))
    recording = bag_motion(path, topic, Wanted(tuple(names)))
    motion = recording.motion
    columns = time_columns(motion.stamps)
    for field in FIELDS:
        values = getattr(motion, field)
        for name, column in zip(names, () if values is None else values.T, strict=False):
            if not np.isnan(column).all():
                columns.append(Column(f"{name}.{field}", column, _UNITS[field]))
    said = [f"{count} messages left out: {why}" for why, count in recording.dropped.items()]
    return Result({MAIN: Table(columns)}, {"inputs": {"bag": str(path)}, "remarks": said})


def _values(path: Path, topics: Mapping[str, str]) -> dict[tuple[str, str], Array]:
    """Topic and field -> values, shape (n, width), or log times, shape (n, 1)."""
    rows: dict[tuple[str, str], list[Any]] = {}
    for topic, log_time, message in messages(path, topics) if topics else ():
        fields: tuple[str, ...] = FIELDS if topics[topic] == JOINT_STATE else ("data",)
        if topics[topic] == ODOMETRY:
            message, fields = read_odometry(message), tuple(BODY_FIELDS)
        for field in fields:
            rows.setdefault((topic, field), []).append(getattr(message, field))
        rows.setdefault((topic, "log_time"), []).append([log_time])
    return {key: np.array(values) for key, values in rows.items()}


def _picked(values: Mapping[tuple[str, str], Array], entry: Mapping[str, Any]) -> Array:
    shape = entry.get("shape", ())
    taken = values.get((entry["topic"], entry["field"]), np.zeros((0, 0)))
    taken = taken[:, entry["at"] : entry["at"] + int(np.prod(shape, dtype=np.int64))]
    kind = np.dtype(entry.get("dtype", taken.dtype))
    return taken.reshape(len(taken), *shape).astype(kind, order="C")


def _streams(
    result: Result,
) -> tuple[list[tuple[Array, list[Stream]]], dict[str, dict[str, dict[str, Any]]]]:
    """Stamps and streams of each table, and where its columns are."""
    timed, more = [], {}
    for name, table in result.tables.items():
        stamps = stamps_of(table) if TIME in table else np.arange(1, table.rows + 1)
        if result.metadata.get("stamps") != RECORDED:
            stamps = np.where(stamps == 0, 1, stamps)
        plain = Table(column for column in table.columns if column.name != STAMP)
        streams, more[name] = streams_of(name, plain, result.metadata.get("topics"))
        more[name][STAMP] = {"topic": streams[-1].topic, "field": "log_time", "at": 0}
        timed.append((stamps, streams))
    return timed, more


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


def _multi_array(
    topic: str, fields: Mapping[str, Any], table: Table
) -> tuple[Stream, dict[str, dict[str, Any]]] | None:
    names = fields["data"]
    if not all(_is_plain(table, name) for name in names):
        return None
    values = np.column_stack([table[name] for name in names])
    where = {name: {"topic": topic, "field": "data", "at": i} for i, name in enumerate(names)}
    return Stream(topic, MULTI_ARRAY, (), {"data": values}), where


def _is_plain(table: Table, name: str) -> bool:
    return name in table and table[name].ndim == 1 and table[name].dtype == np.float64


def _odometry(
    topic: str, body: str, table: Table
) -> tuple[Stream, dict[str, dict[str, Any]]] | None:
    columns = {field: names_of(body, words) for field, words in BODY_FIELDS.items()}
    if not all(_is_plain(table, name) for names in columns.values() for name in names):
        return None
    values, where = _fields(topic, columns, table)
    frames = tuple(table.column(names[0]).frame for names in columns.values())
    return Stream(topic, ODOMETRY, frames, values), where


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


def _columns(quantity: str | Mapping[str, str], table: Table) -> Mapping[str, str]:
    """Name on the topic -> column."""
    if not isinstance(quantity, str):
        return quantity
    end = f".{quantity}"
    return {name.removesuffix(end): name for name in table if name.endswith(end)}


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
