"""Paths of straight lines through points, including points that are only sometimes active.

A point that is active only while a joint is in an interval splits the path into two, see
`SwitchedPath`. `path_through` builds a path from all points and wraps.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.paths.paths import Path, Pull
from mbd_ros.core.kinematics.paths.via_point import Interval, ViaPoint, slopes_of
from mbd_ros.core.kinematics.sampled_kinematics import SampledKinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

if TYPE_CHECKING:
    from mbd_ros.core.kinematics.paths.wrap_surface import Wrap

MAX_SWITCHED = 8  # points with an interval; each doubles the number of paths


class PointPath(Path):
    """Straight lines through points without friction, all with the same tension.

    A line between coincident points has no direction and exerts no force.

    Args:
        robot: The robot.
        points: Two or more points; their intervals `within` are ignored.
    """

    reads = Reads.JACOBIAN

    def __init__(self, robot: Robot, points: Sequence[ViaPoint]) -> None:
        lengths = [_rigid(robot, *ends) for ends in itertools.pairwise(points)]
        beside = itertools.pairwise([0.0, *lengths, 0.0])
        needs_jacobian = [
            point.moves and None in pair for point, pair in zip(points, beside, strict=True)
        ]
        ends = zip(points, [0.0, *lengths], needs_jacobian, strict=True)
        self._first, *self._others = (_End(*end) for end in ends)
        self.over = " - ".join(point.frame for point in points)
        self._nv = int(robot.model.nv)

    def length(self, k: Kinematics, x: State) -> float:
        """Return l [m]."""
        length: Any = 0.0
        begin = self._first.point.position(k, x)
        for point, rigid, _ in self._others:
            end = point.position(k, x)
            length += k.hypot(end - begin) if rigid is None else rigid
            begin = end
        return length

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """Return l [m] and J, shape (nv,), from the velocities of the ends along each line."""
        length: Any = 0.0
        slope: Any = None
        point, _, needs_jacobian = self._first
        begin, at_begin = point.position(k, x), point.jacobian(k, x) if needs_jacobian else None
        for point, rigid, needs_jacobian in self._others:
            end, at_end = point.position(k, x), point.jacobian(k, x) if needs_jacobian else None
            if rigid is None:
                distance, direction = _along(k, end - begin)
                step = 0.0 if at_end is None else k.dot(direction, at_end)
                if at_begin is not None:
                    step = step - k.dot(direction, at_begin)
                slope = step if slope is None else slope + step
            else:
                distance = rigid
            length, begin, at_begin = length + distance, end, at_end
        return length, k.zeros(self._nv) if slope is None else slope

    def drift(self, k: Kinematics, x: State) -> float:
        """Return J' v, the sum of n (p_b'' - p_a'') + (|w|^2 - (n w)^2) / d with w = v_b - v_a."""
        drift: Any = 0.0
        for (a, _, _), (b, rigid, _) in itertools.pairwise((self._first, *self._others)):
            if rigid is None:
                distance, n = _along(k, b.position(k, x) - a.position(k, x))
                w = b.velocity(k, x) - a.velocity(k, x)
                across = w - n * k.dot(n, w)
                turn = k.dot(across, across) / k.where(distance > 0.0, distance, 1.0)
                drift += k.dot(n, b.acceleration(k, x) - a.acceleration(k, x))
                drift += k.where(distance > 0.0, turn, 0.0)
        return drift

    def pulls(self, k: Kinematics, x: State) -> tuple[Pull, ...]:
        """Return the force at every point, along its adjacent lines."""
        points = [end.point for end in (self._first, *self._others)]
        places = [point.position(k, x) for point in points]
        directions = [_along(k, b - a)[1] for a, b in itertools.pairwise(places)]
        forces = [b - a for a, b in itertools.pairwise([np.zeros(3), *directions, np.zeros(3)])]
        triples = zip(points, places, forces, strict=True)
        return tuple(Pull(point.frame, place, force) for point, place, force in triples)

    def lines(self, k: Kinematics, x: State) -> tuple[Array, ...]:
        """Return all points."""
        return (np.array([end.point.position(k, x) for end in (self._first, *self._others)]),)

    def corners(self) -> Sequence[ViaPoint]:
        """Return all points."""
        return [end.point for end in (self._first, *self._others)]

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """Return l [m] and J of n samples."""
        points = self.corners()
        places = np.stack([point.sampled(k) for point in points], axis=1)
        directions = places[:, 1:] - places[:, :-1]
        rigid = [end.length for end in self._others]
        lengths = np.sqrt((directions * directions).sum(axis=-1))
        directions /= np.where(lengths > 0.0, lengths, 1.0)[..., None]
        for i, length in enumerate(rigid):
            if length is not None:
                lengths[:, i], directions[:, i] = length, 0.0
        change = np.zeros(places.shape)
        change[:, 1:] += directions
        change[:, :-1] -= directions
        return lengths.sum(axis=-1), slopes_of(k, points, places, change)


def _rigid(robot: Robot, a: ViaPoint, b: ViaPoint) -> float | None:
    """Return the distance of two points if no joint changes it [m], otherwise None."""
    (joint_a, at_a), (joint_b, at_b) = (robot.places.points[p.point.number] for p in (a, b))
    if joint_a != joint_b or not (a.is_held and b.is_held):
        return None
    return float(np.linalg.norm(at_a.translation - at_b.translation))


