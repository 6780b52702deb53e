"""Force laws of compliant contact: normal forces by penetration, friction by slip or bristles.

Every law works on plain numbers of one contact feature.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple


class Slopes(NamedTuple):
    """Linearised stiffness and damping of a feature, which limit the time step.

    Attributes:
        stiffness: Derivative of the normal force by the penetration [N/m].
        damping: Derivative of the normal force by its rate [N·s/m].
        side_stiffness: Stiffness of bristles [N/m], 0 without bristles.
        side_damping: Derivative of friction by the slip velocity [N·s/m].
    """

    stiffness: float
    damping: float
    side_stiffness: float
    side_damping: float


class LinearNormal(NamedTuple):
    """Spring and damper: F = max(0, k d + c d') at a penetration d > 0.

    With damping, the force jumps at touchdown and vanishes before the bodies separate.

    Attributes:
        stiffness: Stiffness k [N/m].
        dissipation: Damping c [N·s/m].
    """

    stiffness: float
    dissipation: float

    def force(self, depth: float, approach: float) -> float:
        """Return the force [N] at a penetration > 0 [m] that grows at a rate [m/s]."""
        return max(self.stiffness * depth + self.dissipation * approach, 0.0)

    def energy(self, depth: float) -> float:
        """Return the stored energy [J]."""
        return 0.5 * self.stiffness * depth * depth

    def depth(self, force: float) -> float:
        """Return the static penetration under a force [m]."""
        return force / self.stiffness

    def least(self, force: float, depth: float) -> float:
        """Return the stiffness at which a force causes a static penetration [N/m]."""
        return force / depth

    def slopes(self, force: float, share: float) -> tuple[float, float]:
        """Return stiffness and damping at rest under a force, with the stiffness share * k."""
        return share * self.stiffness, self.dissipation


class HuntCrossleyNormal(NamedTuple):
    """Hunt-Crossley law: F = k d^p max(0, 1 + a d') at a penetration d > 0, continuous in d.

    Source: K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975), 440-445,
    doi:10.1115/1.3423596; their damping lambda is k a.

    Attributes:
        stiffness: Stiffness k [N/m^p].
        dissipation: Dissipation a [s/m]; a slow impact at v [m/s] has a coefficient of restitution
            of about 1 - 2/3 a v.
        exponent: Exponent p, 3/2 for Hertz contact of spheres.
    """

    stiffness: float
    dissipation: float
    exponent: float

    def force(self, depth: float, approach: float) -> float:
        """Return the force [N] at a penetration > 0 [m] that grows at a rate [m/s]."""
        damped: float = self.stiffness * depth**self.exponent * (1.0 + self.dissipation * approach)
        return max(damped, 0.0)

    def energy(self, depth: float) -> float:
        """Return the stored energy [J]."""
        power = self.exponent + 1.0
        energy: float = self.stiffness * depth**power / power
        return energy

    def depth(self, force: float) -> float:
        """Return the static penetration under a force [m]."""
        depth: float = (force / self.stiffness) ** (1.0 / self.exponent)
        return depth

    def least(self, force: float, depth: float) -> float:
        """Return the stiffness at which a force causes a static penetration [N/m^p]."""
        least: float = force / depth**self.exponent
        return least

    def slopes(self, force: float, share: float) -> tuple[float, float]:
        """Return stiffness and damping at rest under a force, with the stiffness share * k."""
        if force <= 0.0:
            return 0.0, 0.0
        depth = self.depth(force) * share ** (-1.0 / self.exponent)
        return self.exponent * force / depth, self.dissipation * force


class Creep(NamedTuple):
    """Smooth Coulomb friction, which reaches its limit mu F at a creep velocity c of the slip s.

        |f| = mu F (3 r - r^3) / 2,   r = |s| / c < 1,   else mu F

    Below its limit a contact creeps: to carry the fraction w of mu F it slips at about 2/3 w c,
    and never faster than c.

    Attributes:
        velocity: Creep velocity c [m/s].
    """

    velocity: float

    def force(
        self, z: Sequence[float], slip: Sequence[float], limit: float
    ) -> tuple[float, float]:
        """Return the friction [N] at a slip velocity [m/s], at most `limit` [N]; z is unused."""
        x, y = slip
        c = self.velocity
        size = math.hypot(x, y)
        ratio = size / c
        share = -limit / size if ratio >= 1.0 else -limit * (1.5 - 0.5 * ratio * ratio) / c
        return share * x, share * y

    def slopes(self, limit: float) -> tuple[float, float]:
        """Return stiffness and damping at zero slip [N/m, N·s/m], for a friction limit [N]."""
        return 0.0, 1.5 * limit / self.velocity


class Bristle(NamedTuple):
    """Friction by a bristle with spring and damper, whose tip sticks up to mu F and then slips.

        f = -(k z + c s),  z' = s            where |k z + c s| <= mu F: the tip sticks
        f = that direction times mu F, k z + c z' = -f       where it slips

    Below mu F the contact is elastic: unlike a LuGre bristle, it neither creeps under a constant
    load nor drifts under an oscillating one. It dissipates energy at any change of F. Without load
    the deflection decays as exp(-k t / c).

    Sources: Y. Gonthier, J. McPhee, C. Lange, J.-C. Piedboeuf, Multibody System Dynamics 11
    (2004), 209-233, doi:10.1023/B:MUBO.0000029392.21648.bc, on bristles in two directions; P.
    Dupont, V. Hayward, B. Armstrong, F. Altpeter, IEEE Trans. Automatic Control 47 (2002),
    787-792, doi:10.1109/TAC.2002.1000274, on the elastic range, which here is the whole of mu F.

    Attributes:
        stiffness: Stiffness k [N/m].
        damping: Damping c [N·s/m].
    """

    stiffness: float
    damping: float

    def force(
        self, z: Sequence[float], slip: Sequence[float], limit: float
    ) -> tuple[float, float]:
        """Return the friction [N] at a deflection z [m] and a slip [m/s], at most `limit` [N]."""
        x, y, _ = self._force_and_stick(z, slip, limit)
        return x, y

    def rate(self, z: Sequence[float], slip: Sequence[float], limit: float) -> tuple[float, float]:
        """Return the rate of the deflection [m/s]; arguments are those of `force`."""
        x, y, sticks = self._force_and_stick(z, slip, limit)
        if sticks:
            return slip[0], slip[1]
        return self.released((z[0] + x / self.stiffness, z[1] + y / self.stiffness))

    def released(self, z: Sequence[float]) -> tuple[float, float]:
        """Return the rate of the deflection of a free bristle [m/s]."""
        decay = -self.stiffness / self.damping
        return decay * z[0], decay * z[1]

    def energy(self, z: tuple[float, float]) -> float:
        """Return the stored energy [J]."""
        return 0.5 * self.stiffness * (z[0] * z[0] + z[1] * z[1])

    def slopes(self, limit: float) -> tuple[float, float]:
        """Return stiffness and damping while the tip sticks [N/m, N·s/m]."""
        return self.stiffness, self.damping

    def _force_and_stick(
        self, z: Sequence[float], slip: Sequence[float], limit: float
    ) -> tuple[float, float, bool]:
        """Return the friction, and whether the tip sticks."""
        x = -self.stiffness * z[0] - self.damping * slip[0]
        y = -self.stiffness * z[1] - self.damping * slip[1]
        size = math.hypot(x, y)
        if size <= limit:
            return x, y, True
        return x * limit / size, y * limit / size, False


NormalLaw = LinearNormal | HuntCrossleyNormal
FrictionLaw = Creep | Bristle
