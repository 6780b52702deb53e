"""Header and parameters of a .c3d, whose counts must fit the size of the file.

The library that reads the samples trusts these counts: it takes memory for what they say, and
reads beyond the end of parameters that hold too little.

Source: C3D user guide, Motion Lab Systems, 2021: header section, parameter section.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbd_ros.errors import DataError

_BLOCK = 512  # bytes
_MAGIC = 0x50
LONGEST = 1_000_000  # bytes from the start of the file to the end of its parameters
_INTEL, _DEC = 84, 85
_PROCESSORS = {_INTEL: "Intel", _DEC: "DEC"}
_TYPES = {-1: "text", 1: "i1", 2: "<i2", 4: "<f4"}
_MOST_DIMENSIONS = 7
_MOST_SUBFRAMES = 1000  # samples of analog channels in a frame
_BARE_SUBFRAMES = 100  # where there is no channel to fill them
_PLATE_CHANNELS = 6  # least of a plate
_TURN_BYTES = 17 * 4  # a matrix of 4 x 4 and its reliability
_SINGLE = {  # what must hold a value where it is there
    "POINT": ("USED", "FRAMES", "RATE", "SCALE", "UNITS"),
    "ANALOG": ("USED", "RATE", "GEN_SCALE"),
    "FORCE_PLATFORM": ("USED", "UNITS"),
    "ROTATION": ("USED", "DATA_START", "RATIO", "RATE"),
}


def check_counts(path: Path, start: bytes, size: int) -> None:
    """Refuse a file whose counts do not fit its size or one another.

    Args:
        path: File, for the messages.
        start: Its first `LONGEST` bytes, or all.
        size: Of the file [bytes].

    Raises:
        DataError: Names field or parameter, and what is accepted.
    """
    if len(start) < _BLOCK or start[1] != _MAGIC:
        raise DataError(f"{path}: no .c3d")
    block = start[0]
    at = (block - 1) * _BLOCK
    if block < 2 or at + 4 > len(start):
        raise _broken(path, f"header: parameters begin in block {block}, where there are none")
    processor = start[at + 3]
    if processor not in _PROCESSORS:
        accepted = ", ".join(f"{key} ({name})" for key, name in _PROCESSORS.items())
        raise _broken(path, f"processor type {processor}, accepted: {accepted}")
    parameters = _Parameters(path, _groups_of(path, start, at + 4, processor == _DEC))
    header = _Header.of(start, processor == _DEC)
    _check_samples(parameters, header, size)
    _check_plates(parameters)


class _Header(NamedTuple):
    """Header of the file: frames, the block of the samples, and the scale of points."""

    first: int
    last: int
    scale: float
    data: int

    @classmethod
    def of(cls, start: bytes, is_dec: bool) -> _Header:
        first, last = struct.unpack_from("<HH", start, 6)
        (data,) = struct.unpack_from("<H", start, 16)
        return cls(first, last, float(_floats(start[12:16], is_dec)[0]), data)


class _Value(NamedTuple):
    """A parameter: its dimensions, and its numbers or texts."""

    dimensions: tuple[int, ...]
    entries: Sequence[float] | Sequence[str]


class _Parameters:
    """The parameters of a file by group and name."""

    def __init__(self, path: Path, groups: dict[str, dict[str, _Value]]) -> None:
        self._path, self._groups = path, groups
        for group, names in _SINGLE.items():
            for name in names:
                value = self.get(group, name)
                if value is not None and not len(value.entries):
                    raise self.error(group, name, "holds no value")

    def __contains__(self, group: str) -> bool:
        return group in self._groups

    def error(self, group: str, name: str, text: str) -> DataError:
        """Return an error that names a parameter."""
        return DataError(f"{self._path}: {group}:{name} {text}")

    def get(self, group: str, name: str) -> _Value | None:
        """A parameter, if there is one."""
        return self._groups.get(group, {}).get(name)

    def number(self, group: str, name: str, default: float, largest: float) -> float:
        """A parameter that is one number of at least 0.

        Raises:
            DataError: It is text, negative, too large or not finite.
        """
        value = self.get(group, name)
        first = default if value is None else value.entries[0]
        if isinstance(first, str) or not 0.0 <= first <= largest:
            raise self.error(group, name, f"is {first}, accepted are 0 .. {largest:g}")
        return float(first)

    def count(self, group: str, name: str) -> int:
        """Values of a parameter and of those that continue it: SCALE, SCALE2, .."""
        total, number = 0, 1
        while (value := self.get(group, name if number == 1 else f"{name}{number}")) is not None:
            total, number = total + len(value.entries), number + 1
        return total


def _groups_of(path: Path, start: bytes, at: int, is_dec: bool) -> dict[str, dict[str, _Value]]:
    """The parameters by the names of their groups; of two groups of a name the first counts."""
    names, inside = dict[int, str](), dict[int, dict[str, _Value]]()
    following = at
    while True:
        length, number = struct.unpack("bb", _bytes(path, start, at, 2, "an entry"))
        if length == 0:
            break
        at += 2
        name = _bytes(path, start, at, abs(length), "a name").split(b"\0")[0]
        title = name.decode("latin-1").strip().upper()
        at += abs(length)
        (offset,) = struct.unpack("<H", _bytes(path, start, at, 2, title))
        following = at + offset
        at += 2
        if number < 0:
            names[-number] = title
        else:
            value, at = _value(path, start, at, title, is_dec)
            inside.setdefault(number, {})[title] = value
        described = _bytes(path, start, at, 1, title)[0]
        _bytes(path, start, at + 1, described, title)
        at += 1 + described
        if offset == 0:
            break
        if following != at:
            raise _broken(path, f"parameter {title} ends at byte {at}, not at {following}")
    groups: dict[str, dict[str, _Value]] = {}
    for number in sorted(names):
        groups.setdefault(names[number], inside.get(number, {}))
    return groups


def _bytes(path: Path, start: bytes, at: int, count: int, what: str) -> bytes:
    piece = start[at : at + count]
    if len(piece) < count:
        raise _broken(path, f"parameters: {what} at byte {at} is cut")
    return piece


def _broken(path: Path, text: str) -> DataError:
    """Return the error of a header or of parameters that cannot be read."""
    return DataError(f"{path}: cannot be read as .c3d, or is cut ({text})")


def _value(path: Path, start: bytes, at: int, title: str, is_dec: bool) -> tuple[_Value, int]:
    """A parameter, and where it ends."""
    kind, count = struct.unpack("bb", _bytes(path, start, at, 2, title))
    if kind not in _TYPES:
        raise _broken(path, f"parameter {title} has type {kind}, accepted: -1, 1, 2, 4")
    if not 0 <= count <= _MOST_DIMENSIONS or (count == 0 and kind == -1):
        accepted = f"accepted are 1 .. {_MOST_DIMENSIONS}"
        raise _broken(path, f"parameter {title} has {count} dimensions, {accepted}")
    at += 2
    dimensions = tuple(_bytes(path, start, at, count, title)) or (1,)
    at += count
    visits = math.prod(max(length, 1) for length in dimensions)
    if visits * abs(kind) > len(start) - at:
        shown = " x ".join(map(str, dimensions))
        raise _broken(path, f"parameter {title} has {shown} values, more than the file")
    size = math.prod(dimensions) * abs(kind)
    data = start[at : at + size]
    entries: Sequence[float] | Sequence[str]
    if kind == -1:
        length = dimensions[0] if size else 1
        entries = [data[i : i + length].decode("latin-1") for i in range(0, size, length)]
    elif kind == 4:
        entries = _floats(data, is_dec).tolist()
    else:
        entries = np.frombuffer(data, dtype=_TYPES[kind]).tolist()
    return _Value(dimensions, entries), at + size


def _floats(data: bytes, is_dec: bool) -> np.ndarray:
    """Numbers of four bytes; those of DEC have their words exchanged and four times the value."""
    if not is_dec:
        return np.frombuffer(data, dtype="<f4")
    words = np.frombuffer(data, dtype="<u2").reshape(-1, 2)[:, ::-1]
    return np.ascontiguousarray(words).view("<f4").ravel() / 4.0


def _check_samples(parameters: _Parameters, header: _Header, size: int) -> None:
    """Points, channels and rotations of all frames must be in the file."""
    points = int(parameters.number("POINT", "USED", 0, 32767))
    channels = int(parameters.number("ANALOG", "USED", 0, 32767))
    frames = _frames(parameters, header)
    subframes = _subframes(parameters, channels)
    scale = parameters.get("POINT", "SCALE")
    is_float = scale is None or isinstance(scale.entries[0], str) or not scale.entries[0] >= 0.0
    frame = points * (16 if is_float else 8)
    frame += channels * subframes * (4 if header.scale < 0.0 else 2)
    if frame == 0 and frames > 0 and "ROTATION" not in parameters:
        return  # of which the library reads nothing
    frame = max(frame, 1)  # the library counts empty frames, too
    if frames > 0:
        _check_room(parameters, "POINT", "FRAMES", frames, frame, header.data, size)
    if channels > 0 and "SHADOW" not in parameters:
        for name in ("SCALE", "OFFSET"):
            count = parameters.count("ANALOG", name)
            if count < channels:
                raise parameters.error(
                    "ANALOG", name, f"has {count} values of {channels} channels"
                )
    if "ROTATION" in parameters:
        _check_rotations(parameters, frames, size)


def _frames(parameters: _Parameters, header: _Header) -> int:
    value = parameters.get("POINT", "FRAMES")
    frames = 0.0 if value is None or isinstance(value.entries[0], str) else value.entries[0]
    frames += 65536 if -32768 <= frames < 0 else 0  # of 16 bits, without sign
    if not 0.0 <= frames <= 2**31:
        raise parameters.error("POINT", "FRAMES", f"is {frames:g}, accepted are 0 .. {2**31}")
    if frames == 0.0 and header.last < header.first - 1:
        raise parameters.error(
            "POINT", "FRAMES", f"is 0, and the header has {header.first} .. {header.last}"
        )
    return int(frames) or header.last - header.first + 1


def _subframes(parameters: _Parameters, channels: int) -> int:
    rate = parameters.number("POINT", "RATE", 0.0, 1e6)
    analog = parameters.number("ANALOG", "RATE", 0.0, 1e9)
    subframes = int(analog / rate) if rate >= 1.0 else 1
    largest = _MOST_SUBFRAMES if channels else _BARE_SUBFRAMES
    if subframes > largest:
        raise parameters.error(
            "ANALOG", "RATE", f"is {analog:g} Hz, accepted are {largest} times POINT:RATE"
        )
    return subframes


def _check_room(
    parameters: _Parameters, group: str, name: str, frames: int, frame: int, block: int, size: int
) -> None:
    """Frames of so many bytes must be in the file from a block on."""
    room = size - (block - 1) * _BLOCK
    if block < 2 or room < 0:
        raise parameters.error(group, "DATA_START", f"is block {block}, of a file of {size} bytes")
    if frames * frame > room:
        text = f"{frames} frames of {frame} bytes are more than the {room} bytes of the file"
        raise parameters.error(group, name, f"{text}: the file is cut, or its counts are wrong")


def _check_rotations(parameters: _Parameters, frames: int, size: int) -> None:
    used = int(parameters.number("ROTATION", "USED", 0, 32767))
    block = int(parameters.number("ROTATION", "DATA_START", 0, 65535))
    ratio = int(parameters.number("ROTATION", "RATIO", 0, _BARE_SUBFRAMES))
    if parameters.get("ROTATION", "RATIO") is None:
        rate = parameters.number("ROTATION", "RATE", 0.0, 1e6)
        ratio = math.ceil(rate / max(parameters.number("POINT", "RATE", 0.0, 1e6), 1e-3))
    if ratio > _BARE_SUBFRAMES:
        raise parameters.error(
            "ROTATION", "RATE", f"is more than {_BARE_SUBFRAMES} times POINT:RATE"
        )
    if used * ratio > 0:
        frame = used * ratio * _TURN_BYTES
        _check_room(parameters, "ROTATION", "USED", frames, frame, block, size)


def _check_plates(parameters: _Parameters) -> None:
    """Plates need channels, and as many numbers of each kind as the library takes."""
    group = "FORCE_PLATFORM"
    plates = int(parameters.number(group, "USED", 0, 32767))
    channels = int(parameters.number("ANALOG", "USED", 0, 32767))
    if not plates:
        return
    if plates * _PLATE_CHANNELS > channels:
        raise parameters.error(
            group,
            "USED",
            f"is {plates}, of which each needs {_PLATE_CHANNELS} of {channels} channels",
        )
    for name, each in (("TYPE", 1), ("CORNERS", 12), ("ORIGIN", 3)):
        value = parameters.get(group, name)
        count = 0 if value is None else len(value.entries)
        if count < each * plates:
            raise parameters.error(group, name, f"has {count} values, expected {each} a plate")
    for name, least in (("CHANNEL", _PLATE_CHANNELS), ("CAL_MATRIX", _PLATE_CHANNELS)):
        value = parameters.get(group, name)
        if name == "CAL_MATRIX" and (value is None or not len(value.entries)):
            continue  # only plates of type 4 need it, and the library says so
        shape = () if value is None else value.dimensions
        if len(shape) < 2 or shape[0] < least or (name == "CAL_MATRIX" and shape[1] < least):
            raise parameters.error(
                group, name, f"has the dimensions {shape}, too few or too small"
            )
    poly = parameters.get(group, "FPCOPPOLY")
    if poly is not None and 0 < len(poly.entries) < 12 * plates:
        raise parameters.error(
            group, "FPCOPPOLY", f"has {len(poly.entries)} values, expected 12 a plate"
        )
