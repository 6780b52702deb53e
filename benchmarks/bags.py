"""Torques from bag to bag beside a copy of the bag, message by message, by rosbags.

python benchmarks/bags.py [--messages 100000] [--rate 500] [--rounds 5] [--noise even|decades]

Seven joints (arm7), zero-phase derivatives with the cut-off of each joint's own noise: the same of
all joints, or a decade more or less from joint to joint. Prints JSON: CPU seconds of the quickest
copy (to MCAP, not packed; sqlite3 to sqlite3), of the first and of the quickest `inverse` in this
process, their ratios to that copy, and messages a second.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from mbd_ros.features.inverse_dynamics.job import inverse_to
from mbd_ros.files.bags.bag_types import TYPES
from mbd_ros.files.bags.bag_writer import BagWriter, Rows
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.samples import Task
from mbd_ros.scene.reader import load_scene
from msg_adapters.joint_state_cdr import joint_state_rows

SCENE = Path(__file__).parents[1] / "config" / "scenes" / "arm7.yaml"
TOPIC, KIND = "/joint_states", "sensor_msgs/msg/JointState"
NAMES = tuple(f"joint{i}" for i in range(1, 8))
FIELDS = {
    "efforts": ("position", "velocity", "effort"),
    "no efforts": ("position", "velocity"),
    "positions alone": ("position",),
}
STORAGES = "mcap", "zstd", "sqlite3"
_BLOCK = 8192
_NOISE = {"even": np.zeros(7), "decades": np.arange(3.0, -4.0, -1.0)}  # of each joint, log10


def motion(count: int, rate: float, noise: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Stamps and fields: sines of 0.16 to 1.1 Hz, white noise of 1e-5 rad and 1e-4 rad/s."""
    rng, size = np.random.default_rng(1), 10.0 ** _NOISE[noise]
    stamps = 1_700_000_000_000_000_000 + np.round(1e9 / rate * np.arange(count)).astype(np.int64)
    stamps += rng.integers(0, int(1e8 / rate), count)
    phase, turn = (stamps - stamps[0])[:, None] * 1e-9 * np.arange(1, 8), np.arange(1, 8)
    rough = rng.normal(size=(2, count, 7)) * size
    position = 0.3 * np.sin(phase) + 1e-5 * rough[0]
    velocity = 0.3 * turn * np.cos(phase) + 1e-4 * rough[1]
    return stamps, {"position": position, "velocity": velocity, "effort": position}


def copied(bag: Path, to: Path, *, packed: bool = False, sqlite3: bool = False) -> None:
    """Copy message by message."""
    plugin = StoragePlugin.SQLITE3 if sqlite3 else StoragePlugin.MCAP
    writer = Writer(to, version=9, storage_plugin=plugin)
    if packed:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with Reader(bag) as reader, writer:
        (theirs,) = reader.connections
        own = writer.add_connection(TOPIC, KIND, typestore=TYPES)
        for _, stamp, cdr in reader.messages([theirs]):
            writer.write(own, stamp, cdr)


def recorded(folder: Path, wanted: argparse.Namespace) -> Iterator[tuple[str, str, Path]]:
    """What is carried, the storage, and the bag."""
    stamps, values = motion(wanted.messages, wanted.rate, wanted.noise)
    for carried, fields in FIELDS.items():
        plain = folder / f"{carried} mcap"
        with BagWriter(plain) as bag:
            for begin in range(0, len(stamps), _BLOCK):
                own = slice(begin, begin + _BLOCK)
                cdr = joint_state_rows(NAMES, stamps[own], {f: values[f][own] for f in fields})
                bag.write_rows([Rows(TOPIC, KIND, stamps[own], cdr)])
        for storage in STORAGES:
            path = folder / f"{carried} {storage}"
            if storage != "mcap":
                copied(plain, path, packed=storage == "zstd", sqlite3=storage == "sqlite3")
            yield carried, storage, path


def compared(
    bag: Path, folder: Path, rounds: int, *, sqlite3: bool
) -> Iterator[tuple[str, float]]:
    """Figures of a bag."""
    scene, task, times = load_scene(SCENE), Task(bag, Derivatives("zero-phase")), []
    for i in range(rounds):
        out, to = folder / f"out{i}{'.db3' if sqlite3 else ''}", folder / f"copy{i}"
        marks = [time.process_time()]
        inverse_to(scene, task, out, lambda line: None)
        marks.append(time.process_time())
        copied(bag, to, sqlite3=sqlite3)
        times.append(np.diff([*marks, time.process_time()]))
    warm, copy = np.min(times, axis=0)
    yield from {"copy": copy, "first": times[0][0], "warm": warm}.items()
    yield from {"first_ratio": times[0][0] / copy, "ratio": warm / copy}.items()


def main() -> None:
    """See the head of the file."""
    options = argparse.ArgumentParser()
    options.add_argument("--messages", type=int, default=100_000)
    options.add_argument("--rate", type=float, default=500.0)
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--noise", choices=_NOISE, default="even")
    wanted, found = options.parse_args(), []
    with tempfile.TemporaryDirectory() as bags:
        for carried, storage, bag in recorded(Path(bags), wanted):
            with tempfile.TemporaryDirectory() as folder:
                each = compared(bag, Path(folder), wanted.rounds, sqlite3=storage == "sqlite3")
                figures = {name: round(float(value), 3) for name, value in each}
            rate = round(wanted.messages / figures["warm"])
            found.append(
                {"carried": carried, "storage": storage, **figures, "messages_per_second": rate}
            )
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
