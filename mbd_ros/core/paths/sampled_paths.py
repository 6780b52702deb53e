"""Lengths, speeds and moment arms of all paths over many samples."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.sampled_kinematics import SampledKinematics, carriers
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.paths.paths import Path
from mbd_ros.core.state import Array


class PathSamples(NamedTuple):
    """What paths do in n samples.

    Attributes:
        lengths: [m], shape (n, paths).
        speeds: [m/s], shape (n, paths).
        arms: Moment arms -dl/dy by independent coordinate, dependent joints moving along
            [m or -], shape (n, paths, nv_y).
    """

    lengths: Array
    speeds: Array
    arms: Array


class PathBatch:
    """All paths of a scene, evaluated for all samples at once.

    Args:
        robot: The robot.
        couplings: Its dependent joints.
        paths: By name.
        search: As for `SampledKinematics`; numpy's own by default.

    Attributes:
        names: Of the paths, in the order of the results.
    """

    def __init__(
        self, robot: Robot, couplings: Couplings, paths: Mapping[str, Path], search: Any = None
    ) -> None:
        self._search = search
        self._robot, self._couplings = robot, couplings
        self.names, self._paths = tuple(paths), tuple(paths.values())
        self._joints = carriers(robot)

    @property
    def width(self) -> int:
        """Number of independent velocities: columns of moment arms."""
        return len(self._couplings.v_index)

    def evaluate(self, y: Array, w: Array | None = None) -> PathSamples:
        """Lengths, speeds and moment arms.

        Args:
            y: Independent coordinates, shape (n, ny).
            w: Independent velocities, shape (n, nv_y); 0 where None.

        Raises:
            SolveError: A geodesic is not found.
        """
        q, slopes = self._expanded(y)
        k, n = SampledKinematics(self._robot, q, self._joints, self._search), len(y)
        lengths, arms = np.empty((n, len(self._paths))), []
        for i, path in enumerate(self._paths):
            lengths[:, i], slope = path.sampled(k)
            reduced, _ = self._couplings.reduce(np.array(slope.T, order="C"), slopes)
            arms.append(-reduced.T)
        by_path = (
            np.stack(arms, axis=1) if arms else np.zeros((n, 0, len(self._couplings.v_index)))
        )
        speeds = np.zeros(lengths.shape)
        if w is not None:
            speeds = -(by_path @ w[:, :, None])[..., 0]
        return PathSamples(lengths, speeds, by_path)

    def _expanded(self, y: Array) -> tuple[Array, list[Array]]:
        """All coordinates, shape (n, nq), and the slopes of couplings."""
        model, n = self._robot.model, len(y)
        q, still = np.empty((model.nq, n)), np.zeros((model.nv, n))
        q[self._couplings.q_index] = y.T
        slopes = self._couplings.expand(q, still, still.copy())
        return np.array(q.T, order="C"), slopes
