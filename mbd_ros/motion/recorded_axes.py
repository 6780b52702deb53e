"""Axes of a recording, written as `x,z,-y`: the recorded axis along each axis of the scene."""

from collections.abc import Iterator, Sequence
from itertools import permutations, product

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.markers import SCREEN

_AS_RECORDED = "x,y,z"
_ACCEPTED = "accepted: three of x, y, z, -x, -y, -z, as x,z,-y, or screen"


def axes_matrix(where: str, axes: str, screen: Sequence[str] = ()) -> Array:
    """From recorded axes to those of the scene, shape (3, 3).

    Args:
        where: File and option, for messages.
        axes: `x,z,-y` or the like; or `screen`.
        screen: Recorded axes to the right and upwards on a screen, as `+X`, `+Z`, which `screen`
            takes as x and y of the scene; empty where the recording does not say them.

    Raises:
        DataError: No axes, a mirror image, or a recording that does not say its own.
    """
    if axes == SCREEN:
        if not screen:
            raise DataError(f"{where} screen: it has no POINT:X_SCREEN, Y_SCREEN")
        axes = _right_handed(where, screen)
    names = [name.strip().lower().removeprefix("+") for name in axes.split(",")]
    if sorted(name.removeprefix("-") for name in names) != ["x", "y", "z"]:
        raise DataError(f"{where} {axes}: {_ACCEPTED}")
    rows = _rows(names)
    if np.linalg.det(rows) < 0.0:
        raise DataError(f"{where} {axes} is a mirror image; {_ACCEPTED}")
    return rows


def other_axes() -> Iterator[tuple[str, Array]]:
    """All turns by right angles but none, with their matrices."""
    for order, signs in product(permutations("xyz"), product(("", "-"), repeat=3)):
        names = [sign + axis for sign, axis in zip(signs, order, strict=True)]
        rows, axes = _rows(names), ",".join(names)
        if axes != _AS_RECORDED and np.linalg.det(rows) > 0.0:
            yield axes, rows


def _rows(names: Sequence[str]) -> Array:
    """A unit vector a name."""
    rows = np.zeros((3, 3))
    for i, name in enumerate(names):
        rows[i, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return rows


def _right_handed(where: str, screen: Sequence[str]) -> str:
    """Three axes, the last one square to what a screen shows."""
    names = [name.strip().lower().removeprefix("+") for name in screen]
    rest = set("xyz") - {name.removeprefix("-") for name in names}
    if len(rest) != 1 or not all(name.removeprefix("-") in ("x", "y", "z") for name in names):
        told = ", ".join(screen)
        raise DataError(f"{where} screen: POINT:X_SCREEN, Y_SCREEN are {told}, accepted: +X, +Z")
    last = rest.pop()
    sign = "" if np.linalg.det(_rows([*names, last])) > 0.0 else "-"
    return ",".join([*names, sign + last])
