"""Parameters of nodes: what each means and accepts, how a node declares and changes them.

`STREAM` has those that nodes share which answer joint states.
"""

from __future__ import annotations

import difflib
import math
from array import array
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, get_args, get_origin

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy import parameter as ros
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node

from mbd_ros.errors import MbdError
from mbd_ros.methods.inverse_dynamics.torque_estimator import Tuning
from mbd_ros.scene.schema.schema import Argument, arguments


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
_ROS_TYPES = {
    bool: ros.Parameter.Type.BOOL,
    int: ros.Parameter.Type.INTEGER,
    float: ros.Parameter.Type.DOUBLE,
    str: ros.Parameter.Type.STRING,
    list[bool]: ros.Parameter.Type.BOOL_ARRAY,
    list[int]: ros.Parameter.Type.INTEGER_ARRAY,
    list[float]: ros.Parameter.Type.DOUBLE_ARRAY,
    list[str]: ros.Parameter.Type.STRING_ARRAY,
}


class ParameterError(MbdError):
    """A parameter value that is refused: names the parameter and what is accepted."""


class Declared:
    """The ROS parameters of one node, with strict values.

    Attributes:
        values: Named tuple of all values; replaced as a whole, never changed.
        problems: Name -> why the value given at the start was refused.
    """

    def __init__(
        self,
        node: Node,
        parameters: Sequence[Parameter],
        retune: Callable[[Any], None],
        is_configured: Callable[[], bool],
    ) -> None:
        """Declare everything; a bad value is kept as a problem, never raised.

        Args:
            node: The node of the parameters.
            parameters: What to declare.
            retune: Called with the new values before they are swapped in; an MbdError refuses.
            is_configured: Whether `read_only` holds now.
        """
        self._specs = {parameter.name: parameter for parameter in parameters}
        self._retune = retune
        self._is_configured = is_configured
        self.problems: dict[str, str] = {}
        given = node._parameter_overrides  # rclpy shows them in no public way
        values = {spec.key: self._declare(node, spec, given) for spec in parameters}
        self.values: Any = namedtuple("Values", values)(**values)
        self._is_following = False
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._apply)

    def follow(self, node: Node, parameters: Sequence[Parameter]) -> None:
        """Let a node have these parameters: others end, and those of another kind begin anew.

        What begins has the value given at the start, or its default; a bad one is a problem.
        """
        wanted = {spec.name: spec for spec in parameters}
        if self._is_following or wanted == self._specs:
            return
        unchanged = {n for n, spec in self._specs.items() if wanted.get(n) == spec}
        values, overrides = self.values._asdict(), node._parameter_overrides
        self._is_following = True
        try:
            for name in self._specs.keys() - unchanged:
                node.undeclare_parameter(name)
                self.problems.pop(name, None)
            for spec in (spec for name, spec in wanted.items() if name not in unchanged):
                values[spec.key] = self._declare(node, spec, overrides)
        finally:
            self._is_following = False
        self._specs = wanted
        keys = [spec.key for spec in parameters]
        self.values = namedtuple("Values", keys)(*(values[key] for key in keys))

    def undeclared(self, node: Node) -> list[str]:
        """One warning per override that was given and that nobody declared."""
        unknown = [name for name in node._parameter_overrides if not node.has_parameter(name)]
        return [f"parameter {self._unknown(name)}" for name in unknown]

    def _declare(self, node: Node, spec: Parameter, overrides: dict[str, ros.Parameter]) -> Any:
        value = None if spec.default is None else spec.read(spec.default)
        try:
            if spec.name in overrides:
                override = overrides[spec.name].value
                value = spec.read([] if override is None else override)  # [] arrives without type
            elif value is None:
                raise ParameterError(f"parameter '{spec.name}' must be given: {spec.accepted()}")
        except ParameterError as error:
            self.problems[spec.name] = str(error)
        shown = spec.default if value is None else value
        kind, initial = _ROS_TYPES[spec.kind], spec.kind() if shown is None else shown
        # rclpy would declare an empty list as BYTE_ARRAY: declare its type, then set it. One
        # parameter without a value would leave `ros2 param dump` without any.
        first = kind if initial in ((), []) else initial
        node.declare_parameter(spec.name, first, spec.descriptor(), ignore_override=True)
        if first is kind:
            node.set_parameters([ros.Parameter(spec.name, kind, [])])
        return value

    def _unknown(self, name: str) -> str:
        from mbd_ros.scene.schema.renamed import renamed  # here, since it serves errors only

        near = difflib.get_close_matches(name, self._specs, 1)
        guess = f" (did you mean '{near[0]}'?)" if near else ""
        hint = renamed("parameter", name) or guess
        return f"'{name}' is unknown{hint}; accepted: {', '.join(sorted(self._specs))}"

    def _convert(self, changes: list[ros.Parameter]) -> list[ros.Parameter]:
        """Give an int or an empty list the declared type before rclpy compares types."""
        if self._is_following:
            return changes
        unknown = [change.name for change in changes if change.name not in self._specs]
        for name in set(unknown) - {"use_sim_time", "start_type_description_service"}:
            raise ParameterNotDeclaredException(self._unknown(name))
        return [self._converted(change) for change in changes]

    def _converted(self, change: ros.Parameter) -> ros.Parameter:
        kind = self._specs[change.name].kind if change.name in self._specs else None
        is_array = isinstance(change.value, list | tuple | array)
        if get_origin(kind) is list and is_array and len(change.value) == 0:
            return ros.Parameter(change.name, _ROS_TYPES[kind], [])
        if kind is float and change.type_ == ros.Parameter.Type.INTEGER:
            return ros.Parameter(change.name, value=float(change.value))
        if kind == list[float] and change.type_ == ros.Parameter.Type.INTEGER_ARRAY:
            return ros.Parameter(change.name, value=[float(entry) for entry in change.value])
        return change

    def _apply(self, changes: list[ros.Parameter]) -> SetParametersResult:
        if self._is_following:
            return SetParametersResult(successful=True)
        known = [(self._specs[c.name], c.value) for c in changes if c.name in self._specs]
        try:
            values = self.values._replace(**{spec.key: spec.read(new) for spec, new in known})
            self._refuse_while_configured([spec for spec, _ in known], values)
            if known:
                self._retune(values)
        except MbdError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.values = values
        for spec, _ in known:
            self.problems.pop(spec.name, None)
        return SetParametersResult(successful=True)

    def _refuse_while_configured(self, specs: list[Parameter], values: Any) -> None:
        """Raise for what only a new configuration can take; the same value is no change."""
        for spec in specs if self._is_configured() else ():
            if spec.read_only and getattr(values, spec.key) != getattr(self.values, spec.key):
                raise ParameterError(
                    f"parameter '{spec.name}' is read-only while the node is configured; "
                    "clean up, set it, then configure"
                )


