"""Forces as a matrix times numbers: inertias, friction; for couplings and loops.

    G' (rnea - loads) = G' W(q, v, a) p + known,    N' W p + known = N' B u

with W of Pinocchio, G the Jacobian of the couplings, N the motions that loops leave, one for each
of some of the actuated joints, and `known` what springs, rotors and measured wrenches exert.

Columns of W that others give (W2 = W1 B) cannot be told from these. The base parameters are
b = p1 + B p2: as many as W has rank.

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

_SMOOTHINGS = (0.005, 0.02, 0.05, 0.1, 0.2, 0.4)  # of the usual velocity
_STRIBECKS = (0.1, 0.3, 0.6)  # of the usual velocity
TERMS = ("viscous", "coulomb", "offset", "load", "stribeck", "inertia")
OF_SEVERAL = ("viscous", "coulomb", "offset", "stribeck")  # of a motor that several joints turn
# In a body: what others give comes last, so that masses join the moments that they add to.
_ORDER = tuple(
    PARAMETER_NAMES.index(place)
    for place in ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mcx", "mcy", "mcz", "mass")
)
_ROUNDED = 1.0e-9  # of the largest factor in a combination: what rounding leaves of none


class Regressor:
    """Rows of an open chain, coupled or not: one for each independent coordinate.

    Args:
        solver: Inverse dynamics of the scene, whose forces and wrenches are the known ones.

    Attributes:
        labels: Of the rows: joints, and coordinates of free bases.
        coordinates: Their places among the independent velocities.
        size: Inertial numbers of all bodies.
        base: Rows that no joint drives, those of free bases.
    """

    def __init__(self, robot: Robot, solver: InverseDynamics) -> None:
        self._solver, self._couplings = solver, solver.couplings
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._carried = self._model
        self._given = parameters_of(robot.model).ravel()
        self.size = len(self._given)
        names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
        at = self._couplings.v_index
        self.labels = tuple(names[int(v)] for v in at)
        self.coordinates = np.arange(len(at))
        self.base = np.flatnonzero(np.isin(at, robot.base_v))

    def rows(self, y: Array, v: Array, a: Array) -> Array:
        """G' W at samples.

        Args:
            y: Independent coordinates, shape (n, ny).
            v: Their velocities, shape (n, nv_y).
            a: Their accelerations, same shape.

        Returns:
            Shape (n, nv_y, `size`).
        """
        q, rate, push, slopes = expanded(self._model, self._couplings, y, v, a)
        whole = np.empty((len(y), self._model.nv, self.size))
        model, data, columns = self._model, self._data, zip(q.T, rate.T, push.T, strict=True)
        for row, (here, velocity, acceleration) in zip(whole, columns, strict=True):
            row[...] = pin.computeJointTorqueRegressor(model, data, here, velocity, acceleration)
        for slope, pair in zip(reversed(slopes), reversed(self._couplings.pairs), strict=True):
            whole[:, pair.parent_v] += (np.ones(len(y)) * slope)[:, None] * whole[:, pair.child_v]
        return whole[:, self._couplings.v_index] if self._couplings.pairs else whole

    def known(self, rows: Array, y: Array, v: Array, a: Array, loads: Sequence[Array]) -> Array:
        """What acts besides the inertias, shape (n, nv_y); `rows` are those of these samples."""
        tau: Array = self._solver.batch(y, v, a, list(loads)).tau
        known: Array = tau - rows @ self._given
        return known

    def carry(self, model: Any) -> None:
        """From now on `weight` is that of a model with other inertias."""
        self._carried = model

    def weight(self, y: Array) -> Array:
        """Torques that hold joints still, of the robot or that of `carry`, shape (n, nv_y)."""
        zero = np.zeros((len(y), len(self.labels)))
        q = expanded(self._model, self._couplings, y, zero, zero)[0]
        model, data, at = self._carried, self._data, self._couplings.v_index
        return np.array([pin.computeGeneralizedGravity(model, data, here)[at] for here in q.T])


class LoopRegressor:
    """Rows of a mechanism with loops: one for each motion that its loops leave.

    N = [E; -J_2^-1 J_1] has a column for each of some actuated joints, chosen once: J N = 0 takes
    the multipliers out, N' (M a + h - loads) = N' B u. Efforts of other joints act along N, too.

    Source: J. Garcia de Jalon, E. Bayo, Kinematic and Dynamic Simulation of Multibody Systems,
    1994, section 5.2 (independent coordinates by the matrix R).

    Args:
        solver: Inverse dynamics of the scene, whose forces and wrenches are the known ones.
        start: State near the constraints.
        driven: Joints whose efforts are measured.

    Attributes:
        labels: Actuated joints by which the mechanism moves, and coordinates of free bases.
        coordinates: Their places among the independent velocities.
        size: Inertial numbers of all bodies.
        base: Rows that no joint drives.

    Raises:
        ModelError: The driven joints do not determine the motion.
    """

    def __init__(
        self, robot: Robot, solver: ObservedLoops, start: State, driven: Sequence[str]
    ) -> None:
        self._solver, self._inverse = solver, solver.inverse
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._carried, self._given = self._model, parameters_of(robot.model).ravel()
        self.size = len(self._given)
        names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
        first = [*robot.base_v.tolist(), *(robot.joint(name).v for name in driven)]
        q = self._inverse.motion.start(start)
        J = self._inverse.motion.jacobian(start.t, q)
        self._first = _leading(J, first)
        self._others = np.setdiff1d(np.arange(self._model.nv), self._first)
        self.labels = tuple(names[int(v)] for v in self._first)
        self.coordinates = np.searchsorted(solver.couplings.v_index, self._first)
        self.base = np.flatnonzero(np.isin(self._first, robot.base_v))

    def motions(self, q: Array) -> Array:
        """N at a configuration on the constraints, shape (nv, len(labels))."""
        J = self._inverse.motion.jacobian(0.0, q)
        N = np.zeros((self._model.nv, len(self._first)))
        N[self._first, np.arange(len(self._first))] = 1.0
        N[self._others] = -np.linalg.lstsq(J[:, self._others], J[:, self._first], rcond=SINGULAR)[
            0
        ]
        return N

    def consistent(self, y: Array, v: Array, a: Array) -> tuple[State, Array]:
        """State and acceleration of all joints that the loops allow, near a sample."""
        return self._inverse.consistent(*self._solver.measured(0.0, y, v, a))

    def rows(self, y: Array, v: Array, a: Array) -> Array:
        """N' W at samples, shape (n, len(labels), `size`)."""
        found = np.empty((len(y), len(self.labels), self.size))
        for row, *sample in zip(found, y, v, a, strict=True):
            x, push = self.consistent(*sample)
            W = pin.computeJointTorqueRegressor(self._model, self._data, x.q, x.v, push)
            row[...] = self.motions(x.q).T @ W
        return found

    def known(self, rows: Array, y: Array, v: Array, a: Array, loads: Sequence[Array]) -> Array:
        """What acts besides the inertias, shape (n, len(labels))."""
        found = np.empty((len(y), len(self.labels)))
        for i, sample in enumerate(zip(y, v, a, strict=True)):
            x, push = self.consistent(*sample)
            terms = self._inverse.demand(x, push, [load[i] for load in loads])
            found[i] = self.motions(x.q).T @ terms
        known: Array = found - rows @ self._given
        return known

    def carry(self, model: Any) -> None:
        """From now on `weight` is that of a model with other inertias."""
        self._carried = model

    def weight(self, y: Array) -> Array:
        """Torques that hold joints still, shape (n, len(labels))."""
        zero, found = np.zeros((len(y), self._model.nv)), np.empty((len(y), len(self.labels)))
        for row, sample in zip(found, y, strict=True):
            still = zero[0][: self._width(sample)]
            x, _ = self._solver.measured(0.0, sample, still, still)
            row[...] = pin.computeGeneralizedGravity(self._carried, self._data, x.q)[self._first]
        return found

    def _width(self, sample: Array) -> int:
        return len(sample) - (int(self._model.nq) - int(self._model.nv))


