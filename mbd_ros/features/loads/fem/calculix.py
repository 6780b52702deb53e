"""Input of CalculiX and Abaqus: static steps, or loads as amplitudes.

Forces of joints, contacts and muscles act on reference nodes; gravity and the acceleration of the
origin as GRAV, the angular velocity as CENTRIF, the angular acceleration as forces on nodes, for
which there is no key word. Source: G. Dhondt, CalculiX CrunchiX USER'S MANUAL version 2.20,
sections *CLOAD, *COUPLING, *DISTRIBUTING, *DLOAD, *RIGID BODY.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.features.loads.fem.mesh import KINDS
from mbd_ros.features.loads.fem.model import Attachment, Body, Step, centre_field, load_over_time

_A_LINE = 16  # entries of a line
SOLID, _SPUN = "SOLID", "SPUN"
OUTPUT = "*NODE FILE", "U,RF", "*EL FILE", "S", "*NODE PRINT,NSET=SUPPORT", "RF"
_PAIRS = 4  # of time and value a line


def lines_of(body: Body, steps: Sequence[Step]) -> Iterator[str]:
    """The lines of an input file with a static step for every instant."""
    yield from model_lines(body)
    for i in range(len(steps)):  # CalculiX keeps the axis that CENTRIF first had for a set
        yield f"*ELSET,ELSET={_SPUN}_{i}"
        yield SOLID
    references = references_of(body)
    for i, step in enumerate(steps):
        yield from _step(body, step, references, f"{_SPUN}_{i}")


def model_lines(body: Body) -> Iterator[str]:
    """The lines before the first step: mesh, material, couplings and support."""
    units = body.units
    yield f"** loads on {body.history.body}: N, {units.name}, {units.mass}, s, {units.stress}"
    yield f"** axes and origin of the link {body.history.body}; held at {body.support}"
    yield from _mesh(body)
    yield from _material(body)
    references = references_of(body)
    for attachment in body.attachments:
        yield from _coupling(body, attachment, references[attachment.name])
    reference, turning = references[body.support]
    yield "*BOUNDARY"
    yield from (f"{node},1,3,0." for node in (reference, turning))
    yield "*NSET,NSET=SUPPORT"
    yield f"{reference},{turning}"


def _mesh(body: Body) -> Iterator[str]:
    yield "*NODE,NSET=NALL"
    points = body.mesh.points * body.units.per_metre
    yield from (f"{i},{_numbers(point)}" for i, point in enumerate(points, 1))
    number = len(points)
    for attachment in body.attachments:  # each with a node that moves and one that turns
        at = _numbers(attachment.reference * body.units.per_metre)
        yield from (f"{number + i},{at}" for i in (1, 2))
        number += 2
    element = 0
    for name, cells in body.mesh.blocks:
        yield f"*ELEMENT,TYPE={KINDS[name].calculix},ELSET={SOLID}"
        for nodes in cells + 1:
            element += 1
            yield from _listed([element, *nodes.tolist()])
    for attachment in body.attachments:
        yield f"*NSET,NSET={_name(attachment)}"
        yield from _listed((attachment.nodes + 1).tolist())


def _material(body: Body) -> Iterator[str]:
    young, poisson, density = body.material
    L = body.units.per_metre
    yield "*MATERIAL,NAME=MATERIAL"
    yield "*ELASTIC"
    yield f"{young / L**2:.12g},{poisson:.12g}"
    yield "*DENSITY"
    yield f"{density / L**4 if L != 1.0 else density:.12g}"
    yield f"*SOLID SECTION,ELSET={SOLID},MATERIAL=MATERIAL"


def references_of(body: Body) -> dict[str, tuple[int, int]]:
    """Return the nodes of each attachment that move and turn; of a distributing coupling one."""
    first, references = len(body.mesh.points), {}
    for i, attachment in enumerate(body.attachments):
        moving = first + 2 * i + 1
        references[attachment.name] = (
            moving,
            moving + 1 if _is_rigid(body, attachment) else moving,
        )
    return references


def _is_rigid(body: Body, attachment: Attachment) -> bool:
    return body.coupling == "rigid" or attachment.name == body.support


def _coupling(body: Body, attachment: Attachment, nodes: tuple[int, int]) -> Iterator[str]:
    moving, turning = nodes
    if _is_rigid(body, attachment):
        yield f"*RIGID BODY,NSET={_name(attachment)},REF NODE={moving},ROT NODE={turning}"
        return
    surface = f"FACES_{_name(attachment)}"
    yield f"*SURFACE,NAME={surface},TYPE=ELEMENT"
    yield from _faces(body, attachment)
    yield f"*COUPLING,REF NODE={moving},SURFACE={surface},CONSTRAINT NAME=C_{_name(attachment)}"
    yield "*DISTRIBUTING"
    yield "1,6"


def _faces(body: Body, attachment: Attachment) -> Iterator[str]:
    """Yield the faces of the surface whose corners are all nodes of the load."""
    counts: dict[tuple[int, ...], int] = {}
    faces: list[tuple[int, int, tuple[int, ...]]] = []
    chosen, element = set(attachment.nodes.tolist()), 0
    for name, cells in body.mesh.blocks:
        for nodes in cells.tolist():
            element += 1
            for side, corners in enumerate(KINDS[name].faces, 1):
                key = tuple(sorted(nodes[i] for i in corners))
                if chosen.issuperset(key):
                    counts[key] = counts.get(key, 0) + 1
                    faces.append((element, side, key))
    outside = [f"{element},S{side}" for element, side, key in faces if counts[key] == 1]
    if not outside:
        raise DataError(
            f"{body.mesh.name}: no face of the surface has all of its corners among the "
            f"{len(attachment.nodes)} nodes of load {attachment.name}; take more nodes, or "
            "--coupling rigid"
        )
    yield from outside


def _step(
    body: Body, step: Step, references: dict[str, tuple[int, int]], spun: str
) -> Iterator[str]:
    L = body.units.per_metre
    yield f"** t = {step.time:.9g} s: {step.label}"
    yield "*STEP"
    yield "*STATIC"
    yield "*CLOAD,OP=NEW"
    for attachment, force, moment in zip(body.loaded, step.forces, step.moments * L, strict=True):
        moving, turning = references[attachment.name]
        first = 1 if turning != moving else 4
        yield from (f"{moving},{i},{value:.12g}" for i, value in enumerate(force, 1))
        yield from (f"{turning},{i},{value:.12g}" for i, value in enumerate(moment, first))
    for node in np.flatnonzero(step.turning.any(axis=1)).tolist():
        yield from (f"{node + 1},{i},{v:.12g}" for i, v in enumerate(step.turning[node], 1))
    pull, spin = float(np.linalg.norm(step.gravity)), float(np.linalg.norm(step.spin))
    yield "*DLOAD,OP=NEW"
    if pull:
        yield f"{SOLID},GRAV,{pull * L:.12g},{_numbers(step.gravity / pull)}"
    if spin:
        yield f"{spun},CENTRIF,{spin**2:.12g},0.,0.,0.,{_numbers(step.spin / spin)}"
    yield from OUTPUT
    yield "*END STEP"


def amplitude_lines(body: Body) -> Iterator[str]:
    """Yield the lines of an input file with one step over the whole motion.

    Loads are amplitudes. CalculiX resolves the times of a static step only with large
    displacements, and takes one amplitude per node and direction. Gravity and inertia are
    therefore the field at the mass centre; the part by rotation is left out.

    Source: CalculiX CrunchiX USER'S MANUAL, sections *AMPLITUDE, *STATIC, *STEP.
    """
    stamps, L = body.history.stamps, body.units.per_metre
    times = (stamps - stamps[0]) * NANOSECOND
    yield from model_lines(body)
    references, forces, fields = references_of(body), list[str](), list[str]()
    for attachment in body.loaded:
        force, moment = load_over_time(body, attachment)
        moving, turning = references[attachment.name]
        first = 1 if turning != moving else 4
        for node, start, values in ((moving, 1, force), (turning, first, moment * L)):
            for axis, curve in enumerate(values.T):
                if curve.any():
                    name = f"LOAD_{len(forces)}"
                    yield from _amplitude(name, times, curve)
                    forces.append(f"*CLOAD,AMPLITUDE={name}\n{node},{start + axis},1.")
    for axis, curve in enumerate(centre_field(body).T * L):
        if curve.any():
            yield from _amplitude(f"FIELD_{axis}", times, curve)
            direction = ",".join("1." if i == axis else "0." for i in range(3))
            fields.append(f"*DLOAD,AMPLITUDE=FIELD_{axis}\n{SOLID},GRAV,1.,{direction}")
    yield f"** from t = {stamps[0] * NANOSECOND:.9g} s on"
    yield f"*STEP,NLGEOM,INC={2 * len(times) + 100}"
    yield "*STATIC,DIRECT"
    yield f"{times[-1] / max(len(times) - 1, 1):.12g},{times[-1]:.12g}"
    yield from (*forces, *fields, *OUTPUT, "*END STEP")


def _amplitude(name: str, times: Array, values: Array) -> Iterator[str]:
    yield f"*AMPLITUDE,NAME={name}"
    pairs = [f"{t:.12g},{v:.12g}" for t, v in zip(times.tolist(), values.tolist(), strict=True)]
    for i in range(0, len(pairs), _PAIRS):
        yield ",".join(pairs[i : i + _PAIRS])


def _numbers(values: Any) -> str:
    return ",".join(f"{value:.12g}" for value in values)


def _listed(entries: Sequence[int]) -> Iterator[str]:
    for i in range(0, len(entries), _A_LINE):
        more = "," if i + _A_LINE < len(entries) and len(entries) > _A_LINE else ""
        yield ",".join(map(str, entries[i : i + _A_LINE])) + more


def _name(attachment: Attachment) -> str:
    return "L_" + re.sub(r"\W", "_", attachment.name)


def text_of(lines: Iterable[str]) -> bytes:
    """Join lines to the content of a file."""
    return ("\n".join(lines) + "\n").encode()
