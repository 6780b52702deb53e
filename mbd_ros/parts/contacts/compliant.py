"""Bodies that give way a little where they touch: penalty forces and friction."""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np

from mbd_ros.core.contracts import Internal, Load, Now, Output, Value, Wrench
from mbd_ros.core.geometry.contact_outputs import ContactShow
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

_DEEP = 0.01  # of the distance to a mass centre: a depth that changes a motion little
HERTZ = 1.5  # exponent of two spheres


class Compliant(Load):
    """Contact of two bodies by springs, dampers and friction, one set a feature.

        linear:         normal = max(0, stiffness d + dissipation d')
        hunt_crossley:  normal = stiffness d^exponent max(0, 1 + dissipation d')

    d is the depth of a feature, -gap. It only pushes. Friction takes one of two laws, and is
    friction coefficient times normal at most: with `creep` it is smooth in the slip and creeps
    below break-away, slower than `creep`; with `bristle_stiffness` and `bristle_damping` a
    bristle holds a position, with its deflection as internal states. `check` and `simulate` say
    which stiffness the integrator follows, and which one the depth takes.

    Args:
        between: Shapes of a and of b.
        stiffness: Of each feature; N/m^exponent for `hunt_crossley`.
        dissipation: Damping of each feature, N·s/m; s/m for `hunt_crossley`.
        law: Law of the normal force.
        exponent: Of `hunt_crossley`, 1.5 by default.
        friction: Coefficient, or one a feature.
        creep: Velocity at which friction is that of slip, for friction without bristles.
        bristle_stiffness: Of each bristle, along both tangents.
        bristle_damping: Of each bristle.
        margin: Distance at which surfaces count as touching.
        max_penetration: Depth that the lower end of the window of `stiffness` allows; without it
            one hundredth of the way from the contact to the mass centre of the body.
        max_force: Normal force of a feature that the window is for; without it the load at rest.

    Attributes:
        pair: Gaps, frames and their derivatives.
        features: Names of its slots.
        contact: What it shows.
        normal: Law of the normal force.
        rubbing: Law of friction, None without any.
        max_penetration: As above, 0 where neither is known [m].
        max_force: As above, None without it [N].
        default_name: What it is called where nobody names it.

    Raises:
        ModelError: Bodies that do not move against each other, or friction of another number of
            features.
    """

    example = {
        "between": [{"frame": "heel", "sphere": 0.02}, {"half_space": [0, 0, 1]}],
        "stiffness": 1e5,
        "dissipation": 200.0,
        "friction": 0.8,
        "creep": 0.01,
    }
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
        self.rubbing: FrictionLaw | None = None if creep is None else Creep(creep)
        if bristle_stiffness is not None and bristle_damping is not None:
            self.rubbing = Bristle(bristle_stiffness, bristle_damping)
            self.internal = tuple(_bristles(self.features))
        deep = max_penetration
        self.max_penetration = _DEEP * distance_to_mass(robot, self.pair) if deep is None else deep
        self.max_force = max_force
        self._nv = int(robot.model.nv)
        self.contact = ContactShow(robot, self.pair, friction)
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
        """Refuse laws that are not whole, or more than one."""
        if exponent is not None and law == "linear":
            raise ModelError("exponent belongs to law: hunt_crossley, the linear law has none")
        bristle = (bristle_stiffness, bristle_damping)
        if (bristle_stiffness is None) != (bristle_damping is None):
            raise ModelError("a bristle takes both bristle_stiffness and bristle_damping")
        if creep is not None and bristle != (None, None):
            raise ModelError("friction takes creep or a bristle, not both")
        rubs = any(friction) if isinstance(friction, Sequence) else not is_value(friction, 0.0)
        if rubs and creep is None and bristle == (None, None):
            raise ModelError(
                "friction needs creep, a velocity [m/s], or bristle_stiffness and bristle_damping"
            )

    def multipliers(self, k: Kinematics, x: State) -> Array:
        """Force on a in the contact frames: normal, then both tangents [N], shape (3 n,)."""
        found = self._pushed(k, x)
        return np.zeros(3 * len(self.features)) if found is None else np.array(found.forces)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        found = self._pushed(k, x)
        if found is None:
            return np.zeros(self._nv)
        tau: Array = np.array(found.forces).dot(found.jacobian)
        return tau

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Rates of the deflections [m/s], shape (2 n,); without bristles there are none."""
        law, z = self.rubbing, x.z[self.z]
        if not isinstance(law, Bristle):
            return np.zeros(0)
        released, found = -law.stiffness / law.damping * z, self._pushed(k, x)
        if found is None:
            return released
        rates, bends = released.tolist(), z.tolist()
        for i, mu in enumerate(self._friction):
            normal = found.forces[3 * i]
            if normal:
                own, slip = bends[2 * i : 2 * i + 2], found.speeds[3 * i + 1 : 3 * i + 3]
                rates[2 * i : 2 * i + 2] = law.rate(own, slip, mu * normal)
        return np.array(rates)

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of springs and bristles [J]."""
        stored = sum(self.normal.energy(-gap) for gap in self.pair.gaps(k).tolist() if gap < 0.0)
        if isinstance(self.rubbing, Bristle):
            z = x.z[self.z].tolist()
            stored += sum(map(self.rubbing.energy, zip(z[::2], z[1::2], strict=True)))
        return stored

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """The wrenches on a and on b, at the centre of pressure."""
        return self.contact.wrenches(k, self.multipliers(k, x).reshape(-1, 3))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Forces, gaps, states, what a feels, and where."""
        forces = self.multipliers(k, x)
        return [*forces.tolist(), *self.contact.values(k, forces.reshape(-1, 3))]

    def slopes(self, feature: int, force: float, share: float = 1.0) -> Slopes:
        """Slopes of the forces of a feature at rest.

        Args:
            feature: Its slot.
            force: Normal force that it carries [N].
            share: Multiple of the stiffness of the contact.
        """
        sides = (0.0, 0.0)
        if self.rubbing is not None and self._friction[feature]:
            sides = self.rubbing.slopes(self._friction[feature] * force)
        return Slopes(*self.normal.slopes(force, share), *sides)

    def _pushed(self, k: Kinematics, x: State) -> "_Pushed | None":
        """What pushes at a state; None where nothing touches."""
        gaps = self.pair.gaps(k).tolist()
        if min(gaps) >= 0.0:
            return None
        J = self.pair.jacobian(k)
        speeds, law, forces = J.dot(x.v).tolist(), self.rubbing, [0.0] * len(J)
        bends = x.z[self.z].tolist() if self.internal else [0.0] * (2 * len(gaps))
        for i, gap in enumerate(gaps):
            if gap < 0.0:
                at = 3 * i
                forces[at] = normal = self.normal.force(-gap, -speeds[at])
                if normal and law is not None:
                    own, slip = bends[2 * i : 2 * i + 2], speeds[at + 1 : at + 3]
                    limit = self._friction[i] * normal
                    forces[at + 1 : at + 3] = law.force(own, slip, limit)
        return _Pushed(forces, speeds, J)


class _Pushed(NamedTuple):
    """Normals and tangents of all features.

    Attributes:
        forces: On a [N], 3 n.
        speeds: Of a past b [m/s], 3 n.
        jacobian: From joint velocities to these, shape (3 n, nv).
    """

    forces: list[float]
    speeds: list[float]
    jacobian: Array


def _bristles(features: Sequence[str]) -> list[Internal]:
    parts = [""] if len(features) == 1 else [f"{feature}_" for feature in features]
    return [Internal(f"{part}bristle_{axis}", "m", initial=0.0) for part in parts for axis in "xy"]
