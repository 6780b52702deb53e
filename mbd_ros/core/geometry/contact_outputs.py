"""Output quantities of a contact, for any law of its forces: columns, arrows, friction cone.

The centre of pressure is the mean of the contact points, weighted by their normal forces. In a
flat contact, the normal forces have no moment about axes in the plane through this point. The
wrench of the contact is the sum of its forces and their moment about the centre of pressure; on a
plane this moment is the torsional friction.

Source: P. Sardain, G. Bessonnet, Forces acting on a biped robot. Center of pressure - zero moment
point, IEEE Trans. SMC A 34, 2004, sec. II.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contracts import Kind, Output, Value, Wrench, exerted_on
from mbd_ros.core.geometry.contact_pair import ContactPair
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.poses import cross
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State

OPEN, SLIP, STICK = 0.0, 1.0, 2.0
_AT_BOUND = 1.0 - 1.0e-9  # fraction of the largest friction from which on a feature slips
_PRESSED = 1.0e-6  # fraction of the largest force below which a feature counts as open


class ContactOutputs:
    """Outputs of a contact and their values.

    `gap` is the smallest distance. `state` is 0 for an open contact, 2 if friction is below its
    limit at every loaded feature, and 1 otherwise, also for a loaded contact without friction.
    With several features, each has its own gap and state. `force` acts on body a at
    `centre_of_pressure`, with `torque` about it, in the axes of the world.

    Args:
        robot: The robot.
        pair: Geometry of the contact.
        friction: Friction coefficient, or one per feature.

    Attributes:
        names: Names of the forces, see `force_names`.
        outputs: Outputs in the order of `values`.
    """

    def __init__(self, robot: Robot, pair: ContactPair, friction: float | Sequence[float]) -> None:
        self._pair = pair
        self._points = pair.points
        self._origin = robot.origin
        self._mu = np.broadcast_to(np.array(friction, dtype=np.float64), len(pair.features))
        self.names = force_names(pair.features)
        self._has_several = len(pair.features) > 1
        each = pair.features if self._has_several else ()
        self.outputs = (
            *(Output(name, "m") for name in ("gap", *(f"gap_{feature}" for feature in each))),
            *(Output(name, "") for name in ("state", *(f"state_{feature}" for feature in each))),
            Output("force", "N", Kind.VECTOR, "world"),
            Output("torque", "N·m", Kind.VECTOR, "world"),
            Output("centre_of_pressure", "m", Kind.VECTOR, "world"),
            *_arrows(*self._points),
            Output("cone", "N", Kind.FRICTION_CONE),
        )

    def values(
        self, k: Kinematics, forces: Array, slips: NDArray[np.bool_] | None = None
    ) -> list[Value]:
        """Return the values of `outputs`.

        Args:
            k: Kinematics at the state.
            forces: Forces on a in the contact frames: normal, friction along x and y [N], (n, 3).
            slips: Which loaded features slip, shape (n,); by default those whose friction is at
                its limit.
        """
        gaps, states = self._pair.gaps(k), self.states(forces, slips)
        loaded = states[states > OPEN]
        state = float(loaded.min()) if len(loaded) else OPEN
        gaps_and_states: list[Value] = [float(gaps.min()), state]
        if self._has_several:
            gaps_and_states = [float(gaps.min()), *gaps.tolist(), state, *states.tolist()]
        centre, force, torque, normal = self.resultant(k, forces, gaps)
        mu = float(self._mu[states > OPEN].max(initial=0.0))
        return [
            *gaps_and_states,
            force,
            torque,
            centre + self._origin,
            np.concatenate((centre, force, torque)),
            np.concatenate((centre, -force, -torque)),
            np.array((*centre, *normal, mu)),
        ]

    def states(self, forces: Array, slips: NDArray[np.bool_] | None = None) -> Array:
        """Return 0 (open), 1 (slips) or 2 (sticks) per feature, shape (n,); see `values`."""
        normal = forces[:, 0]
        if slips is None:
            friction = np.hypot(forces[:, 1], forces[:, 2])
            slips = ~(friction < _AT_BOUND * self._mu * normal)
        presses = normal > _PRESSED * np.abs(forces).max(initial=0.0)
        return np.where(presses, np.where(slips, SLIP, STICK), OPEN)

    def wrenches(self, k: Kinematics, forces: Array) -> tuple[Wrench, ...]:
        """Return the wrenches on a and on b at the centre of pressure; see `values`."""
        if self._has_several:
            centre, force, torque, _ = self.resultant(k, forces, self._pair.gaps(k))
        else:
            (centre,), (axes,) = self._pair.places(k)
            force, torque = axes.dot(forces[0, [1, 2, 0]]), np.zeros(3)
        a, b = self._points
        return Wrench(a.frame, centre, force, torque), Wrench(b.frame, centre, -force, -torque)

    def exerted(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the wrenches of forces in the order of constraint rows, shape (3 n,)."""
        return self.wrenches(k, lam.reshape(-1, 3))

    def resultant(self, k: Kinematics, forces: Array, gaps: Array) -> Resultant:
        """Return the resultant of all features at given gaps, shape (n,); see `values`."""
        point, axes = self._pair.places(k)
        normal = forces[:, 0]
        total = float(normal.sum())
        centre = normal.dot(point) / total if total > 0.0 else point[int(np.argmin(gaps))]
        each = np.matmul(axes, forces[:, [1, 2, 0], None])[:, :, 0]
        torque = cross(point - centre, each).sum(axis=0)
        return Resultant(centre, each.sum(axis=0), torque, normal.dot(axes[:, :, 2]))


def force_names(features: Sequence[str]) -> list[str]:
    """Return the names of the forces of a contact, three per feature, in the order of its rows."""
    prefixes = [""] if len(features) == 1 else [f"{feature}_" for feature in features]
    components = ("normal", "friction_x", "friction_y")
    return [f"{prefix}{component}" for prefix in prefixes for component in components]


def _arrows(a: Point, b: Point) -> tuple[Output, Output]:
    """Return the wrenches on both bodies; a fixed body is called `world` if no body is."""
    on_a, on_b = exerted_on(a, None), exerted_on(b, None)
    if b.frame == "universe" and on_a.name != "on_world":
        return on_a, on_b._replace(name="on_world")
    if a.frame == "universe" and on_b.name != "on_world":
        return on_a._replace(name="on_world"), on_b
    return on_a, on_b


class Resultant(NamedTuple):
    """Resultant of the forces of all features on a, in world axes.

    Attributes:
        centre: Centre of pressure relative to `Robot.origin` [m], shape (3,); the nearest feature
            of an open contact.
        force: Force [N], shape (3,).
        torque: Torque about the centre [N·m], shape (3,).
        normal: Sum of the normal forces [N], shape (3,).
    """

    centre: Array
    force: Array
    torque: Array
    normal: Array
