"""A body as finite elements: mesh, material, support, and the loads of each step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mbd_ros.core.kinematics.poses import cross
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.loads.fem.mesh import Mesh, MeshMass, Nodes, nodal_forces
from mbd_ros.features.loads.free_body import inertial_load
from mbd_ros.features.loads.history import History, Units

COUPLINGS = "rigid", "distributing"
_ROUNDING = 1.0e-9  # of the largest load: smaller loads need no nodes
DENSITIES = (1.0, 30_000.0)  # kg/m^3, range of materials
_ALIEN = 0.5  # of the largest load: a larger residual shows the mesh of another body


class Body(NamedTuple):
    """A finite-element model for all writers, in SI units and axes of the link.

    Attributes:
        history: Loads on the body over time.
        mesh: The mesh.
        mass: Mass properties of the mesh with density 1.
        material: Material of the mesh.
        attachments: Nodes of the loads, including that of the support.
        support: Name of the load whose nodes are fixed, so that it becomes a reaction.
        coupling: `rigid` or `distributing`.
        rows: Samples that are steps, in order.
        labels: Names of the peaks or instants at these samples.
        units: Units of the file.
    """

    history: History
    mesh: Mesh
    mass: MeshMass
    material: Material
    attachments: tuple[Attachment, ...]
    support: str
    coupling: str
    rows: tuple[int, ...]
    labels: tuple[str, ...]
    units: Units

    @property
    def fixed(self) -> Attachment:
        """Attachment of the support."""
        return next(
            attachment for attachment in self.attachments if attachment.name == self.support
        )

    @property
    def loaded(self) -> list[Attachment]:
        """Attachments of all other loads."""
        return [attachment for attachment in self.attachments if attachment.name != self.support]


class Material(NamedTuple):
    """A linear elastic, isotropic material.

    Attributes:
        young: Young's modulus [Pa].
        poisson: Poisson's ratio [-].
        density: Density [kg/m^3].
    """

    young: float
    poisson: float
    density: float


class Step(NamedTuple):
    """Loads at one instant.

    Attributes:
        time: Time [s].
        label: Names of the peaks or instants.
        forces: Force of each attachment of `Body.loaded` [N], shape (k, 3).
        moments: Moments about their reference points [N·m], shape (k, 3).
        gravity: Gravity less the acceleration of the origin [m/s^2], shape (3,).
        spin: Angular velocity [rad/s], shape (3,).
        turning: Nodal forces of the angular acceleration [N], shape (n, 3).
        reaction: Force of the support, and moment about its reference point, in the finite-element
            model [N, N·m], shape (6,).
        known: The same load in the mechanism [N, N·m], shape (6,).
    """

    time: float
    label: str
    forces: Array
    moments: Array
    gravity: Array
    spin: Array
    turning: Array
    reaction: Array
    known: Array


def step_of(body: Body, index: int) -> Step:
    """Return the loads of a step."""
    history, row, density = body.history, body.rows[index], body.material.density
    motion = history.motion_at(row)
    turn = motion.angular_acceleration
    pairs = [_about(history, row, attachment) for attachment in body.attachments]
    at = {attachment.name: pair for attachment, pair in zip(body.attachments, pairs, strict=True)}
    forces, moments = (
        np.array([at[attachment.name][i] for attachment in body.loaded]).reshape(-1, 3)
        for i in (0, 1)
    )
    points, blocks = body.mesh.points, body.mesh.blocks
    turning = nodal_forces(points, blocks, lambda r: -density * np.cross(turn, r))
    where = body.fixed.reference
    inertia = _inertia(body)
    inertial, twist = inertial_load(inertia, motion)
    force = -forces.sum(axis=0) - inertial
    moment = -moments.sum(axis=0) - twist - np.cross(inertia.lever - where, inertial)
    for attachment, push in zip(body.loaded, forces, strict=True):
        moment -= np.cross(attachment.reference - where, push)
    return Step(
        *(history.time(row), body.labels[index], forces, moments),
        *(motion.gravity - motion.acceleration, motion.angular_velocity, turning),
        *(np.concatenate((force, moment)), np.concatenate(at[body.support])),
    )


class _Inertia(NamedTuple):
    mass: float
    lever: Array
    inertia: Array


def _inertia(body: Body) -> _Inertia:
    density, mass = body.material.density, body.mass
    return _Inertia(density * mass.volume, mass.centre, density * mass.inertia)


def _about(history: History, row: int, attachment: Attachment) -> tuple[Array, Array]:
    """Return force and moment of a load about the reference point of its nodes."""
    force = history.force[row, attachment.slot]
    arm = history.point[row, attachment.slot] - attachment.reference
    return force, history.moment[row, attachment.slot] + np.cross(arm, force)


def check_material(young: float, poisson: float, density: float, where: str) -> Material:
    """Return a material after checks of its numbers.

    Raises:
        DataError: A number is not accepted; the message names its option and accepted values.
    """
    if not (math.isfinite(young) and young > 0.0):
        raise DataError(f"--young {young:g}: accepted: > 0")
    if not 0.0 <= poisson < 0.5:
        raise DataError(f"--poisson {poisson:g}: accepted: 0 <= .. < 0.5")
    if not DENSITIES[0] <= density <= DENSITIES[1]:
        raise DataError(
            f"{where}: a density of {density:.4g} kg/m^3; accepted: {DENSITIES[0]:g} to "
            f"{DENSITIES[1]:g}; check --density, or --units of the mesh"
        )
    return Material(young, poisson, density)


def check_steps(body: Body, steps: Sequence[Step]) -> str:
    """Compare the reactions of the support with the loads in the mechanism.

    Returns:
        A line for people.

    Raises:
        DataError: The reactions differ so much that units, pose or mass of the mesh are wrong.
    """
    size = max(body.mesh.diagonal, 1e-12)
    scale, off = 0.0, 0.0
    for step in steps:
        parts = [*step.forces, step.known[:3], step.known[3:] / size, *(step.moments / size)]
        scale = max(scale, *(float(np.linalg.norm(each)) for each in parts))
        residual = step.reaction - step.known
        parts = [residual[:3], residual[3:] / size]
        off = max(off, *(float(np.linalg.norm(each)) for each in parts))
    share = off / scale if scale else 0.0
    mass = body.material.density * body.mass.volume
    expected = float(body.history.inertia.mass)
    text = (
        f"mesh of {mass:.4g} kg for a body of {expected:.4g} kg: the reaction of the support "
        f"{body.support} differs from the mechanism by {share:.2g} of the largest load"
    )
    if share > _ALIEN:
        raise DataError(f"{body.mesh.name}: {text}; check --units, --mesh-pose and --density")
    return text


def centre_field(body: Body) -> Array:
    """Return gravity less the acceleration of the mass centre of the mesh [m/s^2], (n, 3)."""
    gravity, push, spin, turn = body.history.motion
    c = body.mass.centre
    field: Array = gravity - push - cross(turn, c) - cross(spin, cross(spin, c))
    return field


def rotation_share(body: Body) -> float:
    """Return the inertial forces by rotation, as a share of the largest load [-]."""
    _, _, spin, turn = body.history.motion
    sizes = np.linalg.norm(body.history.force, axis=2)
    largest = float(sizes.max(initial=0.0))
    far = float(np.linalg.norm(body.mesh.points - body.mass.centre, axis=1).max())
    rate = np.linalg.norm(turn, axis=1) + np.linalg.norm(spin, axis=1) ** 2
    force = body.material.density * body.mass.volume * far * float(rate.max())
    return force / largest if largest else 0.0


def load_over_time(body: Body, attachment: Attachment) -> tuple[Array, Array]:
    """Return force and moment of a load about its reference point [N, N·m], (n, 3) each."""
    history = body.history
    force = history.force[:, attachment.slot]
    arm = history.point[:, attachment.slot] - attachment.reference
    return force, history.moment[:, attachment.slot] + cross(arm, force)


class Attachment(NamedTuple):
    """Nodes that take a load together.

    Attributes:
        name: Name of the load.
        slot: Index of the load in the history.
        reference: Reference point of the load [m], shape (3,).
        nodes: Indices of the nodes.
    """

    name: str
    slot: int
    reference: Array
    nodes: Nodes


def attachments_of(
    history: History, mesh: Mesh, attach: Mapping[str, str], radius: float | None
) -> list[Attachment]:
    """Find the nodes of every load.

    Args:
        history: Loads on the body over time.
        mesh: The mesh.
        attach: Set of nodes, or radius about the point of the load [m], by the name of a load.
        radius: Radius for loads that `attach` does not name [m]; None without one.

    Raises:
        DataError: A load is unknown, has no nodes, or shares nodes with another load; a set is
            unknown, or its nodes are far from the load.
    """
    names = [slot.name for slot in history.slots]
    for name in attach:
        if name not in names:
            raise DataError(f"--attach {name}: no such load; accepted: {', '.join(names)}")
    largest = max(float(np.abs(each).max(initial=0.0)) for each in (history.force, history.moment))
    least, attachments = _ROUNDING * largest, list[Attachment]()
    for slot, name in enumerate(names):
        values = history.force[:, slot], history.moment[:, slot]
        if max(float(np.abs(each).max(initial=0.0)) for each in values) <= least:
            continue
        reference = history.point[:, slot].mean(axis=0)
        nodes = _nodes(mesh, name, reference, attach.get(name, radius))
        attachments.append(Attachment(name, slot, reference, nodes))
    _refuse_shared_nodes(attachments)
    return attachments


def _nodes(mesh: Mesh, name: str, reference: Array, place: str | float | None) -> Nodes:
    """Find the nodes of a load in a set, or within a radius [m]."""
    if place is None:
        known = ", ".join(mesh.sets) or "none"
        raise DataError(
            f"load {name} has no nodes: --attach {name}=SET, {name}=RADIUS, or --radius for all; "
            f"sets of {mesh.name}: {known}"
        )
    if isinstance(place, str) and place in mesh.sets:
        nodes = np.unique(mesh.sets[place])
        centre = mesh.points[nodes].mean(axis=0) if len(nodes) else reference
        off = float(np.linalg.norm(centre - reference))
        if not len(nodes) or off > 2.0 * mesh.diagonal:
            raise DataError(
                f"{mesh.name}: the {len(nodes)} nodes of set {place} are {off:.4g} m from load "
                f"{name}; check --units and --mesh-pose"
            )
        return nodes
    try:
        radius = float(place)
    except ValueError:
        known = ", ".join(mesh.sets) or "none"
        raise DataError(
            f"--attach {name}={place}: no such set; sets of {mesh.name}: {known}"
        ) from None
    if not (np.isfinite(radius) and radius > 0.0):
        raise DataError(f"--attach {name}: a radius of {radius:g} m; accepted: > 0")
    far = np.linalg.norm(mesh.points - reference, axis=1)
    nodes = np.flatnonzero(far <= radius)
    if len(nodes) < 3:
        raise DataError(
            f"{mesh.name}: {len(nodes)} nodes within {radius:.4g} m of load {name}, accepted: 3 "
            f"or more; the nearest is {far.min():.4g} m away; check --units and --mesh-pose"
        )
    return nodes


def _refuse_shared_nodes(attachments: Sequence[Attachment]) -> None:
    for i, attachment in enumerate(attachments):
        for other in attachments[i + 1 :]:
            if shared := np.intersect1d(attachment.nodes, other.nodes).size:
                raise DataError(
                    f"loads {attachment.name} and {other.name} share {shared} nodes; give them "
                    "disjoint sets or smaller radii"
                )


def check_tied(mesh: Mesh, attachments: Sequence[Attachment], support: str) -> None:
    """Refuse solids that are not connected to the nodes of the support.

    Raises:
        DataError: There is such a solid; the message names one of its nodes.
    """
    groups = [cells for _, cells in mesh.blocks] + [
        attachment.nodes[None] for attachment in attachments
    ]
    pairs = [(np.repeat(c[:, 0], c.shape[1] - 1), c[:, 1:].ravel()) for c in groups]
    i, j = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    n = len(mesh.points)
    _, part = connected_components(coo_array((np.ones(len(i)), (i, j)), (n, n)), directed=False)
    fixed = next(attachment.nodes[0] for attachment in attachments if attachment.name == support)
    loose = np.flatnonzero(part != part[fixed])
    if len(loose):
        place = ", ".join(f"{value:.4g}" for value in mesh.points[loose[0]])
        raise DataError(
            f"{mesh.name}: {len(loose)} nodes, such as that at {place} m, are not connected to "
            f"the support {support} by elements; solids that touch must share nodes"
        )
