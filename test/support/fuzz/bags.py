"""Recordings of ROS: other messages in sound bags, and other bytes."""

import random
import struct
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzz.values import NUMBERS, anything, near, spoil_bytes

from mbd_ros.files.bags.bag_reader import raw_messages
from mbd_ros.files.bags.bag_writer import BagWriter

TOPICS = ("/joint_states", "/tf", "", "x" * 300, "/\x1b[2J")
TYPES = ("sensor_msgs/msg/JointState", "std_msgs/msg/String", "geometry_msgs/msg/WrenchStamped")


def bag(rng: random.Random, name: str, files: dict[str, bytes], mild: bool) -> dict[str, bytes]:
    """The files of a bag of this name, changed."""
    if mild or rng.random() < 0.5:
        return _rewritten(rng, name, files, mild)
    changed = dict(files)
    for _ in range(rng.randint(1, 3)):
        file = rng.choice(tuple(changed))
        is_text = file.endswith(".yaml") and rng.random() < 0.5
        changed[file] = (_metadata if is_text else spoil_bytes)(rng, changed[file])
    return changed


def _rewritten(
    rng: random.Random, name: str, files: dict[str, bytes], mild: bool
) -> dict[str, bytes]:
    """The same bag with one message changed, sums and counts right."""
    with TemporaryDirectory() as folder:
        place, new = Path(folder) / "old" / name, Path(folder) / "new" / name
        for file, data in files.items():
            (Path(folder) / "old" / file).parent.mkdir(exist_ok=True, parents=True)
            (Path(folder) / "old" / file).write_bytes(data)
        new.parent.mkdir()
        messages = [list(message) for message in raw_messages(place)]
        k = rng.randrange(len(messages))
        topic, kind, time, cdr = messages[k]
        draw = rng.random()
        if mild:
            cdr = _number(rng, cdr, mild)
        elif draw < 0.5:
            cdr = rng.choice((_number(rng, cdr, mild), spoil_bytes(rng, cdr), _count(rng, cdr)))
        elif draw < 0.7:
            time = rng.choice((0, 1, time, 2**62, 2**63 - 1))
        elif draw < 0.85:
            kind = rng.choice(TYPES)
            messages = [[t, kind if t == topic else other, *rest] for t, other, *rest in messages]
        else:
            messages += [[topic, kind, time, cdr]] * rng.choice((1, 3))
        messages[k] = [topic, kind, time, cdr]
        with BagWriter(new) as writer:
            for message in messages:
                writer.write(*message[:3], bytes(message[3]))
        every = [new] if new.is_file() else sorted(new.iterdir())
        return {str(file.relative_to(new.parent)): file.read_bytes() for file in every}


def _number(rng: random.Random, cdr: bytes, mild: bool) -> bytes:
    """One of the numbers at the end of a message."""
    at = len(cdr) - 8 * rng.randint(1, 4)
    if at < 0:
        return cdr
    (value,) = struct.unpack_from("<d", cdr, at)
    poison = float(rng.choice((*NUMBERS, "nan", "inf")))
    return cdr[:at] + struct.pack("<d", near(rng, value) if mild else poison) + cdr[at + 8 :]


def _count(rng: random.Random, cdr: bytes) -> bytes:
    """A length of a text or list inside a message."""
    at = 4 * rng.randrange(1, len(cdr) // 4)
    value = rng.choice((0, 1, 3, 2**16, 2**31, 2**32 - 1))
    return cdr[:at] + value.to_bytes(4, "little") + cdr[at + 4 :]


def _metadata(rng: random.Random, data: bytes) -> bytes:
    every = data.decode(errors="replace").split("\n")
    k = rng.randrange(len(every))
    head, colon, _ = every[k].partition(":")
    every[k] = f"{head}{colon} {anything(rng)}"
    return "\n".join(every).encode("utf-8", "surrogatepass")
