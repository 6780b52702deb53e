"""rosbag2 recordings written whole or not at all."""

import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, final

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import MARK, check_target
from mbd_ros.files.bags.bag_rows import Rows, append
from mbd_ros.files.bags.bag_types import TYPES, to_cdr

_SHOWN = 40  # characters of a name in that of a temporary folder: names end at 255 bytes
PLUGINS = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}


@final
class BagWriter:
    """Writes a bag beside its place and puts it there when the `with` block ends well.

    Args:
        path: A folder (MCAP storage), or a file ending in .mcap or .db3. An existing
            bag is replaced only if this class wrote it.

    Raises:
        DataError: On entering for a place that cannot be written to; later, when writing fails.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(os.path.abspath(path))
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> "BagWriter":
        with self._failing():
            check_target(self.path)
            self._room = Path(
                tempfile.mkdtemp(prefix=f".{self.path.name[:_SHOWN]}.", dir=self.path.parent)
            )
            with ExitStack() as undo:
                undo.callback(shutil.rmtree, self._room, ignore_errors=True)
                self._open()
                undo.pop_all()
        return self

    def _open(self) -> None:
        bare = self.path.suffix in PLUGINS and not self.path.is_dir()
        # rosbags names the storage file after its folder.
        folder = self._room / "new" / ("bag" if bare else self.path.name)
        self._product = folder / f"bag{self.path.suffix}" if bare else folder
        plugin = PLUGINS[self.path.suffix if bare else ".mcap"]
        self._writer = Writer(folder, version=9, storage_plugin=plugin)
        self._writer.set_custom_data(*MARK)
        self._writer.open()

    def write(self, topic: str, msgtype: str, log_time: int, message: Any) -> None:
        """Append one message.

        Args:
            topic: Topic name; one type a topic.
            msgtype: As `sensor_msgs/msg/JointState`.
            log_time: [ns], >= 0.
            message: Message of rosbags (see `new_message`), or its CDR as bytes.
        """
        if msgtype not in TYPES.fielddefs:
            raise DataError(f"{self.path}: topic {topic}: {msgtype} is no type of ROS 2 Jazzy")
        if not 0 <= log_time < 2**63:
            raise DataError(f"{self.path}: topic {topic}: {log_time} ns is no time for a bag")
        with self._failing():
            cdr = message if isinstance(message, bytes) else to_cdr(message, msgtype)
            self._writer.write(self._connection(topic, msgtype), log_time, cdr)

    def write_rows(self, parts: Sequence[Rows]) -> None:
        """Append messages of several topics, in the order of their log times.

        Args:
            parts: The messages; those of one time come in the order of the parts.
        """
        parts = [part for part in parts if len(part.log_times)]
        for part in parts:
            earliest = int(part.log_times.min())
            if earliest < 0:
                where = f"{self.path}: topic {part.topic}"
                raise DataError(f"{where}: {earliest} ns is no time for a bag")
        with self._failing():
            known = [self._connection(part.topic, part.msgtype) for part in parts]
            if not parts:
                return
            append(self._writer.storage, parts, [connection.id for connection in known])
            for part, connection in zip(parts, known, strict=True):
                times, writer = part.log_times, self._writer
                writer.counts[connection.id] += len(times)
                writer.min_timestamp = min(writer.min_timestamp, int(times.min()))
                writer.max_timestamp = max(writer.max_timestamp, int(times.max()))

    def _connection(self, topic: str, msgtype: str) -> Connection:
        if topic not in self._connections:
            add = self._writer.add_connection
            self._connections[topic] = add(topic, msgtype, typestore=TYPES)
        known = self._connections[topic]
        if known.msgtype != msgtype:
            raise DataError(f"{self.path}: topic {topic} has type {known.msgtype}, not {msgtype}")
        return known

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with self._failing():
                self._writer.__exit__(kind, error, trace)
                if kind is None:
                    self._publish()
        finally:
            shutil.rmtree(self._room, ignore_errors=True)

    def _publish(self) -> None:
        old = self._room / "old"
        if self.path.is_dir():
            os.rename(self.path, old)
        try:
            os.replace(self._product, self.path)
        except OSError:
            if old.exists():
                os.rename(old, self.path)
            raise

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except (WriterError, OSError, sqlite3.Error, struct.error) as error:
            raise DataError(f"{self.path}: cannot be written ({error})") from error
