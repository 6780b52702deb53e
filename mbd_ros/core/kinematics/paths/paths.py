"""Paths of cables and muscles: length, moment arms, and the forces of a tension on bodies.

A tension F along a path of length l(q) with the Jacobian J = dl/dq exerts tau = -J' F on the
joints and takes the power F l' from them. -J are the moment arms. A path has no material
properties: springs, cables, drives and muscles are functions of l, l' and inputs.

Source: M. A. Sherman, A. Seth, S. L. Delp, What is a moment arm? Calculating muscle effectiveness
in biomechanical models using generalized coordinates, ASME IDETC 2013, DETC2013-13633.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.sampled_kinematics import SampledKinematics, carriers
from mbd_ros.core.model.coupling_functions import CouplingFunction
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Joint, Robot
from mbd_ros.core.state import Array, State

if TYPE_CHECKING:
    from mbd_ros.core.kinematics.paths.via_point import ViaPoint
    from mbd_ros.core.kinematics.paths.wrap_surface import Reach, Wrap


class Path:
    """A path whose length depends on the configuration.

    Attributes:
        name: Unique name in the scene; empty for a path in the entry of a part.
        over: Frames or joints of the path, for messages.
        wraps: Surfaces that the path may wrap over.
        reaches: First and last point of the path beside each surface.
        reads: Level of k that its methods read; `drift` reads `Reads.DRIFT`.
    """

    name: str = ""
    over: str = ""
    reads: Reads = Reads.NOTHING
    wraps: Sequence[Wrap] = ()
    reaches: Sequence[Reach] = ()

    def length(self, k: Kinematics, x: State) -> float:
        """Return the length l [m]; it reads positions only."""
        raise NotImplementedError

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """Return the length l [m] and J = dl/dq, shape (nv,)."""
        raise NotImplementedError

    def drift(self, k: Kinematics, x: State) -> float:
        """Return J' v, the l'' at zero joint acceleration [m/s^2]."""
        raise NotImplementedError

    def pulls(self, k: Kinematics, x: State) -> tuple[Pull, ...]:
        """Return the forces of a tension of 1 N on bodies, without its torques in joints."""
        return ()

    def lines(self, k: Kinematics, x: State) -> tuple[Array, ...]:
        """Return polylines of the path, relative to `Robot.origin` [m], shape (n, 3) each."""
        return ()

    def corners(self) -> Sequence[ViaPoint]:
        """Return all points, active or not; empty if the path is more than points and `wraps`."""
        return ()

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """Return l [m] and J of n samples, shapes (n,) and (n, nv)."""
        raise NotImplementedError


class Pull(NamedTuple):
    """Force of a tension of 1 N on a body.

    Attributes:
        frame: Name of the link.
        point: Point of application relative to `Robot.origin` [m], shape (3,).
        force: Force in world axes [N per N], shape (3,).
    """

    frame: str
    point: Array
    force: Array


class JointPath(Path):
    """Sum of functions of joint positions: l = sum f_i(q_i), such as a tendon over pulleys.

    The tension acts between parent and child of each joint.

    Args:
        robot: The robot.
        terms: Joint -> function that returns f, f' and f'' [m, m per rad or m, ..].
    """

    def __init__(self, robot: Robot, terms: Mapping[str, CouplingFunction]) -> None:
        self._terms: list[tuple[Joint, CouplingFunction]] = [
            (robot.joint(name), function) for name, function in terms.items()
        ]
        self.over = ", ".join(joint.name for joint, _ in self._terms)
        self._nv = int(robot.model.nv)

    def length(self, k: Kinematics, x: State) -> float:
        """Return l [m]."""
        return sum(function(k.item(x.q, joint.q))[0] for joint, function in self._terms)

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """Return l [m] and J, whose entries are f_i', shape (nv,)."""
        length, slope = 0.0, k.zeros(self._nv)
        for joint, function in self._terms:
            value, slope[joint.v], _ = function(k.item(x.q, joint.q))
            length += value
        return length, slope

    def drift(self, k: Kinematics, x: State) -> float:
        """Return the sum of f_i'' v_i^2 [m/s^2]."""
        drift = 0.0
        for joint, function in self._terms:
            rate = k.item(x.v, joint.v)
            drift += function(k.item(x.q, joint.q))[2] * rate * rate
        return drift

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """Return l [m] and J of n samples."""
        lengths, slopes = np.zeros(len(k.q)), np.zeros((len(k.q), self._nv))
        for joint, function in self._terms:
            value, slopes[:, joint.v], _ = function(k.q[:, joint.q])
            lengths += value
        return lengths, slopes


