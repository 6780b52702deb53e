"""Where the inputs of the parts of a scene stand in u."""

from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.core.dynamics.inputs import Inputs, bound
from mbd_ros.scene.building import parts_in
from mbd_ros.scene.sections import Section


def bind_inputs(
    sections: Sequence[Section], parts: Mapping[str, Any]
) -> tuple[dict[str, Any], Inputs]:
    """Built sections whose parts know where their inputs stand, and all inputs.

    Actuators come first, in their order, then the others in the order of the table.

    Args:
        sections: The table.
        parts: Built sections by key.
    """
    built = [(s, parts[s.key]) for s in sections if s.key in parts]
    every = [part for section, given in built for part in parts_in(section, given)]
    takers = [part for part in every if getattr(part, "inputs", ())]
    takers.sort(key=lambda part: not hasattr(part, "command"))  # stable
    after, inputs = bound(takers)
    swapped = {id(a): b for a, b in zip(takers, after, strict=True) if a is not b}
    if not swapped:
        return dict(parts), inputs
    return {key: _replaced(given, swapped) for key, given in parts.items()}, inputs


def _replaced(given: Any, swapped: Mapping[int, Any]) -> Any:
    if isinstance(given, tuple | list):
        return tuple(swapped.get(id(part), part) for part in given)
    if isinstance(given, dict):
        return {name: swapped.get(id(part), part) for name, part in given.items()}
    return swapped.get(id(given), given)
