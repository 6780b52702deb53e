"""Gzip files, unpacked within a bound that is counted while reading.

A small file may unpack to any size, and its header does not say to which.
"""

import errno
from gzip import GzipFile
from io import BufferedReader, RawIOBase
from typing import Any, BinaryIO

MAX_UNPACKED = 2_000_000_000  # bytes, of any compressed file
_BLOCK = 1 << 16  # bytes that are unpacked at once


def unpacked_gzip(packed: BinaryIO) -> BufferedReader:
    """The content of a gzip file as a stream; reading beyond 2 GB raises an OSError.

    Args:
        packed: The file, at its begin.
    """
    return BufferedReader(_Counted(GzipFile(fileobj=packed)), _BLOCK)


class _Counted(RawIOBase):
    """A stream that ends in an error beyond `MAX_UNPACKED` bytes."""

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
