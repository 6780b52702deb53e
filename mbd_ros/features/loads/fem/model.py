"""A body as finite elements: mesh, material, what holds it, and the loads of each step."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.loads.fem.attachments import Attachment
from mbd_ros.features.loads.fem.elements import MeshMass, nodal_forces
from mbd_ros.features.loads.fem.mesh import Mesh
from mbd_ros.features.loads.fem.units import Units
from mbd_ros.features.loads.free_body_balance import inertial_load
from mbd_ros.features.loads.history import History

DENSITIES = (1.0, 30_000.0)  # kg/m^3, of what bodies are made of
_ALIEN = 0.5  # of the largest load: a mesh that is so far off is not that of the body


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


class Body(NamedTuple):
    """What all writers write, in SI units and axes of the link.

    Attributes:
        history: The loads.
        mesh: The mesh.
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
