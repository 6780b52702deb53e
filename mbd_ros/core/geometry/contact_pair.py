"""Two bodies that may touch: all features of their shapes, in slots that never change."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.geometry.feature_gaps import Meeting
from mbd_ros.core.geometry.shapes import Between
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.points import Pair, Point
from mbd_ros.core.state import Array, State

_BACK = np.array((1.0, 1.0, -1.0))  # rows of a contact as the other body counts them
_TURN = np.array((-1.0, 1.0, -1.0))  # and its axes x, y, z


class Places(NamedTuple):
    """Where features touch.

    Attributes:
        point: In the world less `Robot.origin` [m], shape (n, 3).
        axes: Contact frames in the world, shape (n, 3, 3), columns x, y, z; z is the normal.
    """

    point: Array
    axes: Array


class Met(NamedTuple):
    """Some features of a pair.

    Attributes:
        meeting: Their geometry.
        is_back: Whether it is b that moves in it.
    """

    meeting: Meeting
    is_back: bool


class ContactPair:
    """Features between two bodies a and b; rows of feature i are 3 i (normal), 3 i + 1, 3 i + 2.

    The contact frame of a feature has its z along the normal out of b. Its tangents are fixed to
    b where b is flat, else to a where a is. Velocities are those of a past b at the contact
    point, which both bodies are pushed at.

    Args:
        between: Both bodies.
        met: Their features.
        margin: Distance at which surfaces count as touching [m].
        reach: Of the body that moves in the first of them, from its point there [m].

    Attributes:
        between: Both bodies.
        features: Names of the slots, fixed while building.
        is_smooth: Whether gaps are twice differentiable, so that events can be found.
        why_not: Why they are not; empty where they are.
        points: A point of a and one of b.
        bodies: The body at rest and the moving one, and how far points of this one that may touch
            are from its point at most [m]; inf where nobody knows.
    """

    def __init__(
        self, between: Between, met: tuple[Met, ...], margin: float, reach: float
    ) -> None:
        self.between = between
        self.features = tuple(name for one in met for name in one.meeting.features)
        self.why_not = next((m.meeting.why_not for m in met if m.meeting.why_not), "")
        self.is_smooth = not self.why_not
        self._met, self._margin = met, margin
        pair = met[0].meeting.pair
        self.bodies: tuple[Pair, float] = (pair, reach)
        self.points: tuple[Point, Point] = (pair.b, pair.a)
        if met[0].is_back:
            self.points = pair.a, pair.b
        self._signs = np.tile(_BACK, len(self.features))
        self._only = met[0] if len(met) == 1 else None

    def gaps(self, k: Kinematics) -> Array:
        """Distances of the surfaces less the margin [m], shape (n,)."""
        each = [one.meeting.gaps(k.motion(one.meeting.pair)) for one in self._met]
        gaps = each[0] if self._only else np.concatenate(each)
        return gaps - self._margin if self._margin else gaps

    def room(self, k: Kinematics, gaps: Array) -> float:
        """How far the bodies are from touching at least [m].

        Args:
            k: Kinematics at a state.
            gaps: At this state, shape (n,).
        """
        rooms, begin = [], 0
        for meeting, _ in self._met:
            end = begin + len(meeting.features)
            rooms.append(meeting.room(k.motion(meeting.pair), gaps[begin:end] + self._margin))
            begin = end
        return min(rooms) - self._margin

    def jacobian(self, k: Kinematics) -> Array:
        """From joint velocities to those of a past b, shape (3 n, nv)."""
        each = []
        for meeting, is_back in self._met:
            seen = k.motion(meeting.pair)
            jacobian = meeting.jacobian(seen)
            if is_back:
                jacobian *= self._signs[: len(jacobian), None]
            each.append(jacobian)
        return each[0] if self._only else np.concatenate(each)

    def drift(self, k: Kinematics, x: State) -> Array:
        """J' v, shape (3 n,)."""
        each = []
        for meeting, is_back in self._met:
            seen = k.motion(meeting.pair)
            drift = meeting.drift(seen)
            if is_back:
                drift *= self._signs[: len(drift)]
            each.append(drift)
        return each[0] if self._only else np.concatenate(each)

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`, for the contact points and frames of one."""
        each = []
        for meeting, is_back in self._met:
            seen = k.motion(meeting.pair)
            jacobian, drift = meeting.accelerations(seen)
            if is_back:
                signs = self._signs[: len(drift)]
                jacobian, drift = jacobian * signs[:, None], drift * signs
            each.append((jacobian, drift))
        if self._only:
            return each[0]
        jacobian, drift = (np.concatenate(part) for part in zip(*each, strict=True))
        return jacobian, drift

    def places(self, k: Kinematics) -> Places:
        """Contact points and frames in the world."""
        each = [self._places(k, *one) for one in self._met]
        if self._only:
            return each[0]
        point, axes = (np.concatenate(part) for part in zip(*each, strict=True))
        return Places(point, axes)

    def _places(self, k: Kinematics, meeting: Meeting, is_back: bool) -> Places:
        _, lever, axes = meeting.touch(k.motion(meeting.pair).pose())
        fixed = k.rotation(meeting.pair.a)
        point = k.position(meeting.pair.b) + lever.dot(fixed.T)
        columns = np.einsum("ij,nkj->nik", fixed, axes[:, [1, 2, 0]])
        return Places(point, columns * _TURN if is_back else columns)