def _leading(J: Array, wanted: Sequence[int]) -> NDArray[np.intp]:
    """Coordinates that determine all others, of those that are wanted.

    Raises:
        ModelError: They do not, or there are more of them than the mechanism has motions.
    """
    nv, size = J.shape[1], SINGULAR * float(np.linalg.norm(J, 2))

    def rank(columns: Sequence[int]) -> int:
        return int(np.linalg.matrix_rank(J[:, columns], tol=size)) if len(columns) else 0

    freedom, chosen = nv - rank(range(nv)), list[int]()
    for v in wanted:
        held = [i for i in range(nv) if i not in {*chosen, v}]
        if rank(held) == nv - freedom:
            chosen.append(v)
    if len(chosen) < freedom or len(wanted) > freedom:
        raise ModelError(
            f"the mechanism has {freedom} motions and {len(wanted)} joints with measured efforts: "
            "identification needs as many as there are motions, none of them idle"
        )
    return np.array(sorted(chosen), dtype=np.intp)


class Column(NamedTuple):
    """One column of what a joint takes besides the inertias of bodies.

        tau = viscous v + (coulomb + load |g| + stribeck / (1 + (v / v_s)^2)) s + offset
              + inertia a,    s = tanh(v / smoothing)

    with g the torque that holds the given robot still. It is linear in all but smoothing and v_s,
    of which a few multiples of the usual velocity of the joint are tried.

    Source: D. P. Hess, A. Soom, J. Tribology 112, 1990, 147 (this curve of Stribeck); B.
    Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30, 1994, 1083 (a survey).

    Attributes:
        term: Of `TERMS`.
        smoothing: Velocity of it [rad/s or m/s]; 0 where the term has none.
        stribeck: v_s [rad/s or m/s]; 0 where the term has none.
    """

    term: str
    smoothing: float = 0.0
    stribeck: float = 0.0


