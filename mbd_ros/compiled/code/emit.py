"""Functions of CasADi symbols as C source, with the search of paths that wrap before them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, Literal

import casadi as ca

from mbd_ros.compiled.code.c_function import CodeError, c_function, instructions, with_reciprocals
from mbd_ros.compiled.code.source import Signature, Source
from mbd_ros.compiled.symbols.path_tables import NATIVE, c_row, row_of, search_text
from mbd_ros.compiled.symbols.searched_paths import SearchedPaths
from mbd_ros.compiled.symbols.trace import ARGUMENTS, Traced

HERE = Path(__file__).parent
EXPORT = '#define EXPORT __attribute__((visibility("default")))\n'
ALONE = 4000  # operations beyond which a function has units of its own, and those of a unit
AS_IN_PYTHON = ("expand",)  # each operation is rounded: states of all joints have the same bits
MOST = 100_000  # operations that are compiled: more take minutes and do not fit into caches
SEARCH = "search_paths"  # from t, q and p to what is searched
_WORK = "work"


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


def emitted(traced: Traced, names: Sequence[str]) -> Source:
    """Return the C source of functions, including the search of wrapping paths if there are any.

    Args:
        traced: Symbolic form of a system.
        names: Names of the functions.

    Raises:
        CodeError: A function cannot be written in C, see `emit`.
    """
    functions = [traced.function(name) for name in names]
    if not traced.searched:
        return emit(functions)
    places = traced.function("path_places")
    asking = [function for function in functions if _needs_paths(function)]
    inner = [_inner(function) if _needs_paths(function) else function for function in functions]
    source = emit([*inner, places])
    return _searching(source, asking, traced.searched)


def _needs_paths(function: Any) -> bool:
    """Return whether a function takes searched paths as an argument."""
    return bool(function.n_in() > len(ARGUMENTS[function.name()]))


def _inner(function: Any) -> Any:
    """The same by another name."""
    symbols = function.sx_in()
    return ca.Function(f"{function.name()}_of_paths", symbols, function.call(symbols))


def _searching(source: Source, asking: Sequence[Any], searched: SearchedPaths) -> Source:
    """The source with the search, and functions that search first by their usual names."""
    signatures, operations = dict(source.signatures), dict(source.operations)
    texts = [source.text, _tables(searched)]
    places = signatures["path_places"]
    for function in asking:
        name = function.name()
        inner = signatures.pop(f"{name}_of_paths")
        operations[name] = operations.pop(f"{name}_of_paths")
        work = max(inner.work, places.work)
        signatures[name] = Signature(inner.arguments[:-1], inner.results, work)
        texts.append(_calling(name, signatures[name]))
    signatures[SEARCH] = Signature(places.arguments, (searched.symbols.numel(),), places.work)
    return source._replace(text="".join(texts), signatures=signatures, operations=operations)


def _tables(searched: SearchedPaths) -> str:
    """Surfaces, ranges and paths, and the code that searches."""
    paths = [entry.path for entry in searched]
    surfaces = [c_row(row_of(wrap.surface)) for path in paths for wrap in path.wraps]
    ends = [f"{{{i}, {r.first}, {r.last}}}" for i, r in enumerate(_reaches(paths))]
    first = [0, *accumulate(len(path.wraps) for path in paths)]
    of = [
        f"{{{len(path.points)}, {len(path.wraps)}, {start}}}"
        for path, start in zip(paths, first, strict=False)
    ]
    numbers = {
        "MOST_WRAPS": max(len(path.wraps) for path in paths),
        "MOST_LINES": max(len(path.points) - 1 for path in paths),
        "WRAP_PATHS": len(paths),
        "WRAP_PLACES": searched.places.numel(),
        "WRAP_NUMBERS": searched.symbols.numel(),
    }
    lines = [f"#define {name} {value}\n" for name, value in numbers.items()]
    lines.append(search_text())
    lines.append(f"static const Surface wrap_surfaces[] = {{{', '.join(surfaces)}}};\n")
    lines.append(f"static const WrapReach wrap_reaches[] = {{{', '.join(ends)}}};\n")
    lines.append(f"static const WrapPath wrap_paths[] = {{{', '.join(of)}}};\n")
    lines.append((NATIVE / "searched_paths.h").read_text(encoding="utf-8"))
    return "".join(lines)


def _reaches(paths: Sequence[Any]) -> list[Any]:
    return [reach for path in paths for reach in path.reaches]


def _calling(name: str, signature: Signature) -> str:
    """Return a C function that searches paths and then calls the function that takes them."""
    names = [f"i{k}" for k in range(len(signature.arguments))]
    results = [f"o{k}" for k in range(len(signature.results))]
    parameters = [*(f"const real *restrict {argument}" for argument in names)]
    parameters += [f"real *restrict {result}" for result in (*results, _WORK)]
    t, q, p = (names[ARGUMENTS[name].index(letter)] for letter in ARGUMENTS["path_places"])
    lines = [
        f"\n#define {name}_WORK {signature.work}\n",
        f"static void {name}({', '.join(parameters)}) {{\n  real paths[WRAP_NUMBERS];\n",
        f"  search_paths({t}, {q}, {p}, paths, work);\n",
        f"  {name}_of_paths({', '.join([*names, 'paths', *results, _WORK])});\n",
    ]
    if name == "accelerate":  # without a path, the plain tier takes over
        lines.append("  if (!are_found(paths)) o2[0] = -1.0;\n")
    at = ", ".join(f"at[{k}]" for k in range(len(parameters)))
    lines.append(f"}}\nEXPORT void call_{name}(void *const *at) {{ {name}({at}); }}\n")
    return "".join(lines)
