"""Linear regressors of inertias and friction, for chains with couplings and for loops.

    G' (rnea - loads) = G' W(q, v, a) p + known,    N' W p + known = N' B u

W is the joint torque regressor of Pinocchio and p the inertial parameters of all bodies. G is the
Jacobian of the couplings. The columns of N span the motions that loops allow, one column for each
of some of the actuated joints. `known` are the torques of springs, rotors and measured wrenches.

Where columns of W are combinations of others (W2 = W1 B), p1 and p2 cannot be identified
separately. The base parameters are b = p1 + B p2, as many as the rank of W.

Source: M. Gautier, J. Robotic Systems 8, 1991, 485 (by QR); W. Khalil, E. Dombre, Modeling,
Identification and Control of Robots, 2002, section 9.4.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.model.couplings import Couplings, IndependentCoordinates
from mbd_ros.core.model.inertial_parameters import COUNT, PARAMETER_NAMES, parameters_of
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SINGULAR
from mbd_ros.errors import ModelError
from mbd_ros.methods.inverse_dynamics.closed_loop import ObservedLoops
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics

_SMOOTHINGS = (0.005, 0.02, 0.05, 0.1, 0.2, 0.4)  # of the RMS velocity
_STRIBECKS = (0.1, 0.3, 0.6)  # of the RMS velocity
TERMS = ("viscous", "coulomb", "offset", "load", "stribeck", "inertia")
SHARED_MOTOR_TERMS = ("viscous", "coulomb", "offset", "stribeck")  # of coupled motors
# Within a body, masses come last, so that they are regrouped into the moments about joints.
_ORDER = tuple(
    PARAMETER_NAMES.index(place)
    for place in ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mcx", "mcy", "mcz", "mass")
)
_ROUNDED = 1.0e-9  # of the largest factor in a combination: smaller factors are rounding


class Regressor:
    """Regressor of an open chain, coupled or not: one row per independent coordinate.

    Args:
        solver: Inverse dynamics of the scene, whose forces and wrenches are the known ones.

    Attributes:
        labels: Names of the rows: joints, and coordinates of free bases.
        coordinates: Indices of the rows among the independent velocities.
        size: Number of inertial parameters of all bodies.
        base: Indices of the rows that no joint drives, those of free bases.
    """

    def __init__(self, robot: Robot, solver: InverseDynamics) -> None:
        self._solver = solver
        self._couplings = solver.couplings
        self._model = robot.model
        self._data = pin.Data(robot.model)
        self._weight_model = self._model
        self._parameters = parameters_of(robot.model).ravel()
        self.size = len(self._parameters)
        names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
        v_index = self._couplings.v_index
        self.labels = tuple(names[int(v)] for v in v_index)
        self.coordinates = np.arange(len(v_index))
        self.base = np.flatnonzero(np.isin(v_index, robot.base_v))

    def rows(self, y: Array, v: Array, a: Array) -> Array:
        """Return G' W at samples.

        Args:
            y: Independent coordinates, shape (n, ny).
            v: Their velocities, shape (n, nv_y).
            a: Their accelerations, same shape.

        Returns:
            Array of shape (n, nv_y, `size`).
        """
        q, velocity, acceleration, slopes = expand_coordinates(
            self._model, self._couplings, y, v, a
        )
        W = np.empty((len(y), self._model.nv, self.size))
        model, data = self._model, self._data
        samples = zip(q.T, velocity.T, acceleration.T, strict=True)
        for row, sample in zip(W, samples, strict=True):
            row[...] = pin.computeJointTorqueRegressor(model, data, *sample)
        for slope, pair in zip(reversed(slopes), reversed(self._couplings.pairs), strict=True):
            W[:, pair.parent_v] += (np.ones(len(y)) * slope)[:, None] * W[:, pair.child_v]
        return W[:, self._couplings.v_index] if self._couplings.pairs else W

    def known(self, rows: Array, y: Array, v: Array, a: Array, loads: Sequence[Array]) -> Array:
        """Return the torques of all but the inertias, shape (n, nv_y).

        Args:
            rows: Result of `rows` for the same samples.
            loads: Measured wrenches, shape (n, 6) each.
        """
        tau: Array = self._solver.batch(y, v, a, list(loads)).tau
        known: Array = tau - rows @ self._parameters
        return known

    def set_weight_model(self, model: pin.Model) -> None:
        """Let `weight` use a model with other inertias from now on."""
        self._weight_model = model

    def weight(self, y: Array) -> Array:
        """Return the torques that hold the joints still against gravity, shape (n, nv_y)."""
        zero = np.zeros((len(y), len(self.labels)))
        q = expand_coordinates(self._model, self._couplings, y, zero, zero)[0]
        model, data, v_index = self._weight_model, self._data, self._couplings.v_index
        return np.array([pin.computeGeneralizedGravity(model, data, q_i)[v_index] for q_i in q.T])


class LoopRegressor:
    """Regressor of a mechanism with loops: one row per degree of freedom.

    N = [E; -J_2^-1 J_1] has a column for each of some actuated joints, chosen once: J N = 0
    eliminates the multipliers, N' (M a + h - loads) = N' B u. Efforts of other joints act along
    N, too.

    Source: J. Garcia de Jalon, E. Bayo, Kinematic and Dynamic Simulation of Multibody Systems,
    1994, section 5.2 (independent coordinates by the matrix R).

    Args:
        solver: Inverse dynamics of the scene, whose forces and wrenches are the known ones.
        start: State near the constraints.
        driven: Names of the joints whose efforts are measured.

    Attributes:
        labels: Actuated joints by which the mechanism moves, and coordinates of free bases.
        coordinates: Indices of the rows among the independent velocities.
        size: Number of inertial parameters of all bodies.
        base: Indices of the rows that no joint drives.

    Raises:
        ModelError: The driven joints do not determine the motion.
    """

    def __init__(
        self, robot: Robot, solver: ObservedLoops, start: State, driven: Sequence[str]
    ) -> None:
        self._solver = solver
        self._inverse = solver.inverse
        self._model = robot.model
        self._data = pin.Data(robot.model)
        self._weight_model = self._model
        self._parameters = parameters_of(robot.model).ravel()
        self.size = len(self._parameters)
        names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
        first = [*robot.base_v.tolist(), *(robot.joint(name).v for name in driven)]
        q = self._inverse.motion.assemble(start)
        J = self._inverse.motion.jacobian(start.t, q)
        self._first = _leading(J, first)
        self._others = np.setdiff1d(np.arange(self._model.nv), self._first)
        self.labels = tuple(names[int(v)] for v in self._first)
        self.coordinates = np.searchsorted(solver.couplings.v_index, self._first)
        self.base = np.flatnonzero(np.isin(self._first, robot.base_v))

    def motions(self, q: Array) -> Array:
        """Return N at a configuration on the constraints, shape (nv, len(labels))."""
        J = self._inverse.motion.jacobian(0.0, q)
        N = np.zeros((self._model.nv, len(self._first)))
        N[self._first, np.arange(len(self._first))] = 1.0
        N[self._others] = -np.linalg.lstsq(J[:, self._others], J[:, self._first], rcond=SINGULAR)[
            0
        ]
        return N

    def consistent(self, y: Array, v: Array, a: Array) -> tuple[State, Array]:
        """Return the nearest state and acceleration that satisfy the constraints."""
        return self._inverse.project_motion(*self._solver.measured(0.0, y, v, a))

    def rows(self, y: Array, v: Array, a: Array) -> Array:
        """Return N' W at samples, shape (n, len(labels), `size`)."""
        rows = np.empty((len(y), len(self.labels), self.size))
        for row, *sample in zip(rows, y, v, a, strict=True):
            x, acceleration = self.consistent(*sample)
            W = pin.computeJointTorqueRegressor(self._model, self._data, x.q, x.v, acceleration)
            row[...] = self.motions(x.q).T @ W
        return rows

    def known(self, rows: Array, y: Array, v: Array, a: Array, loads: Sequence[Array]) -> Array:
        """Return the torques of all but the inertias, shape (n, len(labels)).

        Args:
            rows: Result of `rows` for the same samples.
            loads: Measured wrenches, shape (n, 6) each.
        """
        torques = np.empty((len(y), len(self.labels)))
        for i, sample in enumerate(zip(y, v, a, strict=True)):
            x, acceleration = self.consistent(*sample)
            terms = self._inverse.required_force(x, acceleration, [load[i] for load in loads])
            torques[i] = self.motions(x.q).T @ terms
        known: Array = torques - rows @ self._parameters
        return known

    def set_weight_model(self, model: pin.Model) -> None:
        """Let `weight` use a model with other inertias from now on."""
        self._weight_model = model

    def weight(self, y: Array) -> Array:
        """Return the torques that hold the joints against gravity, shape (n, len(labels))."""
        zero, weights = np.zeros((len(y), self._model.nv)), np.empty((len(y), len(self.labels)))
        for row, sample in zip(weights, y, strict=True):
            still = zero[0][: self._velocity_size(sample)]
            x, _ = self._solver.measured(0.0, sample, still, still)
            gravity = pin.computeGeneralizedGravity(self._weight_model, self._data, x.q)
            row[...] = gravity[self._first]
        return weights

    def _velocity_size(self, sample: Array) -> int:
        return len(sample) - (int(self._model.nq) - int(self._model.nv))


