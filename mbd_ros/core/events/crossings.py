"""Numbers whose zeros end a phase."""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY

_LINE = 1.0e-9  # of the size of points: so near to a line, they are on it


class Crossing(Protocol):
    """A number that has a zero.

    Attributes:
        reads: What it reads of k.
    """

    @property
    def reads(self) -> Reads:
        """See the attributes of the class."""

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """The number at a state of all joints.

        Args:
            k: Kinematics there, refreshed as far as `reads` says.
            x: The state.
            lam: Multipliers of all rows of the phase, shape (m,).
        """


class Combination(NamedTuple):
    """A sum of joint positions times factors, less a level [rad or m].

    Attributes:
        q: Indices of the joints in a configuration, shape (n,).
        factors: One a joint, shape (n,).
        at: The level.
    """

    q: NDArray[np.intp]
    factors: Array
    at: float
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        return float(self.factors.dot(x.q[self.q])) - self.at


class Gap(NamedTuple):
    """The least distance of the bodies of a contact [m].

    Attributes:
        contact: The contact.
    """

    contact: Any
    reads: Reads = Reads.POSITION

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        return float(self.contact.pair.gaps(k).min())


class Force(NamedTuple):
    """A sum of multipliers, less a level [N or N·m].

    Attributes:
        slots: Of the multipliers among those of the phase.
        at: The level.
    """

    slots: Sequence[int]
    at: float = 0.0
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        return sum(float(lam[i]) for i in self.slots) - self.at


class ConeRoom(NamedTuple):
    """What friction of a contact that is held has left before it slips [N].

        mu sum n - |sum t|

    Attributes:
        mu: Coefficient of friction, the smallest of its features.
        normals: Slots of the normal forces among the multipliers of the phase.
        tangents: Slots along either tangent.
    """

    mu: float
    normals: Sequence[int]
    tangents: tuple[Sequence[int], Sequence[int]]
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        n = sum(float(lam[i]) for i in self.normals)
        t = (sum(float(lam[i]) for i in each) for each in self.tangents)
        return self.mu * n - math.hypot(*t)


class Footing(NamedTuple):
    """How far the centre of pressure of a contact that is held is from the edge of its points [N].

        min over edges of sum n_i d_i / d,   d_i the distance of point i from the edge

    d is the size of the points. The sums do not depend on how points share the load. Source: P.
    Sardain, G. Bessonnet, IEEE Trans. Systems, Man, Cybernetics A 34, 2004, 630-637.

    Attributes:
        contact: The contact.
        normals: Slots of the normal forces among the multipliers of the phase, one a feature.
    """

    contact: Any
    normals: Sequence[int]
    reads: Reads = Reads.POSITION

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        n = lam[list(self.normals)]
        return min(float(n.dot(inside)) for inside in self.edges(k))

    def edges(self, k: Kinematics) -> list[Array]:
        """Distances d_i / d of the points from each edge, shape (n,) each."""
        places = self.contact.pair.places(k)
        away = places.point - places.point.mean(axis=0)
        return _inside(away.dot(places.axes[0][:, :2]))


def _inside(points: Array) -> list[Array]:
    """Distances of points in a plane from each edge of their hull, in sizes of it, shape (n,)."""
    _, sizes, ways = np.linalg.svd(points, full_matrices=False)
    along = points.dot(ways[0])
    size = float(np.ptp(along)) or 1.0
    if sizes[-1] <= _LINE * sizes[0]:  # on a line: its ends
        return [(along - along.min()) / size, (along.max() - along) / size]
    found = []
    for i, j in itertools.permutations(range(len(points)), 2):
        edge, from_i = points[j] - points[i], points - points[i]
        length = float(np.hypot(*edge))
        inside = (edge[0] * from_i[:, 1] - edge[1] * from_i[:, 0]) / max(length * size, TINY)
        if length > _LINE * size and (inside >= -_LINE).all():
            found.append(inside)
    return found


class Condition(NamedTuple):
    """Where a guard acts: a sum of joint positions times factors is above or below a level.

    Attributes:
        of: The sum, less the level.
        above: Whether it has to be positive; negative otherwise.
    """

    of: Combination
    above: bool

    def holds(self, x: State) -> bool:
        """Whether a guard acts at a state of all joints."""
        value = float(self.of.factors.dot(x.q[self.of.q])) - self.of.at
        return value > 0.0 if self.above else value < 0.0
