"""Where molecules stand at the start: at given places, on a lattice, or as in a file.

Files of positions are GROMOS87 (.gro), Protein Data Bank (.pdb) and XYZ.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from mbd_ros.core.ranges import Within
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.methods.particles.molecules import Molecules
from mbd_ros.methods.particles.rigid_bonds import DistanceRow
from mbd_ros.methods.particles.units import ANGSTROM, NANOMETRE, Units
from mbd_ros.scene.particles.molecules import MoleculeEntry
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file
from mbd_ros.scene.schema.strict_yaml import read_text

Seed = Annotated[int, Within(0, 2**63 - 1)]
_LONGEST = 200_000_000  # bytes
_UNLIKE = 0.4  # of a length: what its bond in a file differs by, if it is that bond


class Room(NamedTuple):
    """The box and the molecules that are placed already.

    Attributes:
        folder: Where relative paths start.
        units: Of the scene.
        box: Edges of the periodic box; None without one.
    """

    folder: Path
    units: Units
    box: Array | None


def placed(entry: MoleculeEntry, room: Room) -> Array:
    """Positions of all atoms of a kind, shape (count * atoms, 3).

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    kind, where = entry.kind, f"{entry.where}.placement"
    if entry.placement is None:
        if kind.count > 1 and room.box is not None:
            return _on_lattice(kind, room.box, 0)
        return np.tile(kind.at, (kind.count, 1))
    placement: _Placement = schema.call(_Placement, entry.placement, where)
    ways = (placement.positions, placement.file, placement.lattice)
    if sum(way is not None for way in ways) != 1:
        raise SceneError(f"{where}: give either 'positions', 'file' or 'lattice'")
    if placement.file is not None:
        return _from_file(kind, placement.file, room, where)
    if placement.positions is not None:
        offsets = _offsets(placement.positions, kind.count, f"{where}.positions")
        return (offsets[:, None] + kind.at).reshape(-1, 3)
    if placement.lattice != "cubic":
        raise SceneError(f"{where}.lattice: got {placement.lattice!r}, accepted: cubic")
    if room.box is None:
        raise SceneError(f"{where}.lattice: needs the key 'box' of particles")
    return _on_lattice(kind, room.box, placement.seed)


def _on_lattice(kind: Molecules, box: Array, seed: int) -> Array:
    """Centres of the cells of a cubic lattice, turned at random."""
    edge = math.ceil(kind.count ** (1.0 / 3.0) - 1.0e-9)
    cells = np.array(list(np.ndindex(edge, edge, edge)))[: kind.count]
    turns = np.random.Generator(np.random.Philox(seed)).normal(size=(kind.count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    center = kind.masses.dot(kind.at) / kind.masses.sum()
    turned = np.einsum("nij,aj->nai", _rotations(turns), kind.at - center)
    return (((cells + 0.5) / edge * box)[:, None] + turned).reshape(-1, 3)


def _rotations(unit: Array) -> Array:
    """Rotation matrices of unit quaternions (x, y, z, w), shape (n, 3, 3)."""
    v, w = unit[:, :3], unit[:, 3, None, None]
    cross = np.cross(np.eye(3)[None], v[:, None, :])
    rotations: Array = np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
    return rotations


@dataclass(frozen=True)
class _Placement:
    positions: Sequence[Any] | None = None
    file: str | None = None
    lattice: str | None = None
    seed: Seed = 0


def _from_file(kind: Molecules, name: str, room: Room, where: str) -> Array:
    path = find_file(room.folder, name, f"{where}.file")
    if not room.units.sizes:
        raise SceneError(
            f"{where}.file: {path} has units of its own, a scene in reduced units not"
        )
    metres = read_coordinates(path, f"{where}.file")
    if len(metres) != kind.size:
        raise SceneError(
            f"{where}.file: {path} has {len(metres)} atoms, accepted: {kind.size}, "
            f"{kind.count} times {', '.join(kind.atoms)}"
        )
    return _unwrapped(kind, metres / room.units.sizes[0], room.box, f"{where}.file: {path}")


def read_coordinates(path: Path, where: str) -> Array:
    """Positions of all atoms of a file, in its order [m], shape (n, 3).

    Args:
        path: Its suffix chooses the format: GROMOS87 (nm), Protein Data Bank and XYZ (angstrom).
        where: File and key, for the messages.

    Raises:
        SceneError: It cannot be read, or holds something else.
    """
    readers = {".gro": (_gro, NANOMETRE), ".pdb": (_pdb, ANGSTROM), ".xyz": (_xyz, ANGSTROM)}
    if path.suffix.lower() not in readers:
        raise SceneError(f"{where}: {path}: accepted are {', '.join(readers)}")
    read, unit = readers[path.suffix.lower()]
    lines = read_text(path, _LONGEST, "file of positions").splitlines()
    try:
        positions = np.array(list(read(lines)), dtype=np.float64).reshape(-1, 3)
    except (ValueError, IndexError) as error:
        raise SceneError(f"{where}: {path}: is no {path.suffix} of positions: {error}") from error
    if not len(positions) or not np.isfinite(positions).all():
        raise SceneError(f"{where}: {path}: positions are missing or not finite")
    return positions * unit


def _gro(lines: list[str]) -> Iterator[list[float]]:
    """Columns of a width that the distance of the decimal points tells."""
    count = int(lines[1])
    if len(lines) < count + 3:
        raise ValueError(f"it announces {count} atoms and has {max(len(lines) - 3, 0)}")
    for line in lines[2 : 2 + count]:
        first = line.index(".", 20)
        width = line.index(".", first + 1) - first
        yield [float(line[20 + k * width : 20 + (k + 1) * width]) for k in range(3)]


def _pdb(lines: list[str]) -> Iterator[list[float]]:
    for line in lines:
        if line.startswith(("ATOM  ", "HETATM")):
            yield [float(line[start : start + 8]) for start in (30, 38, 46)]
        elif line.startswith("ENDMDL"):
            return


def _xyz(lines: list[str]) -> Iterator[list[float]]:
    count = int(lines[0])
    if len(lines) < count + 2:
        raise ValueError(f"it announces {count} atoms and has {max(len(lines) - 2, 0)}")
    for line in lines[2 : 2 + count]:
        yield [float(word) for word in line.split()[1:4]]


def _unwrapped(kind: Molecules, x: Array, box: Array | None, where: str) -> Array:
    """The same positions, molecules that the box cuts put together.

    Raises:
        SceneError: A bond is far from its length: the atoms stand in another order.
    """
    positions = x.reshape(kind.count, -1, 3)
    if box is not None:
        positions = positions - box * np.rint((positions - positions[:, :1]) / box)
    for row in kind.rows:
        if not isinstance(row, DistanceRow):
            continue
        apart = np.linalg.norm(positions[:, row.i] - positions[:, row.j], axis=1)
        k = int(np.argmax(np.abs(apart / row.length - 1.0)))
        if not abs(apart[k] / row.length - 1.0) <= _UNLIKE:
            raise SceneError(
                f"{where}: {row.name} of molecule {k + 1} is {apart[k]:.3g} long, accepted: about "
                f"{row.length:.3g}; are its atoms in the order {', '.join(kind.atoms)}?"
            )
    return positions.reshape(-1, 3)


def _offsets(rows: Sequence[Any], count: int, where: str) -> Array:
    try:
        offsets = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        offsets = np.zeros(0)
    if offsets.shape != (count, 3) or not np.isfinite(offsets).all():
        raise SceneError(f"{where}: expected {count} places of 3 numbers, one a molecule")
    return offsets
