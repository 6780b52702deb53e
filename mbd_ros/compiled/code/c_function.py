"""One function as C: short functions that run one after the other."""

from collections.abc import Iterator
from typing import NamedTuple

from mbd_ros.compiled.code.chunks import Chunks, cut
from mbd_ros.compiled.code.instructions import Instructions, Value
from mbd_ros.compiled.code.operations import expression
from mbd_ros.compiled.code.sines import Turns, turns

_NAMED = {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}


class CFunction(NamedTuple):
    """The pieces of a function in C.

    Attributes:
        chunks: Short functions, without what comes before `void`.
        declarations: The same without bodies.
        calls: The function that calls them, and the one from outside.
        work: How many reals wait between them at most.
    """

    chunks: list[str]
    declarations: list[str]
    calls: str
    work: int


def c_function(code: Instructions) -> CFunction:
    """A function as C.

    Args:
        code: Its instructions.

    Raises:
        CodeError: C has no form of an operation.
    """
    early = turns(code)
    cuts = cut(code, early)
    words = [f"const real *restrict i{k}" for k in range(len(code.arguments))]
    words += [f"real *restrict o{k}" for k in range(len(code.results))]
    pointers = ", ".join([*words, "real *restrict work"])
    used = [k for k, chunk in enumerate(cuts.chunks) if chunk or (k == 0 and early.angles)]
    heads = [f"void {code.name}_{k}({pointers})" for k in used]
    bodies = []
    for k in used:
        lines = list(_statements(code, cuts, cuts.chunks[k]))
        if k == 0:
            lines += _sines(code.values, early, cuts.work - 2 * early.room)
        bodies.append("".join(lines))
    chunks = [f"{head} {{\n{body}}}\n" for head, body in zip(heads, bodies, strict=True)]
    names = [word.split("restrict ")[1] for word in words]
    calls = [f"  {code.name}_{k}({', '.join([*names, 'work'])});\n" for k in used]
    body = "".join([*calls, *_plain_outputs(code, cuts)])
    at = ", ".join(f"at[{k}]" for k in range(len(words) + 1))
    whole = f"static void {code.name}({pointers}) {{\n{body}}}\n"
    whole += f"EXPORT void call_{code.name}(void *const *at) {{ {code.name}({at}); }}\n"
    return CFunction(chunks, [f"{head};\n" for head in heads], whole, cuts.work)


def _statements(code: Instructions, cuts: Chunks, chunk: list[int]) -> Iterator[str]:
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
                yield f"  const real t{operand} = work[{cuts.slots[operand]}];\n"
        operands = [_name(code.values, operand) for operand in value.operands]
        yield f"  const real t{number} = {expression(value, operands, code.name)};\n"
        here.add(number)
        yield from (f"  {place} = t{number};\n" for place in written.get(number, ()))
        if number in cuts.slots:
            yield f"  work[{cuts.slots[number]}] = t{number};\n"


def _sines(values: list[Value], early: Turns, first: int) -> Iterator[str]:
    """Sines and cosines of all angles, into the work from a place on."""
    if early.angles:
        angles = ", ".join(_name(values, angle) for angle in early.angles)
        yield f"  const real angles[{early.room}] = {{{angles}}};\n"
        arrays = f"angles, work + {first}, work + {first + early.room}"
        yield f"  sines_of({len(early.angles)}, {arrays});\n"


def _plain_outputs(code: Instructions, cuts: Chunks) -> Iterator[str]:
    """Results that no chunk writes: inputs, constants, sines, and those that are zero."""
    chunked = {number for chunk in cuts.chunks for number in chunk}
    seen: list[set[int]] = [set() for _ in code.results]
    for result, place, number in code.outputs:
        seen[result].add(place)
        if number not in chunked:
            slot = cuts.slots.get(number)
            name = _name(code.values, number) if slot is None else f"work[{slot}]"
            yield f"  o{result}[{place}] = {name};\n"
    for result, size in enumerate(code.results):
        zeros = sorted({*range(size)} - seen[result])
        yield from (f"  o{result}[{first}] = R(0.0);\n" for first in zeros)


def _name(values: list[Value], number: int) -> str:
    """What stands for a value in C."""
    value = values[number]
    if value.constant:
        return f"R({_NAMED.get(value.constant, value.constant)})"
    if not value.computed:
        return "i{}[{}]".format(*value.operands)
    return f"t{number}"
