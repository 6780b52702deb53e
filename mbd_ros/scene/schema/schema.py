"""The signature of a function is the schema of its YAML entry.

`call` checks an entry against a signature and calls the function. The signature and its docstring
are the only home of kind, default, range, unit, choices and text of an argument: code that offers
a part to somebody else, such as a node its gains, reads them by `arguments`.
"""

import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from mbd_ros.core.ranges import ANY_NUMBER, Within, described
from mbd_ros.core.state import is_symbol
from mbd_ros.errors import ModelError, SceneError

_EXPECTED = {
    float: "a number",
    int: "an integer",
    str: "a word",
    bool: "true or false",
}
_SECTION = re.compile(r"(\w[\w ]*):")  # a line of its own, at the left
_ENTRY = re.compile(r"\*{0,2}(\w+)(?: \([^)]*\))?:\s*(.*)")  # `name: text` or `name (type): text`
_KINDS = (bool, int, float, str)
ACCEPTED = "float, int, bool, str, Literal of texts, or Gain (a float, or one a joint)"


def call(function: Callable[..., Any], entry: Any, where: str, *context: Any) -> Any:
    """Call a function or class with the keys of an entry.

    A class may have a static method `check`, which gets those of the arguments that it names and
    refuses what does not go together.

    Args:
        function: What to call; its parameters after `context` are the accepted keys, their
            annotations the accepted values.
        entry: What the YAML holds.
        where: File and key of the entry, for the messages.
        *context: First arguments, which do not come from the YAML.

    Raises:
        SceneError: Unknown or missing key, wrong value, or a value that the function itself
            refuses.
    """
    parameters = list(inspect.signature(function).parameters.values())[len(context) :]
    accepted = {parameter.name.rstrip("_"): parameter for parameter in parameters}  # `from_`
    if not isinstance(entry, dict):
        is_type = isinstance(entry, str) and "type" in accepted
        hint = f": write {{type: {entry}}}" if is_type else ""
        raise SceneError(f"{where}: expected a mapping, got {entry!r}{hint}")
    for key in entry:
        if key not in accepted:
            names = ", ".join(accepted) or "none"
            raise SceneError(f"{where}: unknown key '{key}', accepted: {names}")
    for name, parameter in accepted.items():
        if parameter.default is inspect.Parameter.empty and name not in entry:
            raise SceneError(f"{where}: key '{name}' is missing")
    hints = typing.get_type_hints(
        function.__init__ if inspect.isclass(function) else function,  # type: ignore[misc]
        include_extras=True,
    )
    arguments = {}
    for key, item in entry.items():
        name = accepted[key].name
        arguments[name] = value(item, hints.get(name, Any), f"{where}.{key}")
    try:
        _check(function, context, arguments)
        return function(*context, **arguments)
    except ModelError as error:
        raise SceneError(f"{where}: {error}") from error


def _check(function: Any, context: Sequence[Any], arguments: Mapping[str, Any]) -> None:
    check = getattr(function, "check", None) if inspect.isclass(function) else None
    if check is not None and not any(map(_has_symbols, arguments.values())):
        bound = inspect.signature(function).bind(*context, **arguments)
        bound.apply_defaults()
        check(*(bound.arguments[name] for name in inspect.signature(check).parameters))


def _has_symbols(entry: Any) -> bool:
    inner = entry.values() if isinstance(entry, Mapping) else entry
    if isinstance(inner, list) or isinstance(entry, Mapping):
        return any(map(_has_symbols, inner))
    return is_symbol(entry)


def value(entry: Any, hint: Any, where: str, accepted: Within = ANY_NUMBER) -> Any:
    """A value checked against a type hint and its range; integers pass as numbers.

    Args:
        hint: Its annotation, perhaps with a range.
        where: File and key, for the messages.
        accepted: Range of numbers whose annotation has none.

    Raises:
        SceneError: Names the key, what is expected and what was given.
    """
    if is_symbol(entry):
        return entry  # its range is that of the numbers that stand for it
    hint, within, _, length = described(hint)
    accepted = within or accepted
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return None if entry is None else value(entry, _member(entry, inner), where, accepted)
    if origin is Literal:
        if entry not in inner:
            raise SceneError(f"{where}: expected one of {', '.join(inner)}, got {entry!r}")
        return entry
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(entry, dict):
            raise SceneError(f"{where}: expected a mapping, got {entry!r}")
        return {key: value(v, inner[1], f"{where}.{key}", accepted) for key, v in entry.items()}
    if isinstance(origin, type) and issubclass(origin, Sequence):
        if not isinstance(entry, list):
            raise SceneError(f"{where}: expected a list, got {entry!r}")
        if length is not None and len(entry) != length:
            raise SceneError(f"{where}: expected {length} numbers, got {entry}")
        return [value(v, inner[0], f"{where}[{i}]", accepted) for i, v in enumerate(entry)]
    if hint is Any:
        return entry
    if inspect.isclass(hint) and hint not in _EXPECTED and isinstance(entry, hint):
        return entry  # what the reader of a section has built already
    if hint is float and isinstance(entry, int) and not isinstance(entry, bool):
        entry = float(entry)
    if type(entry) is not hint:
        raise SceneError(f"{where}: expected {_EXPECTED.get(hint, hint)}, got {entry!r}")
    has_range = hint is float or (hint is int and accepted is not ANY_NUMBER)
    return _within(entry, accepted, where) if has_range else entry


