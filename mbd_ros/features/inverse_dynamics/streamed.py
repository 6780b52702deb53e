"""Bag to bag, piece by piece: memory does not grow with the recording."""

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

import numpy as np

from mbd_ros.core.inverse_dynamics.torque_estimator import Observations, TorqueEstimator, Tuning
from mbd_ros.errors import DataError
from mbd_ros.features.inverse_dynamics.outcome import about_result, check_finite
from mbd_ros.files.bags.motion_blocks import MotionBlocks, WholeNeededError
from mbd_ros.files.table import MAIN, Result, Table
from mbd_ros.files.times import time_columns
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.lines import Say
from mbd_ros.jobs.progress import watching
from mbd_ros.motion import open_chains
from mbd_ros.motion.causal import causal_line, observe
from mbd_ros.motion.recordings import name_of
from mbd_ros.motion.samples import Task
from mbd_ros.scene.built_scene import Scene


def stream(scene: Scene, task: Task, motion: Path, out: Path, say: Say) -> int | None:
    """Write the torques of a bag into a bag.

    Args:
        scene: The scene.
        task: What is asked for.
        motion: The bag of its motion.
        out: The bag to write.
        say: Is told what was done and left out, a line each.

    Returns:
        Number of samples; None, and nothing is done or said, where the motion has to be read as
        a whole.
    """
    source, _, half_width = task.derivatives
    if task.bounds or task.power or task.stance or not _is_plain(scene):
        return None
    if source not in ("causal", "zero-phase") or half_width:
        return None
    turning = any(joint.kind == "continuous" for joint in scene.robot.joints)
    if source == "zero-phase" and turning:  # turns are counted over the whole
        return None
    from mbd_ros.files.bags.bag import Bag, DifferentPieceError

    try:
        with ExitStack() as stack:
            samples: Source
            if source == "causal":
                samples = CausalSource(scene, task, motion)
            else:
                from mbd_ros.features.inverse_dynamics.smoothed import (
                    SmoothedSource,  # loads scipy
                )

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
    """Whether one topic carries all that the torques depend on."""
    others = scene.has_loops or scene.wrenches or scene.parts.get("contacts") or scene.actuators
    robot = scene.robot
    return bool(scene.couplings.independent) and not (others or robot.bases or robot.members)


class Source(Protocol):
    """Samples piece by piece, and then what is to be said of them."""

    def __iter__(self) -> Iterator[Observations]:
        """The pieces."""
        ...

    def taken(self, table: Table) -> None:
        """Look at the table of a piece."""
        ...

    def lines(self) -> Iterator[str]:
        """Of what was left out, and of derivatives."""
        ...

    def last_lines(self) -> Iterator[str]:
        """Of the torques."""
        ...


class CausalSource:
    """Samples of a bag behind the causal filters.

    Args:
        scene: The scene.
        task: What is asked for.
        path: The bag.
    """

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

    def taken(self, table: Table) -> None:
        """Nothing to look at."""

    def lines(self) -> Iterator[str]:
        """See `Source`."""
        dropped = self._blocks.dropped.items()
        yield from (f"{self._where}: {count} messages left out: {why}" for why, count in dropped)
        yield causal_line(self._estimator.differentiator, self._cutoff)
        yield from (f"{count} samples left out: {why}" for why, count in self._unused.items())

    def last_lines(self) -> Iterator[str]:
        """None."""
        return iter(())


class _Pieces:
    """Results of pieces of a motion, and then what is to be said of all.

    Attributes:
        rows: Samples so far.
    """

    def __init__(self, scene: Scene, task: Task, source: Source) -> None:
        self._scene, self._source, self._where = scene, source, name_of(task.motion)
        self._chains = open_chains.OpenChains(scene, task.parts)
        self._violations = open_chains.Violations(scene)
        self._about = about_result(scene, task, open_chains.topics(scene))
        self.rows = 0

    def __iter__(self) -> Iterator[Result]:
        for samples in self._source:
            with np.errstate(over="ignore", invalid="ignore"), watching(False):
                columns = self._chains.columns(samples, ())
            table = Table([*time_columns(samples.stamps), *columns])
            check_finite(self._where, table)
            self._violations.add(samples)
            self._source.taken(table)
            self.rows += table.rows
            yield Result({MAIN: table}, self._about)
        if not self.rows:
            raise DataError(f"{self._where}: no sample can be used")

    def lines(self) -> list[str]:
        """For people, in the order of a motion that is read as a whole."""
        doubts = (f"warning: {text}" for text in self._scene.robot.doubts)
        source = self._source
        return [*doubts, *source.lines(), *self._violations.lines(), *source.last_lines()]