class _End(NamedTuple):
    """A point of a path, and the line to it.

    Attributes:
        length: Length of the line where no joint changes it [m], else None.
        needs_jacobian: Whether its velocity changes the length of the path.
    """

    point: ViaPoint
    length: float | None
    needs_jacobian: bool


def _along(k: Kinematics, line: Array) -> tuple[float, Array]:
    """Length of a line [m] and its direction, zero where it has none."""
    distance = k.hypot(line)
    return distance, line / k.where(distance > 0.0, distance, 1.0)


def path_through(robot: Robot, points: Sequence[ViaPoint], wraps: Sequence[Wrap] = ()) -> Path:
    """The path through points; those with an interval are left out where their joint is not there.

    Args:
        points: Two or more.
        wraps: Surfaces that it may wrap over, in the order in which they are tried.

    Raises:
        ModelError: Too few points, an end that comes and goes, too many points that do, or no
            joint changes the length.
    """
    if len(points) < 2:
        raise ModelError(f"a path needs two points or more, got {len(points)}")
    if points[0].within or points[-1].within:
        raise ModelError("the ends of a path do not come and go: `within` is for points between")
    switched = [point for point in points if point.within]
    if len(switched) > MAX_SWITCHED:
        raise ModelError(f"{len(switched)} points come and go, accepted are {MAX_SWITCHED}")
    moving = any(wrap.point.moves for wrap in wraps)
    if not moving and all(_rigid(robot, points[0], point) is not None for point in points[1:]):
        frames = " and ".join(f"'{point.frame}'" for point in points)
        raise ModelError(f"frames {frames} have no relative motion")
    return _through(robot, points, switched, [(wrap, *_between(wrap, points)) for wrap in wraps])


def _through(
    robot: Robot,
    points: Sequence[ViaPoint],
    switched: Sequence[ViaPoint],
    wraps: Sequence[tuple[Wrap, int, int]],
) -> Path:
    """The path, by its first point that comes and goes; wraps with first and last point."""
    if not switched:
        if not wraps:
            return PointPath(robot, points)
        from mbd_ros.core.kinematics.paths.wrapped_path import WrappedPath

        return WrappedPath(robot, points, [w for w, *_ in wraps], [(a, b) for _, a, b in wraps])
    first, *rest = switched
    assert first.within is not None
    left_out = next(i for i, point in enumerate(points) if point is first)
    without = [point for point in points if point is not first]
    fewer = [
        (wrap, begin - (begin > left_out), end - (end >= left_out)) for wrap, begin, end in wraps
    ]
    inside = _through(robot, points, rest, wraps)
    return SwitchedPath(first.within, inside, _through(robot, without, rest, fewer))


def _between(wrap: Wrap, points: Sequence[ViaPoint]) -> tuple[int, int]:
    first, last = wrap.between or (0, len(points) - 1)
    if not 0 <= first < last < len(points):
        raise ModelError(
            f"wrap '{wrap.name}' acts between points {first} and {last}; accepted: two indices in "
            f"order, from 0 to {len(points) - 1}"
        )
    return first, last


class SwitchedPath(Path):
    """One path while a joint is in an interval, and another one elsewhere.

    The length jumps at the ends of the interval, unless both paths are as long there.

    Args:
        interval: Where the joint must be.
    """

    reads = Reads.JACOBIAN

    def __init__(self, interval: Interval, inside: Path, outside: Path) -> None:
        self._interval = interval
        self._inside = inside
        self._outside = outside
        self.over = inside.over

    def length(self, k: Kinematics, x: State) -> float:
        """Return l [m]."""
        return self._evaluate(k, x, "length")

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """The l [m] and J, shape (nv,)."""
        return self._evaluate(k, x, "measured")

    def drift(self, k: Kinematics, x: State) -> float:
        """J' v [m/s^2]."""
        return self._evaluate(k, x, "drift")

    def pulls(self, k: Kinematics, x: State) -> tuple[Pull, ...]:
        """Return the forces of a tension of 1 N on bodies, for both paths while either may act."""
        there = k.where(self._interval.holds(k, x), 1.0, 0.0)
        shares = (self._inside, there), (self._outside, 1.0 - there)
        return tuple(
            pull._replace(force=pull.force * share)
            for path, share in shares
            if k.any(np.array([share]))
            for pull in path.pulls(k, x)
        )

    def lines(self, k: Kinematics, x: State) -> tuple[Array, ...]:
        """Corners of the path that there is."""
        return self._evaluate(k, x, "lines")

    def corners(self) -> Sequence[ViaPoint]:
        """All points of the path inside, which has more than the other one; none with wraps."""
        return () if self._inside.wraps else self._inside.corners()

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """Return l [m] and J of n samples."""
        there = self._interval.sampled(k)
        if there.all() or not there.any():
            return (self._inside if there.all() else self._outside).sampled(k)
        inside, outside = self._inside.sampled(k.of(there)), self._outside.sampled(k.of(~there))
        lengths, slopes = np.empty(len(there)), np.empty((len(there), inside[1].shape[1]))
        lengths[there], slopes[there] = inside
        lengths[~there], slopes[~there] = outside
        return lengths, slopes

    def _evaluate(self, k: Kinematics, x: State, what: str) -> Any:
        inside, outside = getattr(self._inside, what), getattr(self._outside, what)
        there = self._interval.holds(k, x)
        return k.either(there, lambda: inside(k, x), lambda: outside(k, x))
