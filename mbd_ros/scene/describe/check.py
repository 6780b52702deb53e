"""The lines of `mbd-ros check`: what a scene builds and leaves out, doubts, and costs."""

from __future__ import annotations

import math
import sys
import timeit
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import repeat
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Part
from mbd_ros.core.dynamics.mass import check_mass
from mbd_ros.core.dynamics.system import System, evaluation_at, inward
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import RowLayout
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TOGGLE
from mbd_ros.errors import DivergedError, SolveError
from mbd_ros.methods.integration.stepping import BlockStepper
from mbd_ros.methods.inverse_dynamics.efforts import join_names
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.describe.scene_summary import inverse_tier
from mbd_ros.scene.describe.start_check import fiber_warnings, start_warnings
from mbd_ros.scene.describe.stiffness_windows import Line, step_lines
from mbd_ros.scene.reading.coupling_entries import coupling_kinds
from mbd_ros.scene.runs.simulation import Tell, build_simulation, default_integrator, integrator_of
from mbd_ros.scene.schema.sections import parts_in

MEASURED = 0.02  # s for which a call is timed, a few times over
_REPEATS = 5  # of which the shortest counts
_CALLS, _STEPS = 2000, 1000  # at most, in one repeat
SMOOTHED_ORDER = 2  # across a kink of the accelerations, of any method
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
        tell: Is told what takes time.

    Yields:
        One line each, label then text.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for label, text in _lines(scene, tell):
            yield line(label, text)


def _lines(scene: Scene, tell: Tell | None) -> Iterator[Line]:
    robot, couplings = scene.robot, scene.couplings
    gravity = np.array2string(robot.model.gravity.linear, separator=", ")
    yield "scene", scene.name
    yield from member_lines(scene)
    yield "gravity", f"{gravity} m/s^2, included in every torque"
    system = scene.system()
    if scene.phases:
        from mbd_ros.scene.phased_systems import build_phased_system

        phased = build_phased_system(scene)
        system = phased.systems[phased.first]
    fault = _mass_fault(scene, system)
    start, factor = _held_start(scene, system) if fault else _start(scene, system)
    if scene.integrator is not None:  # the default one takes every scene
        build_simulation(scene, solver=_PLAIN if scene.solver.compiles else None)
    freedom = system.nv - (0 if factor is None else factor.rank)
    yield "joints", f"{len(robot.joints)}, degrees of freedom {freedom}"
    yield "independent", ", ".join(couplings.independent) or "none"
    dependent = "; ".join(f"{name} <- {kind}" for name, kind in coupling_kinds(scene).items())
    yield "dependent", dependent or "none"
    if robot.locked:
        locked = ", ".join(f"{name} at {value:g}" for name, value in robot.locked.items())
        yield "locked", locked
    yield from part_lines(scene)
    if system.layout.yielding:
        yield from row_lines(scene, system.layout)
    for key, name in scene.code.items():
        file = sys.modules[name.partition(":")[0]].__file__
        yield "code", f"{key}: {name} from {file}"
    unmeasured = ", ".join(scene.unmeasured)
    if unmeasured:
        text = f"from columns of the forces of {unmeasured} alone, which has internal states"
        yield "inverse", text
    else:
        yield "inverse", inverse_tier(scene)
    if scene.has_loops and not unmeasured:
        yield from _reach(scene, system.expand(start))
    yield "forward", f"refused: {fault}" if fault else _forward(scene, system)
    if scene.solver.compiles:
        yield from compiled_lines(scene, not fault, tell)
    yield from (("warning", text) for text in robot.inertia_warnings)
    yield from _warnings(scene, system, start, factor)
    if not fault:
        yield from step_lines(scene, system, start)
    left_out = (*scene.absent, *unused_rubbing(scene), *robot.ignored)
    yield "left out", "; ".join(left_out) or "nothing"
    inverse = inverse_cost(scene, system.expand(start))
    forward = "" if fault else forward_cost(scene, system, start)
    yield "cost", "; ".join(filter(None, (inverse, forward)))


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
    x = scene.initial._replace(q=motion.assemble(scene.initial))
    return x, RowFactor(motion.metric(x.q), system.bilateral.jacobian(x.t, x.q))


