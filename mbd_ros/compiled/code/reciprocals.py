"""Divisions by the same number as products with its reciprocal: a division costs ten products."""

from collections import Counter

import casadi as ca

from mbd_ros.compiled.code.instructions import Instructions, Value


def with_reciprocals(code: Instructions) -> Instructions:
    """The same values, with one division for each divisor that several values share.

    A quotient then differs by a unit in the last place.

    Args:
        code: Instructions of a function.
    """
    divisors = Counter(_divisor(value) for value in code.values)
    shared = {number for number, n in divisors.items() if n > 1 and number is not None}
    values: list[Value] = []
    known: dict[Value, int] = {}
    now: list[int] = []  # old number -> new number

    def number(value: Value) -> int:
        if value not in known:
            known[value] = len(values)
            values.append(value)
        return known[value]

    for value in code.values:
        operands = tuple(now[k] for k in value.operands) if value.computed else value.operands
        new = value._replace(operands=operands)
        if value.code == ca.OP_DIV and value.operands[1] in shared:
            reciprocal = number(Value(ca.OP_INV, (operands[1],)))
            new = Value(ca.OP_MUL, tuple(sorted((operands[0], reciprocal))))
        now.append(number(new))
    outputs = [output._replace(value=now[output.value]) for output in code.outputs]
    return code._replace(values=values, outputs=outputs)


def _divisor(value: Value) -> int | None:
    if value.code == ca.OP_DIV:
        return value.operands[1]
    return value.operands[0] if value.code == ca.OP_INV else None
