"""tau: everything that acts on the joints besides inertia and constraints."""

import itertools
from collections.abc import Sequence

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.parts import Actuator, Load, Reads, Slots
from mbd_ros.core.state import Array, State

_NO_SLOT = slice(0, 0)


class Loads:
    """Sum of the forces of loads, actuators first.

    Args:
        nv: Size of the velocity of the robot.
        forces: Loads that nobody commands.
        actuators: Actuators, in the order of their commands.

    Attributes:
        is_empty: Whether the sum is always zero.
        reads: What `total` reads of k.
        commands: Names of the commanded joints, in the order of u.
        idle: The u without any command, not to be written to.
    """

    def __init__(
        self, nv: int, forces: Sequence[Load] = (), actuators: Sequence[Actuator] = ()
    ) -> None:
        self.forces, self.actuators = tuple(forces), tuple(actuators)
        self.is_empty = not forces and not actuators
        self.reads = max((part.reads for part in (*actuators, *forces)), default=Reads.NOTHING)
        self.commands = tuple(joint for a in actuators for joint in a.joints)
        ends = np.cumsum([0, *(len(a.joints) for a in actuators)]).tolist()
        for actuator, ends_of in zip(self.actuators, itertools.pairwise(ends), strict=True):
            actuator.bind(Slots(slice(*ends_of), _NO_SLOT))
        self.idle = np.zeros(len(self.commands))
        self._zero = np.zeros(nv)

    def total(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Generalized force [N·m or N], shape (nv,), not to be written to.

        Args:
            k: Kinematics at the state, refreshed as far as `reads` says.
            x: State of all joints.
            u: Commands in the order of `commands`; None stands for zero.
        """
        tau, u = self._zero, self.idle if u is None else u
        for actuator in self.actuators:
            tau = tau + actuator.force(k, x, u)
        for force in self.forces:
            tau = tau + force.force(k, x, u)
        return tau

    def beside(self, k: Kinematics, x: State) -> "Loads":
        """The loads near a state, smooth across the surfaces at which they jump.

        Args:
            k: As for `total`.
            x: State of all joints.
        """
        forces = [force.beside(k, x) for force in self.forces]
        if all(one is other for one, other in zip(forces, self.forces, strict=True)):
            return self
        return Loads(len(self._zero), forces, self.actuators)

    def actuator_torque(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Forces of the actuators on the joints [N·m or N], shape (nv,), not to be written to."""
        tau, u = self._zero, self.idle if u is None else u
        for actuator in self.actuators:
            tau = tau + actuator.force(k, x, u)
        return tau

    def command(self, torque: Array, x: State) -> Array:
        """Commands that ask the actuators for torques of `commands` [N·m or N], shape (nu,)."""
        return np.concatenate(
            [self.idle[:0], *(a.command(torque[a.u], x) for a in self.actuators)]
        )

    def potential(self, k: Kinematics, x: State) -> float:
        """Potential energy of the conservative loads [J]."""
        return sum(force.potential(k, x) for force in self.forces)
