"""Read .npz files (numpy arrays in a zip file) with bounded memory and without running code.

Headers are parsed here because numpy evaluates them and allocates the size that they state.
"""

import math
import re
import struct
import sys
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from mbd_ros.errors import DataError
from mbd_ros.gzip_file import MAX_UNPACKED
from mbd_ros.regular_file import open_regular

_BLOCK = 1 << 18  # bytes that are unpacked at once
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1  # flag of a member of a zip file
_BROKEN_ZIP = (
    *(zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError, KeyError, IndexError),
    *(NotImplementedError, RuntimeError, OverflowError, MemoryError),
)
_LENGTHS = {(1, 0): "<H", (2, 0): "<I", (3, 0): "<I"}  # version of .npy -> length of its header
_MAGIC = b"\x93NUMPY"
_MAX_HEADER = 10_000  # bytes
_HEADER = re.compile(
    r"\{'descr': ?'(?P<dtype>[<>|=]?[biufcU][1-9][0-9]{0,8})', ?"
    r"'fortran_order': ?(?P<order>True|False), ?'shape': ?\((?P<shape>[0-9, ]*)\),? ?\}[ \n]*"
)


def read_arrays(path: Path, what: str) -> dict[str, NDArray[Any]]:
    """Read the arrays of an .npz file, by name, without running code.

    Members must be .npy files of numbers, truth values or text, stored or deflated. Unpacked, they
    may have at most 2 GB together, or the size of the file if that is more.

    Args:
        path: The .npz file.
        what: What the file should be, for the error message, such as "a table of arrays".

    Raises:
        DataError: The file cannot be read, is damaged, or contains something else.
    """
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as packed:
            remaining = max(MAX_UNPACKED, path.stat().st_size)  # bytes
            for member in packed.infolist():
                name = member.filename.removesuffix(".npy")
                if name in arrays:
                    raise ValueError(f"two arrays have the name {name}")
                try:
                    arrays[name] = _read_array(packed, member, remaining)
                except ValueError as error:
                    raise ValueError(f"array {name}: {error}") from error
                remaining -= arrays[name].nbytes
    except _BROKEN_ZIP as error:
        reason = str(error) or type(error).__name__
        raise DataError(f"{path}: is damaged, or not {what} ({reason})") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
    return arrays


def _read_array(packed: zipfile.ZipFile, member: zipfile.ZipInfo, limit: int) -> NDArray[Any]:
    """Read one array.

    Args:
        packed: The zip file.
        member: The member that contains the array.
        limit: Largest size of the array [bytes].

    Raises:
        ValueError: The member is not an accepted array, or is larger.
    """
    if member.compress_type not in _METHODS or member.flag_bits & _ENCRYPTED:
        raise ValueError("it is encrypted, or compressed by another method than deflate")
    with packed.open(member) as stream:
        dtype, order, shape = _read_header(stream)
        size = dtype.itemsize * math.prod(filter(None, shape))
        if size > limit:
            raise ValueError(f"more than {MAX_UNPACKED} bytes when unpacked")
        content = np.empty(0 if 0 in shape else size, np.uint8)
        begin = 0
        while block := stream.read(min(_BLOCK, len(content) - begin + 1)):
            end = begin + len(block)
            if end > len(content):
                raise ValueError(f"it has more bytes than shape {shape} of {dtype} needs")
            content[begin:end] = np.frombuffer(block, np.uint8)
            begin = end
        if begin < len(content):
            raise ValueError(f"it has fewer bytes than shape {shape} of {dtype} needs")
    if dtype.kind == "U" and (content.view(f"{dtype.str[0]}u4") > sys.maxunicode).any():
        raise ValueError("its text contains invalid characters")
    return content.view(dtype).reshape(shape, order=order)


def _read_header(stream: IO[bytes]) -> tuple[np.dtype[Any], Literal["C", "F"], tuple[int, ...]]:
    """Read type of the elements, memory order and shape from the header of a .npy file."""
    start = stream.read(len(_MAGIC) + 2)
    form = _LENGTHS.get(tuple(start[len(_MAGIC) :]), "")
    if not start.startswith(_MAGIC) or not form:
        raise ValueError("it is not in .npy format")
    (length,) = struct.unpack(form, stream.read(struct.calcsize(form)))
    match = _HEADER.fullmatch(stream.read(length).decode()) if length <= _MAX_HEADER else None
    if match is None:
        raise ValueError("its elements must be numbers, truth values or text")
    try:
        dtype = np.dtype(match["dtype"])
    except TypeError as error:
        raise ValueError(f"numpy has no type {match['dtype']}") from error
    shape = tuple(int(size) for size in re.findall(r"[0-9]+", match["shape"]))
    return dtype, "F" if match["order"] == "True" else "C", shape
