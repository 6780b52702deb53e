"""Recordings: sound ones written by this package, and what becomes of their bytes."""

import random
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from fuzz.values import anything, spoil_bytes

from mbd_ros.files.table import Column, Result, Table

JOINTS = ("j1", "j2")


@cache
def recording(suffix: str) -> dict[str, bytes]:
    """Files of a sound bag by name; `suffix` .mcap, .db3 or empty for a folder."""
    motion, time = np.linspace(-1.0, 1.0, 8), np.arange(1, 9) * 0.01
    fields = ("position", "velocity", "acceleration", "effort")
    columns = [Column(f"{joint}.{field}", motion) for field in fields for joint in JOINTS]
    result = Result({"samples": Table([Column("time", time, "s"), *columns])})
    with TemporaryDirectory() as folder:
        place = Path(folder) / f"bag{suffix}"
        result.to(place)
        files = [place] if place.is_file() else sorted(place.iterdir())
        return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def mutated(rng: random.Random) -> tuple[str, dict[str, bytes]]:
    """Name of a bag, and its files."""
    suffix = rng.choice((".mcap", ".mcap", ".db3", ""))
    files = dict(recording(suffix))
    for _ in range(rng.randint(0, 3)):
        name = rng.choice(tuple(files))
        is_text = name.endswith(".yaml") and rng.random() < 0.5
        files[name] = (_metadata if is_text else spoil_bytes)(rng, files[name])
    return f"bag{suffix}", files


def _metadata(rng: random.Random, data: bytes) -> bytes:
    lines = data.decode(errors="replace").split("\n")
    k = rng.randrange(len(lines))
    head, colon, _ = lines[k].partition(":")
    lines[k] = f"{head}{colon} {anything(rng)}"
    return "\n".join(lines).encode("utf-8", "surrogatepass")
