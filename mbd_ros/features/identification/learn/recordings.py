"""Recordings as samples to learn from, with the torques of a scene beside the efforts."""

from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.learn.scales import Samples
from mbd_ros.features.identification.learn.task import Task
from mbd_ros.features.identification.samples import Piece, Recorded, band_of, pieces, read
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.motion.samples import kept_rows
from mbd_ros.scene.built_scene import Scene

_MEASURED = 0.99  # of the samples: a joint with fewer efforts is not learned
FEWEST = 20  # samples
_END = 0.75  # periods of the end of the band: where derivatives lack a neighbour
_INNER = 0.5  # of the samples of a piece: with fewer, or with less than `FEWEST`, ends are kept


class Recordings:
    """Recordings of a scene.

    Args:
        scene: The scene; its torques are not asked yet.
        task: What is asked for.
        say: Is told what is left out.

    Attributes:
        every: The recordings.
        joints: Joints with efforts.
        band: End of the band [Hz]; None where motions have accelerations.
    """

    def __init__(self, scene: Scene, task: Task, say: Say) -> None:
        if not isinstance(scene.inverse_dynamics(), InverseDynamics):
            raise DataError(f"{scene.name}: learning takes open chains, the scene has loops")
        if task.wrenches and len(task.wrenches) != len(task.motions):
            raise DataError(
                f"--wrenches: {len(task.wrenches)} for {len(task.motions)} motions; give one each"
            )
        if not task.motions:
            raise DataError("no motion to learn from: give tables or bags")
        options = {"topic": task.topic, "derivatives": task.derivatives, "say": say}
        pairs = zip_longest(task.motions, task.wrenches)
        self.every = [read(scene, source, wrenches=load, **options) for source, load in pairs]
        self.where = ", ".join(one.where for one in self.every)
        self.joints = self._measured(scene, say)
        self.band = task.band
        if self.band is None and any(one.derivatives != "given" for one in self.every):
            found = [band_of(p.times, p.v) for one in self.every for p in pieces(scene, one, None)]
            self.band = max(found)

    def _measured(self, scene: Scene, say: Say) -> tuple[str, ...]:
        names, kept = scene.couplings.independent, []
        for i, name in enumerate(names):
            efforts = [one.motion.effort for one in self.every]
            columns = [e[:, i] for e in efforts if e is not None]
            whole = len(columns) == len(efforts) and all(
                np.isfinite(c).mean() > _MEASURED and c.any() for c in columns
            )
            if whole:
                kept.append(name)
            else:
                say(f"{name}: no effort, nothing is learned of it")
        if not kept:
            raise DataError(f"{self.where}: no effort of any of {', '.join(names)}")
        return tuple(kept)

    def samples(self, scene: Scene, recorded: Sequence[Recorded]) -> Samples:
        """Samples of recordings, one after another.

        Args:
            scene: Whose torques stand beside the efforts; of the same robot.
            recorded: Recordings, or parts of them.

        Raises:
            DataError: Too few.
        """
        found = [
            self._inner(one, self._of_piece(scene, piece))
            for one in recorded
            for piece in pieces(scene, one, self.band)
        ]
        joined = Samples(*(np.concatenate(columns) for columns in zip(*found, strict=True)))
        there = np.isfinite(np.hstack([joined.effort, joined.measured])).all(axis=1)
        joined = joined.at(there)
        if joined.count < FEWEST:
            raise DataError(
                f"{self.where}: {joined.count} samples to learn from, needed are {FEWEST}"
            )
        return joined

    def _inner(self, recorded: Recorded, samples: Samples) -> Samples:
        """Samples without the ends, where nobody can tell an acceleration from positions."""
        if recorded.derivatives == "given" or self.band is None:
            return samples
        times, end = samples.times, _END / self.band
        inner = (times >= times[0] + end) & (times <= times[-1] - end)
        is_enough = inner.mean() > _INNER and inner.sum() >= FEWEST
        return samples.at(inner) if is_enough else samples

    def _of_piece(self, scene: Scene, piece: Piece) -> Samples:
        at = IndependentCoordinates(scene.robot, scene.couplings)
        tau = scene.inverse_dynamics().batch(piece.y, piece.v, piece.a, piece.loads).tau
        names = scene.couplings.independent
        mine = [names.index(name) for name in self.joints]
        y, w = np.array(at.joint_y)[mine], np.array(at.joint_w)[mine]
        motion = piece.y[:, y], piece.v[:, w], piece.a[:, w]
        efforts = piece.effort[:, mine], piece.measured[:, mine]
        return Samples(piece.times, *motion, *efforts, tau[:, w], piece.y, piece.v, piece.a)


def first_seconds(recorded: Recorded, seconds: float) -> Recorded:
    """The beginning of a recording."""
    return recorded._replace(motion=kept_rows(recorded.motion, recorded.times <= seconds))


def thinned(samples: Samples, most: int) -> Samples:
    """Every so many samples: those between say little that is new."""
    return samples.at(slice(None, None, -(-samples.count // most)))


def share_of(prediction: Array, measured: Array) -> float:
    """Norm of an error over the norm of what was measured."""
    return float(np.linalg.norm(prediction - measured) / max(np.linalg.norm(measured), 1e-300))
