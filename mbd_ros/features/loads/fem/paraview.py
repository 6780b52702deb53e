"""Series of files for ParaView: the mesh, and the loads as points with arrows."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mbd_ros.errors import DataError, install_hint
from mbd_ros.features.loads.fem.model import Body, Step
from mbd_ros.files.text_file import replacing


def write_series(body: Body, steps: Sequence[Step], out: Path) -> int:
    """Write a .vtu for every instant, and a .pvd beside them that lists them with their times.

    Points are the nodes, then the places of the loads; their arrays: `force`, `moment` and
    `turning` (of the angular acceleration), `load` (0 on the mesh, else its number from 1 on).

    Args:
        out: As `pylon.vtu`: files are `pylon_0000.vtu`, .., and `pylon.pvd`.

    Returns:
        How many files were written.
    """
    try:
        import meshio
    except ModuleNotFoundError as error:
        raise DataError(install_hint("meshio")) from error
    L, mesh = body.units.per_metre, body.mesh
    count, k = len(mesh.points), len(body.loaded)
    at = np.array([attachment.reference for attachment in body.loaded]).reshape(-1, 3)
    points = np.concatenate((mesh.points, at)) * L
    cells = [*mesh.blocks, ("vertex", np.arange(count, count + k).reshape(-1, 1))]
    number = np.concatenate((np.zeros(count), np.arange(1, k + 1)))
    names = []
    for i, step in enumerate(steps):
        empty, none = np.zeros((count, 3)), np.zeros((k, 3))
        data = {
            "force": np.concatenate((empty, step.forces)),
            "moment": np.concatenate((empty, step.moments * L)),
            "turning": np.concatenate((step.turning, none)),
            "load": number,
        }
        names.append(out.with_name(f"{out.stem}_{i:04d}.vtu"))
        with TemporaryDirectory() as folder, replacing(names[-1]) as file:
            meshio.Mesh(points, cells, point_data=data).write(f"{folder}/instant.vtu")
            file.write(Path(f"{folder}/instant.vtu").read_bytes())
    sets = "".join(
        f'<DataSet timestep="{step.time:.9g}" file="{name.name}"/>\n'
        for step, name in zip(steps, names, strict=True)
    )
    text = f'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"><Collection>\n{sets}'
    with replacing(out.with_suffix(".pvd")) as file:
        file.write(f"{text}</Collection></VTKFile>\n".encode())
    return len(names) + 1
