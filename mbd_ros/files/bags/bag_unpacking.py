"""Unpacking of the compressed parts of a bag, with a limit on what they unpack to.

Chunks of MCAP files, single messages and whole files may be compressed; rosbags unpacks each of
them without a bound. Its functions for chunks are replaced here by those that count.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag2.reader import zstd
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from mbd_ros.errors import DataError
from mbd_ros.gzip_file import MAX_UNPACKED
from mbd_ros.regular_file import open_regular

MAX_PART = 2**28  # bytes of a chunk or message: recorders end a chunk after some 2**20
_RATIO = 100  # of what is unpacked to the size of the bag, where that is more than 2 GB
_BLOCK = 2**20  # bytes
T = TypeVar("T")


class Allowance:
    """Bytes that a bag may unpack to, all parts together: 2 GB, or 100 times its size.

    Args:
        path: Of the bag, for the messages.
        files: What it consists of.
    """

    def __init__(self, path: Path, files: Iterable[Path]) -> None:
        self._path = path
        self._total = max(MAX_UNPACKED, _RATIO * sum(file.stat().st_size for file in files))
        self._left = self._total

    def take(self, count: int) -> None:
        """Count bytes that were unpacked.

        Raises:
            DataError: More than the bag may unpack to.
        """
        self._left -= count
        if self._left < 0:
            raise DataError(f"{self._path}: more than {self._total} bytes when unpacked")

    def refuse_part(self, size: int) -> None:
        """Refuse a chunk or message that is too large.

        Raises:
            DataError: It is.
        """
        if size > MAX_PART:
            raise DataError(
                f"{self._path}: a chunk or message has more than {MAX_PART} bytes when unpacked"
            )

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Count what rosbags unpacks within the `with` block."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    def counted(self, stream: Iterator[T]) -> Iterator[T]:
        """The same stream; what rosbags unpacks for it is counted."""
        while True:
            token = _current.set(self)  # not by `counting`, which costs more than a message
            try:
                item = next(stream, _END)
            finally:
                _current.reset(token)
            if item is _END:
                return
            yield item  # type: ignore[misc]

    def message(self, packed: bytes) -> bytes:
        """A message that is compressed by itself."""
        with self.counting():
            return _unpacked(zstd.ZstdDecompressor, packed, MAX_PART)

    def count_file(self, file: Path) -> None:
        """Count a file that is compressed as a whole."""
        with open_regular(file) as packed, zstd.open(packed, "rb") as stream:
            while block := stream.read(_BLOCK):
                self.take(len(block))


_current: ContextVar[Allowance | None] = ContextVar("allowance", default=None)
_END: Any = object()


def _unpacked(decompressor: Callable[[], Any], packed: bytes, size: int) -> bytes:
    """At most one byte more than the size, which tells that there are more."""
    allowance = _current.get()
    if allowance is not None:
        allowance.refuse_part(size)
    parts, count = [], 0
    while packed and count <= size:
        frame = decompressor()
        parts.append(frame.decompress(packed, max_length=size + 1 - count))
        count += len(parts[-1])
        if not frame.eof:
            break
        packed = frame.unused_data or b""
    if allowance is not None:
        allowance.take(count)
        allowance.refuse_part(count)
    return b"".join(parts)


def _counted(content: bytes, size: int) -> bytes:
    """Count content that is not compressed; an index may name it many times."""
    allowance = _current.get()
    if allowance is not None:
        allowance.take(len(content))
    return content


DECOMPRESSORS[""] = _counted
DECOMPRESSORS["zstd"] = partial(_unpacked, zstd.ZstdDecompressor)
DECOMPRESSORS["lz4"] = partial(_unpacked, LZ4FrameDecompressor)