def _leading(J: Array, preferred: Sequence[int]) -> NDArray[np.intp]:
    """Return coordinates that determine all others, chosen among the preferred ones.

    Raises:
        ModelError: The preferred coordinates do not determine the others, or are more than the
            mechanism has degrees of freedom.
    """
    nv, size = J.shape[1], SINGULAR * float(np.linalg.norm(J, 2))

    def rank(columns: Sequence[int]) -> int:
        return int(np.linalg.matrix_rank(J[:, columns], tol=size)) if len(columns) else 0

    freedom, chosen = nv - rank(range(nv)), list[int]()
    for v in preferred:
        dependent = [i for i in range(nv) if i not in {*chosen, v}]
        if rank(dependent) == nv - freedom:
            chosen.append(v)
    if len(chosen) < freedom or len(preferred) > freedom:
        raise ModelError(
            f"the mechanism has {freedom} degrees of freedom and {len(preferred)} joints with "
            "measured efforts; identification needs measured efforts of exactly as many joints as "
            "there are degrees of freedom, and these joints must determine the motion"
        )
    return np.array(sorted(chosen), dtype=np.intp)


class Column(NamedTuple):
    """One column of the regressor of friction and rotor inertia of a joint.

        tau = viscous v + (coulomb + load |g| + stribeck / (1 + (v / v_s)^2)) s + offset
              + inertia a,    s = tanh(v / smoothing)

    with g the torque that holds the given robot still against gravity. The torque is linear in all
    but smoothing and v_s. Candidates for these two are a few multiples of the RMS velocity of the
    joint.

    Source: D. P. Hess, A. Soom, J. Tribology 112, 1990, 147 (this Stribeck curve); B.
    Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30, 1994, 1083 (a survey).

    Attributes:
        term: One of `TERMS`.
        smoothing: Velocity of the smoothing [rad/s or m/s]; 0 where the term has none.
        stribeck: v_s [rad/s or m/s]; 0 where the term has none.
    """

    term: str
    smoothing: float = 0.0
    stribeck: float = 0.0


