"""A parameter of a node: its name, what it means and which values it accepts."""

import math
from array import array
from typing import Any, NamedTuple, get_args, get_origin

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

from mbd_ros.errors import MbdError


class ParameterError(MbdError):
    """A parameter value that is refused: names the parameter and what is accepted."""


class Parameter(NamedTuple):
    """One parameter of a node.

    Attributes:
        name: As in the parameter file; dots become underscores in `Declared.values`.
        kind: bool, int, float, str, or list[...] of one of them (held as a tuple).
        text: What it means, unit in brackets.
        default: Value when none is given; None makes the parameter required.
        low: Smallest number accepted, also in lists.
        high: Largest number accepted, also in lists.
        length: Number of entries of a list; None accepts any.
        choices: The texts accepted; empty accepts any.
        takes_code: Whether `package.module:Class` is accepted beside `choices`.
        read_only: While configured; False only for gains, rates and timeouts: these may change
            at run time.
        fixed: Read-only at all times: what the process itself is made with.
    """

    name: str
    kind: Any
    text: str
    default: Any = None
    low: float = -math.inf
    high: float = math.inf
    length: int | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = True
    fixed: bool = False
    takes_code: bool = False

    @property
    def key(self) -> str:
        """Attribute name in `Declared.values`."""
        return self.name.replace(".", "_")

    def read(self, value: Any) -> Any:
        """Checked value: an int becomes a float where one is expected, a list a tuple.

        Raises:
            ParameterError: Wrong type or length, not finite, out of range, not a choice.
        """
        if get_origin(self.kind) is not list:
            return self._read_one(self.kind, value)
        if not isinstance(value, list | tuple | array):
            raise self._refusal(value)
        if self.length is not None and len(value) != self.length:
            raise self._refusal(list(value))
        return tuple(self._read_one(get_args(self.kind)[0], entry) for entry in value)

    def accepted(self) -> str:
        """Values that `read` accepts, as text."""
        if self.choices:
            code = ", or package.module:Class" if self.takes_code else ""
            return "one of " + ", ".join(self.choices) + code
        entry = (get_args(self.kind) or (self.kind,))[0]
        text = entry.__name__ if entry is not float else "finite float"
        if (self.low, self.high) != (-math.inf, math.inf):
            text += f" in [{self.low:g}, {self.high:g}]"
        if entry is self.kind:
            return text
        return f"list of {'' if self.length is None else f'{self.length} '}{text}"

    def descriptor(self) -> ParameterDescriptor:
        """Text, range and read_only for tools."""
        when = "; read-only while configured" if self.read_only and not self.fixed else ""
        described = ParameterDescriptor(
            description=self.text,
            additional_constraints=self.accepted() + when,
            read_only=self.fixed,
        )
        # rclpy takes an open end for doubles only, and no range for lists: `read` checks all.
        if self.kind is float and (self.low, self.high) != (-math.inf, math.inf):
            limits = FloatingPointRange(from_value=float(self.low), to_value=float(self.high))
            described.floating_point_range = [limits]
        return described

    def _read_one(self, kind: type, value: Any) -> Any:
        if kind is float and type(value) is int:
            value = float(value)
        fits = type(value) is kind and self._is_choice(value)
        if fits and kind in (int, float):
            fits = math.isfinite(value) and self.low <= value <= self.high
        if not fits:
            raise self._refusal(value)
        return value

    def _is_choice(self, value: Any) -> bool:
        is_code = self.takes_code and isinstance(value, str) and ":" in value
        return not self.choices or is_code or value in self.choices

    def _refusal(self, value: Any) -> ParameterError:
        given = f"parameter '{self.name}' is {value!r} ({type(value).__name__})"
        hint = ": YAML reads y, yes, on as bool, quote texts" if type(value) is bool else ""
        return ParameterError(f"{given}; accepted: {self.accepted()}{hint}")


PARAMETERS = (
    Parameter("autostart", bool, "Configure and activate at the start.", True),
    Parameter(
        "executor",
        str,
        "What drives callbacks.",
        "events",
        choices=("events", "single_threaded"),
        fixed=True,
    ),
)
