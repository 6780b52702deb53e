"""Power balance of a mechanism: power of every force, and its flow between segments.

    sum of powers = d/dt (kinetic energy)

The left-hand side sums generalized forces times velocities and the power of the weight; the
right-hand side is computed from masses, velocities and accelerations of the bodies. Their
difference is the `residual`, which is 0 to rounding where efforts and multipliers explain the
motion. Source: K. E. Zelik, A. D. Kuo, J. Exp. Biology 213 (2010) 4257, doi:10.1242/jeb.044297,
on the work of joints, of soft tissue and of the whole body.
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
POWER = "power"  # name of the quantity, and prefix of the sums
GROUPS = (
    *("efforts", "couplings", "constraints", "contacts", "forces", "external_wrenches"),
    *("gravity", "unexplained"),
)


class PowerBalance:
    """Powers of joints, parts and segments, their sums by kind, and the residual of the balance.

    `power.<kind>` sums up efforts and drives, couplings (0, since they only transfer power between
    joints), other constraints, contacts, force terms, external wrenches, gravity, and the residual
    of free bases. Positive power increases the kinetic energy, which includes that of rotors.

    One instance owns its Pinocchio data and must not be shared between threads.

    Args:
        constraints: The rows to which the multipliers belong.
        driven: Joints that have an effort.
        wrenches: External loads by name.
        contacts: Names of external loads that are contact forces.

    Attributes:
        outputs: `<joint>.power`, `<part>.power`, `<dependent joint>.coupling_power` (power of the
            coupling on it), those of `SegmentPower`, the sums `power.<kind>`, then
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

    def values(
        self, x: State, a: Array, forces: ExertedForces, wrenches: Sequence[Array] = ()
    ) -> Array:
        """Return the values of `outputs`, shape (len(outputs),).

        Args:
            x: State of all joints.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            forces: Efforts, residual and multipliers.
            wrenches: One (6,) array [N, N·m] for every load; none means unloaded.
        """
        self._k.refresh(x.q, x.v)
        self._set_loads(x, forces.multipliers, wrenches)
        bodies = self._segments.bodies(x, a, self._loads)
        ties, parts = self._part_powers(x, forces.multipliers, wrenches)
        sums = np.zeros(len(GROUPS))
        np.add.at(sums, self._group, parts)
        sums[GROUPS.index("efforts")] += forces.efforts.dot(x.v)
        sums[GROUPS.index("couplings")] += ties
        sums[GROUPS.index("gravity")] = bodies.gravity.sum()
        sums[GROUPS.index("unexplained")] = forces.residual.dot(x.v)
        rotors = self._armature * x.v
        rate = float(bodies.rate.sum() + rotors.dot(a))
        tied = forces.multipliers[: len(self._tied)] * x.v[self._tied]
        balance = rate, sums.sum() - rate, bodies.energy.sum() + 0.5 * rotors.dot(x.v)
        driven = (forces.efforts * x.v)[self._driven]
        return np.concatenate((driven, tied, parts, self._segments.values(bodies), sums, balance))

    def _set_loads(self, x: State, multipliers: Array, wrenches: Sequence[Array]) -> None:
        """Apply all wrenches to their bodies."""
        self._loads.set(self._k, wrenches)
        for wrench in self._rows.wrenches(self._k, x, multipliers):
            self._loads.add(self._k, wrench)
        for force in self._forces:
            for wrench in force.wrenches(self._k, x, NONE):
                self._loads.add(self._k, wrench)

    def _part_powers(
        self, x: State, multipliers: Array, wrenches: Sequence[Array]
    ) -> tuple[float, Array]:
        """Return the power of all couplings, and that of each other part."""
        row_powers = multipliers * self._rows.jacobian(self._k, x).dot(x.v)
        ties, parts = 0.0, []
        for part, mine in zip(self._rows.parts, self._rows.slices, strict=True):
            if isinstance(part, CouplingRows):
                ties += float(row_powers[mine].sum())
            else:
                parts.append(float(row_powers[mine].sum()))
        parts += [force.force(self._k, x, NONE).dot(x.v) for force in self._forces]
        values = wrenches or [np.zeros(6)] * len(self._wrenches)
        for load, value in zip(self._wrenches, values, strict=True):
            acts = load.is_loaded(value)
            parts.append(float(load.force_of(self._k, value).dot(x.v)) if acts else 0.0)
        return ties, np.array(parts, dtype=np.float64)


