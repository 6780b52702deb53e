"""Inverse dynamics: torques of the independent coordinates and multipliers of couplings.

    tau_y = G' (rnea(F(y), G y', G y'' + dG/dt y') - sum J' w - sum f + sum M_f a)

Here w are external wrenches, f force terms of the scene and M_f the inertia that some of them add;
y are the independent coordinates, q = F(y) and G = dF/dy.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.loads import BodyLoads
from mbd_ros.core.model.couplings import Couplings, Slopes
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError

NO_BASIS: Array = np.zeros((0, 0))
NO_BASIS.setflags(write=False)
_BLOCK = 256  # samples whose Jacobians stay in the cache
_Poses = dict[int, tuple[Array, Array]]  # joint -> its rotations and origins in the world
_CHUNK = 2048  # samples


class InverseDynamics:
    """Inverse dynamics with dependent joints and external wrenches.

    One instance owns one Pinocchio `Data` and must not be shared between threads. A call allocates
    only its result and what the Pinocchio bindings return.

    Args:
        couplings: Dependent joints.
        wrenches: External loads, in the order in which `solve` takes their values.
        forces: Force terms of the scene.

    Attributes:
        configuration: q = F(y) of the last `solve` of a coupled or loaded robot, a live view
            (nq,).
        rows: Names of the multipliers, which are those of the dependent joints.
        needed: Joints that must be measured: the independent ones.
        correction: 0, since there are no loops onto which a sample could be projected.
        gap: Zeros, shape (n_d,).
    """

    correction = 0.0

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        wrenches: Sequence[ExternalWrench] = (),
        forces: Sequence[Load] = (),
    ) -> None:
        self.couplings = couplings
        self.rows = couplings.dependent
        self.needed = couplings.independent
        self.gap = np.zeros(len(couplings.dependent))
        self.wrenches = tuple(wrenches)
        self.forces = tuple(forces)
        self._heavy = tuple(force for force in forces if force.has_inertia)
        read = (force.reads for force in forces)
        self._reads = max([Reads.POSITION, *read])  # wrenches read positions
        self._model = robot.model
        self._data = pin.Data(robot.model)
        self._k = Kinematics(robot, self._data)
        self.configuration = self._q = pin.neutral(robot.model)
        self._v = np.zeros(robot.model.nv)
        self._a = np.zeros(robot.model.nv)
        self._zero = np.zeros(robot.model.nv)
        self._slopes: Slopes = [0.0] * len(couplings.dependent)
        self._no_multipliers = np.empty(0)
        self._rank = len(couplings.v_index) + len(couplings.dependent)
        self._base = np.flatnonzero(np.isin(couplings.v_index, robot.base_v))
        self._floats = robot.floating
        self._is_free = not (couplings.dependent or wrenches or forces)
        self._loads = BodyLoads(robot, self.wrenches)
        self._batch_loads: BatchLoads | None = None  # made for the first loaded batch
        self._robot = robot
        self._pool: Any = None  # pinocchio.ModelPool, made for the first batch

    def solve(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> Torques:
        """Return the torques of one sample as new arrays, see `SampleSolver.solve`."""
        if self._is_free and len(wrenches) == 0:
            tau = pin.rnea(self._model, self._data, position, velocity, acceleration)
            residual = tau[self._base] if self._floats else NONE
            return Torques(tau, self._no_multipliers, self._rank, residual)
        self._expand(position, velocity, acceleration)
        return self._torques(*self.couplings.reduce(self._full(wrenches), self._slopes))

    def expanded(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> Expanded:
        """Return the torques of one sample with the motion of all joints, see `solve`."""
        self._expand(position, velocity, acceleration)
        full = self._full(wrenches)
        tau, _ = self.couplings.reduce(full, self._slopes)
        return Expanded(tau, self._q, self._v, self._a, self._slopes)

    def components(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> TorqueComponents:
        """Return the torques of one sample by cause, for the arguments of `solve`."""
        self._expand(position, velocity, acceleration)
        model, data, q, v, a = self._model, self._data, self._q, self._v, self._a
        total = self._full(wrenches)
        unloaded = pin.rnea(model, data, q, v, a)
        gravity = pin.rnea(model, data, q, self._zero, self._zero)
        self._expand(position, velocity, np.zeros_like(acceleration))
        unaccelerated = pin.rnea(model, data, q, v, a)
        causes = (gravity, unaccelerated - gravity, unloaded - unaccelerated, total - unloaded)
        return TorqueComponents(
            *(self.couplings.reduce(cause, self._slopes)[0] for cause in causes)
        )

    def batch(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        wrenches: Sequence[Array] = (),
    ) -> Torques:
        """Return the torques of many samples, one a row.

        Args:
            position: y [rad or m], shape (n, ny).
            velocity: y' [rad/s or m/s], shape (n, nv_y).
            acceleration: y'' [rad/s^2 or m/s^2], shape (n, nv_y).
            wrenches: One (n, 6) array [N, N·m] for every load of the scene; none means unloaded.
        """
        chunks = range(0, max(len(position), 1), _CHUNK)
        if self._pool is None:
            self._pool = pin.ModelPool(self._model, 1)
        chunked = [
            self._chunk(
                self._pool,
                position[i : i + _CHUNK],
                velocity[i : i + _CHUNK],
                acceleration[i : i + _CHUNK],
                [load[i : i + _CHUNK] for load in wrenches],
            )
            for i in chunks
        ]
        tau, multipliers = (np.concatenate(part) for part in zip(*chunked, strict=True))
        return self._torques(tau, multipliers)

    def _torques(self, tau: Array, multipliers: Array) -> Torques:
        """Return the result, with all forces on a free base as its residual."""
        residual = tau[..., self._base] if self._floats else NONE
        return Torques(tau, multipliers, self._rank, residual)

    def _chunk(
        self,
        pool: Any,
        position: Array,
        velocity: Array,
        acceleration: Array,
        wrenches: Sequence[Array],
    ) -> tuple[Array, Array]:
        """Return torques and multipliers of a block of samples that fits into the cache."""
        n, couplings = len(position), self.couplings
        nq, nv = self._model.nq, self._model.nv
        q, v, a = (np.empty((size, n), order="F") for size in (nq, nv, nv))
        q[couplings.q_index] = position.T
        v[couplings.v_index], a[couplings.v_index] = velocity.T, acceleration.T
        slopes = couplings.expand(q, v, a)
        tau = np.empty((nv, n), order="F")
        pin.rneaInParallel(1, pool, q, v, a, tau)
        if wrenches:
            if self._batch_loads is None:
                self._batch_loads = BatchLoads(self._robot, self.wrenches)
            tau -= self._batch_loads.forces(q, wrenches)
        if self.forces:
            self._subtract_forces(tau, q, v, a)
        reduced, multipliers = couplings.reduce(tau, slopes)
        return reduced.T, multipliers.T

    def _subtract_forces(self, tau: Array, q: Array, v: Array, a: Array) -> None:
        """Subtract the force terms of each sample, a column, from its torques."""
        for i, (sample_q, sample_v) in enumerate(zip(q.T, v.T, strict=True)):
            self._k.refresh(sample_q, sample_v, self._reads)
            x = State(0.0, sample_q, sample_v)
            for term in self.forces:
                tau[:, i] -= term.force(self._k, x, NONE)
            for term in self._heavy:
                tau[:, i] += term.inertia(self._k, x).dot(a[:, i])

    def doubts(self) -> list[str]:
        """Return warnings about the validity of force terms at the last sample of `solve`."""
        x = State(0.0, self._q, self._v)
        return [doubt for term in self.forces if (doubt := term.doubt(x))]

    def _expand(self, position: Array, velocity: Array, acceleration: Array) -> None:
        couplings = self.couplings
        self._q[couplings.q_index] = position
        self._v[couplings.v_index] = velocity
        self._a[couplings.v_index] = acceleration
        couplings.expand(self._q, self._v, self._a, self._slopes)

    def _full(self, wrenches: Sequence[Array]) -> Array:
        """Return rnea(q, v, a) - sum J' w - sum f + sum M_f a of all joints."""
        if len(wrenches) == 0 and not self.forces:
            bare: Array = pin.rnea(self._model, self._data, self._q, self._v, self._a)
            return bare
        model, data, forces = self._model, self._data, self._loads.forces
        self._k.refresh(self._q, self._v, self._reads)
        self._loads.set(self._k, wrenches)
        tau: Array = pin.rnea(model, data, self._q, self._v, self._a, forces)
        if self.forces:
            x = State(0.0, self._q, self._v)
            for term in self.forces:
                tau -= term.force(self._k, x, NONE)
            for term in self._heavy:
                tau += term.inertia(self._k, x).dot(self._a)
        return tau


