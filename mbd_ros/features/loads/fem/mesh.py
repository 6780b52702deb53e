"""Meshes of finite elements: solids, sets of nodes, units."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, install_hint
from mbd_ros.features.loads.fem.elements import KINDS, Cells, mass_of

Nodes = NDArray[np.int64]
_OFF = 0.25  # lengths of an edge: how far its middle node may be off


class Mesh(NamedTuple):
    """Solid elements in axes of the body.

    Attributes:
        name: File, or what it is.
        points: Nodes [m], shape (n, 3).
        blocks: Kinds of elements of `elements.KINDS`, and their nodes.
        sets: Nodes by the name of their set.
    """

    name: str
    points: Array
    blocks: tuple[tuple[str, Cells], ...]
    sets: Mapping[str, Nodes]

    @property
    def diagonal(self) -> float:
        """Of its bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


def read_mesh(path: Path, per_metre: float, pose: Sequence[float] = ()) -> Mesh:
    """A mesh from any file that meshio reads.

    Args:
        per_metre: Its lengths in a metre.
        pose: Place and roll, pitch, yaw of the axes of the mesh in those of the body, in lengths
            of the mesh and rad; none where they are the same.

    Raises:
        DataError: meshio is not installed, the file cannot be read, has no solid elements or
            others than it may, or elements of no volume.
    """
    try:
        import meshio
    except ModuleNotFoundError as error:
        raise DataError(install_hint("meshio")) from error
    if not path.is_file():
        raise DataError(f"--mesh {path}: no such file")
    try:
        read = meshio.read(path)
    except (meshio.ReadError, OSError, ValueError, KeyError, IndexError, SystemExit) as error:
        raise DataError(f"--mesh {path}: cannot be read ({error})") from error
    solid = [(block.type, np.asarray(block.data, dtype=np.int64)) for block in read.cells]
    blocks = tuple((kind, cells) for kind, cells in solid if kind in KINDS)
    others = sorted({b.type for b in read.cells if b.dim == 3} - KINDS.keys())
    if others or not blocks:
        found = ", ".join(others or sorted({kind for kind, _ in solid})) or "nothing"
        raise DataError(f"--mesh {path}: has {found}; accepted solids: {', '.join(KINDS)}")
    points = np.asarray(read.points, dtype=np.float64) / per_metre
    if points.shape[1] != 3 or not np.isfinite(points).all():
        raise DataError(f"--mesh {path}: its nodes are not three finite numbers each")
    if len(pose):
        points = points @ rotation_matrix(pose[3:]).T + np.array(pose[:3]) / per_metre
    mesh = _without_loose(Mesh(str(path), points, blocks, _sets(read)))
    _check(mesh)
    return mesh


def _without_loose(mesh: Mesh) -> Mesh:
    """The mesh without nodes that no solid has."""
    used = np.unique(np.concatenate([cells.ravel() for _, cells in mesh.blocks]))
    if len(used) == len(mesh.points):
        return mesh
    to = np.full(len(mesh.points), -1)
    to[used] = np.arange(len(used))
    blocks = tuple((kind, to[cells]) for kind, cells in mesh.blocks)
    sets = {name: to[nodes][to[nodes] >= 0] for name, nodes in mesh.sets.items()}
    return Mesh(mesh.name, mesh.points[used], blocks, sets)


def _sets(read: Any) -> dict[str, Nodes]:
    """Sets of nodes, and the nodes of sets of cells."""
    sets = {name: np.asarray(nodes, dtype=np.int64) for name, nodes in read.point_sets.items()}
    groups: dict[str, list[Nodes]] = {}
    for name, per_block in read.cell_sets.items():
        for block, cells in zip(read.cells, per_block, strict=True):
            if cells is not None and len(cells):
                nodes = np.asarray(block.data)[np.asarray(cells, dtype=np.int64)]
                groups.setdefault(name, []).append(nodes.ravel())
    tags = read.cell_data.get("gmsh:physical", [])
    for name, (tag, _) in read.field_data.items():
        for block, of_cells in zip(read.cells, tags, strict=False):
            chosen = np.asarray(block.data)[np.asarray(of_cells) == tag]
            if len(chosen):
                groups.setdefault(name, []).append(chosen.ravel())
    grouped = {name: np.unique(np.concatenate(nodes)) for name, nodes in groups.items()}
    return {**grouped, **sets}


def _check(mesh: Mesh) -> None:
    """Refuse elements without volume, and nodes in another order."""
    for name, cells in mesh.blocks:
        volume = mass_of(mesh.points, [(name, cells)]).volume
        if not volume > 0.0:
            raise DataError(f"{mesh.name}: its {name} have no volume: turned inside out, or flat")
        corners = 4 if name.startswith("tetra") else 8
        for i, (a, b) in enumerate(KINDS[name].edges):
            ends = mesh.points[cells[:, a]], mesh.points[cells[:, b]]
            off = np.linalg.norm(mesh.points[cells[:, corners + i]] - sum(ends) / 2.0, axis=1)
            length = np.linalg.norm(ends[1] - ends[0], axis=1)
            if (off > _OFF * length).any():
                raise DataError(f"{mesh.name}: nodes of its {name} are not in the order of VTK")
