"""The rows of an identification: which there are, and what is known of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.model.inertial_parameters import (
    COUNT,
    inertia_of,
    moving_bodies,
    parameter_transformation,
    parameters_of,
)
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.identification.physical_consistency import known_numbers
from mbd_ros.features.identification.regressor import (
    OF_SEVERAL,
    TERMS,
    BaseParameters,
    Column,
    LoopRegressor,
    Regressor,
    base_parameters,
    candidates,
    columns_of,
    expressions,
    random_states,
)
from mbd_ros.features.identification.samples import (
    Filter,
    Piece,
    Recorded,
    asked_cutoffs,
    band_of,
    check_efforts,
    grid_step,
    pieces,
    read,
    split,
)
from mbd_ros.features.identification.task import Task
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.scene.built_scene import Scene

_STILL = 0.01  # of the largest velocity of a joint: below, it rests
_MOVING_SHARE = 0.5  # of a window of the filter: the least that is kept
_CHUNK = 4000  # samples of the grid that are asked for at once
_STATES = 1000  # random ones that tell which base parameters there are
_MOST_KEPT = 3.0e7  # numbers in blocks that are kept; more are made again when asked for


class Problem:
    """Rows of a scene and its recordings.

    Args:
        scene: The scene, without friction.
        task: What is asked for.
        say: Is told what is left out.

    Attributes:
        where: Names of the recordings.
        learned: What is learned from.
        left: What is left for the test.
        band: End of the band [Hz]; None for all that was measured.
        bodies: Bodies that move.
        given: Their inertial numbers in the description, shape (bodies, 10).
        base: What states can show.
        texts: Expressions of the base parameters.
        labels: Names of the rows.
        rows: Their places in the regressor.
        joints: Their places among the independent joints, -1 without an effort.
        columns: Candidates of friction of each row.
        motors: Of the rows; one a joint until `couple` says otherwise.
        pieces: Of it, in the band.
        gains: Joint -> torque for a unit of its effort, where that is not 1.
        gain_deviation: Of each row, where gains were estimated.
        seconds: Time that is learned from.
        step: Usual step of the samples [s].
        correlation: Of white noise behind the filter, 1 first, shape (k,).
    """

    def __init__(self, scene: Scene, task: Task, say: Say) -> None:
        self.scene, self.task, self.gains = scene, task, dict(task.gains)
        self.gain_deviation = np.zeros(0)
        parts = [split(recorded, task.learned) for recorded in recordings(scene, task, say)]
        self.learned = [first for first, _ in parts]
        self.left = [rest for _, rest in parts if rest is not None]
        self.where = ", ".join(one.where for one in self.learned)
        self.seconds = float(sum(one.times[-1] for one in self.learned))
        self.regressor = regressor_of(scene, self.learned)
        self.bodies = moving_bodies(scene.robot)
        self.given = parameters_of(scene.robot.model)
        self._choose_rows(say)
        self._known = known_numbers(self.bodies, self.given, task.known)
        rows = self.regressor.rows(*self._states())[:, self.rows].reshape(-1, self.given.size)
        rows[:, np.repeat(self._known.reshape(self.given.shape).any(axis=1), COUNT)] = 0.0
        self.base = base_parameters(rows)
        self.texts = expressions(self.base, [body.name for body in self.bodies])
        self._filter()

    def _states(self) -> tuple[Array, Array, Array]:
        """States that tell which base parameters there are; in loops near those recorded."""
        y, v, a = random_states(self.scene.robot, self.scene.couplings, _STATES)
        if not self.scene.has_loops:
            return y, v, a
        seen = np.concatenate([p.y for one in self.learned for p in pieces(self.scene, one, None)])
        at = np.linspace(0, len(seen) - 1, _STATES // 4).astype(np.intp)
        return seen[at], v[: len(at)], a[: len(at)]

    def blocks(self, delays: Array) -> Iterator[Block]:
        """Rows of what is learned from, for efforts with delays [s]."""
        key = tuple((delays + self._shift).tolist())
        if key in self._kept:
            yield from self._kept[key]
            return
        kept: list[Block] | None = []
        for piece in self.pieces:
            for block in self.maker.blocks(piece, self.band, delays + self._shift):
                yield block
                if kept is not None:
                    kept.append(block)
                    if (
                        sum(b.X.size + b.Y.size + sum(f.size for f in b.F) for b in kept)
                        > _MOST_KEPT
                    ):
                        kept = None
        if kept == []:
            raise DataError(
                f"{self.where}: {self.seconds:.3g} s to learn from are too short: no window of "
                f"the filter, which ends at {self.band:.3g} Hz, is without a gap"
            )
        if kept is not None and len(delays) == 1:
            self._kept = {key: kept}

    def shift(self, delay: float) -> None:
        """Efforts come later than the motion by a known time [s]."""
        self._shift = delay

    def gain(self, gains: Mapping[str, float]) -> None:
        """From now on efforts of joints are torques over these gains."""
        names = self.scene.couplings.independent
        self.gains |= gains
        self.pieces = list(gained(self.pieces, names, gains))
        self._kept = {}

    def only(self, body: int) -> None:
        """From now on all bodies are known, and another one is fixed to one of them.

        Args:
            body: Its place among `bodies`.
        """
        rows = self.regressor.rows(*self._states())[:, self.rows].reshape(-1, self.given.size)
        others = np.delete(np.arange(self.given.size), COUNT * body + np.arange(COUNT))
        rows[:, others] = 0.0
        self.base = base_parameters(rows)
        self.texts = expressions(self.base, [one.name for one in self.bodies])
        self.maker.base, self.maker.carried = self.base, self.given.ravel()
        self._kept = {}

    def carry(self, inertial: Array) -> None:
        """From now on friction that grows with the load sees that of these bodies."""
        model = self.scene.robot.model.copy()
        for body, numbers in zip(self.bodies, inertial, strict=True):
            model.inertias[body.joint] = inertia_of(numbers)
        self.regressor.carry(model)
        self._kept = {}

    def _choose_rows(self, say: Say) -> None:
        """Rows of joints with efforts, and of what nothing drives where wrenches are measured."""
        scene, task, labels = self.scene, self.task, self.regressor.labels
        independent = scene.couplings.independent
        passive = passive_joints(scene, task.passive, self.learned, say)
        are_measured = any(one.motion.effort is not None for one in self.learned)
        is_free = (bool(passive) or scene.robot.floating) and not are_measured
        if not scene.has_loops:
            check_efforts(scene, self.learned, independent if is_free else passive)
        at = IndependentCoordinates(scene.robot, scene.couplings).joint_w
        joint_of = {int(w): i for i, w in enumerate(at)}
        rows = []
        for row in range(len(labels)):
            i = joint_of.get(int(self.regressor.coordinates[row]), -1)
            if i < 0 or independent[i] in passive:
                rows.append((row, -1))
            elif are_measured:
                rows.append((row, i))
        if not rows:
            raise DataError(f"{self.where}: no effort of any joint, and no part without a motor")
        self.rows = np.array([row for row, _ in rows], dtype=np.intp)
        self.joints = np.array([i for _, i in rows], dtype=np.intp)
        self.labels = tuple(labels[row] for row in self.rows)

    def _filter(self) -> None:
        """Choose the band, and prepare the pieces and the candidates of friction."""
        task = self.task
        self.band = task.band
        if self.band is None:
            bands = [band for one in self.learned for band in self._bands(one)]
            self.band = max(bands)
        self.pieces = list(self._pieces_of(self.learned, self.band))
        self.correlation = np.ones(1)
        self.step = max(float(np.median(np.diff(p.times))) for p in self.pieces)
        if self.band is not None:
            rate = 1.0 / self.step
            self.correlation = Filter.of(rate / grid_step(rate, self.band), self.band).correlation
        self.couple(Motors.of_joints(len(self.rows)))

    def couple(self, motors: Motors) -> None:
        """From now on rows are those of motors, whose friction is looked for."""
        at = self.regressor.coordinates[self.rows]
        v = motors.speeds(np.concatenate([piece.v for piece in self.pieces])[:, at])
        usual, peak = np.sqrt(np.mean(np.square(v), axis=0)), np.abs(v).max(axis=0)
        terms = [TERMS if alone else OF_SEVERAL for alone in motors.alone]
        self.columns: list[tuple[Column, ...]] = [
            tuple(c for c in candidates(float(u)) if c.term in own) if i >= 0 and u > 0.0 else ()
            for u, i, own in zip(usual, self.joints, terms, strict=True)
        ]
        chosen = self.rows, self.columns, self.joints, peak, motors
        self.maker, self.motors = RowMaker(self.regressor, self.base, *chosen), motors
        self.maker.carried = self._known if self._known.any() else None
        self._shift, self._kept = 0.0, dict[tuple[float, ...], list[Block]]()

    def _bands(self, one: Recorded) -> Iterator[float]:
        """Of the pieces of a recording."""
        for piece in pieces(self.scene, one, None):
            yield band_of(piece.times, piece.v[:, self.regressor.coordinates[self.rows]])

    def tested(self) -> Iterator[Piece]:
        """Pieces of what is left for the test, in the band."""
        return self._pieces_of(self.left, self.band)

    def recorded(self, some: Iterable[Recorded]) -> list[Piece]:
        """Pieces of recordings with the low-pass of motions that what is learned from asks for."""
        return list(self._pieces_of(some, self._cutoff))

    @cached_property
    def _cutoff(self) -> float | None:
        """The highest that any joint asks for, at most the band [Hz]; None without a band."""
        if self.band is None:
            return None
        asked = np.concatenate([asked_cutoffs(self.scene, one) for one in self.learned])
        return float(min(asked[np.isfinite(asked)].max(initial=0.0), self.band)) or self.band

    def _pieces_of(self, some: Iterable[Recorded], band: float | None) -> Iterator[Piece]:
        for one in some:
            found = pieces(self.scene, one, band)
            yield from gained(found, self.scene.couplings.independent, self.gains)


def recordings(scene: Scene, task: Task, say: Say) -> Iterator[Recorded]:
    """All recordings, those with a known load last.

    Raises:
        DataError: There is none, or the load or a wrench is missing.
    """
    sources = (*task.motions, *task.held)
    if task.wrenches and len(task.wrenches) != len(sources):
        raise DataError(
            f"--wrenches: {len(task.wrenches)} for {len(sources)} motions; give one for each"
        )
    if not sources:
        raise DataError("no motion to identify from")
    if bool(task.held) != (task.payload is not None):
        raise DataError("--held and --payload: give the recording and what it holds")
    carried = None if task.payload is None else _carried(scene, *task.payload)
    for i, (source, load) in enumerate(zip_longest(sources, task.wrenches)):
        options = {"topic": task.topic, "derivatives": task.derivatives, "say": say}
        found = read(scene, source, wrenches=load, **options)  # type: ignore[arg-type]
        yield found if i < len(task.motions) else found._replace(carried=carried)


def _carried(scene: Scene, frame: str, numbers: Sequence[float]) -> Array:
    """Inertial numbers of all bodies of what is fixed to a link, shape (10 bodies,)."""
    model = scene.robot.model
    try:
        link = model.frames[scene.robot.frame(frame)]
    except ModelError as error:
        raise DataError(f"--payload {frame}: {error}") from error
    joint = int(link.parentJoint)
    if joint == 0:
        raise DataError(f"--payload {frame}: this link does not move")
    mass, x, y, z, *moments = numbers
    load = pin.Inertia(mass, np.array([x, y, z]), np.diag(moments or [0.0, 0.0, 0.0]))
    own = load.toDynamicParameters()
    found = np.zeros(COUNT * (model.njoints - 1))
    found[COUNT * (joint - 1) : COUNT * joint] = parameter_transformation(link.placement) @ own
    return found


def regressor_of(scene: Scene, recorded: Sequence[Recorded]) -> Regressor | LoopRegressor:
    """The regressor of a scene, with or without loops; efforts tell which joints drive loops."""
    solver = scene.inverse_dynamics()
    if isinstance(solver, InverseDynamics):
        return Regressor(scene.robot, solver)
    try:
        return LoopRegressor(scene.robot, solver, scene.initial, driven_joints(scene, recorded))
    except ModelError as error:
        raise DataError(f"{scene.name}: {error}") from error


def driven_joints(scene: Scene, recorded: Sequence[Recorded]) -> list[str]:
    """Independent joints with an effort that is not 0 throughout.

    Raises:
        DataError: There is none.
    """
    names, found = scene.couplings.independent, []
    for i, name in enumerate(names):
        efforts = [one.motion.effort for one in recorded]
        known = [effort[:, i] for effort in efforts if effort is not None]
        if known and all(np.isfinite(e).mean() > 0.99 and e.any() for e in known):
            found.append(name)
    if not found:
        where = ", ".join(one.where for one in recorded)
        raise DataError(f"{where}: no effort of any of {', '.join(names)}")
    return found


class Block(NamedTuple):
    """Filtered rows that follow each other.

    Attributes:
        X: Columns of the base parameters, shape (n, m, r).
        F: Candidates of friction of each row, shape (n, k) each.
        Y: Torques with a delay each, shape (n, m, delays).
        kept: Which of the n x m rows count, shape (n, m).
        known: What is known of the torques and taken out of them, shape (n, m).
    """

    X: Array
    F: list[Array]
    Y: Array
    kept: NDArray[np.bool_]
    known: Array


def gained(
    found: Iterable[Piece], names: Sequence[str], gains: Mapping[str, float]
) -> Iterator[Piece]:
    """Pieces with the torques of efforts in other units.

    Raises:
        DataError: A gain of no joint.
    """
    unknown = [name for name in gains if name not in names]
    if unknown:
        raise DataError(f"--gain {unknown[0]}: no such joint; there are {', '.join(names)}")
    factors = np.array([gains.get(name, 1.0) for name in names])
    for piece in found:
        yield piece._replace(effort=factors * piece.effort, measured=factors * piece.measured)


def passive_joints(
    scene: Scene, named: Sequence[str], recorded: Sequence[Recorded], say: Say
) -> tuple[str, ...]:
    """Joints whose effort is 0: those named, else those by which the first body is placed.

    Without any effort, a chain of joints from the world to the first link with mass is what
    measured a body that moves freely, such as the pelvis in a model of a person.

    Args:
        named: Joints that the user names.
        say: Is told which they are.

    Raises:
        DataError: Unknown joints.
    """
    joints = scene.couplings.independent
    unknown = [name for name in named if name not in joints]
    if unknown:
        raise DataError(f"--passive {unknown[0]}: no such joint; there are {', '.join(joints)}")
    if named:
        return tuple(named)
    has_effort = any(one.motion.effort is not None for one in recorded)
    if has_effort or not scene.wrenches or scene.robot.floating:
        return ()
    model, chain, at = scene.robot.model, list[str](), 0
    while True:
        below = [j for j in range(1, model.njoints) if int(model.parents[j]) == at]
        if len(below) != 1:
            break
        at = below[0]
        names = [j.name for j in scene.robot.joints if model.getJointId(j.urdf_name) == at]
        chain += [name for name in names if name in joints]
        if model.inertias[at].mass > 0.0:
            break
    if len(chain) > 1:
        say(
            f"no efforts: {', '.join(chain)} place a body that nothing drives, its balance is used"
        )
        return tuple(chain)
    return ()


class RowMaker:
    """Makes filtered rows of pieces: base parameters, candidates of friction, torques.

    Args:
        regressor: Of the scene.
        rows: Rows of the regressor that are used, shape (m,).
        columns: Candidates of friction of each of them; none of a row without a joint.
        joints: Place of each of these rows among the independent joints, -1 of no effort.
        peak: Largest speed of the motor of each, shape (m,).
        motors: Of these rows.
    """

    def __init__(
        self,
        regressor: Regressor | LoopRegressor,
        base: BaseParameters,
        rows: NDArray[np.intp],
        columns: Sequence[tuple[Column, ...]],
        joints: NDArray[np.intp],
        peak: Array,
        motors: Motors,
    ) -> None:
        self.regressor, self.base, self.rows = regressor, base, rows
        self.coordinates = regressor.coordinates[rows]
        self.columns, self.joints, self.peak = columns, joints, peak
        self.motors = motors
        self.carried: Array | None = None  # inertial numbers that are known, of all bodies

    def blocks(self, piece: Piece, band: float | None, delays: Array) -> Iterator[Block]:
        """Rows of a piece through the filter of its band; without a band all its samples."""
        rate = 1.0 / float(np.median(np.diff(piece.times)))
        step = 1 if band is None else grid_step(rate, band)
        grid = np.arange(0, len(piece.times), step)
        low = None if band is None else Filter.of(rate / step, band)
        if low is None:
            chunks = [grid[i : i + _CHUNK] for i in range(0, len(grid), _CHUNK)]
        else:
            chunks = _overlapping(grid, low)
        for chunk in chunks:
            X, F, Y, moves, known = self._plain(piece, chunk, delays)
            if low is None:
                yield Block(X, F, Y, moves, known)
                continue
            passed = low.passed(moves.astype(np.float64))
            X, F, Y = low.passed(X), [low.passed(f) for f in F], low.passed(Y)
            yield Block(X, F, Y, passed >= _MOVING_SHARE, low.passed(known))

    def _plain(
        self, piece: Piece, at: NDArray[np.intp], delays: Array
    ) -> tuple[Array, list[Array], Array, NDArray[np.bool_], Array]:
        """Rows of samples before the filter, and which joints move."""
        y, v, a = piece.y[at], piece.v[at], piece.a[at]
        W = self.regressor.rows(y, v, a)
        known = self.regressor.known(W, y, v, a, [load[at] for load in piece.loads])[:, self.rows]
        for carried in (self.carried, piece.carried):
            if carried is not None:
                known = known + W[:, self.rows] @ carried
        X = np.ascontiguousarray(W[:, self.rows][:, :, self.base.chosen])
        effort = np.zeros((len(at), len(self.rows), len(delays)))
        for i, joint in enumerate(self.joints):
            if joint >= 0:
                for k, delay in enumerate(delays):
                    late = piece.times[at] + delay
                    effort[:, i, k] = np.interp(late, piece.times, piece.effort[:, joint])
        weight = self.regressor.weight(y)[:, self.rows]
        v, a = v[:, self.coordinates], a[:, self.coordinates]
        if self.motors.are_coupled:
            X, known, weight, effort, v, a = self._of_motors(X, known, weight, effort, v, a)
        each = zip(self.columns, v.T, a.T, weight.T, strict=True)
        F = [columns_of(own, rate, push, load) for own, rate, push, load in each]
        moves = np.abs(v) > _STILL * self.peak
        moves[:, self.peak == 0.0] = True
        moves[:, self.joints < 0] = True
        Y = effort - known[:, :, None]
        return X, F, Y, moves, known

    def _of_motors(
        self, X: Array, known: Array, weight: Array, effort: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """All of them for motors in place of joints."""
        motors = self.motors
        turned = np.swapaxes(motors.torques(np.swapaxes(X, 1, 2)), 1, 2)
        told = np.swapaxes(motors.from_measured(np.swapaxes(effort, 1, 2)), 1, 2)
        known, weight = motors.torques(known), motors.torques(weight)
        return turned, known, weight, told, motors.speeds(v), motors.speeds(a)


def _overlapping(grid: NDArray[np.intp], low: Filter) -> Iterator[NDArray[np.intp]]:
    """Chunks of a grid whose windows together are those of all of it."""
    starts = low.starts(len(grid))
    count = max(_CHUNK // low.step, 1)
    for first in range(0, len(starts), count):
        some = starts[first : first + count]
        yield grid[some[0] : some[-1] + len(low.taps)]


class Motors(NamedTuple):
    """Motors that turn with several joints, as those of a wrist behind bevel gears.

        w = U v,    tau = U' tau_m

    with v and tau of joints, w and tau_m of motors, reduced to the joints that bear their names: U
    has ones on its diagonal. Friction is a function of w, so that rows of motors, U^-T times those
    of the joints, have a friction of their own each.

    Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, section 9.7
    (coupled transmissions).

    Attributes:
        ratios: U, shape (m, m).
        are_measured: Whether efforts are those of motors, not of joints.
    """

    ratios: Array
    are_measured: bool = False

    @classmethod
    def of_joints(cls, count: int) -> Motors:
        """One motor a joint."""
        return cls(np.eye(count))

    @property
    def are_coupled(self) -> bool:
        """Whether any turns with several joints."""
        return bool(np.any(self.ratios != np.eye(len(self.ratios))))

    @property
    def others(self) -> list[dict[int, float]]:
        """Of each motor the other joints that turn it, and their ratios."""
        m = len(self.ratios)
        return [
            {j: float(row[j]) for j in range(m) if j != i and row[j] != 0.0}
            for i, row in enumerate(self.ratios)
        ]

    @property
    def alone(self) -> Array:
        """Motors of one joint that turns no other motor, shape (m,) of truth."""
        apart = self.ratios != np.eye(len(self.ratios))
        return np.asarray(~(apart.any(axis=0) | apart.any(axis=1)))

    def speeds(self, v: Array) -> Array:
        """Of motors, of those of joints, shape (.., m)."""
        return v @ self.ratios.T

    def torques(self, tau: Array) -> Array:
        """Of motors, of those of joints, shape (.., m)."""
        return tau @ np.linalg.inv(self.ratios)

    def measured(self, tau: Array) -> Array:
        """What is measured of torques of joints, shape (.., m)."""
        return self.torques(tau) if self.are_measured else tau

    def from_measured(self, effort: Array) -> Array:
        """Torques of motors of what is measured, shape (.., m)."""
        return effort if self.are_measured else self.torques(effort)

    def as_measured(self, torque: Array) -> Array:
        """Inverse of `from_measured`."""
        return torque if self.are_measured else torque @ self.ratios
