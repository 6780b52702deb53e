"""Files of meshes, as triangles to look at."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.mesh_file import load_mesh
from mbd_ros.view.surfaces import Surface

MAX_TRIANGLES = 500_000


def mesh_surface(file: Path, scale: Sequence[float], where: str) -> Surface:
    """The triangles of an STL, OBJ or DAE file.

    Args:
        scale: Factors along x, y and z.
        where: File and key, for the messages.

    Raises:
        SceneError: There is no such file, or it holds no mesh or too large a one.
    """
    model = load_mesh(file, scale, where)
    count = int(model.num_tris)
    if not 0 < count <= MAX_TRIANGLES:
        raise SceneError(
            f"{where}: {file} has {count} triangles, accepted are 1 .. {MAX_TRIANGLES}"
        )
    triangles = [(t[0], t[1], t[2]) for t in map(model.tri_indices, range(count))]
    vertices = np.array(model.vertices(), dtype=np.float32).reshape(-1, 3)
    return Surface(vertices, np.array(triangles, dtype=np.uint32))
