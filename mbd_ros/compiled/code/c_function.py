"""A function as C: short functions that run one after the other.

Compilers take out of proportion long for long functions, so that lists of values are cut into
short ones. Sines and cosines of angles that are known early are computed first, many at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols.untraceable import Untraceable

COMMUTE = {ca.OP_ADD, ca.OP_MUL, ca.OP_FMIN, ca.OP_FMAX, ca.OP_AND, ca.OP_OR, ca.OP_EQ, ca.OP_NE}
ROOM = 2  # values are passed in a multiple of these: SINES_ROOM of sines.h
_PLAIN = {
    *(ca.OP_CONST, ca.OP_INPUT, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG),
    *(ca.OP_SQ, ca.OP_TWICE, ca.OP_INV),
}
WHOLE = 3000  # operations that are not cut: their compilation takes half a second at most
FEWEST, MOST = 500, 1500  # operations of a chunk
_FORMS = {  # what operations of CasADi are in C, for numbers and for vectors of them
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "R(1.0) / {0}",
    ca.OP_ASSIGN: "{0}",
    ca.OP_LIFT: "{0}",
}
_CALLS = {  # of functions that the headers define
    ca.OP_ACOS: "acos",
    ca.OP_ACOSH: "acosh",
    ca.OP_AND: "and",
    ca.OP_ASIN: "asin",
    ca.OP_ASINH: "asinh",
    ca.OP_ATAN: "atan",
    ca.OP_ATAN2: "atan2",
    ca.OP_ATANH: "atanh",
    ca.OP_CEIL: "ceil",
    ca.OP_CONSTPOW: "pow",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_COS: "cos",
    ca.OP_COSH: "cosh",
    ca.OP_EQ: "equal",
    ca.OP_ERF: "erf",
    ca.OP_EXP: "exp",
    ca.OP_EXPM1: "expm1",
    ca.OP_FABS: "fabs",
    ca.OP_FLOOR: "floor",
    ca.OP_FMAX: "fmax",
    ca.OP_FMIN: "fmin",
    ca.OP_FMOD: "fmod",
    ca.OP_HYPOT: "hypot",
    ca.OP_IF_ELSE_ZERO: "where",
    ca.OP_LE: "at_most",
    ca.OP_LOG: "log",
    ca.OP_LOG1P: "log1p",
    ca.OP_LT: "less",
    ca.OP_NE: "differs",
    ca.OP_NOT: "not",
    ca.OP_OR: "or",
    ca.OP_POW: "pow",
    ca.OP_REMAINDER: "remainder",
    ca.OP_SIGN: "sign",
    ca.OP_SIN: "sin",
    ca.OP_SINH: "sinh",
    ca.OP_SQRT: "sqrt",
    ca.OP_TAN: "tan",
    ca.OP_TANH: "tanh",
}
_NAMED = {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}


def c_function(code: Instructions) -> CFunction:
    """A function as C.

    Raises:
        CodeError: C has no form of an operation.
    """
    early = turns(code)
    cuts = cut(code, early)
    parameters = [f"const real *restrict i{k}" for k in range(len(code.arguments))]
    parameters += [f"real *restrict o{k}" for k in range(len(code.results))]
    pointers = ", ".join([*parameters, "real *restrict work"])
    used = [k for k, chunk in enumerate(cuts.chunks) if chunk or (k == 0 and early.angles)]
    heads = [f"void {code.name}_{k}({pointers})" for k in used]
    bodies = []
    for k in used:
        lines = list(_statements(code, cuts, cuts.chunks[k]))
        if k == 0:
            lines += _sines(code.values, early, cuts.work - 2 * early.room)
        bodies.append("".join(lines))
    chunks = [f"{head} {{\n{body}}}\n" for head, body in zip(heads, bodies, strict=True)]
    names = [word.split("restrict ")[1] for word in parameters]
    calls = [f"  {code.name}_{k}({', '.join([*names, 'work'])});\n" for k in used]
    body = "".join([*calls, *_plain_outputs(code, cuts)])
    at = ", ".join(f"at[{k}]" for k in range(len(parameters) + 1))
    whole = f"static void {code.name}({pointers}) {{\n{body}}}\n"
    whole += f"EXPORT void call_{code.name}(void *const *at) {{ {code.name}({at}); }}\n"
    return CFunction(chunks, [f"{head};\n" for head in heads], whole, cuts.work)


def turns(code: Instructions) -> Turns:
    """The angles that are made of inputs by arithmetic alone."""
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


def _made_of(values: list[Value], ends: list[int]) -> list[int]:
    """Computed values that others are made of, themselves among them, in order."""
    needed: set[int] = set()
    waiting = list(ends)
    while waiting:
        number = waiting.pop()
        if number not in needed and values[number].computed:
            needed.add(number)
            waiting += values[number].operands
    return sorted(needed)


def cut(code: Instructions, turns: Turns) -> Chunks:
    """Chunks between which few values wait.

    The first chunk, perhaps empty, makes the angles; sines and cosines wait from there on.

    Args:
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


def _name(values: list[Value], number: int) -> str:
    """Return the C expression of a value."""
    value = values[number]
    if value.constant:
        return f"R({_NAMED.get(value.constant, value.constant)})"
    if not value.computed:
        return "i{}[{}]".format(*value.operands)
    return f"t{number}"


def expression(value: Value, operands: list[str], function: str) -> str:
    """The C expression of a computed value.

    Args:
        operands: What stands for those that it is computed from.
        function: Whose value it is, for the error.

    Raises:
        CodeError: C has no such operation.
    """
    form = _FORMS.get(value.code)
    if form is not None:
        return form.format(*operands)
    call = _CALLS.get(value.code)
    if call is None:
        raise CodeError(f"{function} has an operation without a form in C: CasADi's {value.code}")
    return f"real_{call}({', '.join(operands)})"


class CodeError(Untraceable):
    """Symbols that cannot become code: names the function and the operation."""


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


def _numbered(function: ca.Function) -> tuple[list[Value], list[Output]]:
    """Every different value once, and what is written of them."""
    values: list[Value] = []
    known: dict[Value, int] = {}
    value_at: dict[int, int] = {}  # place in CasADi's work vector -> value
    outputs: list[Output] = []
    read = [function.sparsity_in(k).find() for k in range(function.n_in())]
    written = [function.sparsity_out(k).find() for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        code, into = function.instruction_id(k), function.instruction_output(k)
        places = function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            result, nonzero = into
            outputs.append(Output(result, written[result][nonzero], value_at[places[0]]))
            continue
        if code == ca.OP_CONST:
            value = Value(code, constant=float(function.instruction_constant(k)).hex())
        elif code == ca.OP_INPUT:
            value = Value(code, (places[0], read[places[0]][places[1]]))
        else:
            operands = tuple(value_at[place] for place in places)
            value = Value(code, tuple(sorted(operands)) if code in COMMUTE else operands)
        if value not in known:
            known[value] = len(values)
            values.append(value)
        value_at[into[0]] = known[value]
    return values, outputs


class Output(NamedTuple):
    """Where a value is written: which result, and the place in its columns."""

    result: int
    place: int
    value: int


class Instructions(NamedTuple):
    """Values that a function computes.

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
