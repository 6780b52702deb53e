"""Lengths, speeds and moment arms of paths, by native code."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.source import Source
from mbd_ros.compiled.symbols.path_tables import NATIVE, SURFACES, row_of, search_text
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.kinematics.paths.via_point import ViaPoint
from mbd_ros.core.kinematics.paths.wrap_surface import Placed
from mbd_ros.core.kinematics.paths.wrapped_path import Taut, taut
from mbd_ros.core.model.couplings import Couplings, Slopes
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

WRAPS, LINES = 8, 31  # of a path
HEAD = (
    '#define EXPORT __attribute__((visibility("default")))\n'
    f"#define MOST_WRAPS {WRAPS}\n#define MOST_LINES {LINES}\n"
)
_NUMBERS = (("sign", "f8"), ("size", "f8"), ("half", "f8"), ("axes", "f8", 3))
ROW = np.dtype([("kind", "i4"), ("axis", "i4"), *_NUMBERS], align=True)
_JOINT = np.dtype([("parent", "i4"), ("first", "i4"), ("count", "i4")], align=True)
_POINT = np.dtype(
    [("at", "f8", 3), ("ends", "f8", 2), ("joint", "i4"), ("within", "i4"), ("slides", "i4")],
    align=True,
)
_PATH_POINT = np.dtype([("axis", "f8", 3), ("point", "i4")], align=True)
_CARRIED = np.dtype([("at", "f8", 12), ("joint", "i4")], align=True)
_NOWHERE = -1
_ROTATION = 72  # bytes


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
        """Return the taut path of a `WrappedPath` in every sample, see `wrapped_path.taut`."""
        n, m, _ = points.shape
        known = all(type(wrap.surface) in SURFACES for wrap in path.wraps)
        if not known or len(places) > WRAPS or m - 1 > LINES:
            return taut(points, path.reaches, places)
        out = self._search(path, _flat(points, places))
        length, by_points = out[:, 0], out[:, 1 : 1 + 3 * m].reshape(n, m, 3)
        paths = Taut(length, by_points, out[:, 1 + 3 * m :].reshape(n, len(places), 6))
        lost = np.isnan(length)
        if lost.any():
            others = taut(points[lost], path.reaches, [place.of(lost) for place in places])
            for values, part in zip(paths, others, strict=True):
                values[lost] = part
        return paths

    def _search(self, path: Any, at: Array) -> Array:
        """Return the results of the native search, one sample a row."""
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


class StatePaths:
    """Lengths and forces of paths through points and over surfaces, from Jacobians of a `Data`.

    One library serves all scenes with wraps, another one those without.

    Args:
        data: Its `Data`, which has to live as long.
        paths: Such that `is_known`.
        width: Columns of `columns`, at least one a path.

    Attributes:
        length: Of the paths [m], shape (n,), overwritten by every call.
        speed: Their rates [m/s], same.
        columns: Force of the independent coordinates by a tension of 1 N in its first n columns,
            shape (nv_y, width), same.

    Raises:
        BuildError: It cannot be compiled.
    """

    def __init__(
        self, robot: Robot, data: Any, couplings: Couplings, paths: Sequence[Path], width: int
    ) -> None:
        wrapped = any(path.wraps for path in paths)
        self._call = load(Source(_text(wrapped), (), 1, {}, {})).entry("state_paths")
        corners = [path.corners() for path in paths]
        points = list(chain.from_iterable(corners))
        model, n, independent = robot.model, len(paths), couplings.v_index
        self._q, self._v = np.zeros(model.nq), np.zeros(model.nv)
        self._slopes = np.zeros(len(couplings.pairs))
        self.length, self.speed, self._ones = np.zeros(n), np.zeros(n), np.ones(n)
        self.columns = np.zeros((len(independent), width))
        self._functions = [(p.joint.q, f) for p in points if p.joint for _, f in p.directions]
        self._slides = np.zeros((len(self._functions), 2))
        pairs = [(pair.child_v, pair.parent_v) for pair in couplings.pairs]
        sizes = [n, model.njoints, len(points), len(self._functions), model.nv, len(pairs)]
        tables = [
            np.array([*sizes, len(independent), width], dtype=np.int64),
            *(_joints(model), _places(data)),
            np.array([_row(robot, point) for point in points], dtype=_POINT),
            np.cumsum([0, *map(len, corners)], dtype=np.int32),
            np.array(_path_points(points), dtype=_PATH_POINT),
            *(self._slides, data.J, self._q, self._v),
            *(np.array(pairs, dtype=np.int32), self._slopes, independent.astype(np.int32)),
            *(self.length, self.speed, self.columns),
            *(np.zeros((len(points), 3)) for _ in range(3)),
            *(np.zeros((model.njoints, 6)), np.zeros(model.nv)),
            *(_surfaces(robot, paths) if wrapped else ()),
        ]
        self._alive = data, tables
        self._at = (ctypes.c_void_p * len(tables))(*(table.ctypes.data for table in tables))
        self._address = ctypes.addressof(self._at)

    def __call__(self, q: Array, v: Array, slopes: Slopes) -> bool:
        """Fill the attributes; False where a path over a surface is not found.

        Args:
            q: Configuration that `data` has, shape (nq,).
            slopes: What `Couplings.expand` gave, one number a coupling.
        """
        self._q[:], self._v[:], self._slopes[:] = q, v, slopes
        for i, (at, function) in enumerate(self._functions):
            self._slides[i] = function(q.item(at))[:2]
        self._call(self._address)
        return not np.isnan(self.length.dot(self._ones))


def _text(wrapped: bool) -> str:
    surfaces = (NATIVE / "surfaces.h").read_text(encoding="utf-8")
    last = (NATIVE / "state_paths.h").read_text(encoding="utf-8")
    before = HEAD + search_text() if wrapped else HEAD + surfaces
    return f"#define WRAPS {int(wrapped)}\n{before}{last}"


def _joints(model: Any) -> NDArray[Any]:
    """Where the joints of a model hang, and their velocities."""
    rows = [(0, 0, 0)]
    for i in range(1, model.njoints):
        joint = model.joints[i]
        rows.append((model.parents[i], joint.idx_v, joint.nv))
    return np.array(rows, dtype=_JOINT)


def _places(data: Any) -> NDArray[np.uint64]:
    """Addresses at which Pinocchio keeps rotation and, behind it, origin of every joint.

    Raises:
        BuildError: It keeps them otherwise.
    """
    places = [(one.rotation.ctypes.data, one.translation.ctypes.data) for one in data.oMi]
    if any(origin - rotation != _ROTATION for rotation, origin in places):
        raise BuildError("this Pinocchio keeps origins of joints elsewhere")
    return np.array([rotation for rotation, _ in places], dtype=np.uint64)


def _row(robot: Robot, point: ViaPoint) -> tuple[Any, ...]:
    joint, at = robot.places.points[point.point.number]
    within, slides = point.within, point.joint
    ends = (within.lower, within.upper) if within else (0.0, 0.0)
    where = within.joint.q if within else _NOWHERE
    return at.translation, ends, joint, where, slides.v if slides else _NOWHERE


def _path_points(points: Sequence[ViaPoint]) -> list[tuple[Any, int]]:
    """Ways along which points slide, with the number of the point."""
    return [(axis, i) for i, point in enumerate(points) for axis, _ in point.directions]


def _surfaces(robot: Robot, paths: Sequence[Path]) -> tuple[NDArray[Any], ...]:
    """How many points and surfaces paths have, what these are and where; room for a search."""
    first = np.cumsum([0, *(len(path.wraps) for path in paths)])
    of = [(len(p.corners()), len(p.wraps), i) for p, i in zip(paths, first, strict=False)]
    reaches = [(i, r.first, r.last) for path in paths for i, r in enumerate(path.reaches)]
    wraps = [wrap for path in paths for wrap in path.wraps]
    places = [robot.places.points[wrap.point.number] for wrap in wraps]
    carried = [((*p.at.rotation.ravel(), *p.at.translation), p.joint) for p in places]
    room = max(1 + 3 * n + 12 * m for n, m, _ in of)
    return (
        np.array(of, dtype=np.int32),
        np.array(reaches, dtype=np.int32),
        np.array([tuple(row_of(wrap.surface)) for wrap in wraps], dtype=ROW),
        np.array(carried, dtype=_CARRIED),
        *np.zeros((2, room)),
    )


def is_known(path: Path) -> bool:
    """Whether native code knows a path."""
    count = len(path.corners())
    if not path.wraps:
        return count > 0
    known = all(type(wrap.surface) in SURFACES for wrap in path.wraps)
    return known and len(path.wraps) <= WRAPS and 0 < count <= LINES + 1