class Expanded(NamedTuple):
    """Motion of all joints at one sample, with its torques. All but the torques are live views.

    Attributes:
        tau: Torques of the independent coordinates [N·m or N], shape (nv_y,).
        q: Configuration, shape (nq,).
        v: Velocity, shape (nv,).
        a: Acceleration, shape (nv,).
        slopes: Slopes of the couplings at q, see `Couplings.expand`.
    """

    tau: Array
    q: Array
    v: Array
    a: Array
    slopes: Slopes


class Torques(NamedTuple):
    """Torques and multipliers that explain a motion, with loops or without.

    Attributes:
        tau: Force of every independent coordinate [N·m or N], shape (nv_y,) or (n, nv_y); of
            `ClosedLoopInverseDynamics` the inputs of its `efforts`, shape (na,).
        multipliers: Force of the tendon, cam or gear of every dependent joint on that joint
            [N·m for a revolute joint, N for a prismatic one], shape (n_d,) or (n, n_d). Positive
            pushes the joint in its positive direction. On its parent the coupling exerts -f' times
            as much. With loops, one for each row of the constraints; for a drive, its effort.
        rank: Number of independent forces that efforts and multipliers exert together.
        residual: Force [N] and moment [N·m] that the motion of a free base requires and that no
            effort or multiplier exerts, in the axes of the base, shape (6,) or (n, 6); six for
            each free base, 0 where contacts carry it; size 0 without a free base.
        null_space: Dimension of the efforts and multipliers that together exert no force,
            regardless of bounds; 0 without loops.
        undetermined: `<joint>.effort` and names of rows that take part in it.
        condition: Beyond 1e6 the mechanism is near a toggle and the result unreliable; 1
            without loops.
        null_basis: Basis of these: entries of tau, then of multipliers, one combination a column,
            shape (.., null_space); size 0 without loops.
        root_residual: Residual of the joints that replace a free base [N·m or N].
    """

    tau: Array
    multipliers: Array
    rank: int
    residual: Array = NONE
    null_space: int = 0
    undetermined: tuple[str, ...] = ()
    condition: float = 1.0
    null_basis: Array = NO_BASIS
    root_residual: Array = NONE