def columns_of(chosen: Sequence[Column], v: Array, a: Array, weight: Array) -> Array:
    """Values of columns, shape (n, len(chosen)).

    Args:
        v: Velocities of the joint [rad/s or m/s], shape (n,).
        a: Its accelerations, shape (n,).
        weight: Torques that hold it still, shape (n,).
    """
    found = np.empty((len(v), len(chosen)))
    for k, (term, smoothing, stribeck) in enumerate(chosen):
        plain = {"viscous": v, "inertia": a, "offset": np.ones_like(v)}
        if term in plain:
            found[:, k] = plain[term]
            continue
        side = np.tanh(v / smoothing)
        if term == "load":
            side *= np.abs(weight)
        if term == "stribeck":
            side /= 1.0 + np.square(v / stribeck)
        found[:, k] = side
    return found


def candidates(usual: float) -> tuple[Column, ...]:
    """All columns that are tried of a joint.

    Args:
        usual: Root mean square of its velocity [rad/s or m/s].
    """
    smooth = [factor * usual for factor in _SMOOTHINGS]
    curves = [(s, factor * usual) for s in smooth[:3] for factor in _STRIBECKS]
    return (
        *(Column(term) for term in ("viscous", "offset", "inertia")),
        *(Column("coulomb", s) for s in smooth),
        *(Column("load", s) for s in smooth),
        *(Column("stribeck", s, v) for s, v in curves),
    )


def choices(columns: Sequence[Column], allowed: Iterable[str]) -> list[tuple[int, ...]]:
    """Sets of columns that make sense together, by place; the empty one first.

    Args:
        columns: Those of `candidates`.
        allowed: Of `TERMS`.
    """
    terms = set(allowed)
    at: dict[str, list[int]] = {term: [] for term in TERMS}
    for i, column in enumerate(columns):
        if column.term in terms:
            at[column.term].append(i)
    dry: list[tuple[int, ...]] = [()]
    for c in at["coulomb"]:
        same = columns[c].smoothing
        loads = [i for i in at["load"] if columns[i].smoothing == same]
        curves = [i for i in at["stribeck"] if columns[i].smoothing == same]
        dry += [(c,), *((c, i) for i in loads), *((c, i) for i in curves)]
    dry += [(i,) for i in at["load"]]
    found = []
    for some in dry:
        for viscous in ((), *((i,) for i in at["viscous"])):
            for offset in ((), *((i,) for i in at["offset"])):
                plain = (*some, *viscous, *offset)
                found += [plain, *((*plain, i) for i in at["inertia"])]
    return found


def expanded(
    model: Any, couplings: Couplings, y: Array, v: Array, a: Array
) -> tuple[Array, Array, Array, Any]:
    """All coordinates of samples of the independent ones, one sample a column, and slopes."""
    n = len(y)
    q, rate, push = (np.zeros((size, n)) for size in (model.nq, model.nv, model.nv))
    q[couplings.q_index], rate[couplings.v_index], push[couplings.v_index] = y.T, v.T, a.T
    slopes = couplings.expand(q, rate, push)
    return q, rate, push, slopes


