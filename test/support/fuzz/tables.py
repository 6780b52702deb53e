"""Motions and loads in tables: sound ones, and what becomes of them."""

import gzip
import random

from fuzz.values import WORDS, number, spoil_bytes

FIELDS = ("position", "velocity", "acceleration", "effort")


def table(rng: random.Random, joints: tuple[str, ...], rows: int = 6) -> bytes:
    """A motion that the reader takes."""
    columns = [f"{joint}.{field}" for joint in joints for field in FIELDS]
    lines = [",".join(("time", *columns))]
    for k in range(rows):
        cells = (repr(round(rng.uniform(-1, 1), 3)) for _ in columns)
        lines.append(",".join((repr(round(0.01 * k, 3)), *cells)))
    return ("\n".join(lines) + "\n").encode()


def mutated(rng: random.Random, joints: tuple[str, ...]) -> tuple[str, bytes]:
    """Name and bytes of a motion with some faults."""
    data = table(rng, joints, rng.choice((1, 2, 6, 20)))
    for _ in range(rng.randint(0, 2)):
        data = rng.choice((_cell, _cell, _cell, _header, spoil_bytes, _strange))(rng, data)
    if rng.random() < 0.85:
        return "m.csv", data
    packed = gzip.compress(data, 1, mtime=0)
    return "m.csv.gz", spoil_bytes(rng, packed) if rng.random() < 0.5 else packed


def _cell(rng: random.Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    line = rng.randrange(len(lines))
    cells = lines[line].split(b",")
    word = number(rng) if rng.random() < 0.7 else rng.choice(WORDS)
    cells[rng.randrange(len(cells))] = word.encode("utf-8", "surrogatepass")
    lines[line] = b",".join(cells)
    return b"\n".join(lines)


def _header(rng: random.Random, data: bytes) -> bytes:
    head, _, rest = data.partition(b"\n")
    names = head.split(b",")
    k = rng.randrange(len(names))
    draw = rng.random()
    if draw < 0.3:
        names[k] = rng.choice(names)
    elif draw < 0.6:
        names[k] = rng.choice(WORDS).encode("utf-8", "surrogatepass")
    else:
        rng.shuffle(names)
    return b",".join(names) + b"\n" + rest


def _strange(rng: random.Random, data: bytes) -> bytes:
    return rng.choice(
        (
            b"",
            b"\n",
            b"time\n0\n",
            data.replace(b"\n", b"\r\n"),
            data.replace(b"\n", b"\r"),
            b"\xef\xbb\xbf" + data,
            data.decode(errors="replace").encode("utf-16"),
            data + b"\n\n",
            data.replace(b",", b";"),
            data.replace(b".", b","),
            b"time," + b",".join(b"c%d" % i for i in range(5000)) + b"\n" + data,
            b"\x1b[2J" * 100 + data,
            b"\x1f\x8b" + data,
        )
    )
