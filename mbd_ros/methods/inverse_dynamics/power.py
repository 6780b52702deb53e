"""Power of everything that acts on a mechanism, and where it flows.

    sum of powers = d/dt (kinetic energy)

On the left stand generalized forces times velocities, and the weight; on the right masses of
bodies times their velocities and accelerations. What differs is the `residual`: 0 to rounding
where efforts and multipliers explain the motion. Source: K. E. Zelik, A. D. Kuo, J. Exp. Biology
213 (2010) 4257, doi:10.1242/jeb.044297, on work of joints, of soft parts and of the whole.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.contracts import Load, Output, label, without_multiplier
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.poses import cross
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.loads import BodyLoads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows, CouplingRows, RowLayout
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.methods.inverse_dynamics.closed_loop import ObservedLoops
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import SampleSolver, Torques

WATT = "W"
PROXIMAL, DISTAL = "proximal_power", "distal_power"
QUANTITIES = "gravity_power", "load_power", "kinetic_energy_rate"
POWER = "power"  # quantity of a part, and the part of all sums
GROUPS = (
    *("efforts", "couplings", "constraints", "contacts", "forces", "external_wrenches"),
    *("gravity", "unexplained"),
)


class PowerBalance:
    """Powers of joints, parts and segments, their sums by kind, and what is left.

    `power.<kind>` sums up efforts and drives, couplings (0: what they take from a joint they give
    to another), other constraints, contacts, force terms, external wrenches, gravity, and the
    residual of free bases. Positive power adds kinetic energy. That of rotors is part of it.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        constraints: The rows that multipliers are given for.
        driven: Joints whose efforts are given.
        wrenches: External loads by name.
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


class ObservedPower:
    """Powers of the independent joints, parts and segments, from what a solver found.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        solver: Solves the samples; asked about the newest of them.
        wrenches: External loads by name.

    Attributes:
        outputs: As those of `PowerBalance`.
    """

    def __init__(
        self,
        robot: Robot,
        solver: SampleSolver,
        wrenches: Mapping[str, ExternalWrench],
        forces: Sequence[Load],
    ) -> None:
        couplings, nv = solver.couplings, int(robot.model.nv)
        self._couplings, self._loops = couplings, None
        if isinstance(solver, ObservedLoops):
            self._loops, rows = solver, solver.inverse.constraints
        else:
            ties = [CouplingRows(robot, couplings)] if couplings.dependent else []
            rows = ConstraintRows(RowLayout(ties).blocks, nv)
        free = () if self._loops is None else self._loops.inverse.carriers
        driven = [name for name in couplings.independent if name not in free]
        self._balance = PowerBalance(robot, rows, driven, wrenches, forces)
        self.outputs = self._balance.outputs
        self._neutral, self._nv, self._base = robot.neutral(), nv, robot.base_v

    def values(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        found: Torques,
        wrenches: Sequence[Array] = (),
    ) -> Array:
        """Values of `outputs` of the newest sample, shape (len(outputs),).

        Args:
            position: y, as it was solved, shape (ny,).
            velocity: y', shape (nv_y,).
            acceleration: y'', shape (nv_y,).
            found: What the solver found for it.
            wrenches: One (6,) array for every load; none means unloaded.
        """
        efforts, residual = np.zeros(self._nv), np.zeros(self._nv)
        efforts[self._couplings.v_index] = found.tau
        if self._loops is not None and self._loops.motion is not None:
            x, a = self._loops.motion
            residual = self._loops.inverse.carried(found)
        else:
            x, a = self._whole(position, velocity, acceleration)
            residual[self._base] = found.residual
        exerted = Exerted(efforts - residual, residual, found.multipliers)
        return self._balance.values(x, a, exerted, wrenches)

    def _whole(self, y: Array, rate: Array, acceleration: Array) -> tuple[State, Array]:
        q, v, a = self._neutral.copy(), np.zeros(self._nv), np.zeros(self._nv)
        index = self._couplings.v_index
        q[self._couplings.q_index], v[index], a[index] = y, rate, acceleration
        self._couplings.expand(q, v, a)
        return State(0.0, q, v), a


