"""Samples of a bag without lag, window by window: the motion waits in a file, not in memory."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np

from mbd_ros.core.estimation.torque_estimator import Observations
from mbd_ros.core.state import Motion
from mbd_ros.files.motion_blocks import MotionBlocks
from mbd_ros.files.recordings import name_of
from mbd_ros.files.spool import Columns, Spool
from mbd_ros.files.table import Table
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.inverse.cutoff_lines import cutoff_lines
from mbd_ros.jobs.inverse.observed import Task
from mbd_ros.jobs.inverse.unexplained import driven, off_the_effort
from mbd_ros.jobs.inverse.zero_phase import chosen_cutoffs, smoothed, stated
from mbd_ros.scene.built_scene import Scene

_PIECE = 16_384  # samples that are solved and written at once


class SmoothedSource:
    """Samples of a bag behind the low-pass that sees the future.

    Args:
        scene: The scene, no joint of which turns without end.
        task: What is asked for.
        path: The bag.
        folder: Where the motion may wait.
    """

    def __init__(self, scene: Scene, task: Task, path: Path, folder: Path) -> None:
        self._where, self._task, couplings = name_of(path), task, scene.couplings
        self._n, names = len(couplings.independent), couplings.independent + couplings.dependent
        self._names = names
        self._blocks = MotionBlocks(path, task.topic, names, couplings.independent)
        self._stack, self._folder = ExitStack(), folder
        self._measured, self._driven = np.ones((2, self._n), dtype=np.bool_)

    def __enter__(self) -> "SmoothedSource":
        self._motion = self._stack.enter_context(Spool(self._folder, 3 * len(self._names)))
        self._tau: Spool | None = None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def __iter__(self) -> Iterator[Observations]:
        self._stamps = np.concatenate([self._kept(motion) for motion in self._blocks])
        m = len(self._names)
        position = Columns(self._motion, slice(0, self._n))
        velocity = Columns(self._motion, slice(m, m + self._n))
        cutoff = self._task.derivatives.cutoff
        with about(self._where), np.errstate(over="ignore", invalid="ignore"):
            given = self._stamps, position, velocity, self._measured
            self._cutoff = chosen_cutoffs(*given, cutoff)
            for rows, *smooth in smoothed(*given, self._cutoff):
                dependent = self._motion[rows][:, self._n : m]
                whole = Observations(self._stamps[rows], *smooth, dependent)
                for i in range(0, len(whole.stamps), _PIECE):
                    yield Observations(*(field[i : i + _PIECE] for field in whole))

    def _kept(self, motion: Motion) -> np.ndarray:
        """Put a piece of the motion aside; its stamps."""
        unknown = np.full_like(motion.position, np.nan)
        fields = [unknown if one is None else one for one in (motion.velocity, motion.effort)]
        for every, values in zip((self._measured, self._driven), fields, strict=True):
            every &= np.isfinite(values[:, : self._n]).all(axis=0)
        self._motion.append(np.hstack([motion.position, *fields]))
        return motion.stamps

    def taken(self, table: Table) -> None:
        """Keep the torques beside the measured efforts of their joints."""
        joints = self._names[: self._n]
        self._pairs = driven(joints, list(table), self._driven)
        if not self._pairs:
            return
        if self._tau is None:
            self._tau = self._stack.enter_context(Spool(self._folder, 2 * len(self._pairs)))
        rows = slice(self._tau.rows, self._tau.rows + table.rows)
        effort = self._motion[rows][:, 2 * len(self._names) :]
        known = [effort[:, j] for j, _ in self._pairs]
        self._tau.append(np.column_stack([*known, *(table[name] for _, name in self._pairs)]))

    def lines(self) -> Iterator[str]:
        """See `streamed.Source`."""
        dropped = self._blocks.dropped.items()
        yield from (f"{self._where}: {count} messages left out: {why}" for why, count in dropped)
        self._cutoff = stated(self._stamps, self._cutoff)
        chosen = self._task.derivatives.cutoff is None
        names = self._names[: self._n]
        yield from cutoff_lines(self._cutoff, names, chosen, len(self._stamps))

    def last_lines(self) -> Iterator[str]:
        """How far the torques are off the measured efforts."""
        if self._tau is not None:
            cutoff = self._cutoff[[j for j, _ in self._pairs]]
            yield from off_the_effort(self._stamps, self._tau, cutoff)
