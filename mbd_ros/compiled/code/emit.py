"""Functions of CasADi symbols as C source."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import casadi as ca

from mbd_ros.compiled.code.chunks import Chunks, cut
from mbd_ros.compiled.code.instructions import Instructions, Value, instructions
from mbd_ros.compiled.code.operations import expression
from mbd_ros.compiled.code.reciprocals import with_reciprocals
from mbd_ros.compiled.code.turns import Turns, turns

HERE = Path(__file__).parent
EXPORT = '#define EXPORT __attribute__((visibility("default")))\n'


class Signature(NamedTuple):
    """Sizes of the arguments and results of a function, in their order, as dense columns."""

    arguments: tuple[int, ...]
    results: tuple[int, ...]
    work: int


class Source(NamedTuple):
    """C source of functions.

    For each function there is `static void NAME(const real *restrict i0, .., real *restrict o0,
    .., real *restrict work)`, one pointer an argument and then a result, all of them dense
    columns; `NAME_WORK` is how many reals `work` has to hold. `call_NAME(at)` is the same, from
    outside, with an array of the pointers.

    Attributes:
        text: The source.
        lanes: How many numbers a real is.
        operations: Function -> how many values it computes.
        signatures: Function -> sizes.
    """

    text: str
    lanes: int
    operations: dict[str, int]
    signatures: dict[str, Signature]


def emit(functions: Sequence[ca.Function], real: Literal["double"] | int = "double") -> Source:
    """C source in which each function is split into short ones.

    Args:
        functions: Of scalar symbols, with different names.
        real: What a real is: a double, or a vector of that many lanes.

    Raises:
        CodeError: A function has symbols or operations that C cannot have.
    """
    head = "double.h" if real == "double" else "lanes.h"
    lanes = 1 if real == "double" else real
    pieces = [EXPORT, f"#define LANES {lanes}\n"]
    pieces += [
        (HERE / name).read_text(encoding="utf-8") for name in (head, "elementary.h", "sines.h")
    ]
    operations, signatures = {}, {}
    for function in functions:
        code = with_reciprocals(instructions(function))
        early = turns(code)
        chunks = cut(code, early)
        pieces += _function(code, early, chunks)
        operations[code.name] = code.operations
        signatures[code.name] = Signature(code.arguments, code.results, chunks.work)
    return Source("".join(pieces), lanes, operations, signatures)


def _function(code: Instructions, early: Turns, chunks: Chunks) -> Iterator[str]:
    """The static functions of the chunks, the one that calls them, and the one from outside."""
    arguments = [f"i{k}" for k in range(len(code.arguments))]
    results = [f"o{k}" for k in range(len(code.results))]
    pointers = [f"const real *restrict {name}" for name in arguments]
    pointers += [f"real *restrict {name}" for name in (*results, "work")]
    names = ", ".join((*arguments, *results, "work"))
    yield f"\n#define {code.name}_WORK {chunks.work}\n"
    used = [k for k, chunk in enumerate(chunks.chunks) if chunk or (k == 0 and early.angles)]
    for k in used:
        yield f"static __attribute__((noinline)) void {code.name}_{k}({', '.join(pointers)}) {{\n"
        yield from _statements(code, chunks, chunks.chunks[k])
        if k == 0:
            yield from _sines(code.values, early, chunks.work - 2 * early.room)
        yield "}\n"
    yield f"static void {code.name}({', '.join(pointers)}) {{\n"
    yield from (f"  {code.name}_{k}({names});\n" for k in used)
    yield from _plain_outputs(code, chunks)
    yield "}\n"
    at = ", ".join(f"at[{k}]" for k in range(len(pointers)))
    yield f"EXPORT void call_{code.name}(void *const *at) {{ {code.name}({at}); }}\n"


def _statements(code: Instructions, chunks: Chunks, chunk: list[int]) -> Iterator[str]:
    """Statements of a chunk: what waits is read before its first use, and written at once."""
    written: dict[int, list[str]] = {}
    for output in code.outputs:
        written.setdefault(output.value, []).append(f"o{output.result}[{output.place}]")
    here: set[int] = set()
    for number in chunk:
        value = code.values[number]
        for operand in value.operands:
            if code.values[operand].computed and operand not in here:
                here.add(operand)
                yield f"  const real t{operand} = work[{chunks.slots[operand]}];\n"
        operands = [_name(code.values, operand) for operand in value.operands]
        yield f"  const real t{number} = {expression(value, operands, code.name)};\n"
        here.add(number)
        yield from (f"  {place} = t{number};\n" for place in written.get(number, ()))
        if number in chunks.slots:
            yield f"  work[{chunks.slots[number]}] = t{number};\n"


def _sines(values: list[Value], early: Turns, first: int) -> Iterator[str]:
    """Sines and cosines of all angles, into the work from a place on."""
    if early.angles:
        angles = ", ".join(_name(values, angle) for angle in early.angles)
        yield f"  const real angles[{early.room}] = {{{angles}}};\n"
        arrays = f"angles, work + {first}, work + {first + early.room}"
        yield f"  sines_of({len(early.angles)}, {arrays});\n"


def _plain_outputs(code: Instructions, chunks: Chunks) -> Iterator[str]:
    """Results that no chunk writes: inputs, constants, sines, and those that are zero."""
    chunked = {number for chunk in chunks.chunks for number in chunk}
    seen: list[set[int]] = [set() for _ in code.results]
    for result, place, number in code.outputs:
        seen[result].add(place)
        if number not in chunked:
            slot = chunks.slots.get(number)
            name = _name(code.values, number) if slot is None else f"work[{slot}]"
            yield f"  o{result}[{place}] = {name};\n"
    for result, size in enumerate(code.results):
        zeros = sorted({*range(size)} - seen[result])
        yield from (f"  o{result}[{first}] = R(0.0);\n" for first in zeros)


def _name(values: list[Value], number: int) -> str:
    """What stands for a value in C."""
    value = values[number]
    if value.constant:
        return f"R({_literal(value.constant)})"
    if not value.computed:
        return "i{}[{}]".format(*value.operands)
    return f"t{number}"


def _literal(constant: str) -> str:
    """A constant in C; what is not finite has names there."""
    named = {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}
    return named.get(constant, constant)
