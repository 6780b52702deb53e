"""The parts that a scene builds and leaves out, and the cost of a call."""

import sys
from collections.abc import Iterator

import numpy as np

from mbd_ros.core.dynamics.mass_check import check_mass
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.inverse_dynamics.reach import listed
from mbd_ros.core.projection.assembly import assemble
from mbd_ros.core.rows.row_factor import RowFactor
from mbd_ros.core.state import State
from mbd_ros.core.thresholds import TOGGLE
from mbd_ros.errors import SolveError
from mbd_ros.scene.built_scene import Scene, Tell
from mbd_ros.scene.describe.call_costs import forward_cost, inverse_cost
from mbd_ros.scene.describe.part_lines import (
    line,
    member_lines,
    part_lines,
    type_name,
    unused_rubbing,
)
from mbd_ros.scene.describe.start_check import fiber_warnings, start_warnings
from mbd_ros.scene.describe.step_lines import step_lines

_PLAIN = {"type": "plain"}
_TIERS = {
    "aba": "open chain, articulated-body algorithm",
    "reduced": "couplings eliminated exactly, q = F(z)",
    "dense": "open chain, factorised mass matrix, since a force adds inertia",
    "kkt": "bilateral rows, one factorised solve",
}


def describe(scene: Scene, tell: Tell | None = None) -> Iterator[str]:
    """The lines of `mbd-ros check`.

    Args:
        scene: A built scene.
        tell: Is told what takes time.

    Yields:
        One line each, label then text.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        yield from _lines(scene, tell)


def _lines(scene: Scene, tell: Tell | None) -> Iterator[str]:
    robot, couplings = scene.robot, scene.couplings
    gravity = np.array2string(robot.model.gravity.linear, separator=", ")
    yield line("scene", scene.name)
    yield from member_lines(scene)
    yield line("gravity", f"{gravity} m/s^2, included in every torque")
    system = scene.system()
    if scene.phases:
        phased = scene.phased_system()
        system = phased.systems[phased.first]
    fault = _mass_fault(scene, system)
    start, factor = _held_start(scene, system) if fault else _start(scene, system)
    if scene.integrator is not None:  # the default one takes every scene
        scene.simulation(solver=_PLAIN if scene.solver.compiles else None)
    freedom = system.nv - (0 if factor is None else factor.rank)
    yield line("joints", f"{len(robot.joints)}, degrees of freedom {freedom}")
    yield line("independent", ", ".join(couplings.independent) or "none")
    dependent = "; ".join(f"{name} <- {kind}" for name, kind in scene.coupling_kinds.items())
    yield line("dependent", dependent or "none")
    if robot.locked:
        locked = ", ".join(f"{name} at {value:g}" for name, value in robot.locked.items())
        yield line("locked", locked)
    yield from part_lines(scene)
    yield from _row_lines(scene, system)
    for key, name in scene.code.items():
        file = sys.modules[name.partition(":")[0]].__file__
        yield line("code", f"{key}: {name} from {file}")
    yield line("inverse", _inverse(scene))
    if scene.has_loops and not scene.unmeasured:
        yield from _reach(scene, system.expand(start))
    yield line("forward", f"refused: {fault}" if fault else _forward(scene, system))
    if scene.solver.compiles:
        from mbd_ros.scene.describe.compiled_lines import compiled_lines

        yield from compiled_lines(scene, not fault, tell)
    yield from (line("warning", text) for text in robot.doubts)
    yield from _warnings(scene, system, start, factor)
    if not fault:
        yield from step_lines(scene, system, start)
    left_out = (*scene.absent, *unused_rubbing(scene), *robot.ignored)
    yield line("left out", "; ".join(left_out) or "nothing")
    inverse = inverse_cost(scene, system.expand(start))
    forward = "" if fault else forward_cost(scene, system, start)
    yield line("cost", "; ".join(filter(None, (inverse, forward))))


def _row_lines(scene: Scene, system: System) -> Iterator[str]:
    if system.layout.yielding:
        from mbd_ros.scene.describe.row_lines import row_lines

        yield from row_lines(scene, system.layout)


def _forward(scene: Scene, system: System) -> str:
    """The tier, the method and the step."""
    rows = f", {len(system.held.rows)} rows" if system.held.rows else ""
    method = "integrator" if scene.integrator is None else type(scene.integrator).__name__
    default = f" {scene.default_integrator['type']} by default" if scene.integrator is None else ""
    text = f"{tier_of(system)}: {_TIERS[system.tier]}{rows}; {method}{default}, dt {scene.dt:g} s"
    if system.held.rows:
        kept = scene.stabilization
        text += f"; stabilization {'projection by default' if kept is None else type_name(kept)}"
    return text


def _warnings(scene: Scene, system: System, x: State, factor: RowFactor | None) -> Iterator[str]:
    for text in start_warnings(scene.robot, scene.constraints, scene.initial):
        yield line("warning", text)
    for text in fiber_warnings(scene.robot, scene.muscles, scene.initial, scene.inputs.safe):
        yield line("warning", text)
    floor = getattr(scene.stabilization, "floor", None)
    if (
        system.held.rows
        and floor is not None
        and floor(scene.dt) > scene.stabilization.time_constant
    ):
        used = f"time constant {scene.stabilization.time_constant:g} s raised to 2 dt"
        yield line("warning", f"Baumgarte: {used} = {floor(scene.dt):g} s")
    if factor is not None:
        yield from _rank_lines(factor)
    driven = [scene.robot.joint(name) for part in scene.actuators for name in part.joints]
    without = [joint.name for joint in driven if joint.max_effort == 0.0]
    if without:
        yield line("warning", f"no authority: effort limit 0 of {', '.join(without)}")


def _mass_fault(scene: Scene, system: System) -> str:
    """Why forward dynamics has no answer at the start, empty where it has one."""
    try:
        check_mass(system, system.reduce(scene.initial).q)
    except SolveError as error:
        return str(error)
    return ""


def _held_start(scene: Scene, system: System) -> tuple[State, RowFactor | None]:
    """Start of a scene for inverse dynamics only, and its rows in a metric that has one."""
    if not scene.has_loops:
        return system.reduce(scene.initial), None
    motion = scene.closed_loop().motion
    x = scene.initial._replace(q=motion.start(scene.initial))
    return x, RowFactor(motion.metric(x.q), system.held.jacobian(x.t, x.q))


def _start(scene: Scene, system: System) -> tuple[State, RowFactor | None]:
    """The assembled start and its rows; a mechanism that cannot be assembled is an error."""
    try:
        x = _settled(system, _apart(system, assemble(system, system.reduce(scene.initial))))
    except SolveError as error:
        raise SolveError(f"{scene.name}: {error}") from error
    a = system.evaluate(system.expand(x)).a
    if not np.isfinite(a).all():
        raise SolveError(f"{scene.name}: accelerations at the start are not finite: {a}")
    if not system.held.rows:
        return x, None
    return x, system.held.factor_at(x.t, x.q)


def _apart(system: System, y: State) -> State:
    if not system.layout.cones:
        return y
    from mbd_ros.core.projection.overlap import without_overlap

    return without_overlap(system, y)


def _settled(system: System, y: State) -> State:
    if not system.internals.nz:
        return y
    from mbd_ros.core.dynamics.equilibrium import settled

    return settled(system, y, None)


def _rank_lines(factor: RowFactor) -> Iterator[str]:
    """How many of the rows are independent, and how well conditioned they are."""
    rows = len(factor.A)
    if factor.rank < rows:
        text = f"rank {factor.rank} of {rows} rows: redundant, multipliers of smallest norm"
        yield line("rank", text)
        return
    yield line("rank", f"{rows} of {rows} rows, condition number {factor.condition:.2g}")
    if factor.condition > TOGGLE:
        yield line("warning", "near a toggle position: multipliers are unreliable here")


def tier(scene: Scene) -> str:
    """How inverse dynamics is solved."""
    if scene.has_loops:
        return "loops: efforts and multipliers by rank, of smallest norm where undetermined"
    if not scene.couplings.dependent:
        return "rnea: no dependent joint, one call"
    return "reduced: dependent joints eliminated exactly, q = F(z)"


def _reach(scene: Scene, x: State) -> Iterator[str]:
    """The reach of the actuators at the assembled start, for inverse dynamics."""
    reach = scene.closed_loop().reach(x)
    names = listed(scene.actuated) or "none"
    reason = "" if scene.actuators else "; no actuators section: every independent joint"
    yield line("actuated", f"{names}{reason}; {reach.driven} of {reach.freedom} motions driven")
    if reach.null_space:
        text = f"dimension {reach.null_space}: {listed(reach.undetermined)}"
        yield line("null space", f"{text} are not determined by a motion")
    if reach.undriven:
        joints = ", ".join(reach.undriven)
        text = f"nothing drives {joints}: inverse takes motions that need nothing there"
        yield line("warning", text)


def _inverse(scene: Scene) -> str:
    parts = ", ".join(scene.unmeasured)
    if parts:
        return f"from columns of the forces of {parts} alone, which has internal states"
    return tier(scene)
