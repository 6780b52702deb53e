"""Free bodies of a recording as signals that are filtered without lag."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.kinematics.poses import POSE, TWIST, acceleration_of, rate_of, twist_of
from mbd_ros.core.state import Array, BodyMotion
from mbd_ros.files.body_columns import POSE as POSE_WORDS
from mbd_ros.files.body_columns import TWIST as TWIST_WORDS
from mbd_ros.files.body_columns import names_of


class BodySignals:
    """Each body as the seven numbers of its pose, then its twist where that is measured.

    A rotation is followed by the numbers of its quaternion, whose length counts out afterwards: a
    low-pass mixes no axes and needs no chart. A measured twist is differentiated as it is.

    Args:
        bodies: Their motion; a twist with a gap counts as not measured.

    Attributes:
        names: Of the signals.
        position: Signals, 0 in place of the integral of a twist, shape (n, m).
        velocity: Their rates, NaN where not measured, same shape.
    """

    def __init__(self, bodies: Sequence[BodyMotion]) -> None:
        self._bodies = bodies
        self.names: list[str] = []
        positions, velocities = [], []
        for body in bodies:
            twist, rate = _measured(body), np.full_like(body.pose, np.nan)
            self.names += names_of(body.name, POSE_WORDS)
            if twist is not None:
                rate = rate_of(body.pose, twist)
                self.names += names_of(body.name, TWIST_WORDS)
            positions += [body.pose] + [np.zeros_like(t) for t in (twist,) if t is not None]
            velocities += [rate] + [t for t in (twist,) if t is not None]
        self.position, self.velocity = np.hstack(positions), np.hstack(velocities)

    def motions(self, position: Array, velocity: Array, acceleration: Array) -> list[BodyMotion]:
        """Motion of the bodies from the filtered signals and their derivatives, shape (n, m)."""
        found, at = [], 0
        for body in self._bodies:
            pose = slice(at, at + POSE)
            q, rate, second = position[:, pose], velocity[:, pose], acceleration[:, pose]
            at += POSE
            if _measured(body) is None:
                twist, push = twist_of(q, rate), acceleration_of(q, rate, second)
            else:
                own = slice(at, at + TWIST)
                twist, push = velocity[:, own], acceleration[:, own]
                at += TWIST
            found.append(BodyMotion(body.name, q, twist, push))
        return found


def _measured(body: BodyMotion) -> Array | None:
    """Its twist where every sample has one."""
    return None if body.twist is None or np.isnan(body.twist).any() else body.twist