def random_states(
    robot: Robot, couplings: Couplings, count: int, seed: int = 0
) -> tuple[Array, Array, Array]:
    """States for ranks: positions within limits, velocities and accelerations of about 1.

    Args:
        couplings: Its dependent joints.
        seed: Of the random numbers.

    Returns:
        Independent coordinates, velocities and accelerations, one state a row.
    """
    random, at = np.random.default_rng(seed), IndependentCoordinates(robot, couplings)
    ny, nw = len(couplings.q_index), len(couplings.v_index)
    y, v, a = np.zeros((count, ny)), *random.normal(0.0, 2.0, (2, count, nw))
    for name, i in zip(couplings.independent, at.joint_y, strict=True):
        low, high = limits_of(robot, name)
        y[:, i] = random.uniform(low, high, count)
    for of in at.body_y:
        pose = np.hstack([random.normal(size=(count, 3)), random.normal(size=(count, 4))])
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
        y[:, of] = pose
    return y, v, a


def limits_of(robot: Robot, name: str) -> tuple[float, float]:
    """Where a joint can be [rad or m]; half a turn or half a metre where nothing says it."""
    joint = robot.joint(name)
    usual = 0.5 if joint.kind == "prismatic" else np.pi
    low, high = max(joint.lower, -2.0 * usual), min(joint.upper, 2.0 * usual)
    return (low, high) if low < high else (-usual, usual)


def base_parameters(rows: Array) -> BaseParameters:
    """Base parameters that rows of a regressor show.

    Args:
        rows: W, or an upper triangle R of it, shape (k, p), p a multiple of ten or not.
    """
    p = rows.shape[1]
    scale = np.linalg.norm(rows, axis=0)
    seen = np.flatnonzero(scale > SINGULAR * scale.max(initial=0.0))
    order = np.array([c for c in _columns(p) if c in set(seen.tolist())], dtype=np.intp)
    chosen = _independent(rows[:, order] / scale[order], order)
    given = np.setdiff1d(seen, chosen)
    T = np.zeros((len(chosen), p))
    T[np.arange(len(chosen)), chosen] = 1.0
    if len(given):
        left = rows[:, chosen] / scale[chosen]
        B = np.linalg.lstsq(left, rows[:, given] / scale[given], rcond=None)[0]
        B[np.abs(B) < _ROUNDED * np.abs(B).max(axis=0)] = 0.0
        T[:, given] = B * scale[given] / scale[chosen][:, None]
    T[np.abs(T) < _ROUNDED * np.abs(T).max(initial=1.0)] = 0.0
    return BaseParameters(chosen, T, np.setdiff1d(np.arange(p), seen))


class BaseParameters(NamedTuple):
    """Base parameters b = T p of inertial numbers p.

    Attributes:
        chosen: Numbers that stand for the base parameters: their columns of W are independent.
        matrix: T, shape (r, p), with ones at `chosen`.
        unseen: Numbers that no state shows, neither alone nor with others.
    """

    chosen: NDArray[np.intp]
    matrix: Array
    unseen: NDArray[np.intp]

    def values(self, parameters: Array) -> Array:
        """Base parameters of inertial numbers, shape (r,)."""
        values: Array = self.matrix @ parameters
        return values


def _columns(p: int) -> list[int]:
    """All columns, bodies from the base outwards, in a body as `_ORDER` says."""
    return [COUNT * body + place for body in range(p // COUNT) for place in _ORDER]


def _independent(columns: Array, names: NDArray[np.intp]) -> NDArray[np.intp]:
    """Columns that those before them do not give; columns have length one."""
    basis, chosen = np.zeros((len(columns), 0)), []
    for name, column in zip(names, columns.T, strict=True):
        left = column - basis @ (basis.T @ column)
        left -= basis @ (basis.T @ left)  # twice is enough
        size = np.linalg.norm(left)
        if size > SINGULAR:
            basis = np.column_stack([basis, left / size])
            chosen.append(int(name))
    return np.array(sorted(chosen), dtype=np.intp)


def expressions(base: BaseParameters, bodies: Sequence[str]) -> list[str]:
    """Base parameters for people: moments about mass centres, `shank.Izz + shank.mass (..)`.

    Args:
        base: The base parameters.
        bodies: Names, one for every ten numbers.
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
    """A number about the joint in those of the mass centre."""
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
    """Name of a number, such as `shank.Izz`; moments are about the joint."""
    return f"{bodies[number // COUNT]}.{PARAMETER_NAMES[number % COUNT]}"
