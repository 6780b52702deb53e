"""Goals of a motion as entries of a task file.

The arguments of the function of a type are the keys of its goal.
"""

import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from mbd_ros.core.ranges import Positive, Unit, Unlimited, Within
from mbd_ros.errors import SceneError
from mbd_ros.optimal_control.problem import Goal
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file

Power = Annotated[int, Within(1, 10)]
Seen = Any  # a name, a list of names, or names with weights


def goals_of(given: Sequence[Any], where: str, folder: Path | None = None) -> tuple[Goal, ...]:
    """The goals of a list of entries.

    Args:
        given: Entries with `type`, `weight`, `name` and the keys of that type.
        where: File and key, for the messages.
        folder: From which files are looked for.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    found = list[Goal]()
    for i, entry in enumerate(given):
        at = f"{where}[{i}]"
        if callable(entry):
            entry = {"type": "function", "function": entry}
        found.append(_goal(entry, at, folder, {goal.name for goal in found}))
    return tuple(found)


def _goal(entry: Any, where: str, folder: Path | None, taken: set[str]) -> Goal:
    if not isinstance(entry, dict):
        raise SceneError(f"{where}: expected a mapping with type, got {entry!r}")
    rest = {key: one for key, one in entry.items() if key not in ("type", "weight", "name")}
    kind = entry.get("type")
    if kind not in _KINDS:
        raise SceneError(f"{where}.type: expected one of {', '.join(_KINDS)}, got {kind!r}")
    weight = schema.value(entry.get("weight", 1.0), float, f"{where}.weight")
    options = schema.call(_KINDS[kind], rest, where)
    name = str(entry.get("name", kind))
    number = 1
    while name in taken:
        number += 1
        name = f"{entry.get('name', kind)}_{number}"
    if isinstance(options.get("function"), str):
        options["function"] = _function_of(options["function"], f"{where}.function")
    if options.get("file"):
        options["file"] = find_file(folder or Path(), options["file"], f"{where}.file")
    return Goal(kind, weight, options, name)


def _function_of(path: str, where: str) -> Callable[[Any], Any]:
    from mbd_ros.scene.schema.code_permission import require_permission

    require_permission(where, {"function": path})
    module, _, name = path.partition(":")
    try:
        found: Callable[[Any], Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise SceneError(f"{where}: {path} cannot be imported: {error}") from error
    return found


def _powers(of: Seen = None, power: Power = 2) -> dict[str, Any]:
    return {"of": of, "power": power}


def _power(of: Seen = None, smoothing: Annotated[Positive, Unit("W")] = 0.1) -> dict[str, Any]:
    return {"of": of, "smoothing": smoothing}


def _metabolic(
    of: Seen = None,
    basal: bool = True,
    slow_twitch: Annotated[float, Within(0.0, 1.0), Unit("-")] = 0.5,
    specific_tension: Annotated[Positive, Unit("N/m^2")] = 2.5e5,
    smoothing: Annotated[Positive, Unit("-")] = 10.0,
) -> dict[str, Any]:
    return {
        "of": of,
        "basal": basal,
        "slow_twitch": slow_twitch,
        "specific_tension": specific_tension,
        "smoothing": smoothing,
    }


def _time() -> dict[str, Any]:
    return {}


def _speed(of: str, target: Unlimited) -> dict[str, Any]:
    return {"of": of, "target": target}


def _smoothness(of: Seen = None) -> dict[str, Any]:
    return {"of": of}


def _tracking(of: Seen, file: str = "") -> dict[str, Any]:
    return {"of": of, "file": file}


def _integral(of: Seen, power: Power = 1, target: Unlimited = 0.0) -> dict[str, Any]:
    return {"of": of, "power": power, "target": target}


def _value(of: Seen, power: Power = 2, target: Unlimited = 0.0) -> dict[str, Any]:
    return {"of": of, "power": power, "target": target}


def _function(function: Any, at: Literal["integral", "final"] = "integral") -> dict[str, Any]:
    return {"function": function, "at": at}


_KINDS: Mapping[str, Callable[..., dict[str, Any]]] = {
    "effort": _powers,
    "torque": _powers,
    "power": _power,
    "activation": _powers,
    "metabolic": _metabolic,
    "time": _time,
    "speed": _speed,
    "smoothness": _smoothness,
    "tracking": _tracking,
    "integral": _integral,
    "final": _value,
    "function": _function,
}