def columns_of(chosen: Sequence[Column], v: Array, a: Array, weight: Array) -> Array:
    """Return the values of friction columns, shape (n, len(chosen)).

    Args:
        v: Velocities of the joint [rad/s or m/s], shape (n,).
        a: Its accelerations [rad/s^2 or m/s^2], shape (n,).
        weight: Torques that hold the joint still against gravity [N·m or N], shape (n,).
    """
    values = np.empty((len(v), len(chosen)))
    for k, (term, smoothing, stribeck) in enumerate(chosen):
        plain = {"viscous": v, "inertia": a, "offset": np.ones_like(v)}
        if term in plain:
            values[:, k] = plain[term]
            continue
        side = np.tanh(v / smoothing)
        if term == "load":
            side *= np.abs(weight)
        if term == "stribeck":
            side /= 1.0 + np.square(v / stribeck)
        values[:, k] = side
    return values


def candidates(rms: float) -> tuple[Column, ...]:
    """Return all candidate columns of a joint.

    Args:
        rms: Root mean square of the velocity of the joint [rad/s or m/s].
    """
    smooth = [factor * rms for factor in _SMOOTHINGS]
    curves = [(s, factor * rms) for s in smooth[:3] for factor in _STRIBECKS]
    return (
        *(Column(term) for term in ("viscous", "offset", "inertia")),
        *(Column("coulomb", s) for s in smooth),
        *(Column("load", s) for s in smooth),
        *(Column("stribeck", s, v) for s, v in curves),
    )


