"""Exciting trajectories for identification, Fourier series within limits: `mbd-ros excite`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.regressor import (
    Regressor,
    base_parameters,
    expand_coordinates,
    limits_of,
    random_states,
)
from mbd_ros.features.identification.task import keep_remarks
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.scene.built_scene import Scene

_DEFAULT_SPEED = 2.0  # rad/s, where a description has no velocity limit
_SLIDING_SPEED = 0.5  # m/s, the same for prismatic joints
_SHARE = 0.9  # of every limit is used
_STEPS = 40  # at most, in which the amplitude is reduced
_SMALLER = 0.93  # factor of the amplitude per step
_POSTURES = 50  # random postures that tell which links always touch
_RANDOM_MOTIONS = 200  # random motions, the best of which is improved
_SAMPLES_PER_HARMONIC = 20  # samples per harmonic at which a motion is evaluated
_STATES = 300  # random states that tell which base parameters there are
_CHANGED_SHARE = 0.15  # of the variables change in a step
_LONGER, _SHORTER = 1.2, 0.985  # factors of the step length after success and failure
_SHORTEST = 0.02  # step length
_HOPELESS = 1.0e12  # cost of a motion that violates limits
FIELDS = ("position", "velocity", "acceleration")


def excite(
    scene: Scene,
    *,
    period: float = 10.0,
    harmonics: int = 5,
    share: float = 0.9,
    evaluations: int = 2000,
    seed: int = 0,
    say: Say | None = None,
    progress: Watch = False,
) -> Excitation:
    """Search the periodic motion within all limits that determines the base parameters best.

    Args:
        scene: The scene, without loops and free bases.
        period: Period of the motion [s].
        harmonics: Number of harmonics of the motion.
        share: Share of the limits of position, velocity and effort that is used.
        evaluations: Number of motions that are compared.
        seed: Seed of the random numbers.
        say: Function that is called with each line for people.
        progress: True for a progress line on a terminal, or a function of a label and a share.

    Raises:
        DataError: The scene is not supported, an option is out of range, or no motion keeps the
            limits.
    """
    check_scene(scene)
    _check(period, harmonics, share, evaluations)
    search = _Search(scene, period, harmonics, share)
    remarks, tell = keep_remarks(say)
    for line in search.limits.remarks:
        tell(line)
    with watching(progress):
        x, at_random = search.best(evaluations, seed)
    motion = search.collision_free_motion(x)
    condition = search.condition(motion)
    tell(
        f"condition number {condition:.3g}, best of {_RANDOM_MOTIONS} random motions "
        f"{at_random:.3g}; {len(search.chosen)} base parameters"
    )
    names = scene.couplings.independent
    return Excitation(motion, names, condition, at_random, remarks)


def _check(period: float, harmonics: int, share: float, evaluations: int) -> None:
    checks = {
        "--period": (0.1 <= period <= 1000.0, period, "0.1 .. 1000 s"),
        "--harmonics": (3 <= harmonics <= 50, harmonics, "3 .. 50"),
        "--share": (0.05 <= share <= 1.0, share, "0.05 .. 1"),
        "--evaluations": (
            _RANDOM_MOTIONS <= evaluations <= 10**6,
            evaluations,
            f"{_RANDOM_MOTIONS} .. 1000000",
        ),
    }
    for name, (is_valid, value, accepted) in checks.items():
        if not is_valid:
            raise DataError(f"{name} {value:g}: accepted are {accepted}")


class _Search:
    """Search over unbounded variables that describe motions of a scene."""

    def __init__(self, scene: Scene, period: float, harmonics: int, share: float) -> None:
        solver = scene.inverse_dynamics()
        assert isinstance(solver, InverseDynamics)
        self.limits = Limits(scene, share)
        self._regressor = Regressor(scene.robot, solver)
        states = random_states(scene.robot, scene.couplings, _STATES)
        rows = self._regressor.rows(*states).reshape(-1, self._regressor.size)
        self.chosen = base_parameters(rows).chosen
        self._n = len(self._regressor.labels)
        self._harmonics = harmonics
        self._period = period
        self._t = (
            np.arange(_SAMPLES_PER_HARMONIC * harmonics)
            * period
            / (_SAMPLES_PER_HARMONIC * harmonics)
        )
        self._dense = np.arange(10 * len(self._t)) * period / (10 * len(self._t))

    def best(self, evaluations: int, seed: int) -> tuple[Array, float]:
        """Return the variables of the best motion, and the condition of the best random one.

        Source: H.-G. Beyer, H.-P. Schwefel, Natural Computing 1, 2002, 3 (step length by success).
        """
        random = np.random.default_rng(seed)
        x, least, at_random, step = self._start(random), np.inf, np.inf, 0.3
        for k in progress(range(max(evaluations, _RANDOM_MOTIONS)), evaluations, "searching"):
            if k < _RANDOM_MOTIONS:
                tried = self._start(random)
            else:
                changed = random.random(len(x)) < _CHANGED_SHARE
                tried = x + step * changed * random.normal(size=len(x))
            cost = self._cost(tried)
            if cost < least:
                x, least = tried, cost
                step *= _LONGER
            elif k >= _RANDOM_MOTIONS:
                step = max(_SHORTER * step, _SHORTEST)
            if k < _RANDOM_MOTIONS:
                at_random, step = least, 0.3
        if not least < _HOPELESS:
            raise DataError(
                "no motion keeps the limits of position, velocity and effort; allow more of them "
                "(--share), a longer --period or more --evaluations"
            )
        return x, at_random

    def collision_free_motion(self, x: Array) -> Fourier:
        """Return the motion of some variables, reduced until limits hold and no links touch.

        Raises:
            DataError: Links touch even in the smallest motion.
        """
        motion = self._decode(x)
        for _ in range(100):
            if motion is not None and self.limits.satisfies(motion, self._dense, collisions=True):
                return motion
            motion = None if motion is None else motion.scaled(np.full(self._n, 0.97))
        raise DataError(
            "links touch in every motion that the search found; try another --seed or a smaller "
            "--share"
        )

    def condition(self, motion: Fourier) -> float:
        """Return the condition number of the columns of the base parameters, scaled to 1."""
        rows = self._regressor.rows(*motion.at(self._t)).reshape(-1, self._regressor.size)
        columns = rows[:, self.chosen]
        size = np.linalg.norm(columns, axis=0)
        if not (size > 0.0).all():
            return np.inf
        s = np.linalg.svd(columns / size, compute_uv=False)
        return float(s[0] / s[-1]) if s[-1] > 0.0 else np.inf

    def _start(self, random: np.random.Generator) -> Array:
        n, h = self._n, self._harmonics
        parts = [random.normal(0.0, 1.0, 2 * h * n), random.normal(0.0, 0.5, n)]
        return np.concatenate([*parts, random.normal(1.0, 0.5, n)])

    def _decode(self, x: Array) -> Fourier | None:
        h, rows = self._harmonics, x.reshape(2 * self._harmonics + 2, self._n)
        low, high = self.limits.position_range
        centre = low + (high - low) * (0.5 + 0.45 * np.tanh(rows[-2]))
        share = 0.25 + 0.75 / (1.0 + np.exp(-rows[-1]))
        shape = Fourier.at_rest(centre, rows[:h], rows[h : 2 * h], self._period)
        return self.limits.largest(shape, share, self._t)

    def _cost(self, x: Array) -> float:
        motion = self._decode(x)
        return _HOPELESS if motion is None else self.condition(motion)


class Excitation(NamedTuple):
    """A motion that excites all base parameters.

    Attributes:
        motion: The motion of the independent joints.
        joints: Names of these joints, in the order of the motion.
        condition: Condition number of the regressor of the base parameters, with scaled columns.
        random: Condition number of the best of 200 random motions within the same limits.
        remarks: Lines for people.
    """

    motion: Fourier
    joints: tuple[str, ...]
    condition: float
    random: float
    remarks: list[str]

    def samples(self, rate: float, periods: int = 1) -> Result:
        """Return positions, velocities and accelerations of `periods` periods as a result.

        Args:
            rate: Sampling rate [Hz].
        """
        t = np.arange(round(periods * self.motion.period * rate) + 1) / rate
        columns = [Column("time", t, "s")]
        for field, values in zip(FIELDS, self.motion.at(t), strict=True):
            columns += [Column(f"{n}.{field}", values[:, i]) for i, n in enumerate(self.joints)]
        return Result({"samples": Table(columns)})


def trajectory_points(
    result: Result, joints: tuple[str, ...]
) -> Iterator[tuple[float, list[Array]]]:
    """Yield time since the start, and position, velocity and acceleration of each sample."""
    table = result["samples"]
    fields = [np.transpose([table[f"{n}.{field}"] for n in joints]) for field in FIELDS]
    for i, t in enumerate(table["time"].tolist()):
        yield t, [values[i] for values in fields]


class Fourier(NamedTuple):
    """A periodic motion of joints that begins and ends at rest: a Fourier series of velocities.

        v = sum_l A_l cos(l w t) + B_l sin(l w t),   sum A_l = 0,   sum l B_l = 0

    so that velocity and acceleration are 0 at t = 0 and after every period.

    Source: J. Swevers et al., IEEE Trans. Robot. Autom. 13, 1997, 730.

    Attributes:
        centre: Mean position [rad or m], shape (n,).
        A: Cosines of the velocity [rad/s or m/s], shape (harmonics, n).
        B: Sines of the velocity, same shape.
        period: Period [s].
    """

    centre: Array
    A: Array
    B: Array
    period: float

    @classmethod
    def at_rest(cls, centre: Array, A: Array, B: Array, period: float) -> Fourier:
        """Return the nearest motion that begins and ends at rest."""
        harmonic = np.arange(1.0, len(A) + 1.0)[:, None]
        B = B - harmonic * (harmonic * B).sum(axis=0) / np.square(harmonic).sum()
        return cls(centre, A - A.mean(axis=0), B, period)

    def scaled(self, share: Array) -> Fourier:
        """Return the motion with scaled amplitudes of each joint, about the same centre."""
        return self._replace(A=self.A * share, B=self.B * share)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration at times [s] of shape (k,), (k, n) each."""
        w = 2.0 * np.pi / self.period * np.arange(1.0, len(self.A) + 1.0)
        s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
        position = self.centre + (s / w) @ self.A - (c / w) @ self.B
        return position, c @ self.A + s @ self.B, (c * w) @ self.B - (s * w) @ self.A


