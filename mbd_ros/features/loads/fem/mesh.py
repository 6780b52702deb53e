"""Meshes of finite elements: solids, their mass, sets of nodes.

Integration points are those of CalculiX for the same elements. Nodes stand in the order of VTK,
which is that of meshio and Abaqus. Source: T. J. R. Hughes, The Finite Element Method, 2000,
chapter 3; O. C. Zienkiewicz, R. L. Taylor, The Finite Element Method, 2000, vol. 1, sec. 8.
"""

from __future__ import annotations

import glob
import itertools
import resource
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, install_hint
from mbd_ros.regular_file import check_regular

Cells = NDArray[np.int64]
Nodes = NDArray[np.int64]
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_HEX = np.column_stack((np.tile(_SQUARE, (2, 1)), np.repeat([-1.0, 1.0], 4)))
HEX_EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)] + [
    (i, i + 4) for i in range(4)
]
TET_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
_MIDDLES = np.array([(_HEX[a] + _HEX[b]) / 2.0 for a, b in HEX_EDGES])
_GAUSS = 1.0 / np.sqrt(3.0)  # two points of Gauss in [-1, 1]
_CUBE = np.array(list(itertools.product((-_GAUSS, _GAUSS), repeat=3)))
_IN, _OUT = 0.138196601125011, 0.585410196624968  # coordinates of four points in a tetrahedron
_FOUR = np.full((4, 3), _IN) + (_OUT - _IN) * np.vstack((np.zeros(3), np.eye(3)))
_HEX_FACES = [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
_TET_FACES = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)]
_FORMATS = {  # whose readers end where a file is cut, which those of mdpa, off and others do not
    **{".vtk": "vtk", ".vtu": "vtu", ".msh": "gmsh", ".inp": "abaqus"},
    **{".mesh": "medit", ".meshb": "medit", ".bdf": "nastran", ".nas": "nastran"},
    **{".fem": "nastran", ".su2": "su2", ".avs": "avsucd", ".f3grid": "flac3d"},
    **{".post": "permas", ".dato": "permas", ".med": "med", ".xdmf": "xdmf", ".xmf": "xdmf"},
    **{".cgns": "cgns", ".h5m": "h5m", ".hmf": "hmf", ".e": "exodus", ".exo": "exodus"},
    **{".ugrid": "ugrid", ".xml": "dolfin-xml", ".node": "tetgen", ".ele": "tetgen"},
}
_UNREADABLE = (  # what the readers of meshio raise on broken files
    *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError),
    *(NameError, OSError, RuntimeError, SyntaxError, SystemExit, TypeError, ValueError),
    *(struct.error, zlib.error),
)
_LEAST_MEMORY, _MEMORY_PER_BYTE = 1_000_000_000, 100  # bytes that reading a file may take
_OFF = 0.25  # lengths of an edge: how far its middle node may be off


class Mesh(NamedTuple):
    """Solid elements in axes of the body.

    Attributes:
        name: File, or what it is.
        points: Nodes [m], shape (n, 3).
        blocks: Kinds of elements of `KINDS`, and their nodes.
        sets: Nodes by the name of their set.
    """

    name: str
    points: Array
    blocks: tuple[tuple[str, Cells], ...]
    sets: Mapping[str, Nodes]

    @property
    def diagonal(self) -> float:
        """Diagonal of its bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


def read_mesh(path: Path, per_metre: float, pose: Sequence[float] = ()) -> Mesh:
    """A mesh from a file of one of `_FORMATS`, which meshio reads.

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
        from meshio._exceptions import CorruptionError
    except ModuleNotFoundError as error:
        raise DataError(install_hint("meshio")) from error
    form = _FORMATS.get(path.suffix.lower())
    if form is None:
        raise DataError(f"--mesh {path}: unknown format, accepted: {', '.join(_FORMATS)}")
    try:
        _check_files(path)
        with _limited_memory(_LEAST_MEMORY + _MEMORY_PER_BYTE * path.stat().st_size):
            read = meshio.read(path, form)
        points = np.asarray(read.points, dtype=np.float64) / per_metre
        solid = [(block.type, np.asarray(block.data, dtype=np.int64)) for block in read.cells]
    except ModuleNotFoundError as error:  # of some formats
        raise DataError(f"--mesh {path}: {error.name} is not installed") from error
    except (*_UNREADABLE, meshio.ReadError, CorruptionError) as error:
        raise DataError(f"--mesh {path}: cannot be read ({str(error) or type(error)})") from error
    blocks = tuple((kind, cells) for kind, cells in solid if kind in KINDS and len(cells))
    others = sorted({b.type for b in read.cells if b.dim == 3} - KINDS.keys())
    if others or not blocks:
        found = ", ".join(others or sorted({kind for kind, _ in solid})) or "nothing"
        raise DataError(f"--mesh {path}: has {found}; accepted solids: {', '.join(KINDS)}")
    if points.shape[1:] != (3,) or not np.isfinite(points).all():
        raise DataError(f"--mesh {path}: its nodes are not three finite numbers each")
    if not (np.abs(points) <= LARGEST).all():
        raise DataError(f"--mesh {path}: has nodes beyond {LARGEST:g} m")
    for kind, cells in solid:
        _check_nodes(path, f"its {kind}", cells, len(points))
    for kind, cells in blocks:
        count = len(KINDS[kind].shapes(np.zeros(3))[0])
        if cells.shape[1:] != (count,):
            raise DataError(f"--mesh {path}: its {kind} have not {count} nodes each")
    if len(pose):
        points = points @ rotation_matrix(pose[3:]).T + np.array(pose[:3]) / per_metre
    mesh = _without_loose(Mesh(str(path), points, blocks, _sets(path, read, len(points))))
    _check(mesh)
    return mesh


