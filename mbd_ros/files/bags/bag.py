"""Bags: a rosbag2 folder, .mcap or .db3. Results are joint states and other columns."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_recordings import Wanted, bag_motion
from mbd_ros.files.bags.bag_writer import (
    BODY_FIELDS,
    FIELDS,
    JOINT_STATE,
    ODOMETRY,
    Rows,
    Stream,
    streams_of,
)
from mbd_ros.files.bags.bags import BagWriter, messages, new_message, topic_types
from mbd_ros.files.table import MAIN, STAMP, TIME, Column, Result, Table, stamps_of, time_columns
from mbd_ros.files.tables.description import column_of, describe, described
from msg_adapters.errors import MessageError
from msg_adapters.odometry import read_odometry

DESCRIPTION, STRING = "/result", "std_msgs/msg/String"
RECORDED = "recorded"  # metadata `stamps`: those of a motion that was read
_WHOLE = 2**53  # up to which a float64 tells whole numbers apart
_ROWS = 8192  # rows of tables whose messages are made at once
_UNITS = {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "N·m or N"}


class DifferentPieceError(DataError):
    """Pieces of a result that do not fit together."""


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
            path: The bag.
            results: The pieces, at least one; all have the columns and metadata of the first.

        Raises:
            DataError: As `write`.
            DifferentPieceError: A piece has other columns or metadata.
        """
        whole = ""
        with BagWriter(path) as bag:
            for result in results:
                timed, more = _streams(result)
                described_here = describe(result, more)
                if not whole:
                    whole, said = described_here, new_message(STRING)
                    said.data = whole
                    first = min((int(times[0]) for times, _ in timed if len(times)), default=1)
                    bag.write(DESCRIPTION, STRING, first, said)
                if described_here != whole:
                    raise DifferentPieceError(f"{path}: pieces of a result have other columns")
                for parts in _parts(path, timed):
                    bag.write_rows(parts)

    def read(self, path: Path, topic: str = "/joint_states") -> Result:
        """The result that `write` wrote; of other bags the joint states of a topic.

        Args:
            path: The bag.
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


def _parts(path: Path, timed: Sequence[tuple[Array, Sequence[Stream]]]) -> Iterator[list[Rows]]:
    """Messages of all streams, in spans of time that follow each other."""
    every = np.sort(np.concatenate([stamps for stamps, _ in timed] or [np.zeros(0)]))
    edges = np.unique(every[::_ROWS])
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
