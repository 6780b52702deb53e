"""tau: everything that acts on the joints besides inertia and constraints.

`Loads` sums generalized forces; `BodyLoads` sums wrenches on bodies, as `pin.rnea` takes them.
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
        forces: Loads that nobody commands.
        actuators: Actuators, in the order of their commands.
        sources: What gives u; by default there are only the safe values of the inputs of these
            loads, in this order: actuators, forces.
        watching: Parts that exert nothing and have guards; they see the multipliers of all rows.

    Attributes:
        is_empty: Whether the sum is always zero.
        heavy: Those of the forces that add inertia.
        reads: What `total` reads of k.
        commands: Names of the commanded joints.
        sources: What gives u.
        idle: The u that no source gives, not to be written to.
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
        self._has_sources = bool(self.sources.given)
        self._is_smooth = bool(self.sources.smooth)
        self._zero = np.zeros(nv)

    def total(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Generalized force [N·m or N], shape (nv,), not to be written to.

        Args:
            u: What `Sources.held` gives, or all inputs where nothing smooth does; None asks the
                sources.
        """
        tau, u = self._zero, self.inputs(x, u)
        for actuator in self.actuators:
            tau = tau + actuator.force(k, x, u)
        for force in self.forces:
            tau = tau + force.force(k, x, u)
        return tau

    def having(self, forces: Sequence[Load]) -> Loads:
        """The same actuators beside other forces."""
        return Loads(len(self._zero), forces, self.actuators, self.sources, self.watching)

    def watched_by(self, parts: Sequence[Part]) -> Loads:
        """The same loads with other guards."""
        return Loads(len(self._zero), self.forces, self.actuators, self.sources, parts)

    def beside(self, k: Kinematics, x: State) -> Loads:
        """The loads near a state, smooth across the surfaces at which they jump."""
        forces = [force.beside(k, x) for force in self.forces]
        if all(one is other for one, other in zip(forces, self.forces, strict=True)):
            return self
        return self.having(forces)

    def actuator_torque(self, k: Kinematics, x: State, u: Array | None) -> Array:
        """Forces of the actuators on the joints [N·m or N], shape (nv,), not to be written to."""
        tau, u = self._zero, self.inputs(x, u)
        for actuator in self.actuators:
            tau = tau + actuator.force(k, x, u)
        return tau

    def command(self, torque: Array, x: State) -> Array:
        """Inputs that ask the actuators for torques, fresh, `idle` elsewhere, shape (nu,).

        Args:
            torque: Of `commands` [N·m or N], shape (len(commands),).
        """
        u = self.idle.copy()
        for actuator, driven in zip(self.actuators, self._driven, strict=True):
            u[actuator.u] = actuator.command(torque[driven], x)
        return u

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy that the loads store [J]."""
        return sum(part.potential(k, x) for part in (*self.actuators, *self.forces))

    def inputs(self, x: State, u: Array | None) -> Array:
        """All inputs at a state, shape (nu,)."""
        if u is None:
            return self.sources.at(x.t) if self._has_sources else self.idle
        return self.sources.complete(u, x.t) if self._is_smooth else u


class BodyLoads:
    """Sum of wrenches on every body, in the frame of the joint that carries it.

    Args:
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
        """Replace all loads by the external ones.

        Args:
            values: One (6,) array [N, N·m] for every external load; none means unloaded.

        Raises:
            ModelError: Another number of values.
        """
        if len(values) not in (0, len(self._wrenches)):
            raise ModelError(f"{len(values)} wrenches given, the scene has {len(self._wrenches)}")
        for body in self._loaded:
            self.forces[body] = _UNLOADED
        self._loaded.clear()
        for load, value in zip(self._wrenches, values, strict=False):
            if load.is_loaded(value):
                self._add(load.carrier, load.in_body(k, value))

    def add(self, k: Kinematics, wrench: Wrench) -> None:
        """Add what a part exerts on a body; on the world it has no effect."""
        carrier = self._robot.carrier(wrench.frame)
        about_origin = wrench.torque + np.cross(wrench.point, wrench.force)
        whole = np.concatenate((wrench.force, about_origin))
        self._add(carrier, k.transform_wrench(whole, self._origin, carrier))

    def _add(self, carrier: Point, load: Array) -> None:
        body = self._robot.places.points[carrier.number].joint
        self.forces[body] = self.forces[body] + pin.Force(load)
        self._loaded.append(body)