def _kind(kind: Kind) -> str:
    """Return the entry of `GROUPS` to which rows of a kind belong."""
    return {Kind.DRIVE: "efforts", Kind.CONE: "contacts"}.get(kind, "constraints")


class ExertedForces(NamedTuple):
    """Forces of a motion that inverse dynamics has solved.

    Attributes:
        efforts: Generalized force of the actuators on all joints [N·m or N], shape (nv,).
        residual: Generalized force on free bases that no part exerts [N·m or N], shape (nv,).
        multipliers: Multipliers of the rows, shape (m,).
    """

    efforts: Array
    residual: Array
    multipliers: Array


class ObservedPower:
    """Powers of joints, parts and segments at the newest sample that a solver has solved.

    One instance owns its Pinocchio data and must not be shared between threads.

    Args:
        solver: Solver of the samples.
        wrenches: External loads by name.

    Attributes:
        outputs: Same as `PowerBalance.outputs`.
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
        free = () if self._loops is None else self._loops.inverse.root_joints
        driven = [name for name in couplings.independent if name not in free]
        self._balance = PowerBalance(robot, rows, driven, wrenches, forces)
        self.outputs = self._balance.outputs
        self._neutral, self._nv, self._base = robot.neutral(), nv, robot.base_v

    def values(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        torques: Torques,
        wrenches: Sequence[Array] = (),
    ) -> Array:
        """Return the values of `outputs` at the newest sample, shape (len(outputs),).

        Args:
            position: y of the solved sample, shape (ny,).
            velocity: y', shape (nv_y,).
            acceleration: y'', shape (nv_y,).
            torques: Result of the solver for this sample.
            wrenches: One (6,) array for every load; none means unloaded.
        """
        efforts, residual = np.zeros(self._nv), np.zeros(self._nv)
        efforts[self._couplings.v_index] = torques.tau
        if self._loops is not None and self._loops.motion is not None:
            x, a = self._loops.motion
            residual = self._loops.inverse.unsupported_force(torques)
        else:
            x, a = self._expand(position, velocity, acceleration)
            residual[self._base] = torques.residual
        exerted = ExertedForces(efforts - residual, residual, torques.multipliers)
        return self._balance.values(x, a, exerted, wrenches)

    def _expand(self, y: Array, velocity: Array, acceleration: Array) -> tuple[State, Array]:
        q, v, a = self._neutral.copy(), np.zeros(self._nv), np.zeros(self._nv)
        index = self._couplings.v_index
        q[self._couplings.q_index], v[index], a[index] = y, velocity, acceleration
        self._couplings.expand(q, v, a)
        return State(0.0, q, v), a


class SegmentPower:
    """Power flow through segments (bodies with mass) and the joints between them.

    A joint transmits the force F at its origin and the moment M about it. These do work on both
    segments: the power F . v + M . omega, with the motion of the child, enters the child at its
    proximal end; the opposite force and moment, with the motion of the parent, act on the parent
    at its distal end. The sum of both is the power that the joint itself generates; the remainder
    flows through the joint from segment to segment. Source: D. G. E. Robertson, D. A. Winter,
    J. Biomechanics 13 (1980) 845, doi:10.1016/0021-9290(80)90172-4.

    Massless bodies between two joints are not segments, since power flows through them unchanged.
    The residual force of a free body acts on it like a joint to the world.

    One instance owns its Pinocchio data and must not be shared between threads.

    Attributes:
        outputs: `<link>.proximal_power`, `<link>.distal_power_<link>` from each next link,
            `<link>.gravity_power`, `.load_power` and `.kinetic_energy_rate`, in the order of
            `values`. The first four of a link sum up to the last.
    """

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        self._model, self._data, n = model, pin.Data(model), int(model.njoints)
        self._mass = np.array([float(inertia.mass) for inertia in model.inertias])
        self._lever = np.array([inertia.lever for inertia in model.inertias])
        self._inertia = np.array([inertia.inertia for inertia in model.inertias])
        self._g = np.array(model.gravity.linear)
        self._all_joints, self._parents = range(n), np.array(model.parents, dtype=np.intp)
        chains = _chains(model, self._mass)
        names = _names(robot)
        self._at: NDArray[np.intp] = np.array([chain[-1] for chain in chains], dtype=np.intp)
        ends = [(int(model.parents[chain[0]]), chain) for chain in chains]
        self._distal = np.array([chain[0] for parent, chain in ends if parent], dtype=np.intp)
        outputs = [f"{names[i]}.{PROXIMAL}" for i in self._at]
        outputs += [f"{names[p]}.{DISTAL}_{names[chain[-1]]}" for p, chain in ends if p]
        outputs += [f"{names[i]}.{quantity}" for quantity in QUANTITIES for i in self._at]
        self.outputs = tuple(Output(name, WATT) for name in outputs)

    def bodies(self, x: State, a: Array, loads: BodyLoads) -> BodyPowers:
        """Return the powers of all bodies.

        Args:
            x: State of all joints.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            loads: All wrenches on bodies.
        """
        model, data = self._model, self._data
        pin.rnea(model, data, x.q, x.v, a, loads.forces)
        pin.forwardKinematics(model, data, x.q, x.v, a)
        f, v, acc, load = (
            np.array([field[i].vector for i in self._all_joints])
            for field in (data.f, data.v, data.a, loads.forces)
        )
        f[0] = 0.0
        v_mass = v[:, :3] + cross(v[:, 3:], self._lever)
        a_mass = acc[:, :3] + cross(acc[:, 3:], self._lever)  # without the terms normal to v_mass
        momentum = _multiply(self._inertia, v[:, 3:])
        speed = np.einsum("ij,ij->i", v_mass, v_mass)
        weight = self._g @ np.array([pose.rotation for pose in data.oMi])
        return BodyPowers(
            _products(f, v),
            self._distal_power(f, v),
            self._mass * _products(weight, v_mass),
            _products(load, v),
            self._mass * _products(v_mass, a_mass) + _products(momentum, acc[:, 3:]),
            0.5 * (self._mass * speed + _products(momentum, v[:, 3:])),
        )

    def values(self, bodies: BodyPowers) -> Array:
        """Return the values of `outputs`, shape (len(outputs),)."""
        at = self._at
        return np.concatenate(
            (
                bodies.proximal[at],
                bodies.distal[self._distal],
                bodies.gravity[at],
                bodies.load[at],
                bodies.rate[at],
            )
        )

    def _distal_power(self, f: Array, v: Array) -> Array:
        """Return the power of the opposite joint force on each parent, with its motion."""
        poses = self._data.liMi
        rotation = np.array([pose.rotation for pose in poses])
        origin = np.array([pose.translation for pose in poses])
        force, moment = _multiply(rotation, f[:, :3]), _multiply(rotation, f[:, 3:])
        parent = v[self._parents]
        moment += cross(origin, force)
        power: Array = -_products(force, parent[:, :3]) - _products(moment, parent[:, 3:])
        return power


def _chains(model: Any, mass: Array) -> list[list[int]]:
    """Return the joints that lead to each segment: those of massless bodies, then its own."""
    children = np.bincount(np.array(model.parents)[1:], minlength=model.njoints)
    is_massless = (mass == 0.0) & (children == 1)
    chains = []
    for i in range(1, model.njoints):
        if is_massless[i]:
            continue
        chain = [i]
        while (above := int(model.parents[chain[0]])) and is_massless[above]:
            chain.insert(0, above)
        chains.append(chain)
    return chains


def _names(robot: Robot) -> dict[int, str]:
    """Map each joint of the model to the link that it carries, the heaviest of several."""
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


class BodyPowers(NamedTuple):
    """Powers of all bodies of a model [W], shape (n,) each; the first body is the world.

    Attributes:
        proximal: Power of the joint of a body on the body.
        distal: Power of the same joint on the parent body.
        gravity: Power of its weight.
        load: Power of all wrenches on it.
        rate: Rate of its kinetic energy.
        energy: Its kinetic energy [J].
    """

    proximal: Array
    distal: Array
    gravity: Array
    load: Array
    rate: Array
    energy: Array


def _multiply(A: Array, b: Array) -> Array:
    product: Array = np.einsum("nij,nj->ni", A, b)
    return product


def _products(a: Array, b: Array) -> Array:
    products: Array = np.einsum("ij,ij->i", a, b)
    return products