class SegmentPower:
    """Powers of segments: bodies, and the joints between them.

    What a joint passes on, the force F at its origin and the moment M about it, works at both of
    its ends: F . v + M . omega with the motion of the segment there. The child takes in one at its
    proximal end, the parent the opposite of it at its distal end. Their sum is the power of what
    acts in the joint; the rest passes through the joint from segment to segment. Source: D. G. E.
    Robertson, D. A. Winter, J. Biomechanics 13 (1980) 845, doi:10.1016/0021-9290(80)90172-4.

    Bodies without mass between two joints are no segments: what goes in goes out. A free body is
    joined to the world by what nothing carries of it.

    One instance owns its Pinocchio data: not for two threads.

    Attributes:
        outputs: `<link>.proximal_power`, `<link>.distal_power_<link>` of what each next link
            gives to it, `<link>.gravity_power`, `.load_power` and `.kinetic_energy_rate`, in the
            order of `values`; all five but the last sum up to the last.
    """

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        self._model, self._data, n = model, pin.Data(model), int(model.njoints)
        self._mass = np.array([float(inertia.mass) for inertia in model.inertias])
        self._lever = np.array([inertia.lever for inertia in model.inertias])
        self._inertia = np.array([inertia.inertia for inertia in model.inertias])
        self._g = np.array(model.gravity.linear)
        self._every, self._parents = range(n), np.array(model.parents, dtype=np.intp)
        chains = _chains(model, self._mass)
        names = _names(robot)
        self._at: NDArray[np.intp] = np.array([chain[-1] for chain in chains], dtype=np.intp)
        ends = [(int(model.parents[chain[0]]), chain) for chain in chains]
        self._distal = np.array([chain[0] for parent, chain in ends if parent], dtype=np.intp)
        outputs = [f"{names[i]}.{PROXIMAL}" for i in self._at]
        outputs += [f"{names[p]}.{DISTAL}_{names[chain[-1]]}" for p, chain in ends if p]
        outputs += [f"{names[i]}.{quantity}" for quantity in QUANTITIES for i in self._at]
        self.outputs = tuple(Output(name, WATT) for name in outputs)

    def bodies(self, x: State, a: Array, loads: BodyLoads) -> Bodies:
        """Powers of all bodies.

        Args:
            x: State of all joints.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            loads: Wrenches on bodies.
        """
        model, data = self._model, self._data
        pin.rnea(model, data, x.q, x.v, a, loads.forces)
        pin.forwardKinematics(model, data, x.q, x.v, a)
        f, v, acc, load = (
            np.array([field[i].vector for i in self._every])
            for field in (data.f, data.v, data.a, loads.forces)
        )
        f[0] = 0.0
        v_mass = v[:, :3] + cross(v[:, 3:], self._lever)
        a_mass = acc[:, :3] + cross(acc[:, 3:], self._lever)  # less what is across v_mass
        turned = _turned(self._inertia, v[:, 3:])
        speed = np.einsum("ij,ij->i", v_mass, v_mass)
        weight = self._g @ np.array([pose.rotation for pose in data.oMi])
        return Bodies(
            _products(f, v),
            self._given(f, v),
            self._mass * _products(weight, v_mass),
            _products(load, v),
            self._mass * _products(v_mass, a_mass) + _products(turned, acc[:, 3:]),
            0.5 * (self._mass * speed + _products(turned, v[:, 3:])),
        )

    def values(self, of: Bodies) -> Array:
        """Values of `outputs`, shape (len(outputs),)."""
        at = self._at
        parts = of.taken[at], of.given[self._distal], of.gravity[at], of.load[at], of.rate[at]
        return np.concatenate(parts)

    def _given(self, f: Array, v: Array) -> Array:
        """What each joint gives to the parent: minus what it passes on, at the parent's motion."""
        poses = self._data.liMi
        turn = np.array([pose.rotation for pose in poses])
        place = np.array([pose.translation for pose in poses])
        force, moment = _turned(turn, f[:, :3]), _turned(turn, f[:, 3:])
        parent = v[self._parents]
        moment += cross(place, force)
        given: Array = -_products(force, parent[:, :3]) - _products(moment, parent[:, 3:])
        return given


def _chains(model: Any, mass: Array) -> list[list[int]]:
    """Joints from segment to segment: those of bodies without mass, then that of the segment."""
    children = np.bincount(np.array(model.parents)[1:], minlength=model.njoints)
    passes = (mass == 0.0) & (children == 1)
    chains = []
    for i in range(1, model.njoints):
        if passes[i]:
            continue
        chain = [i]
        while (above := int(model.parents[chain[0]])) and passes[above]:
            chain.insert(0, above)
        chains.append(chain)
    return chains


def _names(robot: Robot) -> dict[int, str]:
    """Joint of the model -> the link that it carries, the heaviest of several."""
    names: dict[int, str] = {}
    heaviest: dict[int, float] = {}
    for frame in robot.model.frames:
        if frame.type == pin.FrameType.BODY:
            names.setdefault(int(frame.parentJoint), frame.name)
    for name, inertia in robot.inertias().items():
        joint = int(robot.model.frames[robot.frame(name)].parentJoint)
        if float(inertia.mass) > heaviest.get(joint, 0.0):
            names[joint], heaviest[joint] = name, float(inertia.mass)
    return names


class Bodies(NamedTuple):
    """Powers of all bodies of a model, the world as the first of them [W], shape (n,) each.

    Attributes:
        taken: What the joint of a body gives to it.
        given: What the same joint gives to the parent.
        gravity: Power of its weight.
        load: Power of all wrenches on it.
        rate: Rate of its kinetic energy.
        energy: Its kinetic energy [J].
    """

    taken: Array
    given: Array
    gravity: Array
    load: Array
    rate: Array
    energy: Array


def _turned(A: Array, b: Array) -> Array:
    turned: Array = np.einsum("nij,nj->ni", A, b)
    return turned


def _products(a: Array, b: Array) -> Array:
    products: Array = np.einsum("ij,ij->i", a, b)
    return products
