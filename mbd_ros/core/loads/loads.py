"""Sum of all applied loads: generalized forces tau, and wrenches on bodies.

`Loads` sums generalized forces; `BodyLoads` sums wrenches on bodies for `pin.rnea`. Inertia and
constraint forces are not loads.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Actuator, Load, Part, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.inputs import Sources
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_UNLOADED = pin.Force.Zero()


class Loads:
    """Sum of the forces of loads, actuators first.

    Args:
        nv: Size of the velocity of the robot.
        forces: Loads other than actuators.
        actuators: Actuators, in the order of their commands.
        sources: Sources of u; by default all inputs have their safe values, those of actuators
            before those of forces.
        watching: Parts without force that have guards; they see the multipliers of all rows.

    Attributes:
        is_empty: Whether the sum is always zero.
        heavy: Forces that add inertia.
        reads: Level of k that `total` reads.
        commands: Names of the commanded joints.
        sources: Sources of u.
        idle: Safe values of u, read-only.
    """

    def __init__(
        self,
        nv: int,
        forces: Sequence[Load] = (),
        actuators: Sequence[Actuator] = (),
        sources: Sources | None = None,
        watching: Sequence[Part] = (),
    ) -> None:
        self.forces = tuple(forces)
        self.actuators = tuple(actuators)
        self.watching = tuple(watching)
        self.is_empty = not forces and not actuators
        self.heavy = tuple(force for force in forces if force.has_inertia)
        self.reads = max((part.reads for part in (*actuators, *forces)), default=Reads.NOTHING)
        self.commands = tuple(joint for a in actuators for joint in a.joints)
        ends = np.cumsum([0, *(len(a.joints) for a in actuators)]).tolist()
        self._driven = [slice(*pair) for pair in itertools.pairwise(ends)]
        safe = [one.safe for part in (*actuators, *forces) for one in part.inputs]
        self.sources = Sources(np.array(safe, dtype=np.float64)) if sources is None else sources
        self.idle = self.sources.idle
        self._has_sources = bool(self.sources.entries)
        self._is_smooth = bool(self.sources.smooth)
        self._zero = np.zeros(nv)

    def total(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Return the generalized force of all loads [N·m or N], shape (nv,), read-only.

        Args:
            k: Kinematics at the state.
            x: State of all joints.
            u: Result of `Sources.hold`, or all inputs if no source is smooth; None evaluates the
                sources.
        """
        tau, u = self._zero, self.inputs(x, u)
        for actuator in self.actuators:
            tau = tau + actuator.force(k, x, u)
        for force in self.forces:
            tau = tau + force.force(k, x, u)
        return tau

    def having(self, forces: Sequence[Load]) -> Loads:
        """Return loads with the same actuators and other forces."""
        return Loads(len(self._zero), forces, self.actuators, self.sources, self.watching)

    def watched_by(self, parts: Sequence[Part]) -> Loads:
        """Return the same loads with other guards."""
        return Loads(len(self._zero), self.forces, self.actuators, self.sources, parts)

    def beside(self, k: Kinematics, x: State) -> Loads:
        """Return the loads near a state, extended smoothly across their switching surfaces."""
        forces = [force.beside(k, x) for force in self.forces]
        if all(one is other for one, other in zip(forces, self.forces, strict=True)):
            return self
        return self.having(forces)

    def actuator_torque(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Return the generalized force of the actuators [N·m or N], shape (nv,), read-only."""
        tau, u = self._zero, self.inputs(x, u)
        for actuator in self.actuators:
            tau = tau + actuator.force(k, x, u)
        return tau

    def command(self, torque: Array, x: State) -> Array:
        """Return the inputs that command torques, a new array, shape (nu,).

        Inputs of other parts have their safe values.

        Args:
            torque: Torques of the joints `commands` [N·m or N], shape (len(commands),).
            x: State of all joints.
        """
        u = self.idle.copy()
        for actuator, driven in zip(self.actuators, self._driven, strict=True):
            u[actuator.u] = actuator.command(torque[driven], x)
        return u

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy that the loads store [J]."""
        return sum(part.potential(k, x) for part in (*self.actuators, *self.forces))

    def inputs(self, x: State, u: Array | None) -> Array:
        """Return all inputs at a state, shape (nu,)."""
        if u is None:
            return self.sources.at(x.t) if self._has_sources else self.idle
        return self.sources.complete(u, x.t) if self._is_smooth else u


class BodyLoads:
    """Sum of the wrenches on every body, in the frame of the joint that carries it.

    Args:
        robot: The robot.
        wrenches: External loads, in the order in which `set` takes their values.

    Attributes:
        forces: `pin.Force` of every joint, a live view.
    """

    def __init__(self, robot: Robot, wrenches: Sequence[ExternalWrench] = ()) -> None:
        self._robot = robot
        self._wrenches = tuple(wrenches)
        self._origin = robot.carrier("universe")
        self._loaded: list[int] = []
        self.forces = pin.StdVec_Force()
        for _ in range(robot.model.njoints):
            self.forces.append(pin.Force.Zero())

    def set(self, k: Kinematics, values: Sequence[Array]) -> None:
        """Replace all wrenches by the external ones.

        Args:
            k: Kinematics at the state.
            values: One (6,) array [N, N·m] per external load; empty for no load.

        Raises:
            ModelError: The number of values does not match.
        """
        if len(values) not in (0, len(self._wrenches)):
            raise ModelError(
                f"got {len(values)} wrenches, but the scene has {len(self._wrenches)} external "
                "loads"
            )
        for body in self._loaded:
            self.forces[body] = _UNLOADED
        self._loaded.clear()
        for load, value in zip(self._wrenches, values, strict=False):
            if load.is_loaded(value):
                self._add(load.carrier, load.in_body(k, value))

    def add(self, k: Kinematics, wrench: Wrench) -> None:
        """Add a wrench of a part on a body; a wrench on the world has no effect."""
        carrier = self._robot.carrier(wrench.frame)
        torque_about_origin = wrench.torque + np.cross(wrench.point, wrench.force)
        load = np.concatenate((wrench.force, torque_about_origin))
        self._add(carrier, k.transform_wrench(load, self._origin, carrier))

    def _add(self, carrier: Point, load: Array) -> None:
        body = self._robot.places.points[carrier.number].joint
        self.forces[body] = self.forces[body] + pin.Force(load)
        self._loaded.append(body)
