"""Bodies that never overlap, with dry friction where they touch."""

from collections.abc import Sequence
from typing import Annotated

from mbd_ros.core.contracts import Now, Value, Wrench
from mbd_ros.core.geometry.contact_outputs import ContactShow
from mbd_ros.core.geometry.contact_pair import contact_pair
from mbd_ros.core.geometry.shapes import Between
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Within
from mbd_ros.core.rows.constraint import Constraint, Row, cone
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class Rigid(Constraint):
    """Contact of two bodies: Signorini and Coulomb, one cone a feature.

        g >= 0,   normal >= 0,   |friction| <= mu normal, against the slip

    Multipliers push a, along the normal out of b, then along two tangents of the contact frame.
    Friction is isotropic, static and kinetic friction are the same. An impact gives back a share
    of its compression. What bodies look like is the subject of `core/geometry`.

    Args:
        between: Shapes of a and of b.
        friction: Coefficient mu, or one a feature.
        restitution: Share of the impulse of a compression that its expansion gives back.
        margin: Distance at which surfaces count as touching.
        assemble: Whether bodies that overlap at the start are lifted out of one another, each the
            least by its mass; otherwise such a start is refused.

    Attributes:
        pair: Gaps, frames and their derivatives.
        features: Names of its slots.
        contact: What it shows.
        assemble: As given.
        default_name: What it is called where nobody names it.

    Raises:
        ModelError: Bodies that do not move against each other, or friction of another number of
            features.
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
        self.contact = ContactShow(robot, self.pair, friction)
        self.rows = tuple(Row(name, "N", between.b.frame) for name in self.contact.names)
        self.outputs = self.contact.outputs

    def residual(self, k: Kinematics, x: State) -> Array:
        """Gaps [m], each before two zeros: along tangents any place will do, shape (3 n,)."""
        residual = k.zeros(len(self.rows))
        residual[::3] = self.pair.gaps(k)
        return residual

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """From joint velocities to those of a past b in the contact frames, shape (3 n, nv)."""
        return self.pair.jacobian(k)

    def drift(self, k: Kinematics, x: State) -> Array:
        """J' v, shape (3 n,)."""
        return self.pair.drift(k, x)

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Both `jacobian` and `drift`, for the places of one."""
        return self.pair.accelerations(k, x)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Gaps, states, what a feels, and where."""
        return self.contact.values(k, now.lam.reshape(-1, 3))

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """The wrenches on a and on b, at the centre of pressure."""
        return self.contact.wrenches(k, lam.reshape(-1, 3))
