"""Solid elements: their mass, and what a field of accelerations exerts on their nodes.

Integration points are those of CalculiX for the same elements. Nodes stand in the order of VTK,
which is that of meshio and Abaqus. Source: T. J. R. Hughes, The Finite Element Method, 2000,
chapter 3; O. C. Zienkiewicz, R. L. Taylor, The Finite Element Method, 2000, vol. 1, sec. 8.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

Cells = NDArray[np.int64]
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_HEX = np.column_stack((np.tile(_SQUARE, (2, 1)), np.repeat([-1.0, 1.0], 4)))
HEX_EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)] + [
    (i, i + 4) for i in range(4)
]
TET_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
_MIDDLES = np.array([(_HEX[a] + _HEX[b]) / 2.0 for a, b in HEX_EDGES])


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


def _serendipity(x: NDArray[np.complex128] | Array) -> NDArray[np.complex128]:
    corner = (1.0 + _HEX * x).prod(axis=1) * ((_HEX * x).sum(axis=1) - 2.0) / 8.0
    across = np.where(_MIDDLES == 0.0, 1.0 - x * x, 1.0 + _MIDDLES * x)
    return np.concatenate((corner, across.prod(axis=1) / 4.0)).astype(np.complex128)


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


_GAUSS = 1.0 / np.sqrt(3.0)
_CUBE = np.array(list(itertools.product((-_GAUSS, _GAUSS), repeat=3)))
_IN, _OUT = 0.138196601125011, 0.585410196624968
_FOUR = np.full((4, 3), _IN) + (_OUT - _IN) * np.vstack((np.zeros(3), np.eye(3)))
_HEX_FACES = [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
_TET_FACES = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)]
KINDS = {
    "tetra": Kind("C3D4", "tet4", _tet4, np.full((1, 3), 0.25), np.ones(1) / 6.0, _TET_FACES),
    "tetra10": Kind(
        "C3D10", "tet10", _tet10, _FOUR, np.full(4, 1.0 / 24.0), _TET_FACES, TET_EDGES
    ),
    "hexahedron": Kind("C3D8I", "hex8", _hex8, _CUBE, np.ones(8), _HEX_FACES),
    "hexahedron20": Kind("C3D20R", "hex20", _hex20, _CUBE, np.ones(8), _HEX_FACES, HEX_EDGES),
}


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


def integration(points: Array, kind: Kind, cells: Cells) -> list[tuple[Array, Array, Array]]:
    """For each integration point: shape functions, places and volumes of all cells there."""
    found = []
    for xi, weight in zip(kind.points, kind.weights, strict=True):
        shape, slope = kind.shapes(xi)
        nodes = points[cells]
        jacobian = np.einsum("cni,nj->cij", nodes, slope)
        places = np.einsum("n,cni->ci", shape, nodes)
        found.append((shape, places, np.linalg.det(jacobian) * weight))
    return found


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