def _check_files(path: Path, above: Sequence[Path] = ()) -> None:
    """Refuse what is no regular file, among the files that meshio reads with a mesh as well.

    Args:
        above: Files of Abaqus that include this one.

    Raises:
        OSError: It is none, or absent.
        ValueError: Files include one another in a circle.
    """
    check_regular(path)
    if path.resolve() in above:
        raise ValueError(f"{path} includes itself")
    suffix = path.suffix.lower()
    if suffix == ".inp":
        for name in _included(path):
            _check_files(name if name.exists() else path.parent / name, [*above, path.resolve()])
    elif suffix in (".xdmf", ".xmf"):
        for name in filter(Path.exists, _data_of_xdmf(path)):
            check_regular(name)
    elif suffix == ".xml":  # data of DOLFIN
        for name in path.parent.glob(f"{glob.escape(path.stem)}_*.xml"):
            check_regular(name)
    elif suffix in (".node", ".ele"):  # points and elements of TetGen
        check_regular(path.with_suffix(".ele" if suffix == ".node" else ".node"))


def _included(path: Path) -> Iterator[Path]:
    """Files that one of Abaqus includes, as it names them."""
    with path.open(encoding="utf-8", errors="surrogateescape") as lines:
        for line in lines:
            if line.upper().startswith("*INCLUDE"):
                yield Path(line.split("=")[-1].strip())


def _data_of_xdmf(path: Path) -> Iterator[Path]:
    """Files with the numbers of an XDMF file."""
    try:
        for _, element in ElementTree.iterparse(path):
            if element.tag == "DataItem" and element.get("Format") in ("HDF", "Binary"):
                name = (element.text or "").strip().partition(":")[0]
                yield from (path.parent / name, Path(name))
            element.clear()
    except ElementTree.ParseError as error:
        raise ValueError(f"not well-formed XML: {error}") from error


