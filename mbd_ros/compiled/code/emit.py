"""Functions of CasADi symbols as C source."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Literal

import casadi as ca

from mbd_ros.compiled.code.c_function import c_function
from mbd_ros.compiled.code.instructions import CodeError, Instructions, Value, instructions
from mbd_ros.compiled.code.source import Signature, Source

# Divisions by the same number as products with its reciprocal: a division costs ten products.


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


HERE = Path(__file__).parent
EXPORT = '#define EXPORT __attribute__((visibility("default")))\n'
ALONE = 4000  # operations beyond which a function has units of its own, and those of a unit
AS_IN_PYTHON = ("expand",)  # each operation is rounded: states of all joints have the same bits
MOST = 100_000  # operations that are compiled: more take minutes and do not fit into caches


def emit(functions: Sequence[ca.Function], real: Literal["double"] | int = "double") -> Source:
    """C source in which each function is split into short ones.

    Args:
        functions: Of scalar symbols, with different names.
        real: What a real is: a double, or a vector of that many lanes.

    Raises:
        CodeError: A function has symbols or operations that C cannot have, or all of them are too
            long.
    """
    files = (
        "double.h" if real == "double" else "lanes.h",
        "elementary.h",
        "sines.h",
        "exponentials.h",
    )
    lanes = 1 if real == "double" else real
    texts = [(HERE / name).read_text(encoding="utf-8") for name in files]
    head = "".join([EXPORT, f"#define LANES {lanes}\n", *texts])
    pieces, units = [head], []
    operations, signatures = {}, {}
    _refuse_long(functions)
    for function in functions:
        code = with_reciprocals(instructions(function))
        written = c_function(code)
        if code.name in AS_IN_PYTHON:
            written = written._replace(chunks=[_uncontracted(chunk) for chunk in written.chunks])
        pieces.append(f"\n#define {code.name}_WORK {written.work}\n")
        if code.operations <= ALONE:
            pieces += [f"static __attribute__((noinline)) {chunk}" for chunk in written.chunks]
        else:
            pieces += written.declarations
            parts = _parted(written.chunks, -(-code.operations // ALONE))
            units += [head + "".join(chunks) for chunks in parts]
        pieces.append(written.calls)
        operations[code.name] = code.operations
        signatures[code.name] = Signature(code.arguments, code.results, written.work)
    return Source("".join(pieces), tuple(units), lanes, operations, signatures)


def _refuse_long(functions: Sequence[ca.Function]) -> None:
    """Refuse code that no compiler ends with in useful time.

    Raises:
        CodeError: Says how long it is.
    """
    count = sum(function.n_nodes() for function in functions if function.is_a("SXFunction"))
    if count > MOST:
        raise CodeError(f"the equations are {count} operations; at most {MOST} are compiled")


def _uncontracted(chunk: str) -> str:
    """A function without fused multiplications: gcc knows the attribute, clang the pragma."""
    return f'__attribute__((optimize("fp-contract=off"))) {chunk}'.replace(
        "{\n", "{\n#ifdef __clang__\n#pragma STDC FP_CONTRACT OFF\n#endif\n", 1
    )


def _parted(chunks: list[str], count: int) -> list[list[str]]:
    """Chunks in a number of parts of about the same length."""
    ends = [round(len(chunks) * k / count) for k in range(count + 1)]
    return [chunks[a:b] for a, b in pairwise(ends) if a < b]
