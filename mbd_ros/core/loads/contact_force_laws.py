"""Laws of contacts that give way: normal forces of a depth, friction of slip and of bristles.

Each works on plain numbers, of one feature at a time.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple


class Slopes(NamedTuple):
    """Slopes of the forces of a feature, for steps that have to follow them.

    Attributes:
        stiffness: Of the normal force by the depth [N/m].
        damping: Of the normal force by the approach [N·s/m].
        side_stiffness: Of bristles [N/m], 0 without.
        side_damping: Of friction by the slip [N·s/m].
    """

    stiffness: float
    damping: float
    side_stiffness: float
    side_damping: float


class LinearNormal(NamedTuple):
    """Spring and damper: F = max(0, k d + c d') at a depth d > 0.

    With a damper the force jumps where bodies touch, and it ends before they part.

    Attributes:
        stiffness: The k [N/m].
        dissipation: The c [N·s/m].
    """

    stiffness: float
    dissipation: float

    def force(self, depth: float, approach: float) -> float:
        """Force [N] at a depth > 0 [m] that grows at a rate [m/s]."""
        return max(self.stiffness * depth + self.dissipation * approach, 0.0)

    def energy(self, depth: float) -> float:
        """Stored energy [J]."""
        return 0.5 * self.stiffness * depth * depth

    def depth(self, force: float) -> float:
        """Depth at rest under a force [m]."""
        return force / self.stiffness

    def least(self, force: float, depth: float) -> float:
        """Stiffness at which a force goes no deeper [N/m]."""
        return force / depth

    def slopes(self, force: float, share: float) -> tuple[float, float]:
        """By depth and by approach, at rest under a force and with a multiple of k."""
        return share * self.stiffness, self.dissipation


class HuntCrossleyNormal(NamedTuple):
    """F = k d^p max(0, 1 + a d') at a depth d > 0: continuous where bodies touch and part.

    Source: K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975), 440-445,
    doi:10.1115/1.3423596; their damping lambda is k a.

    Attributes:
        stiffness: The k [N/m^p].
        dissipation: The a [s/m]. A slow impact at v [m/s] gives back about 1 - 2/3 a v of v.
        exponent: The p, 3/2 for the spheres of Hertz.
    """

    stiffness: float
    dissipation: float
    exponent: float

    def force(self, depth: float, approach: float) -> float:
        """Force [N] at a depth > 0 [m] that grows at a rate [m/s]."""
        damped: float = self.stiffness * depth**self.exponent * (1.0 + self.dissipation * approach)
        return max(damped, 0.0)

    def energy(self, depth: float) -> float:
        """Stored energy [J]."""
        power = self.exponent + 1.0
        energy: float = self.stiffness * depth**power / power
        return energy

    def depth(self, force: float) -> float:
        """Depth at rest under a force [m]."""
        depth: float = (force / self.stiffness) ** (1.0 / self.exponent)
        return depth

    def least(self, force: float, depth: float) -> float:
        """Stiffness at which a force goes no deeper [N/m^p]."""
        least: float = force / depth**self.exponent
        return least

    def slopes(self, force: float, share: float) -> tuple[float, float]:
        """By depth and by approach, at rest under a force and with a multiple of k."""
        if force <= 0.0:
            return 0.0, 0.0
        depth = self.depth(force) * share ** (-1.0 / self.exponent)
        return self.exponent * force / depth, self.dissipation * force


class Creep(NamedTuple):
    """Friction against the slip s that reaches mu F at a creep velocity c.

        |f| = mu F (3 r - r^3) / 2,   r = |s| / c < 1,   else mu F

    It is smooth, and below mu F it creeps: at a share w of mu F with about 2/3 w c, never faster
    than c.

    Attributes:
        velocity: The c [m/s].
    """

    velocity: float

    def force(
        self, z: Sequence[float], slip: Sequence[float], limit: float
    ) -> tuple[float, float]:
        """Force [N] of a slip [m/s], at most `limit` [N]; bristles z it has none."""
        x, y = slip
        c = self.velocity
        size = math.hypot(x, y)
        ratio = size / c
        share = -limit / size if ratio >= 1.0 else -limit * (1.5 - 0.5 * ratio * ratio) / c
        return share * x, share * y

    def slopes(self, limit: float) -> tuple[float, float]:
        """Stiffness and damping without slip [N/m, N·s/m], of friction up to a limit [N]."""
        return 0.0, 1.5 * limit / self.velocity


class Bristle(NamedTuple):
    """Friction by a bristle with spring and damper whose tip sticks up to mu F, then slips.

        f = -(k z + c s),  z' = s            where |k z + c s| <= mu F: the tip sticks
        f = that direction times mu F, k z + c z' = -f       where it slips

    Below mu F it is elastic: it does not creep under a constant load, nor walk under a load that
    swings below mu F, as a LuGre bristle does. It takes energy at any change of F. On a body
    without load it goes back to its rest, as exp(-k t / c).

    Sources: Y. Gonthier, J. McPhee, C. Lange, J.-C. Piedboeuf, Multibody System Dynamics 11
    (2004), 209-233, doi:10.1023/B:MUBO.0000029392.21648.bc, on bristles in two directions; P.
    Dupont, V. Hayward, B. Armstrong, F. Altpeter, IEEE Trans. Automatic Control 47 (2002),
    787-792, doi:10.1109/TAC.2002.1000274, on the elastic range, which here is the whole of mu F.

    Attributes:
        stiffness: The k [N/m].
        damping: The c [N·s/m].
    """

    stiffness: float
    damping: float

    def force(
        self, z: Sequence[float], slip: Sequence[float], limit: float
    ) -> tuple[float, float]:
        """Force [N] of a deflection [m] and a slip [m/s], at most `limit` [N]."""
        x, y, _ = self._held(z, slip, limit)
        return x, y

    def rate(self, z: Sequence[float], slip: Sequence[float], limit: float) -> tuple[float, float]:
        """Rate of the deflection [m/s]; arguments are those of `force`."""
        x, y, sticks = self._held(z, slip, limit)
        if sticks:
            return slip[0], slip[1]
        return self.released((z[0] + x / self.stiffness, z[1] + y / self.stiffness))

    def released(self, z: Sequence[float]) -> tuple[float, float]:
        """Rate of the deflection where nothing holds the tip [m/s]."""
        pace = -self.stiffness / self.damping
        return pace * z[0], pace * z[1]

    def energy(self, z: tuple[float, float]) -> float:
        """Stored energy [J]."""
        return 0.5 * self.stiffness * (z[0] * z[0] + z[1] * z[1])

    def slopes(self, limit: float) -> tuple[float, float]:
        """Stiffness and damping while the tip sticks [N/m, N·s/m]."""
        return self.stiffness, self.damping

    def _held(
        self, z: Sequence[float], slip: Sequence[float], limit: float
    ) -> tuple[float, float, bool]:
        """Force, and whether the tip sticks."""
        x = -self.stiffness * z[0] - self.damping * slip[0]
        y = -self.stiffness * z[1] - self.damping * slip[1]
        size = math.hypot(x, y)
        if size <= limit:
            return x, y, True
        return x * limit / size, y * limit / size, False


NormalLaw = LinearNormal | HuntCrossleyNormal
FrictionLaw = Creep | Bristle
