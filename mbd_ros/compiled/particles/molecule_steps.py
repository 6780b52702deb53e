"""Half steps of rigid triangles in native code: one molecule is traced, and mapped."""

import ctypes
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.build.compiler import lanes as lanes_of_processor
from mbd_ros.compiled.build.library import Library, load
from mbd_ros.compiled.code.emit import emit
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.methods.particles.molecules import Molecules
from mbd_ros.methods.particles.settle import SettledCluster, corrections, velocity_changes
from mbd_ros.methods.particles.verlet_steps import KindSteps

_DRIVER = Path(__file__).parents[1] / "native" / "molecules.h"
_COORDINATES = 9
_REAL, _AT = ctypes.c_double, ctypes.c_void_p


def is_compiled(kind: Molecules) -> bool:
    """Whether steps of these molecules are native: rigid triangles and nothing else."""
    is_triangle = len(kind.clusters) == 1 and isinstance(kind.clusters[0], SettledCluster)
    return is_triangle and len(kind.atoms) == 3


class CompiledTriangles(KindSteps):
    """Steps of rigid triangles in native code, see `KindSteps`.

    Args:
        tolerance: Not needed: rows are closed to rounding.
        projects: Whether velocities are moved onto the rows.

    Raises:
        BuildError: It cannot be compiled here.
    """

    def __init__(self, kind: Molecules, tolerance: float, projects: bool) -> None:
        super().__init__(kind, tolerance, projects)
        self._library = _compiled(kind, projects)
        self._move, self._finish = self._library.c.move_all, self._library.c.finish_all
        self._move.argtypes = (_AT, _AT, _AT, _REAL, _REAL, _AT, ctypes.c_long)
        self._finish.argtypes = (_AT, _AT, _AT, _REAL, ctypes.c_long)
        self._move.restype = self._finish.restype = None

    def move(self, x: Array, v: Array, force: Array | None, kick: float, h: float) -> Array:
        """Kicks the velocities, which are written; the places they lead to, on the rows."""
        moved, force = np.empty_like(x), _dense(force)
        lanes = x.shape[2]
        self._move(*map(_at, (x, v, force)), kick, h, _at(moved), lanes)
        if not np.isfinite(moved.sum()):
            lane = int(np.flatnonzero(~np.isfinite(moved.sum(axis=(0, 1))))[0])
            row = self.kind.clusters[0].rows[0].name
            raise SolveError(f"row {row}, molecule {lane + 1}: no solution")
        return moved

    def finish(self, x: Array, v: Array, force: Array | None, kick: float) -> None:
        """Kicks the velocities and moves them onto the rows; v is written."""
        force = _dense(force)
        self._finish(*map(_at, (x, v, force)), kick, x.shape[2])


def _dense(force: Array | None) -> Array | None:
    return None if force is None else np.ascontiguousarray(force)


def _at(array: Array | None) -> int | None:
    return None if array is None else array.ctypes.data


def _compiled(kind: Molecules, projects: bool) -> Library:
    """The half steps of a kind."""
    source = emit(_traced(kind, projects), real=lanes_of_processor())
    driver = _DRIVER.read_text(encoding="utf-8")
    text = f"{source.text}\n#define COORDINATES {_COORDINATES}\n{driver}"
    return load(source._replace(text=text))


def _traced(kind: Molecules, projects: bool) -> list[Any]:
    """Both half steps of one molecule, as functions of its coordinates."""
    (cluster,) = kind.clusters
    assert isinstance(cluster, SettledCluster)
    triangle, times = cluster.triangle, ca.SX.sym("times", 2)
    x, v, force = (ca.SX.sym(name, _COORDINATES) for name in ("x", "v", "force"))
    kick, h = times[0], times[1]
    mobility = ca.DM(np.repeat(1.0 / kind.masses, 3))
    w = v + kick * mobility * force
    moved = x + h * w
    corners = [[3 * atom + k for k in range(3)] for atom in triangle.atoms]
    before, after = ([_parts(one, at) for at in corners] for one in (x, moved))
    change = _placed(corners, corrections(triangle, before, after, ca.sqrt))
    move = ca.Function("move", [x, v, force, times], [moved + change, w + change / h])
    if projects:
        speeds = [_parts(w, at) for at in corners]
        changes = velocity_changes(triangle, cluster.inverse, before, speeds)
        finished = w + _placed(corners, changes)
    else:
        finished = w
    return [move, ca.Function("finish", [x, v, force, times[0]], [finished])]


def _parts(vector: Any, at: list[int]) -> tuple[Any, ...]:
    return tuple(vector[k] for k in at)


def _placed(corners: list[list[int]], change: Any) -> Any:
    out = ca.SX.zeros(_COORDINATES)
    for at, of_corner in zip(corners, change, strict=True):
        for k, one in zip(at, of_corner, strict=True):
            out[k] = one
    return out
