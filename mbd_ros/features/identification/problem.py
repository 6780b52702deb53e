"""The identification problem: recordings become filtered rows of the regressor."""

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
from mbd_ros.features.identification.physical_consistency import known_parameters
from mbd_ros.features.identification.regressor import (
    SHARED_MOTOR_TERMS,
    TERMS,
    BaseParameters,
    Column,
    LoopRegressor,
    Regressor,
    base_parameters,
    candidates,
    columns_of,
    format_expressions,
    random_states,
)
from mbd_ros.features.identification.samples import (
    Filter,
    Piece,
    Recorded,
    band_of,
    check_efforts,
    cutoff_frequencies,
    grid_step,
    load_recording,
    pieces,
    split_recording,
)
from mbd_ros.features.identification.task import Task
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.scene.built_scene import Scene

_STILL = 0.01  # of the largest velocity of a joint: below, it rests
_MOVING_SHARE = 0.5  # of a window of the filter: rows with less motion do not count
_CHUNK = 4000  # samples of the grid that are computed at once
_STATES = 1000  # random states that tell which base parameters there are
_MOST_CACHED = 3.0e7  # numbers in cached blocks; larger sets are computed again


class Problem:
    """Filtered rows of the regressor of a scene for its recordings.

    Args:
        scene: The scene, without friction.
        task: Options of the identification.
        say: Receives a line for each choice and omission that the user should know.

    Attributes:
        where: Names of the recordings.
        training: Parts of the recordings that parameters are fitted to.
        test: Parts of the recordings that are held out for the test.
        band: End of the band [Hz]; None if samples are not filtered.
        bodies: Bodies that move.
        nominal: Their inertial parameters in the description, shape (bodies, 10).
        base: Base parameters that motions can show.
        texts: Readable format_expressions of the base parameters.
        labels: Names of the rows.
        rows: Indices of the rows in the regressor.
        joints: Index of the joint of each row among the independent joints, -1 without an effort.
        columns: Candidates of friction of each row.
        motors: Motors of the rows; one per joint until `set_motors` couples them.
        pieces: Low-passed training pieces.
        gains: Joint -> torque for a unit of its effort, where that is not 1.
        gain_deviation: Standard deviation of the gain of each row, where gains were estimated.
        seconds: Duration of the training parts [s].
        step: Sampling step [s].
        correlation: Autocorrelation of filtered white noise, starting with 1, shape (k,).
    """

    def __init__(self, scene: Scene, task: Task, say: Say) -> None:
        self.scene = scene
        self.task = task
        self.gains = dict(task.gains)
        self.gain_deviation = np.zeros(0)
        parts = [
            split_recording(recorded, task.learned) for recorded in recordings(scene, task, say)
        ]
        self.training = [first for first, _ in parts]
        self.test = [second for _, second in parts if second is not None]
        self.where = ", ".join(recorded.where for recorded in self.training)
        self.seconds = float(sum(recorded.times[-1] for recorded in self.training))
        self.regressor = regressor_of(scene, self.training)
        self.bodies = moving_bodies(scene.robot)
        self.nominal = parameters_of(scene.robot.model)
        self._choose_rows(say)
        self._known_parameters = known_parameters(self.bodies, self.nominal, task.known)
        rows = self.regressor.rows(*self._states())[:, self.rows].reshape(-1, self.nominal.size)
        rows[
            :, np.repeat(self._known_parameters.reshape(self.nominal.shape).any(axis=1), COUNT)
        ] = 0.0
        self.base = base_parameters(rows)
        self.texts = format_expressions(self.base, [body.name for body in self.bodies])
        self._filter()

    def _states(self) -> tuple[Array, Array, Array]:
        """Return states that show all base parameters: random, or recorded ones with loops."""
        y, v, a = random_states(self.scene.robot, self.scene.couplings, _STATES)
        if not self.scene.has_loops:
            return y, v, a
        parts = (p for recorded in self.training for p in pieces(self.scene, recorded, None))
        recorded_y = np.concatenate([piece.y for piece in parts])
        chosen = np.linspace(0, len(recorded_y) - 1, _STATES // 4).astype(np.intp)
        return recorded_y[chosen], v[: len(chosen)], a[: len(chosen)]

    def blocks(self, delays: Array) -> Iterator[Block]:
        """Yield the training rows, with efforts shifted by each of the delays [s]."""
        key = tuple((delays + self._delay).tolist())
        if key in self._cached_blocks:
            yield from self._cached_blocks[key]
            return
        cached: list[Block] | None = []
        for piece in self.pieces:
            for block in self.maker.blocks(piece, self.band, delays + self._delay):
                yield block
                if cached is not None:
                    cached.append(block)
                    if (
                        sum(b.X.size + b.Y.size + sum(f.size for f in b.F) for b in cached)
                        > _MOST_CACHED
                    ):
                        cached = None
        if cached == []:
            raise DataError(
                f"{self.where}: the {self.seconds:.3g} s for the fit are too short: they contain "
                f"no gap-free window of the filter, which ends at {self.band:.3g} Hz; record for "
                "longer, or raise --band"
            )
        if cached is not None and len(delays) == 1:
            self._cached_blocks = {key: cached}

    def set_delay(self, delay: float) -> None:
        """Shift efforts by a known delay against the motion [s]."""
        self._delay = delay

    def set_gains(self, gains: Mapping[str, float]) -> None:
        """Multiply the efforts of joints by these gains from now on."""
        names = self.scene.couplings.independent
        self.gains |= gains
        self.pieces = list(apply_gains(self.pieces, names, gains))
        self._cached_blocks = {}

    def restrict_to_payload(self, body: int) -> None:
        """Treat all bodies as known, and identify only a payload that is fixed to one of them.

        Args:
            body: Index of the carrying body in `bodies`.
        """
        rows = self.regressor.rows(*self._states())[:, self.rows].reshape(-1, self.nominal.size)
        others = np.delete(np.arange(self.nominal.size), COUNT * body + np.arange(COUNT))
        rows[:, others] = 0.0
        self.base = base_parameters(rows)
        self.texts = format_expressions(self.base, [moving.name for moving in self.bodies])
        self.maker.base = self.base
        self.maker.known_parameters = self.nominal.ravel()
        self._cached_blocks = {}

    def set_load_model(self, inertial: Array) -> None:
        """Let load-dependent friction use the weight of bodies with these inertial parameters."""
        model = self.scene.robot.model.copy()
        for body, numbers in zip(self.bodies, inertial, strict=True):
            model.inertias[body.joint] = inertia_of(numbers)
        self.regressor.set_weight_model(model)
        self._cached_blocks = {}

    def _choose_rows(self, say: Say) -> None:
        """Choose the rows of joints with efforts, and with wrenches those that nothing drives."""
        scene, task, labels = self.scene, self.task, self.regressor.labels
        independent = scene.couplings.independent
        passive = passive_joints(scene, task.passive, self.training, say)
        are_measured = any(r.motion.effort is not None for r in self.training)
        is_free = (bool(passive) or scene.robot.floating) and not are_measured
        if not scene.has_loops:
            check_efforts(scene, self.training, independent if is_free else passive)
        joint_w = IndependentCoordinates(scene.robot, scene.couplings).joint_w
        joint_of = {int(w): i for i, w in enumerate(joint_w)}
        rows = []
        for row in range(len(labels)):
            i = joint_of.get(int(self.regressor.coordinates[row]), -1)
            if i < 0 or independent[i] in passive:
                rows.append((row, -1))
            elif are_measured:
                rows.append((row, i))
        if not rows:
            raise DataError(
                f"{self.where}: there is no effort of any joint and no part without a motor; "
                "record efforts, or name unactuated joints (--passive JOINT ..)"
            )
        self.rows = np.array([row for row, _ in rows], dtype=np.intp)
        self.joints = np.array([i for _, i in rows], dtype=np.intp)
        self.labels = tuple(labels[row] for row in self.rows)

    def _filter(self) -> None:
        """Choose the band, and prepare the training pieces and the candidates of friction."""
        task = self.task
        self.band = task.band
        if self.band is None:
            self.band = max(band for r in self.training for band in self._bands(r))
        self.pieces = list(self._pieces_of(self.training, self.band))
        self.correlation = np.ones(1)
        self.step = max(float(np.median(np.diff(p.times))) for p in self.pieces)
        if self.band is not None:
            rate = 1.0 / self.step
            self.correlation = Filter.of(rate / grid_step(rate, self.band), self.band).correlation
        self.set_motors(Motors.of_joints(len(self.rows)))

    def set_motors(self, motors: Motors) -> None:
        """Turn the rows into those of motors, whose friction is to be identified."""
        coordinates = self.regressor.coordinates[self.rows]
        v = motors.speeds(np.concatenate([piece.v for piece in self.pieces])[:, coordinates])
        rms, peak = np.sqrt(np.mean(np.square(v), axis=0)), np.abs(v).max(axis=0)
        terms = [TERMS if is_alone else SHARED_MOTOR_TERMS for is_alone in motors.alone]
        self.columns: list[tuple[Column, ...]] = [
            tuple(c for c in candidates(float(u)) if c.term in names) if i >= 0 and u > 0.0 else ()
            for u, i, names in zip(rms, self.joints, terms, strict=True)
        ]
        arguments = self.rows, self.columns, self.joints, peak, motors
        self.maker = RowMaker(self.regressor, self.base, *arguments)
        self.motors = motors
        self.maker.known_parameters = (
            self._known_parameters if self._known_parameters.any() else None
        )
        self._delay = 0.0
        self._cached_blocks = dict[tuple[float, ...], list[Block]]()

    def _bands(self, recorded: Recorded) -> Iterator[float]:
        """Yield the ends of the bands of the pieces of a recording [Hz]."""
        for piece in pieces(self.scene, recorded, None):
            yield band_of(piece.times, piece.v[:, self.regressor.coordinates[self.rows]])

    def test_pieces(self) -> Iterator[Piece]:
        """Yield the pieces of the test parts, low-passed to the band."""
        return self._pieces_of(self.test, self.band)

    def pieces_of_motion(self, recordings: Iterable[Recorded]) -> list[Piece]:
        """Return pieces of recordings, low-passed to the frequencies of the training motions."""
        return list(self._pieces_of(recordings, self._cutoff))

    @cached_property
    def _cutoff(self) -> float | None:
        """Highest cutoff frequency of any joint, at most the band [Hz]; None without a band."""
        if self.band is None:
            return None
        cutoffs = np.concatenate([cutoff_frequencies(self.scene, r) for r in self.training])
        return float(min(cutoffs[np.isfinite(cutoffs)].max(initial=0.0), self.band)) or self.band

    def _pieces_of(self, recordings: Iterable[Recorded], band: float | None) -> Iterator[Piece]:
        for recorded in recordings:
            parts = pieces(self.scene, recorded, band)
            yield from apply_gains(parts, self.scene.couplings.independent, self.gains)


def recordings(scene: Scene, task: Task, say: Say) -> Iterator[Recorded]:
    """Yield all recordings; those with a known load come last.

    Raises:
        DataError: There is no recording, or the load or a table of wrenches is missing.
    """
    sources = (*task.motions, *task.held)
    if task.wrenches and len(task.wrenches) != len(sources):
        raise DataError(
            f"--wrenches: there are {len(task.wrenches)} tables for {len(sources)} motions; give "
            "one table for each motion"
        )
    if not sources:
        raise DataError("there is no motion to identify from; give at least one recording")
    if bool(task.held) != (task.payload is not None):
        raise DataError("--held and --payload: give both the recording and the load it holds")
    payload = None if task.payload is None else _payload_parameters(scene, *task.payload)
    for i, (source, load) in enumerate(zip_longest(sources, task.wrenches)):
        options = {"topic": task.topic, "derivatives": task.derivatives, "say": say}
        recorded = load_recording(scene, source, wrenches=load, **options)  # type: ignore[arg-type]
        yield recorded if i < len(task.motions) else recorded._replace(payload=payload)


def _payload_parameters(scene: Scene, frame: str, numbers: Sequence[float]) -> Array:
    """Return the inertial parameters of a load on a link, 0 for other bodies, (10 bodies,)."""
    model = scene.robot.model
    try:
        link = model.frames[scene.robot.frame(frame)]
    except ModelError as error:
        raise DataError(f"--payload {frame}: {error}") from error
    joint = int(link.parentJoint)
    if joint == 0:
        raise DataError(f"--payload {frame}: this link does not move; name a link that moves")
    mass, x, y, z, *moments = numbers
    load = pin.Inertia(mass, np.array([x, y, z]), np.diag(moments or [0.0, 0.0, 0.0]))
    parameters = np.zeros(COUNT * (model.njoints - 1))
    parameters[COUNT * (joint - 1) : COUNT * joint] = (
        parameter_transformation(link.placement) @ load.toDynamicParameters()
    )
    return parameters


def regressor_of(scene: Scene, recorded: Sequence[Recorded]) -> Regressor | LoopRegressor:
    """Return the regressor of a scene; efforts tell which joints drive its loops, if any."""
    solver = scene.inverse_dynamics()
    if isinstance(solver, InverseDynamics):
        return Regressor(scene.robot, solver)
    try:
        return LoopRegressor(scene.robot, solver, scene.initial, driven_joints(scene, recorded))
    except ModelError as error:
        raise DataError(f"{scene.name}: {error}") from error


def driven_joints(scene: Scene, recorded: Sequence[Recorded]) -> list[str]:
    """Return the independent joints with an effort that is not 0 throughout.

    Raises:
        DataError: There is none.
    """
    names, driven = scene.couplings.independent, []
    for i, name in enumerate(names):
        efforts = [r.motion.effort for r in recorded]
        known = [effort[:, i] for effort in efforts if effort is not None]
        if known and all(np.isfinite(e).mean() > 0.99 and e.any() for e in known):
            driven.append(name)
    if not driven:
        where = ", ".join(r.where for r in recorded)
        raise DataError(
            f"{where}: there is no effort of any of {', '.join(names)}; loops need the efforts of "
            "as many joints as they have degrees of freedom"
        )
    return driven


class Block(NamedTuple):
    """Consecutive filtered rows.

    Attributes:
        X: Columns of the base parameters, shape (n, m, r).
        F: Candidates of friction of each row, shape (n, k) each.
        Y: Torques for each delay, shape (n, m, delays).
        mask: Which of the n x m rows count, shape (n, m).
        known: Known part of the torques, which is subtracted from Y, shape (n, m).
    """

    X: Array
    F: list[Array]
    Y: Array
    mask: NDArray[np.bool_]
    known: Array


def apply_gains(
    pieces: Iterable[Piece], names: Sequence[str], gains: Mapping[str, float]
) -> Iterator[Piece]:
    """Yield pieces whose efforts are multiplied by the gains of their joints.

    Raises:
        DataError: A gain names no joint.
    """
    unknown = [name for name in gains if name not in names]
    if unknown:
        raise DataError(f"--gain {unknown[0]}: no such joint; accepted are {', '.join(names)}")
    factors = np.array([gains.get(name, 1.0) for name in names])
    for piece in pieces:
        yield piece._replace(effort=factors * piece.effort, measured=factors * piece.measured)


def passive_joints(
    scene: Scene, named: Sequence[str], recorded: Sequence[Recorded], say: Say
) -> tuple[str, ...]:
    """Return the joints whose effort is 0: the named ones, else those that place the first body.

    Without any effort, a chain of joints from the world to the first link with mass is taken for
    the coordinates of a body that moves freely, such as the pelvis in a model of a person.

    Args:
        named: Joints that the user names.
        say: Receives a line with the joints that are assumed.

    Raises:
        DataError: A joint is unknown.
    """
    joints = scene.couplings.independent
    unknown = [name for name in named if name not in joints]
    if unknown:
        raise DataError(f"--passive {unknown[0]}: no such joint; accepted are {', '.join(joints)}")
    if named:
        return tuple(named)
    has_effort = any(r.motion.effort is not None for r in recorded)
    if has_effort or not scene.wrenches or scene.robot.floating:
        return ()
    model, chain, parent = scene.robot.model, list[str](), 0
    while True:
        children = [j for j in range(1, model.njoints) if int(model.parents[j]) == parent]
        if len(children) != 1:
            break
        parent = children[0]
        names = [j.name for j in scene.robot.joints if model.getJointId(j.urdf_name) == parent]
        chain += [name for name in names if name in joints]
        if model.inertias[parent].mass > 0.0:
            break
    if len(chain) > 1:
        say(
            f"there are no efforts; {', '.join(chain)} are taken for the coordinates of a free "
            "body, whose equations of motion are used"
        )
        return tuple(chain)
    return ()


class RowMaker:
    """Makes filtered rows of pieces: base parameters, candidates of friction, torques.

    Args:
        regressor: Regressor of the scene.
        rows: Indices of the rows of the regressor that are used, shape (m,).
        columns: Candidates of friction of each of them; none for a row without a joint.
        joints: Index of the joint of each row, -1 without an effort, shape (m,).
        peak: Largest speed of the motor of each row, shape (m,).
        motors: Motors of these rows.

    Attributes:
        known_parameters: Inertial parameters of all bodies that are not identified, shape
            (10 bodies,); None if all are.
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
        self.regressor = regressor
        self.base = base
        self.rows = rows
        self.coordinates = regressor.coordinates[rows]
        self.columns = columns
        self.joints = joints
        self.peak = peak
        self.motors = motors
        self.known_parameters: Array | None = None

    def blocks(self, piece: Piece, band: float | None, delays: Array) -> Iterator[Block]:
        """Yield the rows of a piece, filtered to the band; without a band, of all its samples."""
        rate = 1.0 / float(np.median(np.diff(piece.times)))
        step = 1 if band is None else grid_step(rate, band)
        grid = np.arange(0, len(piece.times), step)
        low = None if band is None else Filter.of(rate / step, band)
        if low is None:
            chunks = [grid[i : i + _CHUNK] for i in range(0, len(grid), _CHUNK)]
        else:
            chunks = _overlapping_chunks(grid, low)
        for chunk in chunks:
            X, F, Y, moves, known = self._unfiltered(piece, chunk, delays)
            if low is None:
                yield Block(X, F, Y, moves, known)
                continue
            share = low.apply(moves.astype(np.float64))
            X, F, Y = low.apply(X), [low.apply(f) for f in F], low.apply(Y)
            yield Block(X, F, Y, share >= _MOVING_SHARE, low.apply(known))

    def _unfiltered(
        self, piece: Piece, at: NDArray[np.intp], delays: Array
    ) -> tuple[Array, list[Array], Array, NDArray[np.bool_], Array]:
        """Return the unfiltered rows of some samples: X, F, Y, which joints move, known."""
        y, v, a = piece.y[at], piece.v[at], piece.a[at]
        W = self.regressor.rows(y, v, a)
        known = self.regressor.known(W, y, v, a, [load[at] for load in piece.loads])[:, self.rows]
        for parameters in (self.known_parameters, piece.payload):
            if parameters is not None:
                known = known + W[:, self.rows] @ parameters
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
        motions = zip(self.columns, v.T, a.T, weight.T, strict=True)
        F = [columns_of(columns, *motion) for columns, *motion in motions]
        moves = np.abs(v) > _STILL * self.peak
        moves[:, self.peak == 0.0] = True
        moves[:, self.joints < 0] = True
        Y = effort - known[:, :, None]
        return X, F, Y, moves, known

    def _of_motors(
        self, X: Array, known: Array, weight: Array, effort: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Return the same quantities for motors in place of joints."""
        motors = self.motors
        X_motors = np.swapaxes(motors.torques(np.swapaxes(X, 1, 2)), 1, 2)
        torque = np.swapaxes(motors.from_measured(np.swapaxes(effort, 1, 2)), 1, 2)
        known, weight = motors.torques(known), motors.torques(weight)
        return X_motors, known, weight, torque, motors.speeds(v), motors.speeds(a)


def _overlapping_chunks(grid: NDArray[np.intp], low: Filter) -> Iterator[NDArray[np.intp]]:
    """Yield chunks of a grid whose filter windows together are those of the entire grid."""
    starts = low.starts(len(grid))
    count = max(_CHUNK // low.step, 1)
    for first in range(0, len(starts), count):
        windows = starts[first : first + count]
        yield grid[windows[0] : windows[-1] + len(low.taps)]


class Motors(NamedTuple):
    """Motors that are coupled to several joints, such as those of a wrist with bevel gears.

        w = U v,    tau = U' tau_m

    v and tau belong to joints; w and tau_m belong to motors and are reduced to the joints that
    bear their names, so U has ones on its diagonal. Friction is a function of w. Rows of motors
    are U^-T times those of the joints, so that each has a friction of its own.

    Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, section 9.7
    (coupled transmissions).

    Attributes:
        ratios: U, shape (m, m).
        are_measured: Whether efforts are torques of motors, not of joints.
    """

    ratios: Array
    are_measured: bool = False

    @classmethod
    def of_joints(cls, count: int) -> Motors:
        """Return one motor per joint."""
        return cls(np.eye(count))

    @property
    def are_coupled(self) -> bool:
        """Whether any motor turns with several joints."""
        return bool(np.any(self.ratios != np.eye(len(self.ratios))))

    @property
    def others(self) -> list[dict[int, float]]:
        """Other joints that each motor turns with: row -> ratio."""
        m = len(self.ratios)
        return [
            {j: float(row[j]) for j in range(m) if j != i and row[j] != 0.0}
            for i, row in enumerate(self.ratios)
        ]

    @property
    def alone(self) -> Array:
        """Which motors have one joint that turns no other motor, booleans of shape (m,)."""
        coupled = self.ratios != np.eye(len(self.ratios))
        return np.asarray(~(coupled.any(axis=0) | coupled.any(axis=1)))

    def speeds(self, v: Array) -> Array:
        """Return velocities (or accelerations) of motors from those of joints, shape (.., m)."""
        return v @ self.ratios.T

    def torques(self, tau: Array) -> Array:
        """Return torques of motors from those of joints, shape (.., m)."""
        return tau @ np.linalg.inv(self.ratios)

    def measured(self, tau: Array) -> Array:
        """Return the measured efforts from torques of joints, shape (.., m)."""
        return self.torques(tau) if self.are_measured else tau

    def from_measured(self, effort: Array) -> Array:
        """Return torques of motors from measured efforts, shape (.., m)."""
        return effort if self.are_measured else self.torques(effort)

    def as_measured(self, torque: Array) -> Array:
        """Return measured efforts from torques of motors, the inverse of `from_measured`."""
        return torque if self.are_measured else torque @ self.ratios
