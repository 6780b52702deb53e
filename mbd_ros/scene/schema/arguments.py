"""The arguments of a constructor, with their annotations and texts.

They are the only home of kind, default, range, unit, choices and text. Code that offers a part to
somebody else (a node its gains, for example) reads them here.
"""

import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

from mbd_ros.core.ranges import described
from mbd_ros.errors import ModelError

# The text of each argument in a Google docstring.

_SECTION = re.compile(r"(\w[\w ]*):")  # a line of its own, at the left
_ENTRY = re.compile(r"\*{0,2}(\w+)(?: \([^)]*\))?:\s*(.*)")  # `name: text` or `name (type): text`


def entries(docstring: str | None, section: str = "Args") -> dict[str, str]:
    """The entries of a section of a docstring.

    Args:
        docstring: As written, None where there is none.
        section: Heading, such as `Args` or `Attributes`.

    Returns:
        Name -> text in one line, in the order of the docstring; empty without the section.
    """
    found: dict[str, list[str]] = {}
    width = name = None
    for line in _lines(docstring or "", section):
        indent = len(line) - len(line.lstrip())
        width = indent if width is None else width
        entry = _ENTRY.fullmatch(line.strip()) if indent == width else None
        if entry:
            name = entry[1]
            found[name] = [entry[2]]
        elif name is not None:
            found[name].append(line.strip())
    return {key: " ".join(part for part in parts if part) for key, parts in found.items()}


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


_KINDS = (bool, int, float, str)
ACCEPTED = "float, int, bool, str, Literal of texts, or Gain (a float, or one a joint)"


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
        given = "no annotation" if hint is None else f"the annotation {hint}"
        raise ModelError(f"argument '{parameter.name}' has {given}; accepted: {ACCEPTED}")
    default = None if parameter.default is parameter.empty else parameter.default
    low, high = within[:2] if within else (-math.inf, math.inf)
    return Argument(parameter.name, kind, is_gain, default, low, high, unit, choices, text)


def _is_per_joint(members: Sequence[Any]) -> bool:
    """Whether a union is that of `Gain`: a float, or a sequence of them."""
    lists = [m for m in members if typing.get_args(m) == (float,)]
    return len(members) == 2 and float in members and len(lists) == 1
