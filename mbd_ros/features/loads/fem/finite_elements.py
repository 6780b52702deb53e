"""Loads as boundary conditions of finite elements, for several file formats."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from mbd_ros.errors import DataError
from mbd_ros.features.loads.fem.mesh import Mesh, mass_of, read_mesh
from mbd_ros.features.loads.fem.model import (
    COUPLINGS,
    Attachment,
    Body,
    Step,
    attachments_of,
    check_material,
    check_steps,
    check_tied,
    step_of,
)
from mbd_ros.features.loads.history import History, Instant, Units
from mbd_ros.files.text_file import replacing
from mbd_ros.jobs.progress import Say

_NOTHING: Mapping[str, str] = {}


class MeshTask(NamedTuple):
    """A solid of finite elements that takes the loads.

    Attributes:
        mesh: Mesh of solid elements, or its file, such as .msh, .vtu or .inp (extra fem).
        young: Young's modulus [Pa, or MPa with units mm]; required with a mesh.
        poisson: Poisson's ratio [-].
        density: Density [kg/m^3, or t/mm^3 with units mm]. By default the mesh gets the mass of
            the body.
        pose: Pose of the axes of the mesh in those of the link, as x, y, z [m, or mm] and roll,
            pitch, yaw [rad]. By default the axes are the same.
        attach: Nodes that take a load: the name of a set, or a radius about the point of the load
            [m, or mm].
        radius: Radius about the point of each load that `attach` does not name [m, or mm].
        support: Load whose nodes are fixed. By default it is the first.
        coupling: How the nodes share a load.
        amplitudes: Write one step over the whole motion in place of one for each instant (.inp).
    """

    mesh: Mesh | Path
    young: float
    poisson: float = 0.3
    density: float | None = None
    pose: Sequence[float] = ()
    attach: Mapping[str, str] = _NOTHING
    radius: float | None = None
    support: str | None = None
    coupling: Literal["rigid", "distributing"] = "rigid"
    amplitudes: bool = False


def body_of(
    history: History, instants: Sequence[Instant], task: MeshTask, units: Units
) -> tuple[Body, list[Step], str]:
    """Return the body as finite elements, its steps, and a line about the fit of the mesh.

    Raises:
        DataError: The mesh, a set, the material or the support cannot be used.
    """
    if task.coupling not in COUPLINGS:
        raise DataError(f"--coupling {task.coupling}: accepted: {', '.join(COUPLINGS)}")
    L = units.per_metre
    mesh = task.mesh if isinstance(task.mesh, Mesh) else read_mesh(task.mesh, L, task.pose)
    mass = mass_of(mesh.points, mesh.blocks)
    density = float(history.inertia.mass) / mass.volume
    if task.density is not None:
        density = task.density * (L**4 if L != 1.0 else 1.0)
    material = check_material(task.young * L**2, task.poisson, density, mesh.name)
    attach = {name: _metres(word, L) for name, word in task.attach.items()}
    radius = None if task.radius is None else task.radius / L
    attachments = attachments_of(history, mesh, attach, radius)
    support = _support(history, attachments, task.support)
    check_tied(mesh, attachments, support)
    rows = tuple(sorted({each.row for each in instants}))
    labels = tuple(", ".join(i.name for i in instants if i.row == row) for row in rows)
    body = Body(
        *(history, mesh, mass, material, tuple(attachments), support),
        *(task.coupling, rows, labels, units),
    )
    steps = [step_of(body, i) for i in range(len(rows))]
    return body, steps, check_steps(body, steps)


def _support(history: History, attachments: Sequence[Attachment], support: str | None) -> str:
    """Return the name of the load whose nodes are fixed."""
    names = [attachment.name for attachment in attachments]
    if not names:
        raise DataError(f"{history.body}: no load acts on it, so nothing can support a mesh")
    if support is not None and support not in names:
        raise DataError(f"--support {support}: no such load; accepted: {', '.join(names)}")
    return support or names[0]


def write_body(
    body: Body, steps: Sequence[Step], out: Path, say: Say, amplitudes: bool = False
) -> None:
    """Write a file in the format of its suffix: .inp, .feb or .vtu.

    Args:
        say: Called with each line for people.
        amplitudes: Whether an .inp has one step over the whole motion.

    Raises:
        DataError: The format cannot hold the steps, or the file cannot be written.
    """
    if amplitudes and out.suffix != ".inp":
        raise DataError(f"{out}: --amplitudes goes with .inp; .feb has load curves by itself")
    if out.suffix == ".vtu":
        from mbd_ros.features.loads.fem.paraview import write_series

        say(f"{write_series(body, steps, out)} files of {len(steps)} instants -> {out}")
        return
    from mbd_ros.features.loads.fem.calculix import text_of

    with replacing(out) as file:
        file.write(text_of(_lines(body, steps, out, amplitudes, say)))
    count = "one step with amplitudes" if amplitudes else f"{len(steps)} steps"
    say(f"{count}, {len(body.mesh.points)} nodes -> {out}")


def _lines(body: Body, steps: Sequence[Step], out: Path, amplitudes: bool, say: Say) -> Any:
    if out.suffix == ".inp" and not amplitudes:
        from mbd_ros.features.loads.fem.calculix import lines_of

        return lines_of(body, steps)
    from mbd_ros.features.loads.fem.model import rotation_share

    share = rotation_share(body)
    say(f"left out of {out.name}: inertia by rotation, at most {share:.2g} of the largest load")
    if out.suffix == ".inp":
        from mbd_ros.features.loads.fem.calculix import amplitude_lines

        return amplitude_lines(body)
    from mbd_ros.features.loads.fem.febio import feb_lines

    return feb_lines(body, steps)


def _metres(word: str, per_metre: float) -> str:
    try:
        return str(float(word) / per_metre)
    except ValueError:
        return word
