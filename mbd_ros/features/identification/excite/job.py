"""Motions that show masses, Fourier series within limits: `mbd-ros excite`."""

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
    expanded,
    limits_of,
    random_states,
)
from mbd_ros.features.identification.task import keep_remarks
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.scene.built_scene import Scene

_USUAL_SPEED = 2.0  # rad/s, where a description has no velocity limit
_SLIDING_SPEED = 0.5  # m/s, the same of prismatic joints
_SHARE = 0.9  # of every limit is used
_STEPS = 40  # of the amplitude, each smaller
_SMALLER = 0.93  # factor of the amplitude, a step
_POSTURES = 50  # random ones that tell which links always touch
_RANDOM_MOTIONS = 200  # motions that are tried before the best of them is improved
_LOOKED = 20  # samples a harmonic at which a motion is judged
_STATES = 300  # random ones that tell which base parameters there are
_CHANGED = 0.15  # of the numbers, in a step
_LONGER, _SHORTER = 1.2, 0.985  # factors of a step after success and failure
_SHORTEST = 0.02  # step
_HOPELESS = 1.0e12  # cost of a motion that breaks limits
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
    """A periodic motion within all limits that shows the base parameters of a scene best.

    Args:
        scene: The scene, without loops and free bases.
        period: [s].
        harmonics: Of the motion.
        share: Of limits of position, velocity and effort that is used.
        evaluations: Motions that are tried.
        seed: Of the random numbers.
        say: Is called with each line for people.
        progress: True for a line on a terminal, or a function of a label and a share.

    Raises:
        DataError: A scene or options that this does not serve, or no motion within the limits.
    """
    refuse(scene)
    _check(period, harmonics, share, evaluations)
    search = _Search(scene, period, harmonics, share)
    remarks, tell = keep_remarks(say)
    for line in search.limits.remarks:
        tell(line)
    with watching(progress):
        x, at_random = search.best(evaluations, seed)
    motion = search.kept(x)
    condition = search.condition(motion)
    tell(
        f"condition number {condition:.3g}, best of {_RANDOM_MOTIONS} random motions "
        f"{at_random:.3g}; {len(search.chosen)} base parameters"
    )
    names = scene.couplings.independent
    return Excitation(motion, names, condition, at_random, remarks)


def _check(period: float, harmonics: int, share: float, evaluations: int) -> None:
    wrong = {
        "--period": (0.1 <= period <= 1000.0, period, "0.1 .. 1000 s"),
        "--harmonics": (3 <= harmonics <= 50, harmonics, "3 .. 50"),
        "--share": (0.05 <= share <= 1.0, share, "0.05 .. 1"),
        "--evaluations": (
            _RANDOM_MOTIONS <= evaluations <= 10**6,
            evaluations,
            f"{_RANDOM_MOTIONS} .. 1000000",
        ),
    }
    for name, (is_right, value, accepted) in wrong.items():
        if not is_right:
            raise DataError(f"{name} {value:g}: accepted are {accepted}")


class _Search:
    """Motions of a scene by numbers without limits."""

    def __init__(self, scene: Scene, period: float, harmonics: int, share: float) -> None:
        solver = scene.inverse_dynamics()
        assert isinstance(solver, InverseDynamics)
        self.limits, self._regressor = Limits(scene, share), Regressor(scene.robot, solver)
        states = random_states(scene.robot, scene.couplings, _STATES)
        rows = self._regressor.rows(*states).reshape(-1, self._regressor.size)
        self.chosen = base_parameters(rows).chosen
        self._n, self._harmonics, self._period = len(self._regressor.labels), harmonics, period
        self._t = np.arange(_LOOKED * harmonics) * period / (_LOOKED * harmonics)
        self._dense = np.arange(10 * len(self._t)) * period / (10 * len(self._t))

    def best(self, evaluations: int, seed: int) -> tuple[Array, float]:
        """Numbers of the best motion, and the condition number of the best random one.

        Source: H.-G. Beyer, H.-P. Schwefel, Natural Computing 1, 2002, 3 (steps by success).
        """
        random = np.random.default_rng(seed)
        x, least, at_random, step = self._start(random), np.inf, np.inf, 0.3
        for k in progress(range(max(evaluations, _RANDOM_MOTIONS)), evaluations, "searching"):
            if k < _RANDOM_MOTIONS:
                tried = self._start(random)
            else:
                changed = random.random(len(x)) < _CHANGED
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
            raise DataError("no motion keeps the limits of position, velocity and effort")
        return x, at_random

    def kept(self, x: Array) -> Fourier:
        """The motion of numbers, within the limits at every sample; links do not touch.

        Raises:
            DataError: They touch in however small a motion.
        """
        motion = self._judged(x)
        for _ in range(100):
            if motion is not None and self.limits.keeps(motion, self._dense, collisions=True):
                return motion
            motion = None if motion is None else motion.scaled(np.full(self._n, 0.97))
        raise DataError("links touch in every motion that was found; give another --seed")

    def condition(self, motion: Fourier) -> float:
        """Condition number of the columns of the base parameters, scaled to length one."""
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

    def _judged(self, x: Array) -> Fourier | None:
        h, rows = self._harmonics, x.reshape(2 * self._harmonics + 2, self._n)
        low, high = self.limits.room
        centre = low + (high - low) * (0.5 + 0.45 * np.tanh(rows[-2]))
        share = 0.25 + 0.75 / (1.0 + np.exp(-rows[-1]))
        shape = Fourier.at_rest(centre, rows[:h], rows[h : 2 * h], self._period)
        return self.limits.largest(shape, share, self._t)

    def _cost(self, x: Array) -> float:
        motion = self._judged(x)
        return _HOPELESS if motion is None else self.condition(motion)


