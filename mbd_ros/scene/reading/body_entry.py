"""An entry of the section `bodies` -> what a body is read from."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from mbd_ros.core.model.model_source import Recipe
from mbd_ros.core.ranges import Length, Positive, Unit
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.schema import schema

Metres = Annotated[Positive, Unit("m")]
_Sides = Annotated[Sequence[Positive], Length(3), Unit("m")]


def shaped(
    name: str, where: str, given: Any, mass: float | None, inertia: Sequence[Any] | None
) -> Recipe:
    """A body of one link, its origin in the centre of its shape, which its mass fills evenly.

    Args:
        name: Of the body and its link, a ROS name.
        where: File and key, for the messages.
        given: `{box: [x, y, z]}`, `{sphere: r}`, `{cylinder: {radius, length}}` or
            `{capsule: {radius, length}}`, the last two along z; a capsule is longer than `length`
            by its two half spheres.
        mass: [kg]; None for a body that does not move.
        inertia: About the centre [kg·m^2], shape (3,) for its diagonal or (3, 3); None for that
            of the shape.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    entry = schema.value(given, Mapping[str, Any], f"{where}.shape")
    if len(entry) != 1 or next(iter(entry)) not in _SHAPES:
        names = ", ".join(_SHAPES)
        raise SceneError(
            f"{where}.shape: expected one of {names}, got {', '.join(entry) or 'none'}"
        )
    kind, sizes = next(iter(entry.items()))
    key = f"{where}.shape.{kind}"
    arguments = sizes if kind in _BY_KEYS else {"size": sizes}
    moments = schema.call(_SHAPES[kind], arguments, key)
    text = f'<robot name="{name}"><link name="{name}"/></robot>'
    source = f"bodies.{name}.shape"
    if mass is None:
        return Recipe(text, source, name=name, shape=(kind, sizes))
    tensor = np.diag(moments) * mass if inertia is None else _tensor(inertia, where)
    inertias = {name: (mass, np.zeros(3), tensor)}
    return Recipe(text, source, inertias=inertias, name=name, shape=(kind, sizes))


def _tensor(inertia: Sequence[Any], where: str) -> Array:
    try:
        tensor = np.array(inertia, dtype=np.float64)
    except (TypeError, ValueError):
        tensor = np.zeros(0)
    if tensor.shape not in ((3,), (3, 3)):
        raise SceneError(f"{where}.inertia: expected 3 numbers or 3 x 3, got {inertia}")
    return np.diag(tensor) if tensor.ndim == 1 else tensor


def _box(size: _Sides) -> Array:
    """Moments of inertia of 1 kg [m^2], shape (3,)."""
    squares = np.square(size)
    moments: Array = (squares.sum() - squares) / 12.0
    return moments


def _sphere(size: Metres) -> Array:
    return np.full(3, 0.4 * size**2)


def _cylinder(radius: Metres, length: Metres) -> Array:
    across = radius**2 / 4.0 + length**2 / 12.0
    return np.array((across, across, radius**2 / 2.0))


def _capsule(radius: Metres, length: Metres) -> Array:
    """A cylinder between two half spheres, whose centres of mass lie 3/8 r beyond its ends."""
    share = length / (length + 4.0 / 3.0 * radius)  # of the mass, in the cylinder
    half = 0.4 * radius**2 + length**2 / 4.0 + 0.375 * length * radius
    across = share * (radius**2 / 4.0 + length**2 / 12.0) + (1.0 - share) * half
    along = share * radius**2 / 2.0 + (1.0 - share) * 0.4 * radius**2
    return np.array((across, across, along))


_SHAPES: Mapping[str, Any] = {
    "box": _box,
    "sphere": _sphere,
    "cylinder": _cylinder,
    "capsule": _capsule,
}
_BY_KEYS = ("cylinder", "capsule")