class Limits:
    """Limits of a motion: positions, velocities and torques of joints, and self-collision.

    Args:
        scene: The scene, without loops and free bases.
        share: Share of the limits that is used.

    Attributes:
        remarks: Lines about assumptions, for people.
    """

    def __init__(self, scene: Scene, share: float = _SHARE) -> None:
        self._scene = scene
        self._model = scene.robot.model
        solver = scene.inverse_dynamics()
        assert isinstance(solver, InverseDynamics)
        self._solver = solver
        self._couplings = scene.couplings
        joints = scene.robot.joints
        ranges = np.array([limits_of(scene.robot, joint.name) for joint in joints])
        middle, half = ranges.mean(axis=1), 0.5 * share * np.ptp(ranges, axis=1)
        self._lower = middle - half
        self._upper = middle + half
        speeds = [_speed(joint.kind, joint.max_velocity) for joint in joints]
        self._speed = share * np.array(speeds)
        self._effort = share * np.array([joint.max_effort or np.inf for joint in joints])
        self._q = np.array([joint.q for joint in joints])
        self._v = np.array([joint.v for joint in joints])
        names = scene.couplings.independent
        self._independent = [i for i, joint in enumerate(joints) if joint.name in names]
        self.remarks = [
            f"{joint.name}: the description has no velocity limit; {speed:g} per s is assumed"
            for joint, speed in zip(joints, speeds, strict=True)
            if not np.isfinite(joint.max_velocity)
        ]
        self._self_collision = SelfCollision(scene)
        self.remarks += self._self_collision.remarks

    @property
    def position_range(self) -> tuple[Array, Array]:
        """Lowest and highest positions of the independent joints."""
        return self._lower[self._independent], self._upper[self._independent]

    def largest(self, shape: Fourier, share: Array, t: Array) -> Fourier | None:
        """Return the largest motion of a shape within the limits; None if even a small one fails.

        Args:
            shape: Motion whose amplitudes are scaled; its centre is within the limits.
            share: Share of the amplitude that the limits of each joint allow, shape (n,).
            t: Times at which limits are evaluated [s].
        """
        low, high = self.position_range
        y, v, _ = shape.at(t)
        amplitude = np.abs(y - shape.centre).max(axis=0)
        clearance = np.minimum(shape.centre - low, high - shape.centre)
        speed = np.abs(v).max(axis=0)
        factor = np.minimum(clearance / amplitude, self._speed[self._independent] / speed)
        motion = shape.scaled(share * factor)
        if not self.satisfies(motion.scaled(np.full(len(share), _SMALLER**_STEPS)), t):
            return None
        for _ in range(_STEPS):
            if self.satisfies(motion, t):
                return motion
            motion = motion.scaled(np.full(len(share), _SMALLER))
        return None

    def satisfies(self, motion: Fourier, t: Array, collisions: bool = False) -> bool:
        """Return whether a motion satisfies all limits, and optionally whether no links touch."""
        y, v, a = motion.at(t)
        q, velocity, _, _ = expand_coordinates(self._model, self._couplings, y, v, a)
        position, speed = q[self._q], np.abs(velocity[self._v])
        slack = 1e-9
        if (position < self._lower[:, None] - slack).any():
            return False
        if (position > self._upper[:, None] + slack).any():
            return False
        if (speed > self._speed[:, None] + slack).any():
            return False
        tau = np.abs(self._solver.batch(y, v, a, []).tau)
        if (tau > self._effort[self._independent] + slack).any():
            return False
        return not (collisions and self._self_collision.touches(q))


