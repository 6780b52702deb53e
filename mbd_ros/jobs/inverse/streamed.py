"""Bag to bag, piece by piece: memory does not grow with the recording."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mbd_ros.core.estimation.torque_estimator import TorqueEstimator, Tuning
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag
from mbd_ros.files.motion_blocks import MotionBlocks, WholeNeededError
from mbd_ros.files.recordings import name_of
from mbd_ros.files.table import MAIN, Result, Table
from mbd_ros.files.times import time_columns
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.inverse import open_chains
from mbd_ros.jobs.inverse.causal import causal_line, observe
from mbd_ros.jobs.inverse.observed import Say, Task
from mbd_ros.jobs.inverse.outcome import about_result, check_finite
from mbd_ros.jobs.progress import watching
from mbd_ros.scene.built_scene import Scene


def stream(scene: Scene, task: Task, out: Path, say: Say) -> int | None:
    """Write the torques of a bag into a bag.

    Args:
        scene: The scene.
        task: What is asked for.
        out: The bag to write.
        say: Is told what was done and left out, a line each.

    Returns:
        Number of samples; None, and nothing is done or said, where the motion has to be read as
        a whole.
    """
    if not (isinstance(task.motion, Path) and is_bag(task.motion) and is_bag(out)):
        return None
    if task.derivatives.source != "causal" or task.bounds or not _is_plain(scene):
        return None
    from mbd_ros.files.bag import Bag, DifferentPieceError

    pieces = _Pieces(scene, task, task.motion)
    try:
        Bag().write_blocks(out, pieces)
    except (WholeNeededError, DifferentPieceError):
        return None
    for text in pieces.lines():
        say(text)
    return pieces.rows


def _is_plain(scene: Scene) -> bool:
    """Whether one topic carries all that the torques depend on."""
    others = scene.has_loops or scene.wrenches or scene.parts.get("contacts") or scene.actuators
    robot = scene.robot
    return bool(scene.couplings.independent) and not (others or robot.bases or robot.members)


class _Pieces:
    """Results of pieces of a motion, and then what is to be said of all.

    Attributes:
        rows: Samples so far.
    """

    def __init__(self, scene: Scene, task: Task, path: Path) -> None:
        self._scene, self._task, self._where = scene, task, name_of(path)
        solver = scene.inverse_dynamics()
        with about("--cutoff"):
            tuning = Tuning(cutoff=task.derivatives.causal_cutoff)
            self._estimator = TorqueEstimator(scene.robot, solver, tuning)
        names = self._estimator.names
        self._blocks = MotionBlocks(path, task.topic, names, solver.needed)
        self._unused = Counter[str]()
        self._chains = open_chains.OpenChains(scene, task.parts)
        self._violations = open_chains.Violations(scene)
        self._about = about_result(scene, task, open_chains.topics(scene))
        self.rows = 0

    def __iter__(self) -> Iterator[Result]:
        for motion in self._blocks:
            with np.errstate(over="ignore", invalid="ignore"), watching(False):
                samples = observe(self._estimator, motion, self._unused)
                if not len(samples.stamps):
                    continue
                columns = self._chains.columns(samples, ())
            table = Table([*time_columns(samples.stamps), *columns])
            check_finite(self._where, table)
            self._violations.add(samples)
            self.rows += table.rows
            yield Result({MAIN: table}, self._about)
        if not self.rows:
            raise DataError(f"{self._where}: no sample can be used")

    def lines(self) -> Sequence[str]:
        """For people, in the order of a motion that is read as a whole."""
        filters = self._estimator.differentiator
        dropped = self._blocks.dropped.items()
        return [
            *(f"warning: {text}" for text in self._scene.robot.doubts),
            *(f"{self._where}: {count} messages left out: {why}" for why, count in dropped),
            causal_line(filters, self._task.derivatives.causal_cutoff),
            *(f"{count} samples left out: {why}" for why, count in self._unused.items()),
            *self._violations.lines(),
        ]
