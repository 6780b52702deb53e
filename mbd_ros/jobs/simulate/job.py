"""Forward simulation of a scene into a file: `mbd-ros simulate`."""

import math
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.projection.assembly import violation
from mbd_ros.core.simulation.simulation import Commands, Simulation
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.core.thresholds import SAME_TIME, TOGGLE
from mbd_ros.errors import (
    FAILED,
    INTERRUPTED,
    DataError,
    DivergedError,
    MbdError,
    SolveError,
)
from mbd_ros.files.bag_paths import SUFFIXES
from mbd_ros.files.formats import is_bag
from mbd_ros.files.records import SimulationRecord, finite_rows
from mbd_ros.files.replacing import refuse_overwriting
from mbd_ros.files.results import write_simulation
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.progress import progress
from mbd_ros.jobs.simulate.inputs import Run, check_words, drives, initial_state
from mbd_ros.jobs.simulate.step_check import step_warnings
from mbd_ros.scene.built_scene import SHORTEST_DT, Scene
from mbd_ros.scene.start_check import start_warnings


class Interrupted(MbdError):
    """A simulation that ended early; what it had reached is in a file of its own."""

    exit_code = FAILED


class _CtrlC(MbdError):
    """Ctrl-C, as the reason why a simulation ended."""


def simulate(scene: Scene, run: Run) -> Iterator[str]:
    """Simulate and write states, multipliers, energy and violations.

    Yields:
        The summary, a line each.

    Raises:
        Interrupted: The state diverged, equations have no solution, steps became too short to go
            on, or Ctrl-C was pressed; the states so far are in
            the file of `diverged_place`, named in the message.
        MbdError: Input that cannot be used.
    """
    check_words(scene, run)
    if not scene.robot.joints:
        raise DataError(f"{scene.name}: no joint of the robot moves, so there is no motion")
    kept = diverged_place(run.out)
    for place in (run.out, kept):
        refuse_overwriting(place, run.origin, run.efforts, run.wrenches)
    commands, forces, remarks = drives(scene, run)
    simulation = scene.simulation(forces=forces, **{**run.options, "dt": _interval(scene, run)})
    x, more = initial_state(scene, run)
    yield from (*remarks, *more)
    odd = (*scene.robot.doubts, *start_warnings(scene.robot, scene.constraints, x))
    yield from (f"warning: {text}" for text in odd)
    begin = time.perf_counter()
    states, failure = _states(simulation, x, run, commands)
    wall = time.perf_counter() - begin
    evaluations = simulation.system.evaluations
    record, lost = _record(simulation, states, commands)
    failure = lost or failure
    if failure is not None:
        if not len(record.times):
            raise type(failure)(f"{scene.name}: {failure}") from failure
        early = Interrupted(f"{failure}; {_kept(kept, record)}")
        early.exit_code = INTERRUPTED if isinstance(failure, _CtrlC) else FAILED
        raise early
    with about(scene.name):
        said = list(_summary(simulation, record, wall, evaluations))
        found = step_warnings(simulation.system, simulation.integrator, simulation.dt, states)
        said += [f"warning: {text}" for text in found]
        said += [f"warning: {text}" for text in simulation.passed_stops()]
    write_simulation(run.out, record)  # nothing fails after it
    if scene.wrenches and run.wrenches is None:
        yield f"unloaded: {', '.join(scene.wrenches)}; --wrenches FILE brings their values"
    yield from said
    yield f"{len(states)} states -> {run.out}"


def _interval(scene: Scene, run: Run) -> float:
    """Interval of the output [s]; no longer than the simulation."""
    return min(float(run.options.get("dt", scene.dt)), run.duration)


def _duration(run: Run, dt: float) -> float:
    """That of the run, without a last interval that is too short to have a stamp of its own."""
    count = math.floor(run.duration / dt + SAME_TIME)
    is_sliver = SAME_TIME * dt < run.duration - count * dt < SHORTEST_DT
    return count * dt if is_sliver else run.duration


def diverged_place(out: Path) -> Path:
    """Where a run that ended early is kept: o.csv.gz -> o.diverged.csv.gz, bag -> bag_diverged.

    Raises:
        DataError: `out` names neither a table nor a bag.
    """
    if is_bag(out) and (out.is_dir() or out.suffix not in SUFFIXES):
        return out.parent / f"{out.name.replace('.', '_')}_diverged"
    suffix = ".csv.gz" if out.name.endswith(".csv.gz") else out.suffix
    return out.with_name(f"{out.name.removesuffix(suffix)}.diverged{suffix}")


