"""Inverse dynamics from bag to bag, piece by piece, so that memory does not grow.

With causal filters a piece is solved as it is read. A zero-phase filter needs the future, so the
motion is stored in a temporary file and filtered window by window.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Protocol

import numpy as np

from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.features.inverse_dynamics.result import (
    check_finite,
    measured_columns,
    residual_of_rows,
    result_metadata,
)
from mbd_ros.files.bags.bag_recordings import MotionBlocks, WholeNeededError
from mbd_ros.files.bags.bag_writer import Spool, StampSpool
from mbd_ros.files.table import MAIN, Result, Table, time_columns
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, watching
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observations, TorqueEstimator, Tuning
from mbd_ros.motion.cutoff import cutoff_lines
from mbd_ros.motion.filters import causal_line, chosen_cutoffs, observe, smoothed, stated
from mbd_ros.motion.inverse_solution import OpenChains, Violations, topics
from mbd_ros.motion.long_stamps import Windows
from mbd_ros.motion.recordings import name_of
from mbd_ros.motion.samples import Task
from mbd_ros.scene.built_scene import Scene

_PIECE = 16_384  # samples that are solved and written together


def stream(scene: Scene, task: Task, motion: Path, out: Path, say: Say) -> int | None:
    """Write the torques of a bag into a bag.

    Args:
        scene: The scene.
        task: The motion, and what is computed.
        motion: The bag of the motion.
        out: The bag to write.
        say: Called with each line for people.

    Returns:
        Number of samples; None, without any effect, if the motion must be read at once.
    """
    source, _, half_width = task.derivatives
    if task.bounds or task.power or task.stance or not _is_plain(scene):
        return None
    if source not in ("causal", "zero-phase") or half_width:
        return None
    is_unbounded = any(joint.kind == "continuous" for joint in scene.robot.joints)
    if source == "zero-phase" and is_unbounded:  # turns are counted over the whole motion
        return None
    from mbd_ros.files.bags.bag import Bag, DifferentPieceError

    try:
        with ExitStack() as stack:
            samples: Source
            if source == "causal":
                samples = CausalSource(scene, task, motion)
            else:
                samples = stack.enter_context(
                    SmoothedSource(scene, task, motion, out.absolute().parent)
                )
            pieces = _Pieces(scene, task, samples)
            Bag().write_blocks(out, pieces)
            for text in pieces.lines():
                say(text)
            return pieces.rows
    except (WholeNeededError, DifferentPieceError):
        return None


def _is_plain(scene: Scene) -> bool:
    """Return whether the torques depend on one topic only."""
    others = scene.has_loops or scene.wrenches or scene.parts.get("contacts") or scene.actuators
    robot = scene.robot
    return bool(scene.couplings.independent) and not (others or robot.bases or robot.members)


class Source(Protocol):
    """Samples piece by piece, and lines about them afterwards."""

    def __iter__(self) -> Iterator[Observations]:
        """Yield the pieces."""
        ...

    def record(self, table: Table) -> None:
        """Record the torques of a piece."""
        ...

    def lines(self) -> Iterator[str]:
        """Yield lines about dropped messages and about derivatives."""
        ...

    def last_lines(self) -> Iterator[str]:
        """Yield lines about the torques."""
        ...


class CausalSource:
    """Samples of a bag after the causal filters."""

    def __init__(self, scene: Scene, task: Task, path: Path) -> None:
        solver = scene.inverse_dynamics()
        self._where, self._cutoff = name_of(path), task.derivatives.causal_cutoff
        with about("--cutoff"):
            tuning = Tuning(cutoff=self._cutoff)
            self._estimator = TorqueEstimator(scene.robot, solver, tuning)
        self._blocks = MotionBlocks(path, task.topic, self._estimator.names, solver.needed)
        self._unused = Counter[str]()

    def __iter__(self) -> Iterator[Observations]:
        for motion in self._blocks:
            with np.errstate(over="ignore", invalid="ignore"), watching(False):
                samples = observe(self._estimator, motion, self._unused)
            if len(samples.stamps):
                yield samples

    def record(self, table: Table) -> None:
        """Record nothing."""

    def lines(self) -> Iterator[str]:
        """Yield lines about dropped messages and samples, and the lag of the filters."""
        dropped = self._blocks.dropped.items()
        yield from (f"{self._where}: {count} messages left out: {why}" for why, count in dropped)
        yield causal_line(self._estimator.differentiator, self._cutoff)
        yield from (f"{count} samples left out: {why}" for why, count in self._unused.items())

    def last_lines(self) -> Iterator[str]:
        """Yield no lines."""
        return iter(())


class _Pieces:
    """Results of the pieces of a motion, and lines about them afterwards.

    Attributes:
        rows: Number of samples so far.
    """

    def __init__(self, scene: Scene, task: Task, source: Source) -> None:
        self._scene, self._source, self._where = scene, source, name_of(task.motion)
        self._chains = OpenChains(scene, task.parts)
        self._violations = Violations(scene)
        self._about = result_metadata(scene, task, topics(scene))
        self.rows = 0

    def __iter__(self) -> Iterator[Result]:
        for samples in self._source:
            with np.errstate(over="ignore", invalid="ignore"), watching(False):
                columns = self._chains.columns(samples, ())
            table = Table([*time_columns(samples.stamps), *columns])
            check_finite(self._where, table)
            self._violations.add(samples)
            self._source.record(table)
            self.rows += table.rows
            yield Result({MAIN: table}, self._about)
        if not self.rows:
            raise DataError(f"{self._where}: no sample can be used")

    def lines(self) -> list[str]:
        """Return lines for people, in the order of those for a motion that is read at once."""
        doubts = (f"warning: {text}" for text in self._scene.robot.inertia_warnings)
        source = self._source
        return [*doubts, *source.lines(), *self._violations.lines(), *source.last_lines()]


class SmoothedSource:
    """Samples of a bag after the zero-phase filter, window by window.

    Args:
        scene: A scene without continuous joints.
        task: The motion, and what is computed.
        path: The bag of the motion.
        folder: Folder for the temporary file.
    """

    def __init__(self, scene: Scene, task: Task, path: Path, folder: Path) -> None:
        self._where, self._task, couplings = name_of(path), task, scene.couplings
        self._n, names = len(couplings.independent), couplings.independent + couplings.dependent
        self._names = names
        self._blocks = MotionBlocks(path, task.topic, names, couplings.independent)
        self._stack, self._folder = ExitStack(), folder
        self._measured, self._driven = np.ones((2, self._n), dtype=np.bool_)

    def __enter__(self) -> "SmoothedSource":
        n, m = self._n, len(self._names)
        self._stamps = StampSpool(self._spool(1, np.int64))
        self._moving, self._effort = _Moving(self._spool(n + m), n), self._spool(m)
        self._tau: Spool | None = None
        return self

    def _spool(self, width: int, kind: type[np.generic] = np.float64) -> Spool:
        return self._stack.enter_context(Spool(self._folder, width, kind))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def __iter__(self) -> Iterator[Observations]:
        for motion in self._blocks:
            self._store(motion)
        cutoff = self._task.derivatives.cutoff
        with about(self._where), np.errstate(over="ignore", invalid="ignore"):
            moving = self._moving, self._measured
            self._cutoff = chosen_cutoffs(self._stamps, *moving, cutoff)
            self._windows = Windows(self._stamps, self._cutoff)
            for rows, *smooth in smoothed(self._windows, *moving, self._cutoff):
                dependent = self._moving.dependent(rows)
                window = Observations(self._stamps[rows], *smooth, dependent)
                for i in range(0, len(window.stamps), _PIECE):
                    yield Observations(*(field[i : i + _PIECE] for field in window))

    def _store(self, motion: Motion) -> None:
        """Store a piece of the motion in the temporary files."""
        n, (velocity, effort) = self._n, (motion.velocity, motion.effort)
        for every, values in ((self._measured, velocity), (self._driven, effort)):
            every &= False if values is None else np.isfinite(values[:, :n]).all(axis=0)
        self._stamps.append(motion.stamps)
        moving = np.empty((len(motion.stamps), self._moving.spool.width))
        moving[:, n : 2 * n] = np.nan if velocity is None else velocity[:, :n]
        moving[:, :n], moving[:, 2 * n :] = motion.position[:, :n], motion.position[:, n:]
        self._moving.spool.append(moving)
        if self._driven.any():
            self._effort.append(effort)

    def record(self, table: Table) -> None:
        """Store the torques of joints with measured efforts."""
        joints = self._names[: self._n]
        self._pairs = measured_columns(joints, list(table), self._driven)
        if not self._pairs:
            return
        if self._tau is None:
            self._tau = self._spool(len(self._pairs))
        self._tau.append(np.column_stack([table[name] for _, name in self._pairs]))

    def lines(self) -> Iterator[str]:
        """Yield lines about dropped messages and the cutoffs."""
        dropped = self._blocks.dropped.items()
        yield from (f"{self._where}: {count} messages left out: {why}" for why, count in dropped)
        self._cutoff = stated(self._stamps, self._cutoff)
        chosen = self._task.derivatives.cutoff is None
        names = self._names[: self._n]
        yield from cutoff_lines(self._cutoff, names, chosen, len(self._stamps))

    def last_lines(self) -> Iterator[str]:
        """Yield a line about the error of torques against measured efforts."""
        if self._tau is not None:
            joints = [j for j, _ in self._pairs]
            sides = _Sides(self._effort, joints, self._tau)
            yield from residual_of_rows(self._windows, sides, self._cutoff[joints])


class _Sides:
    """Rows of measured efforts of some joints, then of their torques."""

    def __init__(self, effort: Spool, joints: list[int], tau: Spool) -> None:
        self._effort, self._joints, self._tau = effort, joints, tau

    def __getitem__(self, rows: slice) -> Array:
        """Return some rows, shape (n, 2 * joints)."""
        return np.hstack([self._effort[rows][:, self._joints], self._tau[rows]])


class _Moving:
    """Rows of positions and velocities of independent joints, and of positions of the others."""

    def __init__(self, spool: Spool, independent: int) -> None:
        self.spool, self._n = spool, independent

    def __getitem__(self, rows: slice) -> Array:
        """Return positions and velocities of the independent joints."""
        return self.spool[rows][:, : 2 * self._n]

    def dependent(self, rows: slice) -> Array:
        """Return the positions of the other joints."""
        if self.spool.width == 2 * self._n:
            return np.zeros((rows.stop - rows.start, 0))
        return self.spool[rows][:, 2 * self._n :]