class Excitation(NamedTuple):
    """A motion that shows masses.

    Attributes:
        joints: Names, in its order.
        condition: Condition number of the regressor of its base parameters, columns scaled.
        random: That of the best of 200 random motions within the same limits.
        remarks: Lines for people.
    """

    motion: Fourier
    joints: tuple[str, ...]
    condition: float
    random: float
    remarks: list[str]

    def samples(self, rate: float, periods: int = 1) -> Result:
        """Positions, velocities and accelerations as a result, `periods` times.

        Args:
            rate: Samples a second [Hz].
        """
        t = np.arange(round(periods * self.motion.period * rate) + 1) / rate
        columns = [Column("time", t, "s")]
        for field, values in zip(FIELDS, self.motion.at(t), strict=True):
            columns += [Column(f"{n}.{field}", values[:, i]) for i, n in enumerate(self.joints)]
        return Result({"samples": Table(columns)})


def points_of(result: Result, joints: tuple[str, ...]) -> Iterator[tuple[float, list[Array]]]:
    """Time from the start and position, velocity and acceleration of each sample."""
    table = result["samples"]
    whole = [np.transpose([table[f"{n}.{field}"] for n in joints]) for field in FIELDS]
    for i, t in enumerate(table["time"].tolist()):
        yield t, [values[i] for values in whole]