def _kept(place: Path, record: SimulationRecord) -> str:
    """Write what was reached; where that fails the reason must not hide why the run ended."""
    try:
        write_simulation(place, record)
    except DataError as error:
        return f"the states so far are lost: {error}"
    return f"{len(record.times)} states so far are in {place}"


def _warn(text: str) -> None:
    """Said at once, while the run goes on."""
    erased = "\r\x1b[K" if sys.stderr.isatty() else ""  # the line of `progress`
    sys.stderr.write(f"{erased}warning: {text}\n")
    sys.stderr.flush()


def _states(
    simulation: Simulation, x: State, run: Run, commands: Commands | None
) -> tuple[list[State], MbdError | None]:
    states: list[State] = []
    count = round(run.duration / simulation.dt)
    duration = _duration(run, simulation.dt)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a divergence says so itself
            every = simulation.run(x, duration, commands, _warn)
            states.extend(progress(every, count, "simulate"))
    except (DivergedError, SolveError) as error:
        return states, error
    except KeyboardInterrupt:
        if not states:
            raise
        return states, _CtrlC(f"interrupted after t = {states[-1].t:.9g} s")
    return states, None


def _record(
    simulation: Simulation, states: Sequence[State], commands: Commands | None
) -> tuple[SimulationRecord, MbdError | None]:
    """What is written of states, up to the first one without a finite answer, and why it ends."""
    system, rows = simulation.system, []
    failure: MbdError | None = None
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for x in states:
                rows.append(_row(system, x, commands))
    except SolveError as error:
        failure = error
    joints, m = system.robot.joints, len(system.multiplier_rows)
    q_index, v_index = [j.q for j in joints], [j.v for j in joints]
    nq, nv = system.model.nq, system.model.nv
    t, q, v, a, effort, multiplier, balance = (
        np.array([row[i] for row in rows]).reshape(len(rows), width)
        for i, width in enumerate((1, nq, nv, nv, nv, m, 3))
    )
    record = SimulationRecord(
        stamps=np.round(t[:, 0] / NANOSECOND).astype(np.int64),
        times=t[:, 0],
        joints=tuple(joint.name for joint in joints),
        position=q[:, q_index],
        velocity=v[:, v_index],
        acceleration=a[:, v_index],
        effort=effort[:, v_index],
        rows=tuple(row.name for row in system.multiplier_rows),
        multiplier=multiplier,
        balance=balance,
        **_commands(system, t[:, 0], commands),
    )
    count, lost = finite_rows(record)
    return record.first(count), lost or failure


def _commands(system: System, times: Array, commands: Commands | None) -> dict[str, Any]:
    """Fields of a record: what actuators take that is not the torque of the joint."""
    takes = [a.takes for a in system.loads.actuators for _ in a.joints]
    at = [i for i, what in enumerate(takes) if what]
    if not at:
        return {}
    u = np.zeros((len(times), len(takes)))  # what no command stands for
    if commands is not None:
        u = np.array([commands(t) for t in times])
    return {"commanded": tuple(system.loads.commands[i] for i in at), "command": u[:, at]}


def _row(system: System, x: State, commands: Commands | None) -> tuple[Any, ...]:
    """Time, q, v, a, effort, multipliers and balance of one state."""
    y = system.reduce(x)
    u = None if commands is None else commands(x.t)
    a, lam = system.solve(y, u)
    balance = system.energy(y), *violation(system, y)
    return x.t, x.q, x.v, a, system.loads.actuator_torque(x, u), lam, balance


def _summary(
    simulation: Simulation, record: SimulationRecord, wall: float, evaluations: int
) -> Iterator[str]:
    duration = record.times[-1] - record.times[0]
    energy, position, velocity = record.balance.T
    change = float(np.abs(energy - energy[0]).max())
    per_step = evaluations / max(simulation.steps, 1)
    method = type(simulation.integrator).__name__
    yield (
        f"{method}, tier {tier_of(simulation.system)}: {simulation.steps} steps, {evaluations} "
        f"evaluations ({per_step:.2f} a step)"
    )
    yield f"{wall:.3f} s for {duration:g} s, real-time factor {duration / max(wall, 1e-9):.1f}"
    yield f"energy {energy[0]:.6g} J, largest change {change:.3g} J"
    yield f"largest violation: position {position.max():.2g}, velocity {velocity.max():.2g}"
    condition, t = simulation.worst
    if 1.0 < condition < np.inf:
        doubt = "; near a toggle, multipliers there are unreliable" if condition > TOGGLE else ""
        yield f"condition number of the rows up to {condition:.2g}, at t = {t:g} s{doubt}"
    if simulation.system.bounded is not None:
        s = simulation.system.bounded.qp.statistics
        yield f"QP: {s.solves} solves, {s.cold} cold, {s.damped} damped, {s.failed} failed"