def _start(scene: Scene, system: System) -> tuple[State, RowFactor | None]:
    """The assembled start and its rows; a mechanism that cannot be assembled is an error."""
    try:
        x = _settled(system, _apart(system, assemble(system, system.reduce(scene.initial))))
    except SolveError as error:
        raise SolveError(f"{scene.name}: {error}") from error
    a = system.evaluate(system.expand(x)).a
    if not np.isfinite(a).all():
        raise SolveError(f"{scene.name}: accelerations at the start are not finite: {a}")
    if not system.bilateral.rows:
        return x, None
    return x, system.bilateral.factor_at(x.t, x.q)


def _settled(system: System, y: State) -> State:
    if not system.internals.nz:
        return y
    from mbd_ros.core.dynamics.internal_dynamics import settled

    return settled(system, y, None)


def _apart(system: System, y: State) -> State:
    if not system.layout.cones:
        return y
    from mbd_ros.methods.projection.initial_state import resolve_overlaps

    return resolve_overlaps(system, y)


def _reach(scene: Scene, x: State) -> Iterator[Line]:
    """The reach of the actuators at the assembled start, for inverse dynamics."""
    reach = scene.closed_loop().reach(x)
    names = join_names(scene.actuated) or "none"
    reason = "" if scene.actuators else "; no actuators section: every independent joint"
    yield "actuated", f"{names}{reason}; {reach.driven} of {reach.freedom} motions driven"
    if reach.null_space:
        text = f"dimension {reach.null_space}: {join_names(reach.undetermined)}"
        yield "null space", f"{text} are not determined by a motion"
    if reach.undriven:
        joints = ", ".join(reach.undriven)
        text = f"nothing drives {joints}: inverse takes motions that need nothing there"
        yield "warning", text


def _forward(scene: Scene, system: System) -> str:
    """The tier, the method and the step."""
    rows = f", {len(system.bilateral.rows)} rows" if system.bilateral.rows else ""
    method = f"integrator {default_integrator(scene)['type']} by default"
    if scene.integrator is not None:
        method = type(scene.integrator).__name__
    text = f"{tier_of(system)}: {_TIERS[system.tier]}{rows}; {method}, dt {scene.dt:g} s"
    if system.bilateral.rows:
        correction = scene.stabilization
        title = "projection by default" if correction is None else type(correction).__name__
        text += f"; stabilization {title}"
    return text


def _warnings(scene: Scene, system: System, x: State, factor: RowFactor | None) -> Iterator[Line]:
    for text in start_warnings(scene.robot, scene.constraints, scene.initial):
        yield "warning", text
    for text in fiber_warnings(scene.robot, scene.muscles, scene.initial, scene.inputs.safe):
        yield "warning", text
    floor = getattr(scene.stabilization, "floor", None)
    if (
        system.bilateral.rows
        and floor is not None
        and floor(scene.dt) > scene.stabilization.time_constant
    ):
        used = f"time constant {scene.stabilization.time_constant:g} s raised to 2 dt"
        yield "warning", f"Baumgarte: {used} = {floor(scene.dt):g} s"
    if factor is not None:
        yield from _rank_lines(factor)
    driven = [scene.robot.joint(name) for part in scene.actuators for name in part.joints]
    without = [joint.name for joint in driven if joint.max_effort == 0.0]
    if without:
        yield "warning", f"no authority: effort limit 0 of {', '.join(without)}"


def _rank_lines(factor: RowFactor) -> Iterator[Line]:
    """How many of the rows are independent, and how well conditioned they are."""
    rows = len(factor.A)
    if factor.rank < rows:
        text = f"rank {factor.rank} of {rows} rows: redundant, multipliers of smallest norm"
        yield "rank", text
        return
    yield "rank", f"{rows} of {rows} rows, condition number {factor.condition:.2g}"
    if factor.condition > TOGGLE:
        yield "warning", "near a toggle position: multipliers are unreliable here"


def line(label: str, text: str) -> str:
    """A line of `check`."""
    return f"{label:<12}{text}"


def part_lines(scene: Scene) -> Iterator[Line]:
    """A line for every part whose section has a text: loads, then rows; then their states."""
    for section in sorted(scene.sections, key=lambda section: "residual" in section.offers):
        if section.check and section.key in scene.parts:
            label, _, text = section.check.partition(":")
            built = scene.parts[section.key]
            keys = built if isinstance(built, Mapping) else repeat("")
            for key, part in zip(keys, parts_in(section, built), strict=False):
                words = {"name": key, **_words(part)}
                yield (label, text.strip().format(part=part, **words))
    yield from _state_lines(scene.internals, scene.initial.z)


