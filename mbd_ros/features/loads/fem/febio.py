"""Input of FEBio, specification 4.0: rigid bodies on nodes, loads as curves over the instants.

Time i + 1 of the file is instant i; between them loads go over linearly. Gravity and inertia act
as one field, that of the mass centre; its part by rotation is left out. Source: FEBio User
Manual, version 4, sections Rigid, Loads and LoadData.
"""

from collections.abc import Iterator, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.loads.fem.mesh import KINDS
from mbd_ros.features.loads.fem.model import Attachment, Body, Step, centre_field

_ANCHOR = 1.0e-3  # diagonals of the mesh: size of the element that stands for a rigid body
_DOFS = ("rigid_force", ("Rx", "Ry", "Rz")), ("rigid_moment", ("Ru", "Rv", "Rw"))


def feb_lines(body: Body, steps: Sequence[Step]) -> Iterator[str]:
    """The lines of an input file."""
    count = len(steps)
    yield '<?xml version="1.0" encoding="ISO-8859-1"?>'
    yield '<febio_spec version="4.0">'
    yield '<Module type="solid"/>'
    yield f"<Control><analysis>STATIC</analysis><time_steps>{count}</time_steps>"
    yield '<step_size>1</step_size><solver type="solid"/></Control>'
    yield from _materials(body)
    yield from _mesh(body)
    yield from _domains(body)
    curves: list[Array] = []
    rigid, field = list(_rigid(body, steps, curves)), list(_field(body, curves))
    yield "<LoadData>"
    for i, values in enumerate(curves, 1):
        points = "".join(f"<pt>{t},{v:.12g}</pt>" for t, v in enumerate([0.0, *values]))
        yield f'<load_controller id="{i}" type="loadcurve"><interpolate>LINEAR</interpolate>'
        yield f"<extend>CONSTANT</extend><points>{points}</points></load_controller>"
    yield "</LoadData>"
    yield from (*field, *rigid)
    yield "<Boundary>"
    for attachment in body.attachments:
        name, rigid_body = _q(attachment), _rb(attachment)
        yield f'<bc name={name} type="rigid" node_set={name}><rb>{rigid_body}</rb></bc>'
    yield "</Boundary>"
    yield '<Output><plotfile type="febio"><var type="displacement"/><var type="stress"/>'
    yield "</plotfile></Output>"
    yield "</febio_spec>"


def _materials(body: Body) -> Iterator[str]:
    (young, poisson, _), L = body.material, body.units.per_metre
    density = _density(body)
    yield "<Material>"
    yield '<material id="1" name="solid" type="isotropic elastic">'
    yield f"<density>{density:.12g}</density>"
    yield f"<E>{young / L**2:.12g}</E><v>{poisson:.12g}</v></material>"
    for i, attachment in enumerate(body.attachments, 2):
        centre = ",".join(f"{v:.12g}" for v in attachment.reference * L)
        yield f'<material id="{i}" name="{_rb(attachment)}" type="rigid body">'
        yield f"<density>{density:.12g}</density>"
        yield f"<center_of_mass>{centre}</center_of_mass></material>"
    yield "</Material>"


def _mesh(body: Body) -> Iterator[str]:
    points, L = body.mesh.points, body.units.per_metre
    small = _ANCHOR * body.mesh.diagonal * np.vstack((np.zeros(3), np.eye(3)))
    every = [points, *(attachment.reference + small for attachment in body.attachments)]
    yield '<Mesh><Nodes name="nodes">'
    for i, (x, y, z) in enumerate(np.concatenate(every) * L, 1):
        yield f'<node id="{i}">{x:.12g},{y:.12g},{z:.12g}</node>'
    yield "</Nodes>"
    element = 0
    for i, (name, cells) in enumerate(body.mesh.blocks):
        yield f'<Elements type="{KINDS[name].febio}" name="solid_{i}">'
        for nodes in (cells + 1).tolist():
            element += 1
            yield f'<elem id="{element}">{",".join(map(str, nodes))}</elem>'
        yield "</Elements>"
    for i, attachment in enumerate(body.attachments):
        first = len(points) + 4 * i + 1
        nodes = ",".join(str(first + j) for j in range(4))
        yield f'<Elements type="tet4" name="{_rb(attachment)}">'
        yield f'<elem id="{element + i + 1}">{nodes}</elem></Elements>'
    for attachment in body.attachments:
        nodes = ",".join(map(str, (attachment.nodes + 1).tolist()))
        yield f"<NodeSet name={_q(attachment)}>{nodes}</NodeSet>"
    yield "</Mesh>"


def _domains(body: Body) -> Iterator[str]:
    yield "<MeshDomains>"
    for i in range(len(body.mesh.blocks)):
        yield f'<SolidDomain name="solid_{i}" mat="solid"/>'
    for attachment in body.attachments:
        yield f'<SolidDomain name="{_rb(attachment)}" mat="{_rb(attachment)}"/>'
    yield "</MeshDomains>"


def _rigid(body: Body, steps: Sequence[Step], curves: list[Array]) -> Iterator[str]:
    yield "<Rigid>"
    dofs = "".join(f"<{d}_dof>1</{d}_dof>" for _, three in _DOFS for d in three)
    yield f'<rigid_bc type="rigid_fixed"><rb>{_rb(body.fixed)}</rb>{dofs}</rigid_bc>'
    for i, attachment in enumerate(body.loaded):
        moments = np.array([step.moments[i] for step in steps]) * body.units.per_metre
        both = np.array([step.forces[i] for step in steps]), moments
        for (kind, three), values in zip(_DOFS, both, strict=True):
            for dof, curve in zip(three, values.T, strict=True):
                curves.append(curve)
                yield f'<rigid_load type="{kind}"><rb>{_rb(attachment)}</rb>'
                yield f'<dof>{dof}</dof><value lc="{len(curves)}">1</value></rigid_load>'
    yield "</Rigid>"


def _field(body: Body, curves: list[Array]) -> Iterator[str]:
    """Gravity less the acceleration of the mass centre of the mesh; FEBio counts it negative."""
    field = centre_field(body)[list(body.rows)]
    yield "<Loads>"
    yield '<body_load type="const">'
    for axis, curve in zip("xyz", field.T * body.units.per_metre, strict=True):
        curves.append(-curve)
        yield f'<{axis} lc="{len(curves)}">1</{axis}>'
    yield "</body_load>"
    yield "</Loads>"


def _density(body: Body) -> float:
    L = body.units.per_metre
    return body.material.density / (L**4 if L != 1.0 else 1.0)


def _rb(attachment: Attachment) -> str:
    return "rigid_" + "".join(c if c.isalnum() else "_" for c in attachment.name)


def _q(attachment: Attachment) -> str:
    return quoteattr(attachment.name)
