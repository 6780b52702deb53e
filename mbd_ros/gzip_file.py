"""Gzip files, read with a limit on their unpacked size.

A small file can unpack to any size, and its header does not tell which, so bytes are counted
while they are read.
"""

import errno
import os
from gzip import GzipFile
from io import BufferedReader, RawIOBase
from typing import Any, BinaryIO

MAX_UNPACKED = 2_000_000_000  # bytes, of any compressed file
_BLOCK = 1 << 16  # bytes that are unpacked at once
_COUNTED_BLOCK = 1 << 20  # bytes that are unpacked at once where they are only counted
_MAX_RATIO = 1032  # largest ratio of unpacked to packed bytes of the deflate format


def unpacked_gzip(packed: BinaryIO) -> BufferedReader:
    """Return the unpacked content as a stream, which raises an OSError beyond 2 GB.

    Args:
        packed: The gzip file, positioned at its start.
    """
    return BufferedReader(_Counted(GzipFile(fileobj=packed)), _BLOCK)


def check_gzip(packed: BinaryIO) -> None:
    """Refuse a gzip file that unpacks to more than 2 GB, before its lines are parsed.

    Unpacking takes seconds, whereas parsing 2 GB of numbers takes minutes.

    Args:
        packed: The gzip file, positioned at its start, where this function leaves it again.

    Raises:
        OSError: The unpacked content is larger; `strerror` names the limit.
    """
    if packed.seek(0, os.SEEK_END) * _MAX_RATIO > MAX_UNPACKED:
        packed.seek(0)
        stream = _Counted(GzipFile(fileobj=packed))
        block = bytearray(_COUNTED_BLOCK)
        while stream.readinto(block):
            pass
    packed.seek(0)


class _Counted(RawIOBase):
    """A stream that raises an OSError once more than `MAX_UNPACKED` bytes were read."""

    def __init__(self, source: GzipFile) -> None:
        self._source = source
        self._count = 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        size = self._source.readinto(buffer)
        self._count += size
        if self._count > MAX_UNPACKED:
            raise OSError(errno.EFBIG, f"more than {MAX_UNPACKED} bytes when unpacked")
        return size
