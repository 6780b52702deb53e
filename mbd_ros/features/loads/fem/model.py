"""A body as finite elements: mesh, material, what holds it, and the loads of each step."""

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
_NOTHING = 1.0e-9  # of the largest load: less is rounding and needs no nodes
DENSITIES = (1.0, 30_000.0)  # kg/m^3, of what bodies are made of
_ALIEN = 0.5  # of the largest load: a mesh that is so far off is not that of the body


class Body(NamedTuple):
    """What all writers write, in SI units and axes of the link.

    Attributes:
        mass: Of the mesh with density 1.
        material: What it is made of.
        attachments: Nodes of the loads, that of the support among them.
        support: Name of the load whose nodes are held: its reaction is what the model gives back.
        coupling: `rigid` or `distributing`.
        rows: Samples that are steps, in order.
        labels: What marks them.
        units: Of the file.
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
    def held(self) -> Attachment:
        """Nodes of the support."""
        return next(one for one in self.attachments if one.name == self.support)

    @property
    def loaded(self) -> list[Attachment]:
        """Nodes of all other loads."""
        return [one for one in self.attachments if one.name != self.support]


class Material(NamedTuple):
    """Linear elastic and isotropic.

    Attributes:
        young: Young's modulus [Pa].
        poisson: Poisson's ratio [-].
        density: [kg/m^3].
    """

    young: float
    poisson: float
    density: float


class Step(NamedTuple):
    """Loads at one instant.

    Attributes:
        time: [s].
        label: What marks it.
        forces: One for each of `Body.loaded` [N], shape (k, 3).
        moments: About their references [N·m], shape (k, 3).
        gravity: Gravity less the acceleration of the origin [m/s^2], shape (3,).
        spin: Angular velocity [rad/s], shape (3,).
        turning: Of the angular acceleration on nodes [N], shape (n, 3).
        reaction: Force and moment about its reference that the support must give, shape (6,).
        known: The same as the mechanism has it, shape (6,).
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
    """Loads of one of the steps."""
    history, row, density = body.history, body.rows[index], body.material.density
    motion = history.motion_at(row)
    turn = motion.angular_acceleration
    pairs = [_about(history, row, one) for one in body.attachments]
    at = {one.name: pair for one, pair in zip(body.attachments, pairs, strict=True)}
    forces, moments = (
        np.array([at[one.name][i] for one in body.loaded]).reshape(-1, 3) for i in (0, 1)
    )
    points, blocks = body.mesh.points, body.mesh.blocks
    turning = nodal_forces(points, blocks, lambda r: -density * np.cross(turn, r))
    where = body.held.reference
    inertia = _inertia(body)
    inertial, twist = inertial_load(inertia, motion)
    force = -forces.sum(axis=0) - inertial
    moment = -moments.sum(axis=0) - twist - np.cross(inertia.lever - where, inertial)
    for one, push in zip(body.loaded, forces, strict=True):
        moment -= np.cross(one.reference - where, push)
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


def _about(history: History, row: int, one: Attachment) -> tuple[Array, Array]:
    """A load about the reference of its nodes."""
    force = history.force[row, one.slot]
    arm = history.point[row, one.slot] - one.reference
    return force, history.moment[row, one.slot] + np.cross(arm, force)


