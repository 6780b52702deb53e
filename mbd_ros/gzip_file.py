"""Gzip files, unpacked within a bound that is counted while reading.

A small file may unpack to any size, and its header does not say to which.
"""

import errno
import os
from gzip import GzipFile
from io import BufferedReader, RawIOBase
from typing import Any, BinaryIO

MAX_UNPACKED = 2_000_000_000  # bytes, of any compressed file
_BLOCK = 1 << 16  # bytes that are unpacked at once
_MANY = 1 << 20  # the same, where they are only counted
_RATIO = 1032  # of unpacked to packed bytes, the largest of deflate


def unpacked_gzip(packed: BinaryIO) -> BufferedReader:
    """The content of a gzip file as a stream; reading beyond 2 GB raises an OSError.

    Args:
        packed: The file, at its begin.
    """
    return BufferedReader(_Counted(GzipFile(fileobj=packed)), _BLOCK)


def check_gzip(packed: BinaryIO) -> None:
    """Refuse a gzip file that unpacks to more than 2 GB before its lines are read one by one.

    Unpacking alone takes seconds, reading 2 GB of numbers takes minutes.

    Args:
        packed: The file, at its begin; it is there again afterwards.

    Raises:
        OSError: It does; `strerror` says so.
    """
    if packed.seek(0, os.SEEK_END) * _RATIO > MAX_UNPACKED:
        packed.seek(0)
        stream, block = _Counted(GzipFile(fileobj=packed)), bytearray(_MANY)
        while stream.readinto(block):
            pass
    packed.seek(0)


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