def choices(columns: Sequence[Column], allowed: Iterable[str]) -> list[tuple[int, ...]]:
    """Return the sets of columns that make sense together, by index; the empty set comes first.

    Args:
        columns: Candidates of the joint.
        allowed: Terms that may be used, of `TERMS`.
    """
    terms = set(allowed)
    index: dict[str, list[int]] = {term: [] for term in TERMS}
    for i, column in enumerate(columns):
        if column.term in terms:
            index[column.term].append(i)
    dry: list[tuple[int, ...]] = [()]
    for c in index["coulomb"]:
        smoothing = columns[c].smoothing
        loads = [i for i in index["load"] if columns[i].smoothing == smoothing]
        curves = [i for i in index["stribeck"] if columns[i].smoothing == smoothing]
        dry += [(c,), *((c, i) for i in loads), *((c, i) for i in curves)]
    dry += [(i,) for i in index["load"]]
    sets = []
    for dry_columns in dry:
        for viscous in ((), *((i,) for i in index["viscous"])):
            for offset in ((), *((i,) for i in index["offset"])):
                plain = (*dry_columns, *viscous, *offset)
                sets += [plain, *((*plain, i) for i in index["inertia"])]
    return sets


def expand_coordinates(
    model: Any, couplings: Couplings, y: Array, v: Array, a: Array
) -> tuple[Array, Array, Array, Any]:
    """Return q, v and a of all joints, one sample per column, and the slopes of the couplings.

    Args:
        y: Independent coordinates, shape (n, ny).
        v: Their velocities, shape (n, nv_y).
        a: Their accelerations, shape (n, nv_y).
    """
    n = len(y)
    q, velocity, acceleration = (np.zeros((size, n)) for size in (model.nq, model.nv, model.nv))
    q[couplings.q_index] = y.T
    velocity[couplings.v_index] = v.T
    acceleration[couplings.v_index] = a.T
    slopes = couplings.expand(q, velocity, acceleration)
    return q, velocity, acceleration, slopes


def random_states(
    robot: Robot, couplings: Couplings, count: int, seed: int = 0
) -> tuple[Array, Array, Array]:
    """Return random states: positions within limits, velocities and accelerations of about 1.

    The ranks of regressors at these states tell which parameters motions can show.

    Args:
        seed: Seed of the random numbers.

    Returns:
        Independent coordinates, velocities and accelerations, one state per row.
    """
    random, coordinates = np.random.default_rng(seed), IndependentCoordinates(robot, couplings)
    ny, nw = len(couplings.q_index), len(couplings.v_index)
    y, v, a = np.zeros((count, ny)), *random.normal(0.0, 2.0, (2, count, nw))
    for name, i in zip(couplings.independent, coordinates.joint_y, strict=True):
        low, high = limits_of(robot, name)
        y[:, i] = random.uniform(low, high, count)
    for columns in coordinates.body_y:
        pose = np.hstack([random.normal(size=(count, 3)), random.normal(size=(count, 4))])
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
        y[:, columns] = pose
    return y, v, a


def limits_of(robot: Robot, name: str) -> tuple[float, float]:
    """Return the limits of a joint [rad or m]; by default half a turn or half a metre each way."""
    joint = robot.joint(name)
    reach = 0.5 if joint.kind == "prismatic" else np.pi
    low, high = max(joint.lower, -2.0 * reach), min(joint.upper, 2.0 * reach)
    return (low, high) if low < high else (-reach, reach)


