"""Motions that show masses: `mbd-ros excite`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.base_parameters import base_parameters
from mbd_ros.features.identification.excite.excitation import Fourier, Limits, refuse
from mbd_ros.features.identification.regressor import Regressor, random_states
from mbd_ros.features.identification.task import keep_remarks
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.scene.built_scene import Scene

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


class Excitation(NamedTuple):
    """A motion that shows masses.

    Attributes:
        motion: It.
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
            periods: How often.
        """
        t = np.arange(round(periods * self.motion.period * rate) + 1) / rate
        columns = [Column("time", t, "s")]
        for field, values in zip(FIELDS, self.motion.at(t), strict=True):
            columns += [Column(f"{n}.{field}", values[:, i]) for i, n in enumerate(self.joints)]
        return Result({"samples": Table(columns)})


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


def points_of(result: Result, joints: tuple[str, ...]) -> Iterator[tuple[float, list[Array]]]:
    """Time from the start and position, velocity and acceleration of each sample."""
    table = result["samples"]
    whole = [np.transpose([table[f"{n}.{field}"] for n in joints]) for field in FIELDS]
    for i, t in enumerate(table["time"].tolist()):
        yield t, [values[i] for values in whole]
