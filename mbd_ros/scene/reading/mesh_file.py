"""Files of meshes: their triangles, and the convex body that they are."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np

from mbd_ros.core.geometry.shapes import Polyhedron, polyhedron
from mbd_ros.core.ranges import LARGEST
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.regular_file import check_regular

MAX_TRIANGLES = 5_000
ENDINGS = (".stl", ".obj", ".dae", ".ply")  # formats that need no other files
_MATERIALS = b"mtllib"  # line of an .obj that names a file of colours


def read_mesh(file: Path, scale: Sequence[float], where: str) -> Polyhedron:
    """The convex body of an STL, OBJ or DAE file.

    Args:
        scale: Factors along x, y and z.
        where: File and key, for the messages.

    Raises:
        SceneError: There is no such file, it holds no mesh, or the mesh is not convex.
    """
    model = load_mesh(file, scale, where)
    if not 0 < model.num_tris <= MAX_TRIANGLES:
        raise SceneError(
            f"{where}: {file} has {model.num_tris} triangles, accepted are 1 .. {MAX_TRIANGLES}"
        )
    vertices = np.array(model.vertices())
    if not (np.abs(vertices) <= LARGEST).all():
        raise SceneError(f"{where}: {file} has vertices beyond a size of {LARGEST:g}")
    triangles = [[t[0], t[1], t[2]] for t in map(model.tri_indices, range(model.num_tris))]
    try:
        return polyhedron(vertices, np.array(triangles, dtype=np.intp))
    except ModelError as error:
        raise SceneError(
            f"{where}: {file}: {error}; accepted: a convex mesh, or several of them"
        ) from error


def load_mesh(file: Path, scale: Sequence[float], where: str) -> Any:
    """The triangles of an STL, OBJ, DAE or PLY file, as coal holds them.

    Args:
        scale: Factors along x, y and z.
        where: File and key, for the messages.

    Raises:
        SceneError: There is no such file, or it holds no mesh.
    """
    if file.suffix.lower() not in ENDINGS:
        raise SceneError(f"{where}: mesh {file}: accepted are {', '.join(ENDINGS)}")
    try:
        check_regular(file)
        if file.suffix.lower() == ".obj":
            _check_materials(file)
        return coal.MeshLoader().load(str(file), np.array(scale, dtype=np.float64))
    except OSError as error:
        raise SceneError(f"{where}: mesh {file} cannot be read: {error.strerror}") from error
    except (ValueError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-2:]
        raise SceneError(f"{where}: {file} holds no mesh: {' '.join(reason)}") from error


def _check_materials(file: Path) -> None:
    """Refuse colours that are no regular file: coal would open them.

    Raises:
        OSError: They are none.
    """
    names = [file.with_suffix(".mtl")]  # is read where there is no other one
    with file.open("rb") as lines:
        for line in lines:
            if _MATERIALS in line:
                named = line.partition(_MATERIALS)[2].strip()
                names.append(file.parent / os.fsdecode(named.replace(b"\0", b"")))
    for name in filter(Path.exists, names):
        check_regular(name)