def _member(entry: Any, union: Sequence[Any]) -> Any:
    """The first member of a union, but for a list the first that is one."""
    lists = [
        m for m in union if isinstance(o := typing.get_origin(m), type) and issubclass(o, Sequence)
    ]
    return lists[0] if lists and isinstance(entry, list) else union[0]


def _within(number: float, accepted: Within, where: str) -> float:
    if not accepted.accepts(number):
        raise SceneError(f"{where}: {number:g} is out of range, accepted: {accepted}")
    return number


class Argument(NamedTuple):
    """One argument of a constructor.

    Attributes:
        name: As the constructor spells it.
        kind: bool, int, float or str.
        per_joint: Whether it may have one value a joint.
        default: None where there is none.
        low: Smallest number accepted.
        high: Largest number accepted.
        unit: Empty where the annotation states none.
        choices: The texts accepted; empty accepts any.
        text: The entry of the docstring in one line; empty without one.
    """

    name: str
    kind: type
    per_joint: bool
    default: Any
    low: float
    high: float
    unit: str
    choices: tuple[str, ...]
    text: str


def arguments(
    constructor: Callable[..., Any], skip: int = 0, only: Sequence[str] | None = None
) -> tuple[Argument, ...]:
    """The arguments of a class, in the order of its constructor.

    Args:
        constructor: A class, a NamedTuple too, or a function.
        skip: Number of first arguments to leave out: those that no user gives.
        only: Names of the arguments that are read; None reads all.

    Raises:
        ModelError: An argument has no annotation, or one of another kind than `ACCEPTED`.
    """
    is_class = inspect.isclass(constructor)
    made_by = constructor.__init__ if is_class else constructor  # type: ignore[misc]
    fields = hasattr(constructor, "_fields")  # the hints of a NamedTuple stand in its class
    hints = typing.get_type_hints(constructor if fields else made_by, include_extras=True)
    texts = entries(constructor.__doc__, "Attributes" if fields else "Args")
    texts = texts or entries(made_by.__doc__)
    parameters = list(inspect.signature(constructor).parameters.values())[skip:]
    wanted = [p for p in parameters if only is None or p.name in only]
    return tuple(_argument(p, hints.get(p.name), texts.get(p.name, "")) for p in wanted)


def _argument(parameter: inspect.Parameter, hint: Any, text: str) -> Argument:
    kind, within, unit, _ = described(hint)
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    choices: tuple[str, ...] = ()
    is_gain = origin in (types.UnionType, typing.Union) and _is_per_joint(inner)
    if is_gain:
        kind = float
    elif origin is Literal and all(isinstance(choice, str) for choice in inner):
        kind, choices = str, inner
    elif origin in (types.UnionType, typing.Union) and str in inner:
        kind = str  # a file; from Python also what it holds
    is_keyword = parameter.kind in (parameter.KEYWORD_ONLY, parameter.POSITIONAL_OR_KEYWORD)
    if kind not in _KINDS or not is_keyword:
        annotation = "no annotation" if hint is None else f"the annotation {hint}"
        raise ModelError(f"argument '{parameter.name}' has {annotation}; accepted: {ACCEPTED}")
    default = None if parameter.default is parameter.empty else parameter.default
    low, high = within[:2] if within else (-math.inf, math.inf)
    return Argument(parameter.name, kind, is_gain, default, low, high, unit, choices, text)


def _is_per_joint(members: Sequence[Any]) -> bool:
    """Whether a union is that of `Gain`: a float, or a sequence of them."""
    lists = [m for m in members if typing.get_args(m) == (float,)]
    return len(members) == 2 and float in members and len(lists) == 1


def entries(docstring: str | None, section: str = "Args") -> dict[str, str]:
    """The entries of a section of a docstring.

    Args:
        docstring: As written, None where there is none.
        section: Heading, such as `Args` or `Attributes`.

    Returns:
        Name -> text in one line, in the order of the docstring; empty without the section.
    """
    lines_of: dict[str, list[str]] = {}
    width = name = None
    for line in _lines(docstring or "", section):
        indent = len(line) - len(line.lstrip())
        width = indent if width is None else width
        entry = _ENTRY.fullmatch(line.strip()) if indent == width else None
        if entry:
            name = entry[1]
            lines_of[name] = [entry[2]]
        elif name is not None:
            lines_of[name].append(line.strip())
    return {key: " ".join(part for part in parts if part) for key, parts in lines_of.items()}


def _lines(docstring: str, section: str) -> list[str]:
    """Lines of a section that are not empty, without its heading."""
    inside, lines = False, []
    for line in inspect.cleandoc(docstring).splitlines():
        if line and not line[0].isspace():
            heading = _SECTION.fullmatch(line.rstrip())
            inside = heading is not None and heading[1] == section
        elif inside and line.strip():
            lines.append(line)
    return lines
