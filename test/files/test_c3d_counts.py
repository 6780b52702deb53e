"""A .c3d whose counts do not fit its size is refused before a library reads it."""

import struct
import subprocess
import sys

import numpy as np
import pytest
from c3d_recordings import recording
from places import ROOT

from mbd_ros.errors import DataError
from mbd_ros.files.table import read_result

FORCE = np.full((8, 3), 10.0)


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """Small recordings: markers alone, and plates of all types that are read."""
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is optional (extra: biomechanics)")
    path, found = tmp_path_factory.mktemp("seeds") / "seed.c3d", []
    for kind in (0, 1, 2, 3, 4):
        recording(ezc3d, path, [(FORCE, FORCE)] * 2 if kind else (), kind)
        found.append(path.read_bytes())
    return found


def parameter(data, group, name):
    """Place of the type of a parameter: type, number of dimensions, dimensions, values."""
    at = data.index(group.encode(), 512) if group else 512
    return data.index(name.encode(), at) + len(name) + 2


def with_bytes(data, group, name, after, new):
    """The file with other bytes some places behind the type of a parameter."""
    at = parameter(data, group, name) + after
    return data[:at] + new + data[at + len(new) :]


def header(data, at, *words):
    return data[:at] + struct.pack(f"<{len(words)}H", *words) + data[at + 2 * len(words) :]


BOMBS = {  # kind of plate, what is changed, what the message names
    "frames that end before they begin": (
        0,
        lambda d: header(
            with_bytes(with_bytes(d, "POINT", "FRAMES", 2, b"\0\0"), "POINT", "USED", 2, b"\0\0"),
            6,
            100,
            3,
        ),
        "POINT:FRAMES is 0, and the header has 100 .. 3",
    ),
    "frames": (
        0,
        lambda d: with_bytes(d, "POINT", "FRAMES", 2, b"\xff\xff"),
        "POINT:FRAMES 65535",
    ),
    "points": (
        0,
        lambda d: with_bytes(d, "POINT", "USED", 2, b"\xff\x7f"),
        "POINT:FRAMES 4 frames",
    ),
    "negative points": (0, lambda d: with_bytes(d, "POINT", "USED", 2, b"\xff\xff"), "USED is -1"),
    "channels": (2, lambda d: with_bytes(d, "ANALOG", "USED", 2, b"\xff\x7f"), "of the file"),
    "rate": (
        2,
        lambda d: with_bytes(d, "ANALOG", "RATE", 2, struct.pack("<f", 1e8)),
        "ANALOG:RATE is 1e+08 Hz, accepted are 1000 times POINT:RATE",
    ),
    "no rate": (
        2,
        lambda d: with_bytes(d, "ANALOG", "RATE", 2, struct.pack("<f", np.nan)),
        "ANALOG:RATE is nan",
    ),
    "start of the samples": (0, lambda d: header(d, 16, 0), "is block 0"),
    "start behind the end": (0, lambda d: header(d, 16, 9000), "is block 9000"),
    "dimensions": (
        2,
        lambda d: with_bytes(d, "FORCE_PLATFORM", "CORNERS", 1, b"\3\xff\xff\xff"),
        "CORNERS has 255 x 255 x 255 values, more than the file",
    ),
    "scales": (2, lambda d: with_bytes(d, "ANALOG", "USED", 2, b"\x0d\0"), "SCALE has 12 values"),
    "plates": (
        2,
        lambda d: with_bytes(d, "FORCE_PLATFORM", "USED", 2, b"\xff\x00"),
        "USED is 255",
    ),
    "one plate too many": (
        2,
        lambda d: with_bytes(d, "FORCE_PLATFORM", "USED", 2, b"\3\0"),
        "USED is 3, of which each needs 6 of 12 channels",
    ),
    "description": (0, lambda d: with_bytes(d, "POINT", "USED", 4, b"\xf0"), "USED"),
    "processor": (0, lambda d: d[:515] + b"\x56" + d[516:], "processor type 86, accepted: 84"),
    "cut": (0, lambda d: d[:1600], "POINT:FRAMES 4 frames of 32 bytes are more than the 64 bytes"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_counts_that_the_file_cannot_hold_are_named(tmp_path, seeds, name):
    kind, change, words = BOMBS[name]
    path, data = tmp_path / "bomb.c3d", change(seeds[kind])
    assert data != seeds[kind]
    path.write_bytes(data)
    with pytest.raises(DataError, match="bomb.c3d") as caught:
        read_result(path)
    assert words in str(caught.value)


FLIPS = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (2_500_000_000,) * 2)
sys.path.insert(0, {support!r})
from pathlib import Path
from c3d_recordings import flipped
from mbd_ros.errors import DataError
from mbd_ros.files.table import read_result
path, seeds = Path(sys.argv[1]), [Path(name).read_bytes() for name in sys.argv[3:]]
accepted = 0
for number in range(int(sys.argv[2])):
    path.write_bytes(flipped(seeds, number))
    print(number, flush=True)
    try:
        read_result(path)
        accepted += 1
    except DataError as error:
        assert str(path) in str(error)
print("accepted", accepted)
"""


def assert_survives(tmp_path, seeds, count):
    names = [tmp_path / f"{i}.seed" for i in range(len(seeds))]
    for name, seed in zip(names, seeds, strict=True):
        name.write_bytes(seed)
    program = FLIPS.format(support=str(ROOT / "test/support"))
    command = [sys.executable, "-c", program, tmp_path / "flipped.c3d", str(count), *names]
    ended = subprocess.run(command, capture_output=True, text=True)
    said = ended.stdout.splitlines()
    assert ended.returncode == 0, f"file {said[-1]}: {ended.stderr[-500:]}"
    assert int(said[-1].split()[1]) > 0.1 * count


def test_flipped_bytes_end_in_no_signal_and_take_no_memory(tmp_path, seeds):
    assert_survives(tmp_path, seeds, 120)


@pytest.mark.soak
def test_many_flipped_bytes_end_in_no_signal(tmp_path, seeds):
    assert_survives(tmp_path, seeds, 20_000)
