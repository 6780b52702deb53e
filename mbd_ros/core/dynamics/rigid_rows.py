"""Rows of a mechanism that hold whatever multipliers that takes."""

from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.rows.characteristic_sizes import UsualSizes, usual_sizes
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.row_factor import RowFactor
from mbd_ros.core.state import Array, State


class RigidRows:
    """g(t, q) = 0 of all joints.

    Args:
        mechanism: The mechanism.
        constraints: The rows.
        sizes: What masses and rows usually are, where that is known.

    Attributes:
        constraints: As given.
        rows: One entry a row.
        sizes: What masses and rows usually are; None without rows.
        condition: Condition number of the rows in the mass metric when last factorised, for
            reports; 1 without rows.
    """

    def __init__(
        self, mechanism: Mechanism, constraints: ConstraintRows, sizes: UsualSizes | None = None
    ) -> None:
        self._mechanism, self.constraints = mechanism, constraints
        self.rows: tuple[Row, ...] = constraints.rows
        self._of_g, self._of_J = (
            min(constraints.reads, reads) for reads in (Reads.POSITION, Reads.JACOBIAN)
        )
        self.condition = 1.0
        self.sizes = sizes
        if sizes is None and self.rows:
            self.sizes = usual_sizes(mechanism.robot, self._at)
        self._usual = None if self.sizes is None else self.sizes.mobility

    def residual(self, t: float, q: Array) -> Array:
        """g(t, q), shape (m,); 0 for rows of velocities."""
        x = self._mechanism.placed(t, q, self._of_g)
        return self.constraints.residual(self._mechanism.k, x)

    def jacobian(self, t: float, q: Array) -> Array:
        """dg/dq, shape (m, nv), fresh."""
        x = self._mechanism.placed(t, q, self._of_J)
        return self.constraints.jacobian(self._mechanism.k, x)

    def rate(self, t: float, q: Array) -> Array:
        """dg/dt, shape (m,)."""
        return self.constraints.rate(self._mechanism.k, State(t, q, self._mechanism.zero))

    def factorise(self, M: Array, J: Array) -> RowFactor:
        """Factor of the rows; brings `condition` up to date.

        Args:
            M: Mass matrix, shape (nv, nv).
            J: Jacobian of the rows, shape (m, nv).
        """
        factor = RowFactor(M, J, self._usual)
        self.condition = factor.condition
        return factor

    def factor_at(self, t: float, q: Array) -> RowFactor:
        """Factor at a configuration of all joints; brings `condition` up to date."""
        J = self.jacobian(t, q)
        return self.factorise(self._mechanism.mass(q), J)

    def _at(self, q: Array) -> tuple[Array, Array]:
        return self._mechanism.mass(q), self.jacobian(0.0, q)
