"""A function of CasADi symbols as a list of values, each computed once."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols.untraceable import Untraceable

COMMUTE = {ca.OP_ADD, ca.OP_MUL, ca.OP_FMIN, ca.OP_FMAX, ca.OP_AND, ca.OP_OR, ca.OP_EQ, ca.OP_NE}


def instructions(function: ca.Function) -> Instructions:
    """The list of values of a function.

    Args:
        function: Of scalar symbols (SX), without free ones.

    Raises:
        CodeError: It is of matrix symbols, or has free ones.
    """
    name = function.name()
    if not function.is_a("SXFunction"):
        raise CodeError(f"{name} is no function of scalar symbols (SX): expand it first")
    if function.has_free():
        raise CodeError(f"{name} has symbols that are no argument: {function.get_free()}")
    values, outputs = _numbered(function)
    sizes = (function.numel_in, function.n_in()), (function.numel_out, function.n_out())
    arguments, results = (tuple(size(k) for k in range(n)) for size, n in sizes)
    return Instructions(name, arguments, results, values, outputs)


class CodeError(Untraceable):
    """Symbols that cannot become code: names the function and the operation."""


def _numbered(function: ca.Function) -> tuple[list[Value], list[Output]]:
    """Every different value once, and what is written of them."""
    values: list[Value] = []
    known: dict[Value, int] = {}
    held: dict[int, int] = {}  # place in CasADi's work vector -> value
    outputs: list[Output] = []
    read = [function.sparsity_in(k).find() for k in range(function.n_in())]
    written = [function.sparsity_out(k).find() for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        code, into = function.instruction_id(k), function.instruction_output(k)
        places = function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            result, nonzero = into
            outputs.append(Output(result, written[result][nonzero], held[places[0]]))
            continue
        if code == ca.OP_CONST:
            value = Value(code, constant=float(function.instruction_constant(k)).hex())
        elif code == ca.OP_INPUT:
            value = Value(code, (places[0], read[places[0]][places[1]]))
        else:
            operands = tuple(held[place] for place in places)
            value = Value(code, tuple(sorted(operands)) if code in COMMUTE else operands)
        if value not in known:
            known[value] = len(values)
            values.append(value)
        held[into[0]] = known[value]
    return values, outputs


class Instructions(NamedTuple):
    """What a function computes.

    Attributes:
        name: Of the function.
        arguments: Sizes of its arguments, as dense columns.
        results: Sizes of its results.
        values: In an order in which they can be computed; none is there twice.
        outputs: What is written; other places of a result are zero.
    """

    name: str
    arguments: tuple[int, ...]
    results: tuple[int, ...]
    values: list[Value]
    outputs: list[Output]

    @property
    def operations(self) -> int:
        """How many values are computed."""
        return sum(value.computed for value in self.values)


class Value(NamedTuple):
    """One number that a function computes or reads.

    Attributes:
        code: Operation, as CasADi numbers them; a constant, an input or what computes it.
        operands: Numbers of the values that it is computed from; of an input: which argument, and
            the place in it.
        constant: Of a constant.
    """

    code: int
    operands: tuple[int, ...] = ()
    constant: str = ""

    @property
    def computed(self) -> bool:
        """Whether it is neither a constant nor an input."""
        return self.code not in (ca.OP_CONST, ca.OP_INPUT)


class Output(NamedTuple):
    """Where a value is written: which result, and the place in its columns."""

    result: int
    place: int
    value: int


def with_reciprocals(code: Instructions) -> Instructions:
    """The same values, with one division for each divisor that several values share.

    A quotient then differs by a unit in the last place.
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
