"""A file of a mesh -> a convex body."""

from collections.abc import Sequence
from pathlib import Path

import coal
import numpy as np

from mbd_ros.core.geometry.shapes import Polyhedron, polyhedron
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.regular_file import check_regular

MAX_TRIANGLES = 5_000


def read_mesh(file: Path, scale: Sequence[float], where: str) -> Polyhedron:
    """The convex body of an STL, OBJ or DAE file.

    Args:
        scale: Factors along x, y and z.
        where: File and key, for the messages.

    Raises:
        SceneError: There is no such file, it holds no mesh, or the mesh is not convex.
    """
    try:
        check_regular(file)
        model = coal.MeshLoader().load(str(file), np.array(scale, dtype=np.float64))
    except OSError as error:
        raise SceneError(f"{where}: mesh {file} cannot be read: {error.strerror}") from error
    except (ValueError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-2:]
        raise SceneError(f"{where}: {file} holds no mesh: {' '.join(reason)}") from error
    if not 0 < model.num_tris <= MAX_TRIANGLES:
        raise SceneError(
            f"{where}: {file} has {model.num_tris} triangles, accepted are 1 .. {MAX_TRIANGLES}"
        )
    triangles = [[t[0], t[1], t[2]] for t in map(model.tri_indices, range(model.num_tris))]
    try:
        return polyhedron(np.array(model.vertices()), np.array(triangles, dtype=np.intp))
    except ModelError as error:
        raise SceneError(
            f"{where}: {file}: {error}; accepted: a convex mesh, or several of them"
        ) from error
