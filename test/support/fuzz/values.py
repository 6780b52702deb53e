"""Values that break things."""

import random
from typing import Any

NUMBERS = (
    *(0, -0.0, 1, -1, 2, 0.5, -0.3, 3.2, 90, 1e-3, 1e-9, 1e-15, 1e-160, 1e-300, 5e-324),
    *(
        1e3,
        1e6,
        1e9,
        1e15,
        1e20,
        1e29,
        -9e29,
        1e-29,
        1e100,
        1e154,
        1e155,
        1e200,
        1e300,
        -1e300,
        1.7976931348623157e308,
    ),
    *(-1e6, -1e9, -1e155, 2**31, 2**53, 2**63 - 1, 2**63, -(2**63), 10**18, 10**30),
)
WORDS = (
    *("", "nan", ".nan", "inf", "-.inf", "1e999", "1_000", "0x10", "true", "null", "~", "é", "١"),
    *("\x1b[2J\x1b[31mred", "a\x00b", "a\nb: c", "a\rb", "\u202eabc", "\ud7ff", "\ufeff", "\x7f"),
    *(
        "x" * 300,
        "y" * 5000,
        "..",
        "/",
        "/dev/null",
        "../outside",
        "all",
        "universe",
        "world",
        "*a",
        "&a b",
    ),
    *("!!python/object/apply:os.system [ls]", "os:system", "{", "[", "'", '"', "%s", "{0}", ","),
)


def number(rng: random.Random) -> str:
    """A number as text, mostly an ordinary one."""
    return repr(rng.choice(NUMBERS) if rng.random() < 0.7 else round(rng.uniform(-2, 2), 3))


def near(rng: random.Random, value: float) -> float:
    """A number that is as good as another."""
    return value * rng.uniform(0.99, 1.01)


def anything(rng: random.Random) -> Any:
    """A value of any type."""
    draw = rng.random()
    if draw < 0.55:
        return rng.choice(NUMBERS)
    if draw < 0.8:
        return rng.choice(WORDS)
    return rng.choice((None, True, False, [], {}, [[]], [0], [1e300] * 3, {"a": 1}, [None], [[0]]))


def spoil_text(rng: random.Random, text: str) -> str:
    """A few characters cut, repeated or put in."""
    if not text:
        return text
    at = rng.randrange(len(text))
    draw = rng.random()
    if draw < 0.3:
        return text[:at]
    if draw < 0.6:
        return text[:at] + text[at + rng.randint(1, 20) :]
    if draw < 0.8:
        piece = text[at : at + rng.randint(1, 40)]
        return text[:at] + piece + text[at:]
    return text[:at] + rng.choice(WORDS) + text[at:]


def spoil_bytes(rng: random.Random, data: bytes) -> bytes:
    """Cut, flipped, repeated or strange bytes."""
    if not data:
        return data
    at, draw = rng.randrange(len(data)), rng.random()
    if draw < 0.25:
        return data[:at]
    if draw < 0.7:
        flipped = bytearray(data)
        for _ in range(rng.choice((1, 1, 2, 8))):
            flipped[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(flipped)
    if draw < 0.85:
        return data[:at] + data[at + rng.randint(1, 64) :]
    return (
        data[:at] + rng.choice((b"\x00", b"\xff\xfe", b"\x1b[2J", data[at : at + 64])) + data[at:]
    )