def _words(part: Any) -> dict[str, str]:
    """Words for a part that texts of sections may use."""
    where = getattr(part, "joints", None) or [getattr(part, "joint", None)]
    names = ", ".join(str(getattr(joint, "name", joint)) for joint in where if joint)
    words = {"kind": type(part).__name__, "at": f" at {names}" if names else ""}
    words |= {"rows": "", "law": "", "contact": ""}
    if hasattr(part, "pair") and hasattr(part, "features"):
        words["contact"] = contact_words(part)
    if isinstance(part, Part):
        words["name"] = part.name
    if hasattr(part, "rows"):
        words["rows"] = ", ".join(f"{row.name} [{row.unit}]" for row in part.rows)
        words["law"] = part.law.kind.value
    return words


def _state_lines(internals: Internals, z: Array) -> Iterator[Line]:
    """A line for every internal state.

    Args:
        internals: Of the scene.
        z: First values, NaN for those that the parts choose.
    """
    for i, first in enumerate(internals.completed(z).tolist()):
        bounds = (internals.lower[i], internals.upper[i])
        unit = f" [{internals.units[i]}]" if internals.units[i] else ""
        text = "starts at equilibrium" if math.isnan(first) else f"starts at {first:g}"
        inside = f", in {bounds[0]:g} .. {bounds[1]:g}" if np.isfinite(bounds).any() else ""
        yield "state", f"{internals.names[i]}{unit}, {text}{inside}"


def member_lines(scene: Scene) -> Iterator[Line]:
    """The robots and the other bodies."""
    robot, bodies = scene.robot, scene.parts.get("bodies", {})
    if len(robot.model_sources) == 1 and not robot.model_sources[0].name:
        yield "robot", f"{robot.name} from {scene.source}, {robot.base_text}"
        return
    for model_source in robot.model_sources:
        if model_source.name in bodies:
            how = "free" if model_source.base == "floating" else "placed"
            yield "body", f"{model_source.name} from {model_source.source}, {how}"
        else:
            name = f"{model_source.name} from " if model_source.name else ""
            yield "robot", f"{name}{model_source.source}, {model_source.base} base"


def row_lines(scene: Scene, layout: RowLayout) -> Iterator[Line]:
    """A line for exact rows and one for smoothed ones, where there are any.

    Methods at the velocity level solve for both alike.

    Source: E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 1993,
    II.6, on the order of steps across discontinuities.

    Args:
        layout: Its rows, some of which give way.
    """
    method = integrator_of(scene)
    name, order = type(method).__name__, method.order
    if method.at_velocity_level:
        names = join_names([block.part.name for block in layout.yielding])
        yield "stepped", f"{names}; solved for once a step of {name}, impacts included"
        return
    exact, smoothed = (
        [block.part.name for block in layout.yielding if block.smoothed is is_smoothed]
        for is_smoothed in (False, True)
    )
    if exact:
        text = "steps end where rows begin and cease to act"
        yield "exact", f"{join_names(exact)}; {text}, {name} keeps its order {order}"
    if smoothed:
        where = "in steps in which a row begins or ceases to act"
        cost = f"{name} has order {SMOOTHED_ORDER} in place of {order} {where}"
        if order <= SMOOTHED_ORDER:
            cost = f"{name} has order {order} all the same"
        yield "smoothed", f"{join_names(smoothed)}; solved for in every evaluation, {cost}"


def contact_words(part: Any) -> str:
    """Bodies and features, and whether events of a rigid contact can be found."""
    a, b = part.pair.between
    count = f"{len(part.features)} features: " if len(part.features) > 1 else ""
    text = f"between {a.frame} and {b.frame}, {count}{join_names(part.features)}"
    law = getattr(part, "law", None)
    if law is None or law.kind is not Kind.CONE:
        return text
    if part.pair.is_smooth:
        return f"{text}; smooth, for event-driven integrators and moreau_jean"
    return f"{text}; for moreau_jean, not event-driven: {part.pair.why_not}"


def compiled_lines(scene: Scene, has_start: bool, tell: Tell | None = None) -> Iterator[Line]:
    """Yield lines on compiled steps of a scene that asks for them, and their cost.

    Args:
        has_start: Whether it has a start from which steps can be taken.
        tell: Is told what takes time.

    Raises:
        SceneError: It demands compiled steps and cannot have them.
    """
    simulation = build_simulation(scene, tell=tell)
    is_compiled = isinstance(simulation.stepper, BlockStepper)
    text = simulation.how.partition(": ")[2]
    if is_compiled and has_start:
        text += step_costs(scene, simulation)
    yield "compiled", text if is_compiled else f"not: {text}"


