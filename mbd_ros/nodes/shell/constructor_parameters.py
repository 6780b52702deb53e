"""Parameters that follow from the arguments of constructors."""

from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.scene.arguments import Argument


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
    unit = f"[{argument.unit}]" if argument.unit else ""
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
