"""Tables and other lines of numbers: motions, markers, positions, meshes as text."""

import random
import re

from fuzz.values import WORDS, near, number, spoil_bytes

FIELDS = ("position", "velocity", "acceleration", "effort")
_NUMBER = re.compile(rb"-?\d+\.(\d+)")
_BETWEEN = re.compile(rb"[,\t ]+")


def table(rng: random.Random, joints: tuple[str, ...], rows: int = 6) -> bytes:
    """A motion that the reader takes."""
    columns = [f"{joint}.{field}" for joint in joints for field in FIELDS]
    lines = [",".join(("time", *columns))]
    for k in range(rows):
        cells = (repr(round(rng.uniform(-1, 1), 3)) for _ in columns)
        lines.append(",".join((repr(round(0.01 * k, 3)), *cells)))
    return ("\n".join(lines) + "\n").encode()


def lines(rng: random.Random, data: bytes, mild: bool) -> bytes:
    """Lines with other numbers, names and order."""
    if mild:
        return _near(rng, data)
    for _ in range(rng.randint(1, 2)):
        data = rng.choice((_cell, _cell, _cell, _header, _line, spoil_bytes, _strange))(rng, data)
    return data


def _near(rng: random.Random, data: bytes) -> bytes:
    """A number a little larger or smaller, as wide as before."""
    numbers = list(_NUMBER.finditer(data))
    if not numbers:
        return data
    there = rng.choice(numbers)
    text = f"{near(rng, float(there.group())):.{len(there.group(1))}f}".encode()
    return data[: there.start()] + text.rjust(len(there.group())) + data[there.end() :]


def _cell(rng: random.Random, data: bytes) -> bytes:
    every = data.split(b"\n")
    line = rng.randrange(len(every))
    cells, gaps = _BETWEEN.split(every[line]), _BETWEEN.findall(every[line])
    word = number(rng) if rng.random() < 0.7 else rng.choice(WORDS)
    cells[rng.randrange(len(cells))] = word.encode("utf-8", "surrogatepass")
    every[line] = b"".join(c + g for c, g in zip(cells, [*gaps, b""], strict=True))
    return b"\n".join(every)


def _line(rng: random.Random, data: bytes) -> bytes:
    """A line less, twice or elsewhere."""
    every = data.split(b"\n")
    line = every.pop(rng.randrange(len(every)))
    for _ in range(rng.choice((0, 1, 2))):
        every.insert(rng.randint(0, len(every)), line)
    return b"\n".join(every)


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
