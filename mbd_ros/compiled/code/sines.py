"""Sines and cosines of angles that are known early: computed first, many at once."""

from typing import NamedTuple

import casadi as ca

from mbd_ros.compiled.code.instructions import Instructions, Value

ROOM = 2  # values are passed in a multiple of these: SINES_ROOM of sines.h
_PLAIN = {
    *(ca.OP_CONST, ca.OP_INPUT, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG),
    *(ca.OP_SQ, ca.OP_TWICE, ca.OP_INV),
}


class Turns(NamedTuple):
    """The angles of a function, and what waits for their sines and cosines.

    Attributes:
        before: Computed values that the angles are made of, in order.
        angles: Numbers of the values of which sines and cosines are taken.
        sines: Angle -> number of its sine, where there is one.
        cosines: The same of the cosines.
        after: All other computed values, in order.
    """

    before: list[int]
    angles: list[int]
    sines: dict[int, int]
    cosines: dict[int, int]
    after: list[int]

    @property
    def room(self) -> int:
        """Size of an array of the sines."""
        return -(-len(self.angles) // ROOM) * ROOM

    def slots(self, first: int) -> dict[int, int]:
        """Places of the sines, then the cosines, in two arrays that begin at a place.

        Args:
            first: Where the array of the sines begins.
        """
        places = {angle: first + k for k, angle in enumerate(self.angles)}
        slots = {number: places[angle] for angle, number in self.sines.items()}
        return slots | {n: self.room + places[angle] for angle, n in self.cosines.items()}


def turns(code: Instructions) -> Turns:
    """The angles that are made of inputs by arithmetic alone.

    Args:
        code: Instructions of a function.
    """
    plain = _plain(code.values)
    sines, cosines = (
        {
            v.operands[0]: k
            for k, v in enumerate(code.values)
            if v.code == c and plain[v.operands[0]]
        }
        for c in (ca.OP_SIN, ca.OP_COS)
    )
    angles = sorted({*sines, *cosines})
    early = _made_of(code.values, angles)
    taken = {*early, *sines.values(), *cosines.values()}
    after = [k for k, v in enumerate(code.values) if v.computed and k not in taken]
    return Turns(early, angles, sines, cosines, after)


def _plain(values: list[Value]) -> list[bool]:
    """Which values are made of inputs and constants by arithmetic."""
    plain: list[bool] = []
    for value in values:
        operands = value.operands if value.computed else ()
        plain.append(value.code in _PLAIN and all(plain[operand] for operand in operands))
    return plain


def _made_of(values: list[Value], ends: list[int]) -> list[int]:
    """Computed values that others are made of, themselves among them, in order."""
    found: set[int] = set()
    waiting = list(ends)
    while waiting:
        number = waiting.pop()
        if number not in found and values[number].computed:
            found.add(number)
            waiting += values[number].operands
    return sorted(found)
