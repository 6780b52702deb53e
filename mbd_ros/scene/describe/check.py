"""The parts that a scene builds and leaves out, and the cost of a call."""

import math
import sys
import timeit
from collections.abc import Iterator
from functools import partial

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.mass_check import check_mass
from mbd_ros.core.dynamics.phase_queries import inward
from mbd_ros.core.dynamics.system import System, evaluation_at
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.integration.linear_motion import linear_motion, longest_step
from mbd_ros.core.inverse_dynamics.reach import listed
from mbd_ros.core.projection.assembly import assemble
from mbd_ros.core.rows.row_factor import RowFactor
from mbd_ros.core.state import State
from mbd_ros.core.thresholds import TOGGLE
from mbd_ros.errors import SolveError
from mbd_ros.scene.built_scene import DEFAULT_STABLE, Scene, Tell
from mbd_ros.scene.describe.part_lines import (
    line,
    member_lines,
    part_lines,
    type_name,
    unused_rubbing,
)
from mbd_ros.scene.describe.start_check import fiber_warnings, start_warnings

# What a call of the equations of a scene costs, measured.

_CALLS, _REPEATS = 2000, 5
MEASURED = 0.02  # s for which a call is timed, a few times over


def inverse_cost(scene: Scene, x: State) -> str:
    """Time of a call of inverse dynamics; empty where a motion does not show what it takes.

    Args:
        scene: The scene.
        x: Consistent state of all joints.
    """
    if scene.unmeasured:
        return ""
    return _loop_cost(scene, x) if scene.has_loops else _cost(scene)


def _cost(scene: Scene) -> str:
    robot, model = scene.robot, scene.robot.model
    q, v = pin.neutral(model), np.zeros(model.nv)
    bare = _best(partial(pin.rnea, model, pin.Data(model), q, v, v))
    inverse, loads = scene.inverse_dynamics(), [np.ones(6)] * len(scene.wrenches)
    z, w = q[scene.couplings.q_index], v[scene.couplings.v_index]
    ours = _best(lambda: inverse.solve(z, w, w, loads))
    ratio = f"{ours / bare:.1f} x a bare rnea of {len(robot.joints)} joints"
    return f"one inverse-dynamics call {ours * 1e6:.1f} us, {ratio}"


def _loop_cost(scene: Scene, x: State) -> str:
    drives = [section.key for section in scene.sections if "command" in section.offers]
    every = scene.without(drives).closed_loop()  # so that no fixed base is out of reach
    x, a = every.consistent(x, np.zeros(scene.robot.model.nv))
    call = (lambda: every.reach(x)) if scene.robot.floating else (lambda: every.solve(x, a))
    return f"one inverse-dynamics call {_best(call) * 1e6:.0f} us"


def forward_cost(scene: Scene, system: System, x: State) -> str:
    """Time of a call of forward dynamics.

    Args:
        scene: The scene.
        system: Its system.
        x: Consistent start of what it integrates.
    """
    model, given = system.model, scene.initial
    bare = _best(partial(pin.aba, model, pin.Data(model), given.q, given.v, np.zeros(model.nv)))
    y = x  # else in its mode
    if system.exact is not None:
        simulation = scene.simulation(solver={"type": "plain"})
        y = inward(simulation.system, simulation.start(given))
    ours = _best(evaluation_at(system, y))
    return f"one acceleration {ours * 1e6:.1f} us, {ours / bare:.1f} x a bare aba"


def _best(call: object) -> float:
    """Shortest time of a call [s], by as many calls as there is time for."""
    timer = timeit.Timer(call)  # type: ignore[arg-type]
    first = timer.timeit(1)
    if first >= MEASURED:
        return first
    calls = int(min(max(MEASURED / first, 1), _CALLS))
    return min(timer.repeat(_REPEATS, calls)) / calls


# Lines of `mbd-ros check` about the step: rates that are too fast, contacts too stiff for it.


def step_lines(scene: Scene, system: System, x: State) -> Iterator[str]:
    """Windows of contacts that give way, and warnings of a step that is too long.

    Args:
        scene: The scene.
        system: Its system.
        x: Consistent start of what it integrates.
    """
    yield from _windows(scene, system, x)
    motion, method = linear_motion(system, x), scene.integrator
    name = scene.default_integrator["type"]
    if method is not None:
        name = type_name(method)
    elif motion.rate * scene.dt > DEFAULT_STABLE:
        method = scene.method
    longest = math.inf if method is None else longest_step(method, motion, scene.dt)
    if not math.isfinite(motion.rate):
        yield line("warning", f"stiff: forces change too steeply for any step of {name}")
    elif longest < math.inf:
        limit = f"steps of {name} need dt < {longest:.2g} s, gauss_legendre does not"
        stiff = f"stiff: fastest rate {motion.rate:.3g} 1/s at dt {scene.dt:g} s"
        yield line("warning", f"{stiff}; {limit}")


def _windows(scene: Scene, system: System, x: State) -> Iterator[str]:
    parts = [part for part in scene.parts.get("contacts", ()) if hasattr(part, "slopes")]
    if not parts:
        return
    from mbd_ros.scene.describe.window_lines import (
        depth_doubts,
        window_doubts,
        window_text,
        windows_at,
    )

    method = scene.method
    start = system.expand(x)
    found = windows_at(system, parts, method, scene.dt, start)
    for window in found:
        yield line("window", window_text(window, method, scene.dt))
    for window in found:
        yield from (line("warning", text) for text in window_doubts(window, method, scene.dt))
    yield from (line("warning", text) for text in depth_doubts(system, parts, [start]))


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
