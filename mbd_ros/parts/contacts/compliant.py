"""Compliant contact of two bodies: penalty forces and friction."""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np

from mbd_ros.core.contracts import Internal, Load, Now, Output, Value, Wrench
from mbd_ros.core.geometry.contact_outputs import ContactOutputs
from mbd_ros.core.geometry.contact_pair import contact_pair, distance_to_mass
from mbd_ros.core.geometry.shapes import Between
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.contact_force_laws import (
    Bristle,
    Creep,
    FrictionLaw,
    HuntCrossleyNormal,
    LinearNormal,
    NormalLaw,
    Slopes,
)
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Positive, Unit, Within, is_value
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_RELATIVE_PENETRATION = 0.01  # of the distance to the mass centre, which affects a motion little
HERTZ = 1.5  # exponent of Hertz's law for two spheres


class Compliant(Load):
    """Contact of two bodies by a spring, a damper and friction at every contact feature.

        linear:         normal = max(0, stiffness d + dissipation d')
        hunt_crossley:  normal = stiffness d^exponent max(0, 1 + dissipation d')

    d is the penetration of a feature, the negative gap. The contact never pulls. Friction is at
    most `friction` times the normal force, by one of two laws. With `creep` it is a smooth
    function of the slip velocity, so a contact below the friction limit creeps, slower than
    `creep`. With `bristle_stiffness` and `bristle_damping` a bristle holds its position; its
    deflections are internal states. `mbd-ros check` and `simulate` report the range of stiffness
    that the integrator can follow and that keeps the penetration small.

    Args:
        between: Shapes of bodies a and b.
        stiffness: Stiffness of each feature [N/m, or N/m^exponent for `hunt_crossley`].
        dissipation: Damping of each feature [N·s/m, or s/m for `hunt_crossley`].
        law: Law of the normal force.
        exponent: Exponent of `hunt_crossley`, 1.5 by default.
        friction: Friction coefficient, or one per feature.
        creep: Slip velocity at which friction reaches its limit, for friction without bristles.
        bristle_stiffness: Stiffness of each bristle, along both tangents.
        bristle_damping: Damping of each bristle.
        margin: Distance at which surfaces count as touching.
        max_penetration: Largest acceptable penetration, from which the lowest reported stiffness
            follows; by default 1 % of the distance from the contact to the mass centre.
        max_force: Normal force per feature for which that penetration is accepted; by default the
            static load.

    Attributes:
        pair: Geometry of the contact: gaps, frames and their derivatives.
        features: Names of the contact features.
        contact: Output quantities of the contact.
        normal: Law of the normal force.
        friction_law: Law of friction, None without friction.
        max_penetration: Largest acceptable penetration [m], 0 if it is unknown.
        max_force: Normal force for that penetration [N], or None.
        default_name: Name of the contact if its entry has none.

    Raises:
        ModelError: Bodies without relative motion, or a wrong number of friction coefficients.
    """

    example = {
        "between": [{"frame": "heel", "sphere": 0.02}, {"half_space": [0, 0, 1]}],
        "stiffness": 1e5,
        "dissipation": 200.0,
        "friction": 0.8,
        "creep": 0.01,
    }
    is_compliant_contact = True
    reads = Reads.JACOBIAN

    def __init__(
        self,
        robot: Robot,
        *,
        between: Between,
        stiffness: Annotated[Positive, Unit("N/m or N/m^exponent")],
        dissipation: Annotated[NotNegative, Unit("N·s/m or s/m")] = 0.0,
        law: Literal["linear", "hunt_crossley"] = "linear",
        exponent: Annotated[float | None, Within(1.0, 4.0), Unit("-")] = None,
        friction: Annotated[NotNegative | Sequence[NotNegative], Unit("-")] = 0.0,
        creep: Annotated[float | None, Within(1e-12, 1e12), Unit("m/s")] = None,
        bristle_stiffness: Annotated[float | None, Within(1e-30, 1e30), Unit("N/m")] = None,
        bristle_damping: Annotated[float | None, Within(1e-30, 1e30), Unit("N·s/m")] = None,
        margin: Annotated[NotNegative, Unit("m")] = 0.0,
        max_penetration: Annotated[float | None, Within(1e-30, 1e30), Unit("m")] = None,
        max_force: Annotated[float | None, Within(1e-30, 1e30), Unit("N")] = None,
    ) -> None:
        self.pair = contact_pair(robot, between, margin)
        self.features = self.pair.features
        n = len(self.features)
        if isinstance(friction, Sequence) and len(friction) != n:
            known = ", ".join(self.features)
            raise ModelError(f"friction: expected one number or {n}: {known}")
        self._friction = list(friction) if isinstance(friction, Sequence) else [friction] * n
        self.normal: NormalLaw = LinearNormal(stiffness, dissipation)
        if law == "hunt_crossley":
            power = HERTZ if exponent is None else exponent
            self.normal = HuntCrossleyNormal(stiffness, dissipation, power)
        self.friction_law: FrictionLaw | None = None if creep is None else Creep(creep)
        if bristle_stiffness is not None and bristle_damping is not None:
            self.friction_law = Bristle(bristle_stiffness, bristle_damping)
            self.internal = tuple(_bristles(self.features))
        if max_penetration is None:
            max_penetration = _RELATIVE_PENETRATION * distance_to_mass(robot, self.pair)
        self.max_penetration = max_penetration
        self.max_force = max_force
        self._nv = int(robot.model.nv)
        self.contact = ContactOutputs(robot, self.pair, friction)
        forces = (Output(name, "N", frame=between.b.frame) for name in self.contact.names)
        self.outputs = (*forces, *self.contact.outputs)
        a, b = self.pair.points
        self.default_name = f"{a.frame if a.moves else b.frame}_contact"

    @staticmethod
    def check(
        law: str,
        exponent: float | None,
        friction: float | Sequence[float],
        creep: float | None,
        bristle_stiffness: float | None,
        bristle_damping: float | None,
    ) -> None:
        """Refuse incomplete laws of normal force and friction, and two laws of friction."""
        if exponent is not None and law == "linear":
            raise ModelError("exponent is accepted with law: hunt_crossley only")
        bristle = (bristle_stiffness, bristle_damping)
        if (bristle_stiffness is None) != (bristle_damping is None):
            raise ModelError("give both bristle_stiffness and bristle_damping, or neither")
        if creep is not None and bristle != (None, None):
            raise ModelError("give either creep or a bristle, not both")
        has_friction = (
            any(friction) if isinstance(friction, Sequence) else not is_value(friction, 0.0)
        )
        if has_friction and creep is None and bristle == (None, None):
            raise ModelError(
                "friction needs creep, a velocity [m/s], or bristle_stiffness and bristle_damping"
            )

    def multipliers(self, k: Kinematics, x: State) -> Array:
        """Return the forces on a in the contact frames [N], shape (3 n,).

        For each feature: the normal force, then the friction along both tangents.
        """
        contact = self._contact_forces(k, x)
        return np.zeros(3 * len(self.features)) if contact is None else np.array(contact.forces)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        contact = self._contact_forces(k, x)
        if contact is None:
            return np.zeros(self._nv)
        tau: Array = np.array(contact.forces).dot(contact.jacobian)
        return tau

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the rates of the bristle deflections [m/s], shape (2 n,), (0,) without bristles.

        A bristle whose feature does not touch relaxes to its undeflected state.
        """
        law, z = self.friction_law, x.z[self.z]
        if not isinstance(law, Bristle):
            return np.zeros(0)
        relaxation = -law.stiffness / law.damping * z
        contact = self._contact_forces(k, x)
        if contact is None:
            return relaxation
        rates, deflections = relaxation.tolist(), z.tolist()
        for i, mu in enumerate(self._friction):
            normal = contact.forces[3 * i]
            if normal:
                deflection = deflections[2 * i : 2 * i + 2]
                slip = contact.velocities[3 * i + 1 : 3 * i + 3]
                rates[2 * i : 2 * i + 2] = law.rate(deflection, slip, mu * normal)
        return np.array(rates)

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy of springs and bristles [J]."""
        energy = sum(self.normal.energy(-gap) for gap in self.pair.gaps(k).tolist() if gap < 0.0)
        if isinstance(self.friction_law, Bristle):
            z = x.z[self.z].tolist()
            energy += sum(map(self.friction_law.energy, zip(z[::2], z[1::2], strict=True)))
        return energy

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the wrenches on a and on b, at the centre of pressure."""
        return self.contact.wrenches(k, self.multipliers(k, x).reshape(-1, 3))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return forces, gaps, contact states, and the wrench on a with its point."""
        forces = self.multipliers(k, x)
        return [*forces.tolist(), *self.contact.values(k, forces.reshape(-1, 3))]

    def slopes(self, feature: int, force: float, share: float = 1.0) -> Slopes:
        """Return stiffness and damping of a feature, linearised at rest under load.

        Args:
            feature: Index of the feature.
            force: Normal force that the feature carries [N].
            share: Factor on the stiffness of the contact.
        """
        sides = (0.0, 0.0)
        if self.friction_law is not None and self._friction[feature]:
            sides = self.friction_law.slopes(self._friction[feature] * force)
        return Slopes(*self.normal.slopes(force, share), *sides)

    def _contact_forces(self, k: Kinematics, x: State) -> "_ContactForces | None":
        """Evaluate all features; None where none touches."""
        gaps = self.pair.gaps(k).tolist()
        if min(gaps) >= 0.0:
            return None
        J = self.pair.jacobian(k)
        velocities, law, forces = J.dot(x.v).tolist(), self.friction_law, [0.0] * len(J)
        deflections = x.z[self.z].tolist() if self.internal else [0.0] * (2 * len(gaps))
        for i, gap in enumerate(gaps):
            if gap < 0.0:
                row = 3 * i
                forces[row] = normal = self.normal.force(-gap, -velocities[row])
                if normal and law is not None:
                    deflection = deflections[2 * i : 2 * i + 2]
                    slip = velocities[row + 1 : row + 3]
                    limit = self._friction[i] * normal
                    forces[row + 1 : row + 3] = law.force(deflection, slip, limit)
        return _ContactForces(forces, velocities, J)


class _ContactForces(NamedTuple):
    """Forces and velocities along normal and tangents of all features.

    Attributes:
        forces: Forces on a [N], 3 n numbers.
        velocities: Velocities of a relative to b [m/s], 3 n numbers.
        jacobian: Map from joint velocities to these velocities, shape (3 n, nv).
    """

    forces: list[float]
    velocities: list[float]
    jacobian: Array


def _bristles(features: Sequence[str]) -> list[Internal]:
    prefixes = [""] if len(features) == 1 else [f"{feature}_" for feature in features]
    return [Internal(f"{p}bristle_{axis}", "m", initial=0.0) for p in prefixes for axis in "xy"]