def _speed(kind: str, limit: float) -> float:
    default = _SLIDING_SPEED if kind == "prismatic" else _DEFAULT_SPEED
    return limit if np.isfinite(limit) else default


class SelfCollision:
    """Self-collision of a robot, by the collision shapes of its description.

    Pairs of links that touch in each of many postures, such as neighbours, are ignored.

    Attributes:
        remarks: Reason why self-collision is not checked, if that is so.
    """

    def __init__(self, scene: Scene) -> None:
        self.remarks: list[str] = []
        self._model = scene.robot.model
        self._pairs = 0
        model_source = scene.robot.model_sources[0]
        if len(scene.robot.model_sources) > 1 or "<collision" not in model_source.text:
            self.remarks.append("there are no collision shapes; self-collision is not checked")
            return
        try:
            geometry = pin.buildGeomFromUrdfString(
                self._model, model_source.text, pin.GeometryType.COLLISION
            )
        except (ValueError, RuntimeError) as error:
            self.remarks.append(f"self-collision is not checked: {error}")
            return
        geometry.addAllCollisionPairs()
        self._data = self._model.createData()
        self._geometry = geometry
        self._ignore_permanent_contacts(scene)
        self._pairs = len(geometry.collisionPairs)
        self._geometry_data = pin.GeometryData(geometry)

    def _ignore_permanent_contacts(self, scene: Scene) -> None:
        random, geometry, always = np.random.default_rng(0), self._geometry, None
        q = scene.robot.neutral()
        geometry_data = pin.GeometryData(geometry)
        for _ in range(_POSTURES):
            for joint in scene.robot.joints:
                q[joint.q] = random.uniform(*limits_of(scene.robot, joint.name))
            pin.computeCollisions(self._model, self._data, geometry, geometry_data, q, False)
            touch = np.array([result.isCollision() for result in geometry_data.collisionResults])
            always = touch if always is None else always & touch
        parents = [int(shape.parentJoint) for shape in geometry.geometryObjects]
        for k in reversed(range(len(geometry.collisionPairs))):
            pair: Any = geometry.collisionPairs[k]
            a, b = parents[pair.first], parents[pair.second]
            is_adjacent = a == b or self._model.parents[max(a, b)] == min(a, b)
            if is_adjacent or (always is not None and always[k]):
                geometry.removeCollisionPair(pair)

    def touches(self, q: Array) -> bool:
        """Return whether any links touch in any configuration, given as columns (nq, n)."""
        if not self._pairs:
            return False
        arguments = self._model, self._data, self._geometry, self._geometry_data
        return any(
            pin.computeCollisions(*arguments, np.ascontiguousarray(column), True) for column in q.T
        )


def check_scene(scene: Scene) -> None:
    """Refuse scenes with loops, with free bases or without joints.

    Raises:
        DataError: The scene is not supported; the message tells what to do instead.
    """
    if scene.has_loops:
        raise DataError(
            f"{scene.name}: excite does not support scenes with loops; drive the motors by slow "
            "and fast sines within their limits, since identify accepts recordings of loops"
        )
    if scene.robot.floating:
        raise DataError(
            f"{scene.name}: excite does not support free bases; fix the base (`robot: {{base: "
            "fixed}`), or record any lively motion with the wrench that supports the base, which "
            "identify accepts"
        )
    if not scene.couplings.independent:
        raise DataError(f"{scene.name}: the scene has no joint that moves")
