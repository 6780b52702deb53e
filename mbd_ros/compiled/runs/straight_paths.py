"""Lengths, speeds and moment arms of straight paths, by native code at one configuration."""

import ctypes
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.path_tables import NATIVE
from mbd_ros.compiled.code.source import Source
from mbd_ros.core.model.couplings import Couplings, Slopes
from mbd_ros.core.model.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.via_points import ViaPoint
from mbd_ros.core.state import Array

_JOINT = np.dtype([("parent", "i4"), ("first", "i4"), ("count", "i4")], align=True)
_POINT = np.dtype(
    [("at", "f8", 3), ("ends", "f8", 2), ("joint", "i4"), ("within", "i4"), ("slides", "i4")],
    align=True,
)
_WAY = np.dtype([("axis", "f8", 3), ("point", "i4")], align=True)
_NOWHERE = -1
_ROTATION = 72  # bytes


class StraightPaths:
    """What paths of straight lines do, beside a Pinocchio `Data` that has its Jacobians.

    One library serves all scenes.

    Args:
        robot: The robot.
        data: Its `Data`, which has to live as long.
        couplings: Its dependent joints.
        paths: Every one with `corners`.
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
        text = (NATIVE / "straight_paths.c").read_text(encoding="utf-8")
        self._call = load(Source(text, (), 1, {}, {})).entry("straight_paths")
        corners = [path.corners() for path in paths]
        points = list(chain.from_iterable(corners))
        model, n, independent = robot.model, len(paths), couplings.v_index
        self._q, self._v = np.zeros(model.nq), np.zeros(model.nv)
        self._slopes = np.zeros(len(couplings.pairs))
        self.length, self.speed = np.zeros(n), np.zeros(n)
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
            np.array(_ways(points), dtype=_WAY),
            *(self._slides, data.J, self._q, self._v),
            *(np.array(pairs, dtype=np.int32), self._slopes, independent.astype(np.int32)),
            *(self.length, self.speed, self.columns),
            *(np.zeros((len(points), 3)) for _ in range(3)),
            *(np.zeros((model.njoints, 6)), np.zeros(model.nv)),
        ]
        self._kept = data, tables
        self._at = (ctypes.c_void_p * len(tables))(*(table.ctypes.data for table in tables))
        self._address = ctypes.addressof(self._at)

    def __call__(self, q: Array, v: Array, slopes: Slopes) -> None:
        """Fill the attributes.

        Args:
            q: Configuration that `data` has, shape (nq,).
            v: Velocity, shape (nv,).
            slopes: What `Couplings.expand` gave, one number a coupling.
        """
        self._q[:], self._v[:], self._slopes[:] = q, v, slopes
        for i, (at, function) in enumerate(self._functions):
            self._slides[i] = function(q.item(at))[:2]
        self._call(self._address)


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


def _ways(points: Sequence[ViaPoint]) -> list[tuple[Any, int]]:
    """Ways along which points slide, with the number of the point."""
    return [(axis, i) for i, point in enumerate(points) for axis, _ in point.directions]