class Fourier(NamedTuple):
    """A periodic motion of joints that begins and ends at rest: a Fourier series of velocities.

        v = sum_l A_l cos(l w t) + B_l sin(l w t),   sum A_l = 0,   sum l B_l = 0

    so that velocity and acceleration are 0 at t = 0 and after every period.

    Source: J. Swevers et al., IEEE Trans. Robot. Autom. 13, 1997, 730.

    Attributes:
        centre: Mean position [rad or m], shape (n,).
        A: Cosines of the velocity [rad/s or m/s], shape (harmonics, n).
        B: Sines of the velocity, same shape.
        period: [s].
    """

    centre: Array
    A: Array
    B: Array
    period: float

    @classmethod
    def at_rest(cls, centre: Array, A: Array, B: Array, period: float) -> Fourier:
        """The nearest motion that begins at rest."""
        harmonic = np.arange(1.0, len(A) + 1.0)[:, None]
        B = B - harmonic * (harmonic * B).sum(axis=0) / np.square(harmonic).sum()
        return cls(centre, A - A.mean(axis=0), B, period)

    def scaled(self, share: Array) -> Fourier:
        """With other amplitudes of each joint, about the same centre."""
        return self._replace(A=self.A * share, B=self.B * share)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at times [s] of shape (k,), shape (k, n) each."""
        w = 2.0 * np.pi / self.period * np.arange(1.0, len(self.A) + 1.0)
        s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
        position = self.centre + (s / w) @ self.A - (c / w) @ self.B
        return position, c @ self.A + s @ self.B, (c * w) @ self.B - (s * w) @ self.A


class Limits:
    """What a motion must keep: positions, velocities and torques of joints, distance of links.

    Args:
        scene: The scene, without loops and free bases.
        share: Of limits that is used.

    Attributes:
        remarks: What is assumed, for people.
    """

    def __init__(self, scene: Scene, share: float = _SHARE) -> None:
        self._scene, self._model = scene, scene.robot.model
        solver = scene.inverse_dynamics()
        assert isinstance(solver, InverseDynamics)
        self._solver, self._couplings = solver, scene.couplings
        joints = scene.robot.joints
        own = np.array([limits_of(scene.robot, joint.name) for joint in joints])
        middle, half = own.mean(axis=1), 0.5 * share * np.ptp(own, axis=1)
        self._lower, self._upper = middle - half, middle + half
        speeds = [_speed(joint.kind, joint.max_velocity) for joint in joints]
        self._speed = share * np.array(speeds)
        self._effort = share * np.array([joint.max_effort or np.inf for joint in joints])
        self._q = np.array([joint.q for joint in joints])
        self._v = np.array([joint.v for joint in joints])
        names = scene.couplings.independent
        self._independent = [i for i, joint in enumerate(joints) if joint.name in names]
        self.remarks = [
            f"{joint.name}: no velocity limit, {speed:g} per s is taken"
            for joint, speed in zip(joints, speeds, strict=True)
            if not np.isfinite(joint.max_velocity)
        ]
        self._near = SelfCollision(scene)
        self.remarks += self._near.remarks

    @property
    def room(self) -> tuple[Array, Array]:
        """Positions of the independent joints, lowest and highest."""
        return self._lower[self._independent], self._upper[self._independent]

    def largest(self, shape: Fourier, share: Array, t: Array) -> Fourier | None:
        """A motion of a shape, as large as it may be; None where even a small one may not be.

        Args:
            shape: The shape; its centre is in the room.
            share: Of the amplitude that positions and velocities of each joint let, shape (n,).
            t: Times at which limits are looked at [s].
        """
        low, high = self.room
        y, v, _ = shape.at(t)
        away = np.abs(y - shape.centre).max(axis=0)
        beside = np.minimum(shape.centre - low, high - shape.centre)
        fast = np.abs(v).max(axis=0)
        most = np.minimum(beside / away, self._speed[self._independent] / fast)
        motion = shape.scaled(share * most)
        if not self.keeps(motion.scaled(np.full(len(share), _SMALLER**_STEPS)), t):
            return None
        for _ in range(_STEPS):
            if self.keeps(motion, t):
                return motion
            motion = motion.scaled(np.full(len(share), _SMALLER))
        return None

    def keeps(self, motion: Fourier, t: Array, collisions: bool = False) -> bool:
        """Whether all joints keep positions, velocities and torques, and links their distance."""
        y, v, a = motion.at(t)
        q, rate, _, _ = expanded(self._model, self._couplings, y, v, a)
        position, speed = q[self._q], np.abs(rate[self._v])
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
        return not (collisions and self._near.touches(q))


def _speed(kind: str, limit: float) -> float:
    usual = _SLIDING_SPEED if kind == "prismatic" else _USUAL_SPEED
    return limit if np.isfinite(limit) else usual


class SelfCollision:
    """Whether links of a robot touch, by the collision shapes of its description.

    Links that touch in each of many postures, such as neighbours, are left aside.

    Attributes:
        remarks: Why it is not looked at, where that is so.
    """

    def __init__(self, scene: Scene) -> None:
        self.remarks: list[str] = []
        self._model, self._pairs = scene.robot.model, 0
        model_source = scene.robot.model_sources[0]
        if len(scene.robot.model_sources) > 1 or "<collision" not in model_source.text:
            self.remarks.append("no collision shapes: distances of links are not looked at")
            return
        try:
            geometry = pin.buildGeomFromUrdfString(
                self._model, model_source.text, pin.GeometryType.COLLISION
            )
        except (ValueError, RuntimeError) as error:
            self.remarks.append(f"distances of links are not looked at: {error}")
            return
        geometry.addAllCollisionPairs()
        self._data, self._geometry = self._model.createData(), geometry
        self._leave_aside(scene)
        self._pairs = len(geometry.collisionPairs)
        self._found = pin.GeometryData(geometry)

    def _leave_aside(self, scene: Scene) -> None:
        random, geometry, always = np.random.default_rng(0), self._geometry, None
        q = scene.robot.neutral()
        found = pin.GeometryData(geometry)
        for _ in range(_POSTURES):
            for joint in scene.robot.joints:
                q[joint.q] = random.uniform(*limits_of(scene.robot, joint.name))
            pin.computeCollisions(self._model, self._data, geometry, found, q, False)
            touch = np.array([result.isCollision() for result in found.collisionResults])
            always = touch if always is None else always & touch
        parents = [int(one.parentJoint) for one in geometry.geometryObjects]
        for k in reversed(range(len(geometry.collisionPairs))):
            pair: Any = geometry.collisionPairs[k]
            a, b = parents[pair.first], parents[pair.second]
            beside = a == b or self._model.parents[max(a, b)] == min(a, b)
            if beside or (always is not None and always[k]):
                geometry.removeCollisionPair(pair)

    def touches(self, q: Array) -> bool:
        """Whether any two links touch in any of the configurations, shape (nq, n)."""
        if not self._pairs:
            return False
        model, data, geometry, found = self._model, self._data, self._geometry, self._found
        return any(
            pin.computeCollisions(model, data, geometry, found, np.ascontiguousarray(one), True)
            for one in q.T
        )


def refuse(scene: Scene) -> None:
    """Refuse scenes whose motion cannot be chosen joint by joint.

    Raises:
        DataError: Says why.
    """
    if scene.has_loops:
        raise DataError(
            f"{scene.name}: excite serves scenes without loops. Drive the motors by different "
            "slow and fast sines within their limits; identify takes recordings of loops"
        )
    if scene.robot.floating:
        raise DataError(
            f"{scene.name}: excite serves scenes without free bases. Hold the base and say "
            "`robot: {base: fixed}`, or record any lively motion with the wrench that carries "
            "it: identify takes that"
        )
    if not scene.couplings.independent:
        raise DataError(f"{scene.name}: no joint moves")
