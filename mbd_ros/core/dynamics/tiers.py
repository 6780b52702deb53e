"""The tier of a scene: how it is solved, chosen once, while building."""

from collections.abc import Sequence

from mbd_ros.core.dynamics.bilateral_system import BilateralSystem
from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.dynamics.mimic_system import MimicSystem, mimic_model
from mbd_ros.core.dynamics.reduced_system import ReducedSystem
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.bounded_rows import BoundedRows
from mbd_ros.core.parts import Constraint
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.row_order import RowOrder
from mbd_ros.errors import ModelError

TIERS = ("auto", "aba", "reduced", "kkt", "qp")


def build_system(
    robot: Robot,
    couplings: Couplings,
    constraints: Sequence[Constraint],
    loads: Loads,
    tier: str = "auto",
    backend: str = "proxqp",
) -> System:
    """The system of a scene in the cheapest tier that serves, or in the one that is asked for.

    aba: no rows. reduced: couplings only, eliminated. kkt: bilateral rows, couplings among them.
    qp: bounded rows on top of any of these; when asked for, all rows go through the QP.

    Args:
        robot: The robot.
        couplings: Its dependent joints.
        constraints: Constraints of the scene.
        loads: Forces and actuators.
        tier: One of `TIERS`.
        backend: Solver of the QP, see `box_qp.BoxQp`.

    Raises:
        ModelError: The tier cannot serve these rows, or a package is missing.
    """
    bilateral = [part for part in constraints if part.law.is_rigid]
    bounded = [part for part in constraints if not part.law.is_rigid]
    _check(tier, couplings, bilateral, bounded)
    nv = robot.model.nv
    coupled: list[Constraint] = [CouplingRows(robot, couplings)] if couplings.dependent else []
    order = RowOrder([*coupled, *constraints])
    rows = ConstraintRows([*coupled, *bilateral], nv, order.bilateral_rows)
    if tier == "qp" and (coupled or constraints):
        every = ConstraintRows([*coupled, *constraints], nv, order.rows)
        return System(robot, loads, rows, BoundedRows(every, nv, backend), order)
    acting = ConstraintRows(bounded, nv, order.bounded_rows)
    limits = BoundedRows(acting, nv, backend) if bounded else None
    if bilateral or (tier == "kkt" and coupled):
        return BilateralSystem(robot, loads, rows, limits, order)
    if coupled:
        mimics = mimic_model(robot, couplings)
        if mimics is not None:
            return MimicSystem(robot, loads, couplings, mimics, limits)
        return ReducedSystem(robot, loads, couplings, limits)
    return System(robot, loads, bounded=limits)


def _check(
    tier: str,
    couplings: Couplings,
    bilateral: Sequence[Constraint],
    bounded: Sequence[Constraint],
) -> None:
    if tier not in TIERS:
        raise ModelError(f"unknown solver type '{tier}', accepted: {', '.join(TIERS)}")
    names = [row.name for part in (*bilateral, *bounded) for row in part.rows]
    if tier == "aba" and (couplings.dependent or names):
        rows = ", ".join([*couplings.dependent, *names])
        raise ModelError(f"solver aba takes no rows, the scene has {rows}")
    if tier == "reduced" and (bilateral or bounded):
        raise ModelError(f"solver reduced takes couplings only, the scene has {', '.join(names)}")
    if tier == "kkt" and bounded:
        rows = ", ".join(row.name for part in bounded for row in part.rows)
        raise ModelError(f"solver kkt takes no bounded rows, the scene has {rows}")


def tier_of(system: System) -> str:
    """Name of the tier that was chosen."""
    return system.tier if system.bounded is None else f"qp over {system.tier}"