def guard_parameter_services(node: Node) -> None:
    """Let the services of a node refuse values of a type that ROS does not have.

    rclpy raises for them, out of the callback, which would end the process.
    """
    for service in node.services:
        if service.srv_type in (SetParameters, SetParametersAtomically):
            service.callback = _of_known_types(service.callback)


def _of_known_types(take: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def refuse_or_take(request: Any, response: Any) -> Any:
        types = [kind.value for kind in ros.Parameter.Type]
        unknown = [change for change in request.parameters if change.value.type not in types]
        if not unknown:
            return take(request, response)
        name, kind = unknown[0].name, unknown[0].value.type
        reason = f"parameter '{name}': type {kind} is unknown; accepted: 0 to {max(types)}"
        refusal = SetParametersResult(successful=False, reason=reason)
        if isinstance(response, SetParameters.Response):
            response.results = [refusal] * len(request.parameters)
        else:
            response.result = refusal
        return response

    return refuse_or_take


def constructor_parameters(
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
        argument_parameter(found[argument], name, read_only=read_only)
        for argument, name in names.items()
    )


def argument_parameter(
    argument: Argument, name: str, *, note: str = "", read_only: bool = True
) -> Parameter:
    """The parameter whose value becomes an argument of a constructor.

    Args:
        argument: Kind, default, range, choices, unit and text.
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


TUNING = Tuning._fields
ALLOW_CODE = Parameter(
    "allow_code",
    bool,
    "Import what is named as package.module:Class: code of others runs in this node.",
    False,
    fixed=True,
)


def tunable(name: str, default: float, low: float, high: float, text: str) -> Parameter:
    """A number that may change while the node runs."""
    return Parameter(name, type(default), text, default, low=low, high=high, read_only=False)


STREAM = (
    Parameter("scene", str, "Scene: a file, or the name of an embedded one."),
    ALLOW_CODE,
    *constructor_parameters(Tuning, {name: name for name in TUNING}, read_only=False),
    tunable(
        "timeout", 0.5, 1e-3, 3600.0, "Age of the newest joint state that is reported STALE [s]."
    ),
    tunable(
        "clock_tolerance",
        5.0,
        1e-3,
        1e10,
        "Difference of stamp and node clock from which they count as two clocks [s].",
    ),
    tunable(
        "coupling_tolerance",
        0.05,
        0.0,
        100.0,
        "Distance of a measured dependent joint from its coupling that is reported [rad, m].",
    ),
    tunable(
        "wrench_wait",
        0.01,
        0.0,
        10.0,
        "How long a joint state waits for the wrenches of its stamp [s].",
    ),
    Parameter(
        "wrench_max_age",
        float,
        "How long the newest wrench stands for later joint states [s].",
        0.1,
        low=0.0,
        high=60.0,
    ),
)


def stream_parameters(*names: str) -> tuple[Parameter, ...]:
    """Those of `STREAM` with these names."""
    return tuple(parameter for parameter in STREAM if parameter.name in names)


def tuning(values: Any) -> Tuning:
    """The part of the parameters that tunes the estimator."""
    return Tuning(*(getattr(values, field) for field in TUNING))
