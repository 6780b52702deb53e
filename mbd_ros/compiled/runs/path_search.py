"""Taut paths of many samples, by the native search."""

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.source import Source
from mbd_ros.compiled.symbols.path_tables import NATIVE, SURFACES, row_of, search_text
from mbd_ros.core.paths.wrapping.arcs import Placed
from mbd_ros.core.paths.wrapping.taut import Taut, taut
from mbd_ros.core.state import Array

WRAPS, LINES = 8, 31  # of a path
HEAD = (
    '#define EXPORT __attribute__((visibility("default")))\n'
    f"#define MOST_WRAPS {WRAPS}\n#define MOST_LINES {LINES}\n"
)
_NUMBERS = (("sign", "f8"), ("size", "f8"), ("half", "f8"), ("axes", "f8", 3))
ROW = np.dtype([("kind", "i4"), ("axis", "i4"), *_NUMBERS], align=True)


class PathSearch:
    """Lengths and slopes of paths that wrap; one library serves all scenes.

    Paths that it does not know, and samples in which it finds none, are left to numpy.

    Raises:
        BuildError: It cannot be compiled.
    """

    def __init__(self) -> None:
        last = (NATIVE / "path_samples.h").read_text(encoding="utf-8")
        source = Source("".join((HEAD, search_text(), last)), (), 1, {}, {})
        self._library = load(source)
        self._call = self._library.c.search_samples
        pointer = ctypes.c_void_p
        self._call.argtypes = (pointer, pointer, pointer, ctypes.c_long, pointer, pointer)
        self._call.restype = None

    def __call__(self, path: Any, points: Array, places: Sequence[Placed]) -> Taut:
        """As `wrapping.taut.taut`, of a `WrappedPath`."""
        n, m, _ = points.shape
        known = all(type(wrap.surface) in SURFACES for wrap in path.wraps)
        if not known or len(places) > WRAPS or m - 1 > LINES:
            return taut(points, path.reaches, places)
        out = self._found(path, _flat(points, places))
        length, by_points = out[:, 0], out[:, 1 : 1 + 3 * m].reshape(n, m, 3)
        found = Taut(length, by_points, out[:, 1 + 3 * m :].reshape(n, len(places), 6))
        lost = np.isnan(length)
        if lost.any():
            rest = taut(points[lost], path.reaches, [place.of(lost) for place in places])
            for whole, part in zip(found, rest, strict=True):
                whole[lost] = part
        return found

    def _found(self, path: Any, at: Array) -> Array:
        """What native code finds of every sample, a row each."""
        rows = np.array([tuple(row_of(wrap.surface)) for wrap in path.wraps], dtype=ROW)
        of = np.array([len(path.points), len(path.wraps), 0], dtype=np.int32)
        reaches: NDArray[np.int32] = np.array(
            [(i, reach.first, reach.last) for i, reach in enumerate(path.reaches)], dtype=np.int32
        )
        out = np.empty((len(at), 1 + 3 * len(path.points) + 6 * len(path.wraps)))
        tables = rows.ctypes.data, of.ctypes.data, reaches.ctypes.data
        self._call(*tables, len(at), at.ctypes.data, out.ctypes.data)
        return out


def _flat(points: Array, places: Sequence[Placed]) -> Array:
    """Points, then rotation row by row and origin of every surface, a row a sample."""
    n = len(points)
    parts = [points.reshape(n, -1)]
    for place in places:
        parts += [np.asarray(place.rotation).reshape(n, 9), place.origin]
    return np.ascontiguousarray(np.concatenate(parts, axis=1))
