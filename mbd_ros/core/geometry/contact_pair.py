"""Two bodies that may touch: all features of their shapes, in slots that never change."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.geometry.balls import BallsOnBalls, BallsOnPlane, nearest_basis
from mbd_ros.core.geometry.meeting import Meeting
from mbd_ros.core.geometry.shapes import Balls, Between, HalfSpace, Side, balls_of
from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.points import Pair, Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_BACK = np.array((1.0, 1.0, -1.0))  # rows of a contact as the other body counts them
_TURN = np.array((-1.0, 1.0, -1.0))  # and its axes x, y, z


class ContactPlaces(NamedTuple):
    """Where features touch.

    Attributes:
        point: In the world less `Robot.origin` [m], shape (n, 3).
        axes: Contact frames in the world, shape (n, 3, 3), columns x, y, z; z is the normal.
    """

    point: Array
    axes: Array


class ContactPair:
    """Features between two bodies a and b; what stands in rows is 3 i (normal), 3 i + 1, 3 i + 2.

    The contact frame of a feature has its z along the normal out of b. Its tangents are fixed to
    b where b is flat, else to a where a is. Velocities are those of a past b at the contact
    point, which is the point of the ball nearest to the other body.

    Args:
        between: Both bodies.
        meeting: The features.
        is_back: Whether b is the body that moves in the meeting.
        margin: Distance at which surfaces count as touching [m].

    Attributes:
        between: Both bodies.
        features: Names of the slots, fixed while building.
        is_smooth: Whether gaps are twice differentiable, so that events can be found.
        why_not: Why they are not; empty where they are.
    """

    reads = Reads.DRIFT

    def __init__(self, between: Between, meeting: Meeting, is_back: bool, margin: float) -> None:
        self.between, self.features = between, meeting.features
        self.is_smooth, self.why_not = True, ""
        self._meeting, self._margin, self._is_back = meeting, margin, is_back
        self._pair = meeting.pair
        self._signs = np.tile(_BACK, len(self.features))

    @property
    def bodies(self) -> tuple[Pair, float]:
        """The body at rest and the moving one, and the `reach` of this one [m]."""
        return self._pair, self._meeting.reach

    @property
    def points(self) -> tuple[Point, Point]:
        """A point of a and one of b."""
        return (self._pair.a, self._pair.b) if self._is_back else (self._pair.b, self._pair.a)

    def gaps(self, k: Kinematics) -> Array:
        """Distances of the surfaces less the margin [m], shape (n,)."""
        gaps = self._meeting.gaps(k.motion(self._pair))
        return gaps - self._margin if self._margin else gaps

    def jacobian(self, k: Kinematics) -> Array:
        """From joint velocities to those of a past b, shape (3 n, nv)."""
        seen = k.motion(self._pair)
        jacobian = self._meeting.jacobian(seen, seen.placed())
        return self._signs[:, None] * jacobian if self._is_back else jacobian

    def drift(self, k: Kinematics, x: State) -> Array:
        """J' v, shape (3 n,)."""
        seen = k.motion(self._pair)
        drift = self._meeting.drift(seen, seen.place())
        return self._signs * drift if self._is_back else drift

    def places(self, k: Kinematics) -> ContactPlaces:
        """Contact points and frames in the world."""
        lever, axes = self._meeting.touch(k.motion(self._pair).pose())
        fixed = k.rotation(self._pair.a)
        point = k.position(self._pair.b) + lever.dot(fixed.T)
        columns = np.einsum("ij,nkj->nik", fixed, axes[:, [1, 2, 0]])
        return ContactPlaces(point, columns * _TURN if self._is_back else columns)


def contact_pair(robot: Robot, between: Between, margin: float = 0.0) -> ContactPair:
    """The features of two bodies.

    Args:
        robot: The robot.
        between: Both bodies.
        margin: Distance at which surfaces count as touching [m].

    Raises:
        ModelError: The bodies do not move against each other, or no features are known of them.
    """
    a, b = between
    if _plane(b.shapes) and not _plane(a.shapes):
        return ContactPair(between, _on_plane(robot, a, b), False, margin)
    if _plane(a.shapes) and not _plane(b.shapes):
        return ContactPair(between, _on_plane(robot, b, a), True, margin)
    moving, resting = balls_of(robot, a), balls_of(robot, b)
    return ContactPair(between, _on_balls(robot, moving, resting), False, margin)


def _plane(shapes: Sequence[object]) -> bool:
    return any(isinstance(shape, HalfSpace) for shape in shapes)


def _on_plane(robot: Robot, moving: Side, plane: Side) -> Meeting:
    if len(plane.shapes) > 1:
        raise ModelError(f"{plane.frame}: a half space goes by itself, without other shapes")
    balls = balls_of(robot, moving)
    return BallsOnPlane(robot.pair(plane.shapes[0].at, balls.at), balls)


def _on_balls(robot: Robot, moving: Balls, resting: Balls) -> Meeting:
    pair = robot.pair(resting.at, moving.at)
    k = Kinematics(robot)
    k.refresh(robot.neutral(), np.zeros(robot.model.nv), Reads.POSITION)
    basis = nearest_basis(k.motion(pair).offset())
    return BallsOnBalls(pair, moving, resting, basis)