class JoinedPaths(Path):
    """Paths in series with the same tension: l is the sum of their lengths.

    Args:
        paths: Paths, at least one.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = tuple(paths)
        self.over = "; ".join(path.over for path in paths)
        self.reads = max(path.reads for path in paths)

    def length(self, k: Kinematics, x: State) -> float:
        """Return l [m]."""
        return sum(path.length(k, x) for path in self._paths)

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """Return l [m] and J, shape (nv,)."""
        length, slope = self._paths[0].measured(k, x)
        for path in self._paths[1:]:
            more, slopes = path.measured(k, x)
            length, slope = length + more, slope + slopes
        return length, slope

    def drift(self, k: Kinematics, x: State) -> float:
        """Return J' v [m/s^2]."""
        return sum(path.drift(k, x) for path in self._paths)

    def pulls(self, k: Kinematics, x: State) -> tuple[Pull, ...]:
        """Return the forces of a tension of 1 N on bodies."""
        return tuple(pull for path in self._paths for pull in path.pulls(k, x))

    def lines(self, k: Kinematics, x: State) -> tuple[Array, ...]:
        """Return the polylines of all paths."""
        return tuple(line for path in self._paths for line in path.lines(k, x))

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """Return l [m] and J of n samples."""
        lengths, slopes = zip(*(path.sampled(k) for path in self._paths), strict=True)
        return np.sum(lengths, axis=0), np.sum(slopes, axis=0)


class PathBatch:
    """All paths of a scene, evaluated for all samples at once.

    Args:
        robot: The robot.
        couplings: Its couplings.
        paths: Paths by name.
        search: Search for shortest paths, see `SampledKinematics`; a numpy version by default.

    Attributes:
        names: Names of the paths, in the order of the results.
    """

    def __init__(
        self, robot: Robot, couplings: Couplings, paths: Mapping[str, Path], search: Any = None
    ) -> None:
        self._search = search
        self._robot = robot
        self._couplings = couplings
        self.names = tuple(paths)
        self._paths = tuple(paths.values())
        self._joints = carriers(robot)

    @property
    def width(self) -> int:
        """Number of independent velocities: columns of moment arms."""
        return len(self._couplings.v_index)

    def evaluate(self, y: Array, w: Array | None = None) -> PathSamples:
        """Return lengths, speeds and moment arms.

        Args:
            y: Independent coordinates, shape (n, ny).
            w: Independent velocities, shape (n, nv_y); 0 by default.

        Raises:
            SolveError: The search for a geodesic failed.
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
        """Return all coordinates, shape (n, nq), and the slopes of couplings."""
        model, n = self._robot.model, len(y)
        q, still = np.empty((model.nq, n)), np.zeros((model.nv, n))
        q[self._couplings.q_index] = y.T
        slopes = self._couplings.expand(q, still, still.copy())
        return np.array(q.T, order="C"), slopes


class PathSamples(NamedTuple):
    """Lengths, speeds and moment arms of paths in n samples.

    Attributes:
        lengths: Lengths [m], shape (n, paths).
        speeds: Rates of the lengths [m/s], shape (n, paths).
        arms: Moment arms -dl/dy of independent coordinates, including the motion of dependent
            joints [m or -], shape (n, paths, nv_y).
    """

    lengths: Array
    speeds: Array
    arms: Array
