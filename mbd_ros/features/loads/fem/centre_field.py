"""Gravity and inertia as one field that is the same everywhere in the mesh, and what it lacks."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.vectors import cross
from mbd_ros.features.loads.fem.attachments import Attachment
from mbd_ros.features.loads.fem.model import Body


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
