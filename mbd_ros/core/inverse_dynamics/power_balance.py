"""Power of everything that acts on a mechanism, and where it goes.

    sum of powers = d/dt (kinetic energy)

On the left stand generalized forces times velocities, and the weight; on the right masses of
bodies times their velocities and accelerations. What differs is the `residual`: 0 to rounding
where efforts and multipliers explain the motion. Source: K. E. Zelik, A. D. Kuo, J. Exp. Biology
213 (2010) 4257, doi:10.1242/jeb.044297, on work of joints, of soft parts and of the whole.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contracts.outputs import Output
from mbd_ros.core.contracts.parts import Load
from mbd_ros.core.inverse_dynamics.segment_power import WATT, SegmentPower
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.body_loads import BodyLoads
from mbd_ros.core.loads.external_wrench import ExternalWrench
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.multiplier_laws import Kind
from mbd_ros.core.names import label, without_multiplier
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.state import NONE, Array, State

POWER = "power"  # quantity of a part, and the part of all sums
GROUPS = (
    *("efforts", "couplings", "constraints", "contacts", "forces", "external_wrenches"),
    *("gravity", "unexplained"),
)


class Exerted(NamedTuple):
    """What inverse dynamics found.

    Attributes:
        efforts: Generalized force of the actuators on all joints [N·m or N], shape (nv,).
        residual: What nothing carries, on all joints [N·m or N], shape (nv,).
        multipliers: Of the rows, shape (m,).
    """

    efforts: Array
    residual: Array
    multipliers: Array


class PowerBalance:
    """Powers of joints, parts and segments, their sums by kind, and what is left.

    `power.<kind>` sums up efforts and drives, couplings (0: what they take from a joint they give
    to another), other constraints, contacts, force terms, external wrenches, gravity, and the
    residual of free bases. Positive power adds kinetic energy. That of rotors is part of it.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        robot: The robot.
        constraints: The rows that multipliers are given for.
        driven: Joints whose efforts are given.
        wrenches: External loads by name.
        forces: Force terms.
        contacts: Names of loads that are forces of contacts.

    Attributes:
        outputs: `<joint>.power`, `<part>.power`, `<dependent joint>.coupling_power` (what the
            coupling gives to it), those of `SegmentPower`, the sums `power.<kind>`, then
            `power.kinetic_energy`, its rate, and `power.residual`, the sum less the rate.
    """

    def __init__(
        self,
        robot: Robot,
        constraints: ConstraintRows,
        driven: Sequence[str],
        wrenches: Mapping[str, ExternalWrench],
        forces: Sequence[Load] = (),
        contacts: Collection[str] = (),
    ) -> None:
        self._k, self._rows = Kinematics(robot), constraints
        self._wrenches, self._forces = tuple(wrenches.values()), tuple(forces)
        self._loads, self._segments = BodyLoads(robot, self._wrenches), SegmentPower(robot)
        self._armature = np.array(robot.model.armature)
        self._driven = np.array([robot.joint(name).v for name in driven], dtype=np.intp)
        ties = [part for part in constraints.parts if isinstance(part, CouplingRows)]
        self._tied = np.array([p.child_v for part in ties for p in part.pairs], dtype=np.intp)
        tied = [row.name for part in ties for row in part.rows]
        parts: list[tuple[str, str]] = []
        for part in constraints.parts:
            if not isinstance(part, CouplingRows):
                parts.append((label(part, POWER), _kind(part.law.kind)))
        for force in forces:
            kind = "contacts" if getattr(force, "contact", None) is not None else "forces"
            parts.append((label(force, POWER), kind))
        for name in wrenches:
            kind = "contacts" if name in contacts else "external_wrenches"
            parts.append((f"{name}.{POWER}", kind))
        self._group = np.array([GROUPS.index(kind) for _, kind in parts], dtype=np.intp)
        names = [f"{name}.{POWER}" for name in driven]
        names += [f"{without_multiplier(name)}.coupling_power" for name in tied]
        names += [name for name, _ in parts]
        sums = [*GROUPS, "kinetic_energy_rate", "residual"]
        self.outputs = (
            *(Output(name, WATT) for name in names),
            *self._segments.outputs,
            *(Output(f"{POWER}.{name}", WATT) for name in sums),
            Output(f"{POWER}.kinetic_energy", "J"),
        )

    def values(self, x: State, a: Array, found: Exerted, wrenches: Sequence[Array] = ()) -> Array:
        """Values of `outputs`, shape (len(outputs),).

        Args:
            x: State of all joints.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            found: Efforts, residual and multipliers.
            wrenches: One (6,) array [N, N·m] for every load; none means unloaded.
        """
        self._k.refresh(x.q, x.v)
        self._load(x, found.multipliers, wrenches)
        bodies = self._segments.bodies(x, a, self._loads)
        ties, parts = self._parts(x, found.multipliers, wrenches)
        sums = np.zeros(len(GROUPS))
        np.add.at(sums, self._group, parts)
        sums[GROUPS.index("efforts")] += found.efforts.dot(x.v)
        sums[GROUPS.index("couplings")] += ties
        sums[GROUPS.index("gravity")] = bodies.gravity.sum()
        sums[GROUPS.index("unexplained")] = found.residual.dot(x.v)
        rotors = self._armature * x.v
        rate = float(bodies.rate.sum() + rotors.dot(a))
        tied = found.multipliers[: len(self._tied)] * x.v[self._tied]
        ends = rate, sums.sum() - rate, bodies.energy.sum() + 0.5 * rotors.dot(x.v)
        driven = (found.efforts * x.v)[self._driven]
        return np.concatenate((driven, tied, parts, self._segments.values(bodies), sums, ends))

    def _load(self, x: State, multipliers: Array, wrenches: Sequence[Array]) -> None:
        """Put all wrenches on their bodies."""
        self._loads.set(self._k, wrenches)
        for wrench in self._rows.wrenches(self._k, x, multipliers):
            self._loads.add(self._k, wrench)
        for force in self._forces:
            for wrench in force.wrenches(self._k, x, NONE):
                self._loads.add(self._k, wrench)

    def _parts(
        self, x: State, multipliers: Array, wrenches: Sequence[Array]
    ) -> tuple[float, Array]:
        """Power of all couplings, and of each other part."""
        of_rows = multipliers * self._rows.jacobian(self._k, x).dot(x.v)
        ties, parts = 0.0, []
        for part, mine in zip(self._rows.parts, self._rows.slices, strict=True):
            if isinstance(part, CouplingRows):
                ties += float(of_rows[mine].sum())
            else:
                parts.append(float(of_rows[mine].sum()))
        parts += [force.force(self._k, x, NONE).dot(x.v) for force in self._forces]
        given = wrenches or [np.zeros(6)] * len(self._wrenches)
        for load, value in zip(self._wrenches, given, strict=True):
            acts = load.is_loaded(value)
            parts.append(float(load.force_of(self._k, value).dot(x.v)) if acts else 0.0)
        return ties, np.array(parts, dtype=np.float64)


def _kind(kind: Kind) -> str:
    """Which of `GROUPS` rows belong to."""
    return {Kind.DRIVE: "efforts", Kind.CONE: "contacts"}.get(kind, "constraints")
