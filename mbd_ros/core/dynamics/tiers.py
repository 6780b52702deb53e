"""The formulation ("tier") of a scene, chosen once while it is built."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mbd_ros.core.complementarity.bounded_rows import BoundedRows
from mbd_ros.core.dynamics.composed_system import ComposedSystem
from mbd_ros.core.dynamics.kkt import Kkt
from mbd_ros.core.dynamics.mechanism import Mechanism, RigidRows
from mbd_ros.core.dynamics.open_chain import Aba, Dense
from mbd_ros.core.dynamics.reduced import Mimic, Reduced, mimic_model
from mbd_ros.core.dynamics.system import FreeMotion, System
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Kind, Level
from mbd_ros.core.rows.constraint_rows import ConstraintRows, CouplingRows, RowBlock, RowLayout
from mbd_ros.core.rows.delassus import UsualSizes
from mbd_ros.errors import ModelError

if TYPE_CHECKING:
    from mbd_ros.core.contact_modes.event_rows import EventRows

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
    dense: as aba, where loads add inertia.
    qp: bounded rows on top of any of these; when asked for, all rows go through the QP.

    Args:
        constraints: Constraints of the scene.
        loads: Forces and actuators.
        tier: One of `TIERS`.
        backend: Solver of the QP, see `box_qp.BoxQp`.

    Raises:
        ModelError: The tier cannot serve these rows, or a package is missing.
    """
    coupled: list[Constraint] = [CouplingRows(robot, couplings)] if couplings.dependent else []
    layout = RowLayout([*coupled, *constraints])
    _refuse_unserved(layout.blocks)
    _check(tier, couplings, layout.rigid[len(coupled) :], layout.yielding)
    keeps_couplings = tier in ("kkt", "qp") or len(layout.rigid) > len(coupled)
    limited = layout.smoothed
    if tier == "qp":
        limited = tuple(b for b in layout.blocks if b.law.is_rigid or b.smoothed)
    parts = (*loads.actuators, *loads.forces, *constraints)
    plan = _Plan(robot, couplings, layout, Internals(parts), keeps_couplings, limited, backend)
    return plan.build(loads, (0.0, 0.0))


class _Plan:
    """The parts of a system that do not depend on loads and gains.

    Args:
        layout: All rows of the scene.
        internals: The internal states of all parts.
        keeps_couplings: Whether couplings are rows.
        limited: Blocks whose multipliers the QP finds.
    """

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        layout: RowLayout,
        internals: Internals,
        keeps_couplings: bool,
        limited: Sequence[RowBlock],
        backend: str,
    ) -> None:
        self._robot = robot
        self._couplings = couplings
        self._layout = layout
        self._internals = internals
        self._limited = tuple(limited)
        self._backend = backend
        self._rigid = layout.rigid if keeps_couplings else ()
        self._rigid_positions = tuple(
            block for block in self._rigid if block.level is Level.POSITION
        )
        self._is_reduced = bool(couplings.dependent) and not keeps_couplings
        self._mimics = mimic_model(robot, couplings) if self._is_reduced else None
        self._sizes: tuple[UsualSizes | None, ...] = (None, None)

    def build(self, loads: Loads, gains: tuple[float, float]) -> System:
        """Return the system under some loads, with kp [1/s^2] and kd [1/s] of rigid rows."""
        nv, blocks = self._robot.model.nv, self._limited
        mechanism = Mechanism(self._robot, loads)
        bilateral = rigid = RigidRows(
            mechanism, ConstraintRows(self._rigid_positions, nv, gains), self._sizes[0]
        )
        if self._rigid != self._rigid_positions:
            bilateral = RigidRows(
                mechanism, ConstraintRows(self._rigid, nv, gains), self._sizes[1]
            )
        self._sizes = rigid.sizes, bilateral.sizes
        acting = ConstraintRows(blocks, nv, gains)
        bounded = BoundedRows(acting, nv, self._backend) if blocks else None
        motion = self._motion(mechanism, bilateral)
        event_rows = self._event_rows(motion, gains)
        parts = rigid, bilateral, bounded, event_rows, self._layout, self._internals
        return ComposedSystem(motion, *parts, self.build)

    def _event_rows(self, motion: FreeMotion, gains: tuple[float, float]) -> "EventRows | None":
        blocks, nv = self._layout.event_rows, self._robot.model.nv
        if not blocks:
            return None
        from mbd_ros.core.contact_modes.event_rows import EventRows
        from mbd_ros.core.contact_modes.row_distances import stiff

        together = (*self._limited, *map(stiff, blocks))
        ordered = sorted(together, key=lambda block: block.slots.start)
        solver = BoundedRows(ConstraintRows(ordered, nv, gains), nv, self._backend)
        return EventRows(motion, solver)

    def _motion(self, mechanism: Mechanism, bilateral: RigidRows) -> FreeMotion:
        is_heavy = bool(mechanism.loads.heavy)
        if self._mimics is not None and not is_heavy:
            return Mimic(mechanism, self._couplings, self._mimics)
        if self._is_reduced:
            return Reduced(mechanism, self._couplings)
        is_solved = {block.slots.start for block in self._limited}
        if any(block.slots.start not in is_solved for block in self._rigid):
            if is_heavy:
                raise ModelError(_heavy_rows(mechanism.loads))
            return Kkt(mechanism, bilateral)
        return Dense(mechanism) if is_heavy else Aba(mechanism)


def _heavy_rows(loads: Loads) -> str:
    """Return why rigid rows and loads that add inertia do not go together."""
    names = ", ".join(load.name for load in loads.heavy)
    return (
        f"{names} adds inertia that changes with the posture, which no solver serves beside rigid "
        "rows; accepted: a learned model without structure (--variant free)"
    )


def _refuse_unserved(blocks: Sequence[RowBlock]) -> None:
    """Refuse laws that exist and that no solver serves."""
    for block in blocks:
        what, smoothed = "", block.smoothed and not block.law.is_rigid
        if smoothed and block.law.kind is Kind.CONE:
            what = "has the law cone and is smoothed"
        elif smoothed and block.law.restitution > 0.0:
            what = f"has restitution {block.law.restitution:g} and is smoothed"
        elif smoothed and block.level is Level.VELOCITY and block.law.kind is Kind.UNILATERAL:
            what = "has the law unilateral on velocities and is smoothed"
        elif block.slips:
            what = "pushes along another direction than it holds"
        elif not block.part.acts(()):
            what = "comes and goes with the mode"
        if what:
            raise ModelError(
                f"row {block.rows[0].name} {what}, which no solver serves; accepted: bilateral, "
                "drive, cone, unilateral (smoothed ones without restitution), and box, which "
                "serves velocities too"
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
    """Return the name of the tier that was chosen."""
    return system.tier if system.bounded is None else f"qp over {system.tier}"
