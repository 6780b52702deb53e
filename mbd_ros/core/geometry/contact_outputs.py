"""What a contact shows, whatever law its forces follow: columns, arrows and a friction cone.

The centre of pressure is the mean of the contact points, each weighted by its normal force. It is
the point of a flat contact about which normal forces have no moment along the plane. The wrench
is the sum of all forces and their moment about it, so that on a plane the moment is that of
friction about the normal. Source: P. Sardain, G. Bessonnet, Forces acting on a biped robot.
Center of pressure - zero moment point, IEEE Trans. SMC A 34, 2004, sec. II.
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
_AT_BOUND = 1.0 - 1.0e-9  # of the largest friction: from here on it slips
_PRESSED = 1.0e-6  # of the largest force of a contact: a feature with less decides nothing


class ContactOutputs:
    """Outputs of a contact and their values.

    `gap` is the smallest distance, `state` is 0 where nothing touches, 2 where friction is inside
    its bound at every feature that presses, else 1: so is a contact without friction that
    presses. With several features each has both of its own. `force` acts on a at
    `centre_of_pressure` with `torque` about it, all in axes of the world.

    Args:
        friction: Coefficient, or one a feature.

    Attributes:
        names: Of the forces, as `force_names` gives them.
        outputs: In the order of `values`.
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
            *(Output(name, "m") for name in ("gap", *(f"gap_{one}" for one in each))),
            *(Output(name, "") for name in ("state", *(f"state_{one}" for one in each))),
            Output("force", "N", Kind.VECTOR, "world"),
            Output("torque", "N·m", Kind.VECTOR, "world"),
            Output("centre_of_pressure", "m", Kind.VECTOR, "world"),
            *_arrows(*self._points),
            Output("cone", "N", Kind.FRICTION_CONE),
        )

    def values(
        self, k: Kinematics, forces: Array, slips: NDArray[np.bool_] | None = None
    ) -> list[Value]:
        """Values of `outputs`.

        Args:
            forces: On a in the contact frames: normal, friction along x and y [N], shape (n, 3).
            slips: Which features slip where they press, shape (n,); None where friction at its
                bound says so.
        """
        gaps, states = self._pair.gaps(k), self.states(forces, slips)
        pressed = states[states > OPEN]
        state = float(pressed.min()) if len(pressed) else OPEN
        shown: list[Value] = [float(gaps.min()), state]
        if self._has_several:
            shown = [shown[0], *gaps.tolist(), state, *states.tolist()]
        centre, force, torque, normal = self.resultant(k, forces, gaps)
        mu = float(self._mu[states > OPEN].max(initial=0.0))
        return [
            *shown,
            force,
            torque,
            centre + self._origin,
            np.concatenate((centre, force, torque)),
            np.concatenate((centre, -force, -torque)),
            np.array((*centre, *normal, mu)),
        ]

    def states(self, forces: Array, slips: NDArray[np.bool_] | None = None) -> Array:
        """0 open, 1 slips, 2 sticks, shape (n,); arguments are those of `values`."""
        normal = forces[:, 0]
        if slips is None:
            friction = np.hypot(forces[:, 1], forces[:, 2])
            slips = ~(friction < _AT_BOUND * self._mu * normal)
        presses = normal > _PRESSED * np.abs(forces).max(initial=0.0)
        return np.where(presses, np.where(slips, SLIP, STICK), OPEN)

    def wrenches(self, k: Kinematics, forces: Array) -> tuple[Wrench, ...]:
        """The wrenches on a and on b at the centre of pressure; arguments as for `values`."""
        if self._has_several:
            centre, force, torque, _ = self.resultant(k, forces, self._pair.gaps(k))
        else:
            (centre,), (axes,) = self._pair.places(k)
            force, torque = axes.dot(forces[0, [1, 2, 0]]), np.zeros(3)
        a, b = self._points
        return Wrench(a.frame, centre, force, torque), Wrench(b.frame, centre, -force, -torque)

    def exerted(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """The same, of forces one after the other as rows have them, shape (3 n,)."""
        return self.wrenches(k, lam.reshape(-1, 3))

    def resultant(self, k: Kinematics, forces: Array, gaps: Array) -> Resultant:
        """The forces of all features; arguments as for `values`, and the gaps, shape (n,)."""
        point, axes = self._pair.places(k)
        normal = forces[:, 0]
        total = float(normal.sum())
        centre = normal.dot(point) / total if total > 0.0 else point[int(np.argmin(gaps))]
        each = np.matmul(axes, forces[:, [1, 2, 0], None])[:, :, 0]
        torque = cross(point - centre, each).sum(axis=0)
        return Resultant(centre, each.sum(axis=0), torque, normal.dot(axes[:, :, 2]))


def force_names(features: Sequence[str]) -> list[str]:
    """What the forces of a contact are called, three a feature, in the order of its rows."""
    parts = [""] if len(features) == 1 else [f"{feature}_" for feature in features]
    words = ("normal", "friction_x", "friction_y")
    return [f"{part}{word}" for part in parts for word in words]


def _arrows(a: Point, b: Point) -> tuple[Output, Output]:
    """The wrenches on both bodies; what is at rest is called world where no body has that name."""
    on_a, on_b = exerted_on(a, None), exerted_on(b, None)
    if b.frame == "universe" and on_a.name != "on_world":
        return on_a, on_b._replace(name="on_world")
    if a.frame == "universe" and on_b.name != "on_world":
        return on_a._replace(name="on_world"), on_b
    return on_a, on_b


class Resultant(NamedTuple):
    """The forces of all features on a, in world axes.

    Attributes:
        centre: Centre of pressure; the nearest feature where nothing presses. In the world less
            `Robot.origin` [m], shape (3,).
        force: [N], shape (3,).
        torque: About the centre [N·m], shape (3,).
        normal: The part of the force along the normals [N], shape (3,).
    """

    centre: Array
    force: Array
    torque: Array
    normal: Array