def unused_rubbing(scene: Scene) -> Iterator[str]:
    """Friction and damping of the description that no part of the scene brings in."""
    covered: set[tuple[str, str]] = set()
    for part in (*scene.forces, *scene.constraints):
        joint = getattr(getattr(part, "joint", None), "name", None)
        covered.update((key, joint) for key in getattr(part, "brings", ()) if joint)
    for key in ("friction", "damping"):
        names = [n for n, rub in scene.robot.joint_friction.items() if getattr(rub, key)]
        lacking = [name for name in names if (key, name) not in covered]
        if lacking:
            yield f"URDF <dynamics> {key} of {', '.join(lacking)}"


def forward_cost(scene: Scene, system: System, x: State) -> str:
    """Time of a call of forward dynamics.

    Args:
        x: Consistent start of what it integrates.
    """
    model, entry = system.model, scene.initial
    bare = _best(partial(pin.aba, model, pin.Data(model), entry.q, entry.v, np.zeros(model.nv)))
    y = x  # else in its mode
    if system.event_rows is not None:
        simulation = build_simulation(scene, solver=_PLAIN)
        y = inward(simulation.system, simulation.start(entry))
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


def inverse_cost(scene: Scene, x: State) -> str:
    """Time of a call of inverse dynamics; empty where a motion does not show what it takes.

    Args:
        x: Consistent state of all joints.
    """
    if scene.unmeasured:
        return ""
    return _loop_cost(scene, x) if scene.has_loops else _open_chain_cost(scene)


def _loop_cost(scene: Scene, x: State) -> str:
    drives = [section.key for section in scene.sections if "command" in section.offers]
    every = scene.without(drives).closed_loop()  # so that no fixed base is out of reach
    x, a = every.project_motion(x, np.zeros(scene.robot.model.nv))
    call = (lambda: every.reach(x)) if scene.robot.floating else (lambda: every.solve(x, a))
    return f"one inverse-dynamics call {_best(call) * 1e6:.0f} us"


def _open_chain_cost(scene: Scene) -> str:
    robot, model = scene.robot, scene.robot.model
    q, v = pin.neutral(model), np.zeros(model.nv)
    bare = _best(partial(pin.rnea, model, pin.Data(model), q, v, v))
    inverse, loads = scene.inverse_dynamics(), [np.ones(6)] * len(scene.wrenches)
    z, w = q[scene.couplings.q_index], v[scene.couplings.v_index]
    ours = _best(lambda: inverse.solve(z, w, w, loads))
    ratio = f"{ours / bare:.1f} x a bare rnea of {len(robot.joints)} joints"
    return f"one inverse-dynamics call {ours * 1e6:.1f} us, {ratio}"


def step_costs(scene: Scene, simulation: Simulation) -> str:
    """Times of a step, empty where the first one fails."""
    plain = build_simulation(scene, solver=_PLAIN)
    try:
        ours, theirs = _step_time(simulation, scene), _step_time(plain, scene)
    except (DivergedError, SolveError):
        return ""
    if isinstance(simulation.stepper, BlockStepper) and simulation.stepper.plain_steps:
        return "; plain steps at the start, where rows are near dependence"
    name = plain.integrator.title
    return f"; one step of {name} {ours * 1e6:.2g} us, plain {theirs * 1e6:.3g} us"


def _step_time(simulation: Simulation, scene: Scene) -> float:
    """Shortest time of a step from the start on, with its corrections [s]."""
    y = simulation.start(scene.initial)
    u, stepper = simulation.system.loads.sources.hold(y.t), simulation.stepper
    if isinstance(stepper, BlockStepper):
        return _shortest(lambda: stepper.stride(y, u, math.inf, _STEPS)[1])
    return _shortest(lambda: _advanced(simulation, y, u))


def _shortest(steps: Callable[[], int]) -> float:
    """Time of one of the steps that a function takes and counts [s]."""
    times = []
    for _ in range(_REPEATS):
        begin = timeit.default_timer()
        count = steps()
        times.append((timeit.default_timer() - begin) / max(count, 1))
    return min(times)


def _advanced(simulation: Simulation, y: State, u: Array | None) -> int:
    """Number of steps to the next sample."""
    before = simulation.steps
    simulation.advance(y, u, y.t + simulation.dt)
    return simulation.steps - before
