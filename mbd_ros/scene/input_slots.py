"""Where the inputs of the parts of a scene stand in u, and their internal states in z."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.loads.inputs import Inputs, bound
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.reading.building import parts_in
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.sections import Section


def bind_inputs(
    sections: Sequence[Section], parts: Mapping[str, Any]
) -> tuple[dict[str, Any], Inputs]:
    """Built sections whose parts know where their inputs and states stand, and all inputs.

    Actuators come first, in their order, then the others in the order of the table.

    Args:
        sections: The table.
        parts: Built sections by key.
    """
    built = [(s, parts[s.key]) for s in sections if s.key in parts]
    every = [part for section, given in built for part in parts_in(section, given)]
    takers = [p for p in every if getattr(p, "inputs", ()) or getattr(p, "internal", ())]
    takers.sort(key=lambda part: not hasattr(part, "command"))  # stable
    after, inputs = bound(takers)
    swapped = {id(a): b for a, b in zip(takers, after, strict=True) if a is not b}
    if not swapped:
        return dict(parts), inputs
    return {key: _replaced(given, swapped) for key, given in parts.items()}, inputs


def first_values(internals: Internals, given: Any, where: str) -> Array:
    """Internal states at the start, NaN where nothing is given, shape (nz,).

    Args:
        internals: Of the scene.
        given: Values by name, `<part>.<name>: 0.1` or `<part>: {<name>: 0.1}`; None for none.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    z = np.full(internals.nz, np.nan)
    for name, value in _flat(given or {}):
        if name not in internals.names:
            accepted = ", ".join(internals.names) or "none, no part has internal states"
            raise SceneError(f"{where}.internal: unknown '{name}', accepted: {accepted}")
        z[internals.names.index(name)] = schema.value(value, float, f"{where}.internal.{name}")
    try:
        internals.completed(z)
    except ModelError as error:
        raise SceneError(f"{where}.internal: {error}") from error
    return z


def _flat(given: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names with dots, and values."""
    for name, value in given.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{rest}", one) for rest, one in _flat(value))
        else:
            yield name, value


def _replaced(given: Any, swapped: Mapping[int, Any]) -> Any:
    if type(given) in (tuple, list):
        return tuple(swapped.get(id(part), part) for part in given)
    if isinstance(given, dict):
        return {name: swapped.get(id(part), part) for name, part in given.items()}
    return swapped.get(id(given), given)