@contextmanager
def _limited_memory(more: int) -> Iterator[None]:
    """Let the process take so many more bytes at most; beyond it MemoryError is raised.

    Readers of meshio make arrays as large as a number in the file says: up to the largest tag of
    a node of Gmsh, or of the cells of a structured grid.
    """
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    ours = pages * resource.getpagesize() + more
    limits = [one for one in (ours, soft, hard) if one != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _check_nodes(path: Path, what: str, nodes: Nodes, count: int) -> None:
    """Refuse numbers of nodes that are not there."""
    if nodes.size and not (nodes.min() >= 0 and nodes.max() < count):
        named = f"{nodes.min()} .. {nodes.max()}"
        raise DataError(f"--mesh {path}: {what}: nodes {named}, there are 0 .. {count - 1}")


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


def _sets(path: Path, read: Any, count: int) -> dict[str, Nodes]:
    """Sets of nodes, and the nodes of sets of cells."""
    try:
        sets = {name: np.asarray(nodes, dtype=np.int64) for name, nodes in read.point_sets.items()}
        groups = _groups(read)
    except (ValueError, TypeError, IndexError) as error:
        raise DataError(f"--mesh {path}: its sets cannot be read ({error})") from error
    grouped = {name: np.unique(np.concatenate(nodes)) for name, nodes in groups.items()}
    for name, nodes in sets.items():
        _check_nodes(path, f"set {name}", nodes, count)
    return {**grouped, **sets}


def _groups(read: Any) -> dict[str, list[Nodes]]:
    """Nodes of sets of cells, and of the tags of Gmsh, by their names."""
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
    return groups


def _check(mesh: Mesh) -> None:
    """Refuse elements without volume, and nodes in another order."""
    for name, cells in mesh.blocks:
        parts = integration(mesh.points, KINDS[name], cells)
        if not sum(float(volume.sum()) for _, _, volume in parts) > 0.0:
            raise DataError(f"{mesh.name}: its {name} have no volume: turned inside out, or flat")
        corners = 4 if name.startswith("tetra") else 8
        for i, (a, b) in enumerate(KINDS[name].edges):
            ends = mesh.points[cells[:, a]], mesh.points[cells[:, b]]
            off = np.linalg.norm(mesh.points[cells[:, corners + i]] - sum(ends) / 2.0, axis=1)
            length = np.linalg.norm(ends[1] - ends[0], axis=1)
            if (off > _OFF * length).any():
                raise DataError(f"{mesh.name}: nodes of its {name} are not in the order of VTK")


def mass_of(points: Array, blocks: Sequence[tuple[str, Cells]]) -> MeshMass:
    """Mass properties of a mesh."""
    at, volumes = [], []
    for name, cells in blocks:
        for _, places, volume in integration(points, KINDS[name], cells):
            at.append(places)
            volumes.append(volume)
    place, part = np.concatenate(at), np.concatenate(volumes)
    total = float(part.sum())
    centre = part.dot(place) / total
    arm = place - centre
    second = np.einsum("p,pi,pj->ij", part, arm, arm)
    return MeshMass(total, centre, np.trace(second) * np.eye(3) - second)


def integration(points: Array, kind: Kind, cells: Cells) -> list[tuple[Array, Array, Array]]:
    """For each integration point: shape functions, places and volumes of all cells there."""
    rules = []
    for xi, weight in zip(kind.points, kind.weights, strict=True):
        shape, slope = kind.shapes(xi)
        nodes = points[cells]
        jacobian = np.einsum("cni,nj->cij", nodes, slope)
        places = np.einsum("n,cni->ci", shape, nodes)
        rules.append((shape, places, np.linalg.det(jacobian) * weight))
    return rules


def nodal_forces(
    points: Array, blocks: Sequence[tuple[str, Cells]], field: Callable[[Array], Array]
) -> Array:
    """Forces on nodes that do the work of a force per volume.

    Args:
        points: Nodes [m], shape (n, 3).
        blocks: Kinds of elements and their nodes.
        field: Force per volume at places of shape (m, 3) [N/m^3], same shape.

    Returns:
        [N], shape (n, 3).
    """
    forces = np.zeros(points.shape)
    for name, cells in blocks:
        for shape, places, volume in integration(points, KINDS[name], cells):
            push = field(places) * volume[:, None]
            np.add.at(forces, cells, shape[None, :, None] * push[:, None, :])
    return forces


class MeshMass(NamedTuple):
    """Mass properties of a mesh of density 1.

    Attributes:
        volume: [m^3].
        centre: [m], shape (3,).
        inertia: About the centre [m^5], shape (3, 3).
    """

    volume: float
    centre: Array
    inertia: Array


class Kind(NamedTuple):
    """A kind of element.

    Attributes:
        calculix: What CalculiX and Abaqus call it.
        febio: What FEBio calls it.
        shapes: Shape functions and their derivatives at a point of the unit element.
        points: Integration points, shape (m, 3).
        weights: Of these, shape (m,).
        faces: Corners of its faces, in the order of Abaqus.
        edges: Corners of the edges that have a node in the middle.
    """

    calculix: str
    febio: str
    shapes: Callable[[Array], tuple[Array, Array]]
    points: Array
    weights: Array
    faces: Sequence[tuple[int, ...]]
    edges: Sequence[tuple[int, int]] = ()


def _tet4(x: Array) -> tuple[Array, Array]:
    slope = np.array([[-1.0, -1.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return np.array([1.0 - x.sum(), *x]), slope


def _tet10(x: Array) -> tuple[Array, Array]:
    L, slope = _tet4(x)
    corner, at_corner = L * (2.0 * L - 1.0), slope * (4.0 * L - 1.0)[:, None]
    a, b = np.array(TET_EDGES).T
    middle = 4.0 * L[a] * L[b]
    at_middle = 4.0 * (slope[a] * L[b][:, None] + slope[b] * L[a][:, None])
    return np.concatenate((corner, middle)), np.concatenate((at_corner, at_middle))


def _hex8(x: Array) -> tuple[Array, Array]:
    terms = 1.0 + _HEX * x
    shape = terms.prod(axis=1) / 8.0
    slope = np.stack(
        [_HEX[:, i] * terms[:, [j for j in range(3) if j != i]].prod(axis=1) for i in range(3)], 1
    )
    return shape, slope / 8.0


def _hex20(x: Array) -> tuple[Array, Array]:
    """Serendipity functions; slopes by complex steps, exact for polynomials."""
    slope = np.stack([_serendipity(x + 1e-30j * axis).imag / 1e-30 for axis in np.eye(3)], 1)
    return _serendipity(x).real, slope


KINDS = {
    "tetra": Kind("C3D4", "tet4", _tet4, np.full((1, 3), 0.25), np.ones(1) / 6.0, _TET_FACES),
    "tetra10": Kind(
        "C3D10", "tet10", _tet10, _FOUR, np.full(4, 1.0 / 24.0), _TET_FACES, TET_EDGES
    ),
    "hexahedron": Kind("C3D8I", "hex8", _hex8, _CUBE, np.ones(8), _HEX_FACES),
    "hexahedron20": Kind("C3D20R", "hex20", _hex20, _CUBE, np.ones(8), _HEX_FACES, HEX_EDGES),
}


def _serendipity(x: NDArray[np.complex128] | Array) -> NDArray[np.complex128]:
    corner = (1.0 + _HEX * x).prod(axis=1) * ((_HEX * x).sum(axis=1) - 2.0) / 8.0
    across = np.where(_MIDDLES == 0.0, 1.0 - x * x, 1.0 + _MIDDLES * x)
    return np.concatenate((corner, across.prod(axis=1) / 4.0)).astype(np.complex128)