def base_parameters(rows: Array) -> BaseParameters:
    """Return the base parameters that rows of a regressor determine.

    Args:
        rows: W, or a triangular factor R of it, shape (k, p) with ten columns per body.
    """
    p = rows.shape[1]
    scale = np.linalg.norm(rows, axis=0)
    visible = np.flatnonzero(scale > SINGULAR * scale.max(initial=0.0))
    order = np.array([c for c in _columns(p) if c in set(visible.tolist())], dtype=np.intp)
    chosen = _independent(rows[:, order] / scale[order], order)
    dependent = np.setdiff1d(visible, chosen)
    T = np.zeros((len(chosen), p))
    T[np.arange(len(chosen)), chosen] = 1.0
    if len(dependent):
        basis = rows[:, chosen] / scale[chosen]
        B = np.linalg.lstsq(basis, rows[:, dependent] / scale[dependent], rcond=None)[0]
        B[np.abs(B) < _ROUNDED * np.abs(B).max(axis=0)] = 0.0
        T[:, dependent] = B * scale[dependent] / scale[chosen][:, None]
    T[np.abs(T) < _ROUNDED * np.abs(T).max(initial=1.0)] = 0.0
    return BaseParameters(chosen, T, np.setdiff1d(np.arange(p), visible))


class BaseParameters(NamedTuple):
    """Base parameters b = T p of inertial parameters p.

    Attributes:
        chosen: Inertial parameters that stand for the base parameters: their columns of W are
            independent.
        matrix: T, shape (r, p), with ones at `chosen`.
        unseen: Inertial parameters that no motion shows, neither alone nor with others.
    """

    chosen: NDArray[np.intp]
    matrix: Array
    unseen: NDArray[np.intp]

    def values(self, parameters: Array) -> Array:
        """Return the base parameters of inertial parameters, shape (r,)."""
        values: Array = self.matrix @ parameters
        return values


def _columns(p: int) -> list[int]:
    """Return all columns in elimination order: bodies from the base outwards, then `_ORDER`."""
    return [COUNT * body + place for body in range(p // COUNT) for place in _ORDER]


def _independent(columns: Array, names: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the names of columns that are independent of those before them.

    Args:
        columns: Columns of length one.
    """
    basis, chosen = np.zeros((len(columns), 0)), []
    for name, column in zip(names, columns.T, strict=True):
        remainder = column - basis @ (basis.T @ column)
        remainder -= basis @ (basis.T @ remainder)  # twice is enough
        size = np.linalg.norm(remainder)
        if size > SINGULAR:
            basis = np.column_stack([basis, remainder / size])
            chosen.append(int(name))
    return np.array(sorted(chosen), dtype=np.intp)


def format_expressions(base: BaseParameters, bodies: Sequence[str]) -> list[str]:
    """Return readable base parameters with moments about mass centres.

    An example is `shank.Izz + shank.mass (shank.cx^2 + shank.cy^2)`.

    Args:
        bodies: Names of the bodies, one for every ten inertial parameters.
    """
    texts = []
    for row, first in zip(base.matrix, base.chosen, strict=True):
        terms = [int(first), *(int(i) for i in np.flatnonzero(row) if i != first)]
        text = " ".join(_term(float(row[i]), i, bodies) for i in terms)
        texts.append(text.removeprefix("+ "))
    return texts


def _term(factor: float, number: int, bodies: Sequence[str]) -> str:
    sign, size = "-" if factor < 0 else "+", abs(factor)
    text = f"{_symbol(PARAMETER_NAMES[number % COUNT], bodies[number // COUNT])}"
    is_one = abs(size - 1.0) < _ROUNDED
    if (" + " in text or " - " in text) and not (is_one and factor > 0):
        text = f"({text})"
    if is_one:
        return f"{sign} {text}"
    return f"{sign} {size:.6g} {text}"


def _symbol(place: str, body: str) -> str:
    """Return an inertial parameter about the joint in terms of those about the mass centre."""
    if place.startswith("mc"):
        return f"{body}.mass {body}.c{place[-1]}"
    if not place.startswith("I"):
        return f"{body}.{place}"
    i, j = place[1], place[2]
    if i != j:
        return f"{body}.{place} - {body}.mass {body}.c{i} {body}.c{j}"
    others = [axis for axis in "xyz" if axis != i]
    return f"{body}.{place} + {body}.mass ({body}.c{others[0]}^2 + {body}.c{others[1]}^2)"


def parameter_name(number: int, bodies: Sequence[str]) -> str:
    """Return the name of an inertial parameter about the joint, such as `shank.Izz`."""
    return f"{bodies[number // COUNT]}.{PARAMETER_NAMES[number % COUNT]}"
