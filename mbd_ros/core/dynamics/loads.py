"""tau: everything that acts on the joints besides inertia and constraints."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.parts import Actuator, ForceTerm
from mbd_ros.core.state import Array, State


class Loads:
    """Sum of force terms and actuator torques.

    Args:
        nv: Size of the velocity of the robot.
        forces: Force terms.
        actuators: Actuators, in the order of their commands.

    Attributes:
        is_empty: Whether the sum is always zero.
        reads_frames: Whether `total` reads more from `data` than the masses.
        commands: Names of the commanded joints, in the order of u.
    """

    def __init__(
        self, nv: int, forces: Sequence[ForceTerm] = (), actuators: Sequence[Actuator] = ()
    ) -> None:
        self.forces, self.actuators = tuple(forces), tuple(actuators)
        self.is_empty = not forces and not actuators
        self.reads_frames = any(getattr(force, "reads_frames", False) for force in forces)
        self.commands = tuple(joint for a in actuators for joint in a.joints)
        ends = np.cumsum([0, *(len(a.joints) for a in actuators)]).tolist()
        self._slices = [slice(*pair) for pair in itertools.pairwise(ends)]
        self._idle = np.zeros(len(self.commands))
        self._zero = np.zeros(nv)

    def total(self, data: Any, x: State, u: Array | None) -> Array:
        """Generalized force [N·m or N], shape (nv,), not to be written to.

        Args:
            data: Pinocchio data, refreshed if `reads_frames`.
            x: State of all joints.
            u: Commands in the order of `commands`; None stands for zero.
        """
        tau = self.actuator_torque(x, u) if self.actuators else self._zero
        for force in self.forces:
            tau = tau + force.force(data, x)
        return tau

    def beside(self, data: Any, x: State) -> "Loads":
        """The loads near a state, smooth across the surfaces at which they jump.

        Args:
            data: As for `total`.
            x: State of all joints.
        """
        forces = [f.beside(data, x) if isinstance(f, ForceTerm) else f for f in self.forces]
        if all(one is other for one, other in zip(forces, self.forces, strict=True)):
            return self
        return Loads(len(self._zero), forces, self.actuators)

    def actuator_torque(self, x: State, u: Array | None) -> Array:
        """Forces of the actuators on the joints [N·m or N], shape (nv,), not to be written to."""
        tau, u = self._zero, self._idle if u is None else u
        for actuator, mine in zip(self.actuators, self._slices, strict=True):
            tau = tau + actuator.torque(u[mine], x)
        return tau

    def command(self, torque: Array, x: State) -> Array:
        """Commands that ask the actuators for torques of `commands` [N·m or N], shape (nu,)."""
        pairs = zip(self.actuators, self._slices, strict=True)
        return np.concatenate([self._idle[:0], *(a.command(torque[s], x) for a, s in pairs)])

    def potential(self, data: Any, x: State) -> float:
        """Potential energy of the conservative force terms [J]."""
        return sum(f.potential(data, x) for f in self.forces if isinstance(f, ForceTerm))
