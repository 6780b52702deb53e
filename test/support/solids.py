"""Boxes, cylinders and tubes of quadratic elements, along z."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.loads.fem.mesh import HEX_EDGES, Mesh

Map = Callable[[Array], Array]
BOTTOM, TOP = "bottom", "top"
_CORNERS = np.array(
    [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]]
)


def box(size: Sequence[float], counts: Sequence[int]) -> Mesh:
    """A box about the origin in x and y, from z = 0 on.

    Args:
        size: Along x, y and z [m].
        counts: Elements along them.
    """
    length = np.array(size)
    return _mapped("box", counts, lambda u: (u - [0.5, 0.5, 0.0]) * length)


def cylinder(radius: float, length: float, counts: Sequence[int]) -> Mesh:
    """A cylinder along z from z = 0 on.

    Args:
        radius: [m].
        length: [m].
        counts: Elements across, and along.
    """

    def disc(u: Array) -> Array:
        flat = 2.0 * u[:, :2] - 1.0
        square = np.abs(flat).max(axis=1)
        far = np.linalg.norm(flat, axis=1)
        round_ = np.divide(square, far, out=np.ones_like(far), where=far > 0.0)
        pull = 1.0 + square**2 * (round_ - 1.0)
        return np.column_stack((radius * flat * pull[:, None], length * u[:, 2]))

    across, along = counts
    return _mapped("cylinder", (across, across, along), disc)


def tube(inner: float, outer: float, length: float, counts: Sequence[int]) -> Mesh:
    """A tube along z from z = 0 on.

    Args:
        inner: Inner radius [m].
        outer: Outer radius [m].
        length: [m].
        counts: Elements through the wall, around, and along.
    """

    def ring(u: Array) -> Array:
        radius, angle = inner + (outer - inner) * u[:, 0], 2.0 * np.pi * u[:, 1]
        return np.column_stack((radius * np.cos(angle), radius * np.sin(angle), length * u[:, 2]))

    return _mapped("tube", counts, ring, closed=True)


def _mapped(name: str, counts: Sequence[int], place: Map, closed: bool = False) -> Mesh:
    """A grid of the unit cube, mapped; `closed` joins both ends of its second direction."""
    nx, ny, nz = counts
    cells = np.stack(np.meshgrid(range(nx), range(ny), range(nz), indexing="ij"), -1)
    first = 2 * cells.reshape(-1, 1, 3)
    middles = np.array([(_CORNERS[a] + _CORNERS[b]) // 2 for a, b in HEX_EDGES])
    at = first + np.concatenate((_CORNERS, middles))
    if closed:
        at[..., 1] %= 2 * ny
    grid, nodes = np.unique(at.reshape(-1, 3), axis=0, return_inverse=True)
    points = place(grid / (2.0 * np.array([nx, ny, nz])))
    ends = {BOTTOM: grid[:, 2] == 0, TOP: grid[:, 2] == 2 * nz}
    sets = {end: np.flatnonzero(chosen) for end, chosen in ends.items()}
    return Mesh(name, points, (("hexahedron20", nodes.reshape(-1, 20)),), sets)


def write_mesh(mesh: Mesh, path: Path, per_metre: float) -> None:
    """Write a mesh with its sets to any file that meshio writes; `per_metre` lengths are 1 m."""
    import meshio  # here, since tests without it are skipped

    sets = {name: nodes.tolist() for name, nodes in mesh.sets.items()}
    cells = [(kind, nodes) for kind, nodes in mesh.blocks]
    meshio.Mesh(mesh.points * per_metre, cells, point_sets=sets).write(path)
