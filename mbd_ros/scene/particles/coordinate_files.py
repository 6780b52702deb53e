"""Positions of atoms in files of others: .gro, .pdb and .xyz."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mbd_ros.core.particles.units import ANGSTROM, NANOMETRE
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.schema.strict_yaml import read_text

_LONGEST = 200_000_000  # bytes


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