def check_material(young: float, poisson: float, density: float, where: str) -> Material:
    """A material that there can be.

    Raises:
        DataError: Names the number and what is accepted.
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
    """Compare what the support must give with what the mechanism knows of it.

    Returns:
        A line for people.

    Raises:
        DataError: The mesh cannot be that of the body: other units, another place, or mass.
    """
    size = max(body.mesh.diagonal, 1e-12)
    scale, off = 0.0, 0.0
    for step in steps:
        parts = [*step.forces, step.known[:3], step.known[3:] / size, *(step.moments / size)]
        scale = max(scale, *(float(np.linalg.norm(each)) for each in parts))
        left = step.reaction - step.known
        off = max(off, *(float(np.linalg.norm(e)) for e in (left[:3], left[3:] / size)))
    share = off / scale if scale else 0.0
    mass, own = body.material.density * body.mass.volume, float(body.history.inertia.mass)
    text = (
        f"mesh of {mass:.4g} kg for a body of {own:.4g} kg: the support {body.support} gives "
        f"{share:.2g} of the largest load more or less than in the mechanism"
    )
    if share > _ALIEN:
        raise DataError(f"{body.mesh.name}: {text}; check --units, --mesh-pose and --density")
    return text


def centre_field(body: Body) -> Array:
    """Gravity less the acceleration of the mass centre of the mesh [m/s^2], shape (n, 3)."""
    gravity, push, spin, turn = body.history.motion
    c = body.mass.centre
    field: Array = gravity - push - cross(turn, c) - cross(spin, cross(spin, c))
    return field


def rotation_share(body: Body) -> float:
    """Forces of the field of rotation, as a share of the largest load [-]."""
    _, _, spin, turn = body.history.motion
    sizes = np.linalg.norm(body.history.force, axis=2)
    largest = float(sizes.max(initial=0.0))
    far = float(np.linalg.norm(body.mesh.points - body.mass.centre, axis=1).max())
    rate = np.linalg.norm(turn, axis=1) + np.linalg.norm(spin, axis=1) ** 2
    own = body.material.density * body.mass.volume * far * float(rate.max())
    return own / largest if largest else 0.0


def load_over_time(body: Body, one: Attachment) -> tuple[Array, Array]:
    """A load and its moment about the reference of its nodes [N, N·m], shape (n, 3) each."""
    history = body.history
    force = history.force[:, one.slot]
    arm = history.point[:, one.slot] - one.reference
    return force, history.moment[:, one.slot] + cross(arm, force)


class Attachment(NamedTuple):
    """Nodes that take a load together.

    Attributes:
        name: Of the load.
        slot: Its place in the history.
        reference: Where the load is written about [m], shape (3,).
    """

    name: str
    slot: int
    reference: Array
    nodes: Nodes


def attachments_of(
    history: History, mesh: Mesh, given: Mapping[str, str], radius: float | None
) -> list[Attachment]:
    """Nodes of every load.

    Args:
        given: Load -> name of a set of nodes, or a radius about its point [m].
        radius: Of loads that are not given [m]; None where all are.

    Raises:
        DataError: A load that is unknown, has no nodes, or shares some with another; an unknown
            set; nodes that are nowhere near their load.
    """
    names = [slot.name for slot in history.slots]
    for name in given:
        if name not in names:
            raise DataError(f"--attach {name}: no such load; accepted: {', '.join(names)}")
    largest = max(float(np.abs(each).max(initial=0.0)) for each in (history.force, history.moment))
    least, found = _NOTHING * largest, []
    for slot, name in enumerate(names):
        values = history.force[:, slot], history.moment[:, slot]
        if max(float(np.abs(each).max(initial=0.0)) for each in values) <= least:
            continue
        reference = history.point[:, slot].mean(axis=0)
        nodes = _nodes(mesh, name, reference, given, radius)
        found.append(Attachment(name, slot, reference, nodes))
    _check_apart(found)
    return found


def _nodes(
    mesh: Mesh, name: str, reference: Array, given: Mapping[str, str], radius: float | None
) -> Nodes:
    word = given.get(name, radius)
    if word is None:
        known = ", ".join(mesh.sets) or "none"
        raise DataError(
            f"load {name} has no nodes: --attach {name}=SET, {name}=RADIUS, or --radius for all; "
            f"sets of {mesh.name}: {known}"
        )
    if isinstance(word, str) and word in mesh.sets:
        nodes = np.unique(mesh.sets[word])
        centre = mesh.points[nodes].mean(axis=0) if len(nodes) else reference
        off = float(np.linalg.norm(centre - reference))
        if not len(nodes) or off > 2.0 * mesh.diagonal:
            raise DataError(
                f"{mesh.name}: the {len(nodes)} nodes of set {word} are {off:.4g} m from load "
                f"{name}; check --units and --mesh-pose"
            )
        return nodes
    try:
        about = float(word)
    except ValueError:
        known = ", ".join(mesh.sets) or "none"
        raise DataError(
            f"--attach {name}={word}: no such set; sets of {mesh.name}: {known}"
        ) from None
    if not (np.isfinite(about) and about > 0.0):
        raise DataError(f"--attach {name}: a radius of {about:g} m; accepted: > 0")
    far = np.linalg.norm(mesh.points - reference, axis=1)
    nodes = np.flatnonzero(far <= about)
    if len(nodes) < 3:
        raise DataError(
            f"{mesh.name}: {len(nodes)} nodes within {about:.4g} m of load {name}, accepted: 3 or "
            f"more; the nearest is {far.min():.4g} m away; check --units and --mesh-pose"
        )
    return nodes


def _check_apart(found: Sequence[Attachment]) -> None:
    """Refuse nodes that two loads would hold."""
    for i, one in enumerate(found):
        for other in found[i + 1 :]:
            if shared := np.intersect1d(one.nodes, other.nodes).size:
                raise DataError(
                    f"loads {one.name} and {other.name} share {shared} nodes; give them sets or "
                    "radii that do not"
                )


def check_tied(mesh: Mesh, attachments: Sequence[Attachment], support: str) -> None:
    """Refuse solids that nothing ties to the nodes of the support: they would fly away.

    Raises:
        DataError: Names a node of one.
    """
    groups = [cells for _, cells in mesh.blocks] + [one.nodes[None] for one in attachments]
    pairs = [(np.repeat(c[:, 0], c.shape[1] - 1), c[:, 1:].ravel()) for c in groups]
    i, j = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    n = len(mesh.points)
    _, part = connected_components(coo_array((np.ones(len(i)), (i, j)), (n, n)), directed=False)
    held = next(one.nodes[0] for one in attachments if one.name == support)
    loose = np.flatnonzero(part != part[held])
    if len(loose):
        place = ", ".join(f"{value:.4g}" for value in mesh.points[loose[0]])
        raise DataError(
            f"{mesh.name}: {len(loose)} nodes, as that at {place} m of the body, share no element "
            f"with what {support} holds; solids that touch must share nodes"
        )
