"""Parameters that follow from the arguments of constructors."""

from collections.abc import Callable, Mapping
from typing import Any

from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.scene.schema.arguments import Argument, arguments


def of(
    constructor: Callable[..., Any],
    names: Mapping[str, str],
    *,
    skip: int = 0,
    read_only: bool = True,
) -> tuple[Parameter, ...]:
    """Parameters whose values become arguments of a constructor.

    Args:
        constructor: Where kind, default, range, unit and text stand.
        names: Argument -> name of the parameter.
        skip: So many first arguments come from elsewhere.
        read_only: See `Parameter`.
    """
    found = {argument.name: argument for argument in arguments(constructor, skip, tuple(names))}
    return tuple(
        parameter(found[argument], name, read_only=read_only) for argument, name in names.items()
    )


def parameter(
    argument: Argument, name: str, *, note: str = "", read_only: bool = True
) -> Parameter:
    """The parameter whose value becomes an argument of a constructor.

    Args:
        argument: Kind, default, range, choices, unit and text.
        name: Of the parameter.
        note: Sentences after the text.
        read_only: See `Parameter`.
    """
    kind, default = argument.kind, argument.default
    if argument.per_joint:
        kind = list[kind]  # type: ignore[valid-type]
        is_one = isinstance(default, int | float)
        default = (float(default),) if is_one else default and tuple(default)
    text = argument.text.removesuffix(".")
    unit = f"[{argument.unit}]" if argument.unit not in ("", "-") else ""
    words = (text, "" if unit in text else unit)
    return Parameter(
        name,
        kind,
        " ".join(word for word in words if word) + "." + note,
        default,
        low=argument.low,
        high=argument.high,
        choices=argument.choices,
        read_only=read_only,
    )
