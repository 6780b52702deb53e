"""Lists of values cut into short ones: compilers take out of proportion long for long ones."""

from typing import NamedTuple

from mbd_ros.compiled.code.instructions import Instructions, Value
from mbd_ros.compiled.code.sines import Turns

WHOLE = 3000  # operations that are not cut: their compilation takes half a second at most
FEWEST, MOST = 500, 1500  # operations of a chunk


class Chunks(NamedTuple):
    """Values in the order in which they are computed, and those that wait between the chunks.

    Attributes:
        chunks: Numbers of the computed values, by chunk.
        slots: Value -> its place among those that later chunks read.
        work: How many places there are.
    """

    chunks: list[list[int]]
    slots: dict[int, int]
    work: int


def cut(code: Instructions, turns: Turns) -> Chunks:
    """Chunks between which few values wait.

    The first chunk, perhaps empty, makes the angles; sines and cosines wait from there on.

    Args:
        code: The instructions.
        turns: Its angles, and the order in which everything else is computed.
    """
    order = turns.before + turns.after
    at = {value: k for k, value in enumerate(order)}
    last = _last_reads(code.values, order, at)
    early = len(turns.before)
    chunks = [turns.before]
    chunks += [order[early + a : early + b] for a, b in _bounds([k - early for k in last[early:]])]
    number = [n for n, chunk in enumerate(chunks) for _ in chunk]
    slots, work = _slots(order, last, number)
    return Chunks(chunks, slots | turns.slots(work), work + 2 * turns.room)


def _last_reads(values: list[Value], order: list[int], at: dict[int, int]) -> list[int]:
    """Where in the order each value is read for the last time; itself if never."""
    last = list(range(len(order)))
    for k, value in enumerate(order):
        for operand in values[value].operands:
            if operand in at:
                last[at[operand]] = k
    return last


def _bounds(last: list[int]) -> list[tuple[int, int]]:
    """First and end of each chunk, where fewest values wait."""
    ends = [0] * (len(last) + 1)
    for k in last:
        ends[k] += 1
    waiting, now = [], 0  # before each place in the order: values that are read at it or later
    for k in range(len(last)):
        waiting.append(now)
        now += 1 - ends[k]
    begins = [0]
    while len(last) - begins[-1] > (MOST if len(last) > WHOLE else WHOLE):
        window = range(begins[-1] + FEWEST, begins[-1] + MOST + 1)
        begins.append(min(window, key=lambda k: waiting[k]))
    return list(zip(begins, [*begins[1:], len(last)], strict=True))


def _slots(order: list[int], last: list[int], number: list[int]) -> tuple[dict[int, int], int]:
    """A place for every value that a later chunk reads, used again when it was read last."""
    slots: dict[int, int] = {}
    free: list[int] = []
    leaves: dict[int, list[int]] = {}  # chunk -> places that are free after it
    work, chunk = 0, number[0] if number else 0
    for k, value in enumerate(order):
        if number[k] != chunk:
            free += leaves.pop(chunk, [])
            chunk = number[k]
        if number[last[k]] > chunk:
            if not free:
                free.append(work)
                work += 1
            slots[value] = free.pop()
            leaves.setdefault(number[last[k]], []).append(slots[value])
    return slots, work
