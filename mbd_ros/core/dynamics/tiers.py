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
from mbd_ros.core.row_laws import Kind, Level
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.row_layout import RowBlock, RowLayout
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
    coupled: list[Constraint] = [CouplingRows(robot, couplings)] if couplings.dependent else []
    layout, nv = RowLayout([*coupled, *constraints]), robot.model.nv
    _refuse_unserved(layout.blocks)
    _check(tier, couplings, layout.rigid[len(coupled) :], layout.yielding)
    kept = [block for block in layout.of(Level.POSITION) if block.law.is_rigid]
    rows = ConstraintRows(kept, nv)
    if tier == "qp" and layout.blocks:
        every = ConstraintRows(layout.blocks, nv)
        return System(robot, loads, rows, BoundedRows(every, nv, backend), layout)
    acting = ConstraintRows(layout.yielding, nv)
    limits = BoundedRows(acting, nv, backend) if layout.yielding else None
    if len(layout.rigid) > len(coupled) or (tier == "kkt" and coupled):
        return BilateralSystem(robot, loads, rows, limits, layout)
    if coupled:
        mimics = mimic_model(robot, couplings)
        if mimics is not None:
            return MimicSystem(robot, loads, couplings, mimics, limits)
        return ReducedSystem(robot, loads, couplings, limits)
    return System(robot, loads, bounded=limits)


def _refuse_unserved(blocks: Sequence[RowBlock]) -> None:
    """Refuse laws that exist and that no solver serves."""
    for block in blocks:
        what = ""
        if block.law.kind is Kind.CONE:
            what = "has the law cone"
        elif block.law.restitution > 0.0:
            what = f"has restitution {block.law.restitution:g}"
        elif block.level is Level.VELOCITY and block.law.kind is not Kind.BOX:
            what = f"has the law {block.law.kind.value} on velocities"
        elif block.slips:
            what = "pushes along another direction than it holds"
        if what:
            raise ModelError(
                f"row {block.rows[0].name} {what}, which no solver serves; accepted: bilateral, "
                "drive, unilateral without restitution, and box, which serves velocities too"
            )


def _check(
    tier: str,
    couplings: Couplings,
    rigid: Sequence[RowBlock],
    yielding: Sequence[RowBlock],
) -> None:
    if tier not in TIERS:
        raise ModelError(f"unknown solver type '{tier}', accepted: {', '.join(TIERS)}")
    names = [row.name for block in (*rigid, *yielding) for row in block.rows]
    if tier == "aba" and (couplings.dependent or names):
        rows = ", ".join([*couplings.dependent, *names])
        raise ModelError(f"solver aba takes no rows, the scene has {rows}")
    if tier == "reduced" and (rigid or yielding):
        raise ModelError(f"solver reduced takes couplings only, the scene has {', '.join(names)}")
    if tier == "kkt" and yielding:
        rows = ", ".join(row.name for block in yielding for row in block.rows)
        raise ModelError(f"solver kkt takes no bounded rows, the scene has {rows}")


def tier_of(system: System) -> str:
    """Name of the tier that was chosen."""
    return system.tier if system.bounded is None else f"qp over {system.tier}"