class SampleSolver(Protocol):
    """Inverse dynamics of the independent joints, sample by sample, with loops or without.

    Attributes:
        couplings: Dependent joints.
        configuration: Configuration of the last sample, shape (nq,).
        rows: Names of the multipliers: the dependent joints, then the rows of the constraints.
        needed: Joints that must be measured; the loops determine the others.
        correction: Largest displacement of a joint of the last sample by its projection onto the
            constraints [rad or m].
        gap: Residual of every row at the last sample as measured, shape (m,); 0 for drives and
            for couplings.
    """

    couplings: Couplings
    configuration: Array
    rows: tuple[str, ...]
    needed: tuple[str, ...]
    correction: float
    gap: Array

    def solve(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> Torques:
        """Return the torques of one sample.

        Args:
            position: y [rad or m], shape (ny,).
            velocity: y' [rad/s or m/s], shape (nv_y,).
            acceleration: y'' [rad/s^2 or m/s^2], shape (nv_y,).
            wrenches: One (6,) array [N, N·m] for every load of the scene; none means unloaded.
        """
        ...

    def doubts(self) -> list[str]:
        """Return warnings about the validity of force terms at the last sample of `solve`."""
        ...


class TorqueComponents(NamedTuple):
    """Torques of the independent coordinates by cause; their sum is `Torques.tau`.

    Attributes:
        gravity: G' g(q).
        coriolis: G' (C(q, v) v + M dG/dt y'), all terms quadratic in velocity.
        inertial: G' M G y''.
        external: -G' (sum J' w + sum f), the share of external wrenches and force terms.
    """

    gravity: Array
    coriolis: Array
    inertial: Array
    external: Array


class BatchLoads:
    """Generalized forces of measured loads, sum J' w, of many samples at once.

    A wrench w about the origin of the world, in its axes, does the work w . J dq with Pinocchio's
    world Jacobian J. Only the joints between the world and its body have a column.

    Args:
        wrenches: External loads, in the order in which `forces` takes their values.
    """

    def __init__(self, robot: Robot, wrenches: Sequence[ExternalWrench]) -> None:
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._loads = tuple(wrenches)
        points = robot.places.points
        self._origins = [points[load.about.number] for load in self._loads]
        self._moving = sorted({point.joint for point in self._origins} - {0})
        carriers = [points[load.carrier.number].joint for load in self._loads]
        self._columns = [_supporting_columns(robot.model, joint) for joint in carriers]

    def forces(self, q: Array, wrenches: Sequence[Array]) -> Array:
        """Return sum J' w.

        Args:
            q: Configurations, shape (nq, n).
            wrenches: One (n, 6) array for every load: force [N] then torque [N·m].

        Returns:
            Shape (nv, n).

        Raises:
            ModelError: The number of wrenches is not that of the loads.
        """
        if len(wrenches) != len(self._loads):
            raise ModelError(f"got {len(wrenches)} wrenches, but the scene has {len(self._loads)}")
        total: Array = np.zeros((self._model.nv, q.shape[1]))
        for start in range(0, q.shape[1], _BLOCK):
            rows = slice(start, start + _BLOCK)
            jacobians, poses = self._kinematics(q[:, rows])
            for k, values in enumerate(wrenches):
                world = self._in_world(k, values[rows], poses)
                part = np.einsum("ij,ijk->ki", world, jacobians)
                total[self._columns[k], rows] += part[self._columns[k]]
        return total

    def _kinematics(self, q: Array) -> tuple[Array, _Poses]:
        """Return world Jacobians, (n, 6, nv), and poses of the joints whose axes loads use."""
        n, data = q.shape[1], self._data
        jacobians = np.empty((n, 6, self._model.nv))
        poses = {joint: (np.empty((n, 3, 3)), np.empty((n, 3))) for joint in self._moving}
        jacobian, refresh = data.J, partial(pin.computeJointJacobians, self._model, data)
        for i, row in enumerate(np.ascontiguousarray(q.T)):
            refresh(row)
            jacobians[i] = jacobian
            for joint, (rotations, origins) in poses.items():
                pose = data.oMi[joint]
                rotations[i], origins[i] = pose.rotation, pose.translation
        return jacobians, poses

    def _in_world(self, k: int, values: Array, poses: _Poses) -> Array:
        """Return a load about the origin of the world, 0 where its force is below threshold."""
        load, origin = self._loads[k], self._origins[k]
        if load.threshold > 0.0:
            acts = np.linalg.norm(values[:, :3], axis=1) > load.threshold
            values = np.where(acts[:, None], values, 0.0)
        values = _transform_wrenches(values, origin.at.rotation, origin.at.translation)
        return _transform_wrenches(values, *poses[origin.joint]) if origin.joint else values


def _supporting_columns(model: Any, joint: int) -> NDArray[np.intp]:
    """Return the indices in v of the joints between the world and a joint."""
    supports = [model.joints[j] for j in model.supports[joint] if j]
    return np.array([i for j in supports for i in range(j.idx_v, j.idx_v + j.nv)], np.intp)


def _transform_wrenches(values: Array, rotation: Array, origin: Array) -> Array:
    """Return wrenches about the parent origin, in its axes, shape (n, 6)."""
    force, torque = (
        np.einsum("...ij,...j->...i", rotation, part) for part in (values[:, :3], values[:, 3:])
    )
    return np.hstack([force, torque + np.cross(origin, force)])
