"""Rigid contact of two bodies with Coulomb friction."""

from collections.abc import Sequence
from typing import Annotated

from mbd_ros.core.contracts import Now, Value, Wrench
from mbd_ros.core.geometry.contact_outputs import ContactOutputs
from mbd_ros.core.geometry.contact_pair import contact_pair
from mbd_ros.core.geometry.shapes import Between
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Within
from mbd_ros.core.rows.constraint import Constraint, Row, cone
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class Rigid(Constraint):
    """Unilateral contact of two bodies with a friction cone at every contact feature.

        g >= 0,   normal >= 0,   g normal = 0                       (Signorini)
        |friction| <= mu normal, opposed to the slip where equal     (Coulomb)

    The multipliers act on body a: along the normal, which points out of b, then along two tangents
    of the contact frame. Friction is isotropic, with equal static and kinetic coefficients.
    Impacts have Poisson's restitution. Shapes and gaps are the subject of `core/geometry`.

    Args:
        between: Shapes of bodies a and b.
        friction: Friction coefficient mu, or one per feature.
        restitution: Poisson's coefficient of restitution, the ratio of the impulse of expansion to
            that of compression.
        margin: Distance at which surfaces count as touching.
        assemble: Whether bodies that overlap initially are separated, by the smallest displacement
            in the mass metric; otherwise such a start is refused.

    Attributes:
        pair: Geometry of the contact: gaps, frames and their derivatives.
        features: Names of the contact features.
        contact: Output quantities of the contact.
        assemble: Whether an initial overlap is removed.
        default_name: Name of the contact if its entry has none.

    Raises:
        ModelError: Bodies without relative motion, or a wrong number of friction coefficients.
    """

    smoothed = False
    example = {
        "between": [
            {"frame": "heel", "sphere": 0.02},
            {"half_space": [0, 0, 1], "xyz": [0, 0, -9]},
        ],
        "friction": 0.5,
        "margin": 0.001,
    }
    reads = Reads.DRIFT

    def __init__(
        self,
        robot: Robot,
        *,
        between: Between,
        friction: Annotated[NotNegative | Sequence[NotNegative], Unit("-")],
        restitution: Annotated[float, Within(0.0, 1.0), Unit("-")] = 0.0,
        margin: Annotated[NotNegative, Unit("m")] = 0.0,
        assemble: bool = False,
    ) -> None:
        self.assemble = assemble
        self.pair = contact_pair(robot, between, margin)
        self.features = self.pair.features
        if isinstance(friction, Sequence) and len(friction) != len(self.features):
            known = ", ".join(self.features)
            raise ModelError(f"friction: expected one number or {len(self.features)}: {known}")
        self.law = cone(friction, restitution)
        a, b = self.pair.points
        self.default_name = f"{a.frame if a.moves else b.frame}_contact"
        self.contact = ContactOutputs(robot, self.pair, friction)
        self.rows = tuple(Row(name, "N", between.b.frame) for name in self.contact.names)
        self.outputs = self.contact.outputs

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return (gap, 0, 0) of every feature [m], shape (3 n,); tangents restrict no position."""
        residual = k.zeros(len(self.rows))
        residual[::3] = self.pair.gaps(k)
        return residual

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the map from joint velocities to contact velocities of a, shape (3 n, nv)."""
        return self.pair.jacobian(k)

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return J' v, shape (3 n,)."""
        return self.pair.drift(k, x)

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return `jacobian` and `drift`, which share the contact points."""
        return self.pair.accelerations(k, x)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return gaps, contact states, and the wrench on a with its point."""
        return self.contact.values(k, now.lam.reshape(-1, 3))

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the wrenches on a and on b, at the centre of pressure."""
        return self.contact.wrenches(k, lam.reshape(-1, 3))
