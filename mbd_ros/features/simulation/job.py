"""Forward simulation of a scene: `mbd-ros simulate`."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.complementarity.contact_problem import Residuals
from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.system import phase_names
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.ranges import SHORTEST_DT
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SAME_TIME, TOGGLE
from mbd_ros.errors import FAILED, INTERRUPTED, DataError, DivergedError, MbdError, SolveError
from mbd_ros.features.simulation.checks import (
    residual_line,
    step_warnings,
    window_lines,
    with_residuals,
)
from mbd_ros.features.simulation.events import EVENTS, event_table
from mbd_ros.features.simulation.run import (
    Run,
    check_run,
    check_stamps,
    initial_state,
    options_of,
    read_inputs,
)
from mbd_ros.files.formats import FOLDER, format_of, suffix_of
from mbd_ros.files.table import MAIN, TIME, Result, Table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, announce, watching
from mbd_ros.jobs.progress import progress as shown
from mbd_ros.methods.integration.stepping import BlockStepper
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.motion.recordings import Source, metadata_of
from mbd_ros.motion.state_table import BALANCE, table_of, topics_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.describe.start_check import fiber_warnings, start_warnings
from mbd_ros.scene.runs.simulation import build_simulation

_UNCOMPILED = "compiled steps take no rows near dependence, and no states that are not finite"


def simulate(
    scene: Scene,
    duration: float,
    *,
    start: float = 0.0,
    origin: Source | None = None,
    efforts: Source | None = None,
    wrenches: Source | None = None,
    dt: float | None = None,
    integrator: str | Mapping[str, Any] | None = None,
    tolerance: float | None = None,
    solver: str | Mapping[str, str] | None = None,
    say: Say | None = None,
    progress: Watch = False,
) -> Result:
    """Simulate a scene: its motion, constraint forces, energy and constraint violations.

    Ctrl-C returns the motion so far, with the reason in `metadata["ended"]`.

    Args:
        duration: Simulated time [s].
        start: Time at which the simulation starts [s].
        origin: Result, table or bag with the initial joint state at `start`, in place of that of
            the scene.
        efforts: Result, table or bag of the inputs: `<actuator>.command` or `<joint>.effort`.
        wrenches: Result, table or bag of the external loads of the scene.
        dt: Step of a fixed-step method, and interval of the output [s]. By default that of the
            scene.
        integrator: Integrator in place of that of the scene: its type, or from Python an entry.
        tolerance: Tolerance of the integrator: the largest error of a step of dopri5, dop853 and
            filippov, or that of Newton's method of gauss_legendre, generalized_alpha, rattle and
            shake. The other integrators have none.
        solver: Solver in place of that of the scene: its type, or from Python an entry.
        say: Called with each line for people; without it the lines go to `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.

    Returns:
        Table `samples`: `time`, `<joint>.position`, `.velocity`, `.acceleration`, `.effort`,
        `<joint>.multiplier`, `<part>.<quantity>`, `energy`, `drift.position`, `drift.velocity`;
        with actuators `<joint>.command`, with contacts `contacts.residual.primal` and so on; for
        free bodies `<body>.position.x` and so on. Table `events`, with the columns of
        `event_table`, if the scene can have events.

    Raises:
        Interrupted: The state diverged, the equations have no solution, or steps became too
            short; its `result` is the motion so far.
        MbdError: An input cannot be used.
    """
    options = options_of(scene, dt, integrator, tolerance, solver)
    run = Run(duration, origin, start, efforts, wrenches, options)
    remarks: list[str] = []
    with watching(progress):
        result = run_simulation(scene, run, say or remarks.append)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def run_simulation(scene: Scene, run: Run, say: Say) -> Result:
    """Return the result of `simulate` for an order."""
    check_run(scene, run)
    if not scene.robot.model.nv:
        raise DataError(f"{scene.name}: no joint of the robot moves, so there is no motion")
    sources, forces, remarks = read_inputs(scene, run)
    options = {**run.options, "dt": _interval(scene, run)}
    simulation = build_simulation(scene, forces=forces, sources=sources, tell=announce, **options)
    x, more = initial_state(scene, run)
    inputs = simulation.system.loads.sources.at(x.t)
    fibers = fiber_warnings(scene.robot, scene.muscles, x, inputs)
    doubts = (
        *scene.robot.inertia_warnings,
        *start_warnings(scene.robot, scene.constraints, x),
        *fibers,
    )
    how = (simulation.how,) if simulation.how else ()
    for text in (*remarks, *more, *how, *(f"warning: {text}" for text in doubts)):
        say(text)
    begin = time.perf_counter()
    states, residuals, forces, failure = _states(simulation, x, run)
    wall = time.perf_counter() - begin
    evaluations = simulation.evaluations
    _say_windows(scene, simulation, states, say)
    table, of_samples, lost = table_of(simulation, states, forces, scene.sensors)
    table, of_contacts = _with_residuals(table, residuals)
    topics = topics_of(simulation.system)
    tables = {MAIN: table}
    if simulation.guards:
        tables[EVENTS] = event_table(simulation, simulation.events)
    result = Result(tables, metadata_of("simulate", scene, run.inputs, topics))
    if phases := phase_names(simulation.system):
        result.metadata["phases"] = list(phases)
    failure = lost or failure
    if failure is not None:
        return _ended(scene, result, failure)
    with about(scene.name):
        lines = [*summary(simulation, table, wall, evaluations), *of_contacts, *of_samples]
        warnings = step_warnings(
            simulation.system, simulation.integrator, simulation.dt, states, simulation.events
        )
        lines += [f"warning: {text}" for text in warnings]
        lines += [f"warning: {text}" for text in simulation.passed_stops()]
    if scene.wrenches and run.wrenches is None:
        say(f"external loads without values: {', '.join(scene.wrenches)}; give --wrenches FILE")
    for text in lines:
        say(text)
    return result


def _interval(scene: Scene, run: Run) -> float:
    """Return the interval of the output [s], which is at most the duration."""
    return min(float(run.options.get("dt", scene.dt)), run.duration)


def _states(
    simulation: Simulation, x: State, run: Run
) -> tuple[list[State], list[Residuals], list[Array | None], MbdError | None]:
    """Simulate; return states, residuals and forces of contacts, and the error of an early end."""
    states: list[State] = []
    residuals: list[Residuals] = []
    forces: list[Array | None] = []
    count = round(run.duration / simulation.dt)
    duration = _duration(run, simulation.dt)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a divergence is an error of its own
            every = simulation.run(x, duration, _warn)
            for state in shown(every, count, "simulate"):
                states.append(state)
                if (worst := simulation.take_residuals()) is not None:
                    residuals.append(worst)
                    forces.append(simulation.stepper.forces)
    except (DivergedError, SolveError) as error:
        return states, residuals, forces, error
    except KeyboardInterrupt:
        if not states:
            raise
        return states, residuals, forces, _CtrlC(f"interrupted after t = {states[-1].t:.9g} s")
    return states, residuals, forces, None


def _duration(run: Run, dt: float) -> float:
    """Return the duration, without a last interval too short for a stamp of its own."""
    count = math.floor(run.duration / dt + SAME_TIME)
    is_sliver = SAME_TIME * dt < run.duration - count * dt < SHORTEST_DT
    return count * dt if is_sliver else run.duration


def _warn(text: str) -> None:
    """Print a warning at once, while the run continues."""
    erased = "\r\x1b[K" if sys.stderr.isatty() else ""  # erases the line of `progress`
    sys.stderr.write(f"{erased}warning: {text}\n")
    sys.stderr.flush()


class _CtrlC(MbdError):
    """Ctrl-C as the reason for the end of a simulation."""


def _say_windows(scene: Scene, simulation: Simulation, states: Sequence[State], say: Say) -> None:
    """Report on compliant contacts, also if the motion diverged."""
    contacts = scene.parts.get("contacts", ())
    parts = [part for part in contacts if isinstance(part, Load) and part.is_compliant_contact]
    if parts and states:
        for text in window_lines(simulation, parts, states):
            say(text)


def _with_residuals(table: Table, residuals: list[Residuals]) -> tuple[Table, list[str]]:
    """Add residuals of contacts to the table; also return a line about them."""
    if not residuals:
        return table, []
    return with_residuals(table, residuals), [residual_line(residuals)]


def _ended(scene: Scene, result: Result, failure: MbdError) -> Result:
    """Return the result of a run that Ctrl-C ended; raise that of one that ended otherwise."""
    if not result[MAIN].rows:
        raise type(failure)(f"{scene.name}: {failure}") from failure
    result.metadata["ended"] = str(failure)
    if isinstance(failure, _CtrlC):
        return result
    early = Interrupted(str(failure))
    early.result = result
    raise early from failure


class Interrupted(MbdError):
    """A simulation that ended early.

    Attributes:
        result: The motion so far; None if it is in a file.
        exit_code: Exit code of the command line.
    """

    exit_code = FAILED
    result: Result | None = None


def simulate_to(scene: Scene, run: Run, out: Path, say: Say, events: Path | None = None) -> None:
    """Simulate and write the result.

    Args:
        run: The order.
        out: Path whose suffix chooses the format.
        say: Called with each line for people.
        events: Path for the table of events by itself.

    Raises:
        Interrupted: The simulation ended early, perhaps by Ctrl-C; the message names the file of
            `diverged_place` with the states so far.
        MbdError: An input cannot be used, or a file cannot be written.
    """
    places = [out] if events is None else [out, events]
    sources = [source for source in (run.origin, run.efforts, run.wrenches) if source is not None]
    for place in (*places, *map(diverged_place, places)):
        refuse_overwriting(place, *(s for s in sources if isinstance(s, Path)))
    check_stamps(scene, run, out)
    for place in places:
        check_place(place)
    if events is not None:
        _check_events(scene, run, events, out)
    write_result(places, lambda: run_simulation(scene, run, say), say)


def diverged_place(out: Path) -> Path:
    """Return the path of a run that ended early: o.csv -> o.diverged.csv, bag -> bag_diverged.

    Raises:
        DataError: No format has the suffix of `out`.
    """
    suffix = suffix_of(out)
    if suffix == FOLDER:
        return out.parent / f"{out.name.replace('.', '_')}_diverged"
    return out.with_name(f"{out.name.removesuffix(suffix)}.diverged{suffix}")


def _check_events(scene: Scene, run: Run, events: Path, out: Path) -> None:
    """Refuse an impossible file of events.

    Raises:
        DataError: It is the file of the motion, or nothing in the scene has events.
    """
    if events.resolve() == out.resolve():
        raise DataError(f"--events {events}: is the file of -o, choose another name")
    if not build_simulation(scene, **run.options).guards:
        raise DataError(f"--events: {scene.name} has no events, such as impacts")


def summary(simulation: Simulation, table: Table, wall: float, evaluations: int) -> Iterator[str]:
    """Yield lines about the steps, their cost, and the conservation of energy and constraints.

    Args:
        simulation: The simulation after its run.
        table: Its samples.
        wall: Wall time of the run [s].
        evaluations: Number of evaluations of accelerations.
    """
    duration = table[TIME][-1] - table[TIME][0]
    energy, position, velocity = (table[name] for name in BALANCE)
    change = float(np.abs(energy - energy[0]).max())
    per_step = evaluations / max(simulation.steps, 1)
    method = simulation.integrator.title
    yield (
        f"{method}, tier {tier_of(simulation.system)}: {simulation.steps} steps, {evaluations} "
        f"evaluations ({per_step:.2f} a step)"
    )
    if isinstance(simulation.stepper, BlockStepper) and simulation.stepper.handed_over:
        yield f"{simulation.stepper.handed_over} of the steps were not compiled: {_UNCOMPILED}"
    yield f"{wall:.3f} s for {duration:g} s, real-time factor {duration / max(wall, 1e-9):.1f}"
    yield f"energy {energy[0]:.6g} J, largest change {change:.3g} J"
    yield f"largest violation: position {position.max():.2g}, velocity {velocity.max():.2g}"
    if phases := phase_names(simulation.system):
        ends = [event.before.mode[0] for event in simulation.events if event.ends_phase]
        counts = (f"{name} {ends.count(i)} times" for i, name in enumerate(phases))
        yield f"phases ended: {', '.join(counts)}"
    condition, t = simulation.worst
    if 1.0 < condition < np.inf:
        doubt = "; near a toggle, multipliers there are unreliable" if condition > TOGGLE else ""
        yield f"condition number of the rows up to {condition:.2g}, at t = {t:g} s{doubt}"
    if simulation.system.bounded is not None:
        s = simulation.system.bounded.qp.statistics
        yield f"QP: {s.solves} solves, {s.cold} cold, {s.damped} damped, {s.failed} failed"


def write_result(places: Sequence[Path], simulation: Callable[[], Result], say: Say) -> None:
    """Write the result of a simulation, or the motion so far if it ends early.

    Args:
        places: File of the result, and perhaps a file for its events.
        simulation: Function that simulates; Ctrl-C may end it.
        say: Called with a line for each file.

    Raises:
        Interrupted: The simulation ended early; the message names the files of `diverged_place`.
    """
    try:
        result = simulation()
    except Interrupted as early:
        assert early.result is not None
        raise Interrupted(f"{early}; {_write_early(places, early.result)}") from early
    if "ended" in result.metadata:
        stopped = Interrupted(f"{result.metadata['ended']}; {_write_early(places, result)}")
        stopped.exit_code = INTERRUPTED
        raise stopped
    for text in _write(result, *places):
        say(text)


def _write_early(places: Sequence[Path], result: Result) -> str:
    """Write the motion so far; a failure must not hide the reason for the early end."""
    try:
        texts = list(_write(result, *map(diverged_place, places)))
    except DataError as error:
        return f"the states so far are lost: {error}"
    return ", ".join(text.replace(" -> ", " so far are in ") for text in texts)


def _write(result: Result, out: Path, events: Path | None = None) -> Iterator[str]:
    """Write the files, and yield a line for each."""
    result.to(out)
    yield f"{result[MAIN].rows} states -> {out}"
    if events is not None:
        options = {"table": EVENTS} if format_of(events).one_table else {}
        Result({EVENTS: result[EVENTS]}, result.metadata).to(events, **options)
        yield f"{result[EVENTS].rows} events -> {events}"
